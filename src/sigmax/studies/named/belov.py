"""Terrain-aided navigation, each sigma set before and after the permutation of the state (Belov et al.)."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from sigmax.dependence import complexity, permutation
from sigmax.filters import Filter, get
from sigmax.models import Gaussian
from sigmax.records.maps import elevation
from sigmax.records.terrain import START, flight, middle, terrain_model
from sigmax.rules import SigmaPoints
from sigmax.running.explain import explain
from sigmax.studies.study import Charts, Study

# The paper's sets by the filter that uses them; its W (12), what the map and the whole equation (11) read.
_SETS: dict[str, tuple[str, dict[str, Any]]] = {
    "2n": ("CKF", {}),
    "2n+1": ("UKF", {}),
    "n+1": ("SKF", {"moireau": True}),
    "n+1 reversed": ("SKF", {}),
}
_W, _MAP, _EQUATION = (1, 0, 0, 0, 0, 2, 2), (5, 6), (0, 5, 6)
_UNITS = ("m", "m/s", "m/s²", "m/s", "m/s", "m", "m")


def terrain(map: str = "jacksboro", method: str = "bicubic") -> Study:
    """A flight over real heights; truth is drawn as the filters suppose, the optimum by particles.

    Args:
        map: jacksboro, or the path of an .npz or a GeoTIFF.
        method: bicubic or bilinear.
    """
    ground = middle(elevation(map, method))
    planned = flight(ground)
    model = terrain_model(ground)
    prior = Gaussian(np.zeros(len(START)), np.square(START))
    filters = {"EKF": get("EKF"), "PF": get("PF")}
    for name, (base, parameters) in _SETS.items():
        filters[f"{base} {name}"] = get(base, **parameters)
        filters[f"{base} {name} permuted"] = get(base, permute=True, **parameters)
    place = planned.place[len(planned.place) // 2]

    def extra() -> dict[str, Any]:
        return {"sigma_sets": {name: _told(get(base, **p), model, prior, place) for name, (base, p) in _SETS.items()}}

    return Study(
        name="belov-terrain",
        model=model,
        prior=prior,
        steps=len(planned.place),
        dt=planned.dt,
        title=f"Terrain-aided navigation over {map} ({method})",
        inputs=planned.place,
        filters=filters,
        runs=1000,
        look=(1, 10, 30, 100, len(planned.place)),
        particles=400,
        optimum="bank",
        optimum_runs=32,
        units=_UNITS,
        extra=extra,
        charts=_charts,
        about=(
            "State (10): errors of an inertial system; measurement (11): the height of a radio altimeter above real "
            "terrain. A permuted filter draws the points of the positions first, so that the map is looked up at the "
            "fewest points; its points come from another root of the same covariance.",
        ),
    )


def _charts(extra: Mapping[str, Any]) -> Charts:
    """Figure 1: time and Q of each set before and after, and how often the map is looked up."""
    sets = extra["sigma_sets"]
    titles: dict[str, Callable[[Any, int], Any]] = {
        "time of one linearisation [µs]": lambda told, k: (
            np.nan if told["seconds"] is None else 1e6 * told["seconds"][k]
        ),
        "Q": lambda told, k: told["Q"][k],
        "look-ups of the map": lambda told, k: told["evaluations"]["map"][k],
    }
    orders = ("as the state stands", "permuted")
    return {
        title: {order: {name: float(of(told, k)) for name, told in sets.items()} for k, order in enumerate(orders)}
        for title, of in titles.items()
    }


def _told(filter: Filter, model: Any, prior: Gaussian, place: np.ndarray) -> dict[str, Any]:
    """Of one set: evaluations and Q in the order of the state and in the paper's, and the time that is saved."""
    rule = filter.correct
    assert isinstance(rule, SigmaPoints)
    unit = rule.points(len(_W))
    orders = tuple(range(len(_W))), permutation(_W)

    def times(reads: tuple[int, ...]) -> list[int]:
        return [unit.counts[1 + max(order.index(c) for c in reads)] for order in orders]

    found = explain(filter, model, prior, inputs=place)[-1]
    return {
        "points": unit.evaluations,
        "evaluations": {"map": times(_MAP), "equation": times(_EQUATION)},
        "Q": [complexity(_W, unit.elements, order) for order in orders],
        "seconds": found.seconds,
        "time_saved": found.measured,
    }

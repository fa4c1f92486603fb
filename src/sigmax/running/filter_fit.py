"""The parameters of a filter itself, such as the spread of its points, by the likelihood of several records."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter, get
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.running.run import run


class FilterFit(NamedTuple):
    """What `fit_filter` found.

    Attributes:
        filter: the filter with the parameters of greatest likelihood.
        parameters: these.
        log_likelihood: of all records together.
        tried: all G combinations, in the order of the grid.
        by_record: log-likelihoods (G, B) of each record alone, −inf where a step of it failed.
    """

    filter: Filter
    parameters: dict[str, Any]
    log_likelihood: float
    tried: tuple[dict[str, Any], ...]
    by_record: np.ndarray


def fit_filter(
    name: str, grid: Mapping[str, Sequence[Any]], model: Model, prior: Gaussian, z: Any, **options: Any
) -> FilterFit:
    """Choose parameters of a filter (alpha, kappa, w0, order, …) from a grid, by the likelihood of several records.

    A grid, for the likelihood has several maxima over the spread of points. Several records, for a single one may by
    chance prefer points that fold over the circle: with Sobolev's prior as printed it does so in 13 % of the cases,
    and five records in 0.06 % (`python benchmarks/spread.py`).

    Args:
        name: of the catalogue.
        grid: values by parameter, such as {"alpha": [0.1, 0.5, 1.0]}; all combinations are tried.
        model: the model.
        prior: as in `run`.
        z: records (B, T, m), shorter ones with NaN at their ends; a dict of them by sensor.
        options: of `run`: dt, inputs, R, update_first, backend.

    Raises:
        InputError: for what `get` and `run` refuse, for a grid without values, for one record alone, and where every
            combination fails. Before the first run for all that can be seen then.

    It runs all records once for each combination, and compiles as often.
    """
    if not isinstance(grid, Mapping) or not grid or not all(len(values) for values in grid.values()):
        raise InputError(f"grid must hold values by parameter, such as {{'alpha': [0.1, 0.5, 1.0]}}; it is {grid!r}")
    if "keep" in options:
        raise InputError("fit_filter gives a filter, not a result: keep= belongs to run")
    if any(np.ndim(part) != 3 or len(part) < 2 for part in (z.values() if isinstance(z, Mapping) else [z])):
        raise InputError(
            "give several records, z (B, T, m) with B of two or more, better five: a single record may by chance "
            "prefer points so far apart that they fold, and others would lose their tracks with them"
        )
    tried = [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]
    filters = [get(name, **one) for one in tried]
    by_record = np.stack([_likelihoods(filter, model, prior, z, options) for filter in filters])
    together = by_record.sum(axis=1)
    best = int(np.argmax(together))
    if not np.isfinite(together[best]):
        raise InputError(f"{name} fails in a step of some record with every combination of {list(grid)} of the grid")
    return FilterFit(filters[best], tried[best], float(together[best]), tuple(tried), by_record)


def _likelihoods(filter: Filter, model: Model, prior: Gaussian, z: Any, options: dict[str, Any]) -> np.ndarray:
    """Of each record (B,); none where a step failed, as what was left out has no likelihood."""
    result = run(filter, model, prior, z, keep=("fault",), **options)
    sound = (np.asarray(result.fault) <= 0).all(axis=-1)
    return np.where(sound, np.nan_to_num(np.asarray(result.log_likelihood), nan=-np.inf), -np.inf)

"""Bearings with a random bias (Zhang et al., section 4), the same repaired, and a problem where two stages pay."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.filters import Filter, get
from sigmax.models import Bias, Gaussian, Model, fused, motions, sensors
from sigmax.studies.study import Study

_DEG = np.pi / 180
_APART = 500.0  # metres between the two platforms
_R = np.array([[0.15, 0.01], [0.01, 0.01]])
_PLACES = ((0.0, 0.0, 0.0), (30e3, 0.0, 0.0), (0.0, 30e3, 0.0), (30e3, 30e3, 0.0))  # of the radars, in metres
_STATE = ("x", "vx", "y", "vy")
_UNITS = ("m", "m/s", "m", "m/s", "rad")


def _straight(x: Any, dt: Any) -> Any:
    return jnp.stack([x[0] + dt * x[1], x[1], x[2] + dt * x[3], x[3]])


def _driven(density: float) -> np.ndarray:
    """The noise of one second."""
    one = density * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    return np.kron(np.eye(2), one)


def _both(x: Any) -> Any:
    """The angles at two platforms, arccos(x / r): it does not tell on which side of their line the target is."""
    return jnp.stack([jnp.abs(jnp.arctan2(x[2], x[0])), jnp.abs(jnp.arctan2(x[2], x[0] - _APART))])


def _filters() -> dict[str, Filter]:
    printed = {f"{name}:information=paper": get(name, information="paper") for name in ("CIF", "TSHCIF")}
    exact = {name: get(name) for name in ("EIF", "CKF", "HCKF", "TSHCKF", "TSHCIF", "MTSHCKF", "MTSHCIF")}
    return {**exact, **printed}


def _model(density: float, R: np.ndarray, bias: Bias, count: int) -> Model:
    if count < 1:
        raise InputError(f"there must be a station at least; stations = {count}")

    def each(given: Any) -> Any:
        return given if count == 1 else dict.fromkeys([f"station {k + 1}" for k in range(count)], given)

    made = Model(
        motion=_straight,
        state=_STATE,
        Q=_driven(density),
        sensor=each(_both),
        R=each(R),
        measurement=each(("α", "β")),
        bias=bias,
    )
    return made if count == 1 else fused(made)


def _bias(B: Any, count: int, Q: float, b0: float, variance: float) -> Bias:
    F = np.ones((2, 1))
    sensor: Any = F if count == 1 else {f"station {k + 1}": F for k in range(count)}
    return Bias(motion=B, sensor=sensor, Q=[Q], prior=Gaussian([b0], [variance]), names=("b",))


def bearings(unit: str = "radians", motion: str = "ones", bias: str = "walks", stations: int = 1) -> Study:
    """The set-up of the paper; what it leaves open is an option."""
    for what, given, known in (
        ("unit of R", unit, ("radians", "degrees")),
        ("motion bias", motion, ("ones", "none")),
        ("kind of bias", bias, ("walks", "constant")),
    ):
        if given not in known:
            raise unknown(what, given, known)
    B = np.ones((4, 1)) if motion == "ones" else None
    made = _bias(B, stations, 0.5 if bias == "walks" else 0.0, 0.1, 0.5)
    return Study(
        name="zhang-bearings",
        model=_model(0.5, _R if unit == "radians" else _R * _DEG**2, made, stations),
        prior=Gaussian([0.0, 10.0, 3.0, 10.0], np.eye(4)),
        steps=200,
        title="Bearings with a random bias, as printed (Zhang et al., section 4)",
        filters=_filters(),
        runs=500,
        look=(1, 20, 100, 200),
        units=_UNITS,
        about=(
            f"Zhang et al., 4.1 and 4.2: R in {unit}² , the motion's bias matrix "
            f"{'of ones' if motion == 'ones' else 'zero'}, the bias "
            f"{'walks with variance 0.5 a step' if bias == 'walks' else 'is constant'}, stations: {stations}.",
            "Truth is drawn from the stated model and prior. Then no estimator, with any number of stations and any "
            "accuracy of theirs, has a velocity error below √(qT / (2√3)) = 0.380 m/s; the printed 0.02 to 0.10 m/s "
            "are impossible, and so is a position error of 0.018 m (1.12 m) where the bound is tens of metres.",
        ),
    )


def repaired(s0: float = 400.0, stations: int = 1) -> Study:
    """The same stations with a geometry, a prior and a bias that tell filters apart."""
    if not s0 > 0:
        raise InputError(f"s0 is the standard deviation of the prior, above 0 m; s0 = {s0:g}")
    made = _bias(None, stations, (0.02 * _DEG) ** 2, 0.0, (2 * _DEG) ** 2)
    return Study(
        name="bearings-repaired",
        model=_model(0.05, _R * _DEG**2, made, stations),
        prior=Gaussian([-800.0, 8.0, 1200.0, -1.0], np.square([s0, 3.0, s0, 3.0])),
        steps=200,
        title="Bearings with a random bias, repaired",
        filters=_filters(),
        runs=1000,
        look=(1, 10, 50, 100, 200),
        limit=[200.0, np.inf, 200.0, np.inf, np.inf],
        units=_UNITS,
        about=(
            f"A target known to {s0:g} m, 1.4 km from two platforms 500 m apart; bearings to 0.39° and 0.1°, a common "
            f"bias of 2° that wanders by 0.02° a step; stations: {stations}. A run is lost where the position "
            "ends more than 200 m off.",
        ),
    )


def registration(biased: int = 2, radars: int = 3) -> Study:
    """Radars that do not agree: three offsets of each of the first ones (p = 3 biased) beside a state of six."""
    if radars > len(_PLACES):
        raise InputError(f"there are places for {len(_PLACES)} radars; radars = {radars}")
    if not 1 <= biased <= radars:
        raise InputError(f"of {radars} radars 1 to {radars} can be biased; biased = {biased}")
    straight = motions.constant_velocity(("x", "y", "z"))
    places = _PLACES[:radars]
    names = [f"radar {k + 1}" for k in range(radars)]
    p = 3 * biased
    deviation = np.array([50.0, 0.5 * _DEG, 0.5 * _DEG])
    offsets = Bias(
        sensor={s: np.eye(3, p, 3 * k) for k, s in enumerate(names[:biased])},
        Q=np.tile(np.square([0.05, 2e-4 * _DEG, 2e-4 * _DEG]), biased),
        prior=Gaussian(np.zeros(p), np.tile(np.square(deviation), biased)),
        names=[f"{s} {c}" for s in names[:biased] for c in ("range", "azimuth", "elevation")],
    )
    seen = {s: sensors.range_azimuth(at=(0, 1, 2), origin=place) for s, place in zip(names, places, strict=True)}
    model = Model(
        motion=straight,
        sensor=seen,
        Q=straight.noise(0.5),
        R={s: np.square([30.0, 0.2 * _DEG, 0.2 * _DEG]) for s in names},
        bias=offsets,
    )
    return Study(
        name="radar-registration",
        model=model,
        prior=Gaussian([20e3, -10e3, 6e3, -100.0, 150.0, 0.0], np.square([300.0, 300.0, 300.0, 30.0, 30.0, 30.0])),
        steps=100,
        dt=2.0,
        title="Radars that do not agree: six components, three offsets of each biased radar",
        # Two stages of the fifth degree in the order of [b; x] evaluate 2 (n + p)² + 1 points: minutes of compiling.
        filters={name: get(name) for name in ("EKF", "CKF", "TSCKF", "MTSCKF", "HCKF", "MTSHCKF", "MTSHCIF")}
        | {"TSHCKF:permute=1": get("TSHCKF", permute=True)},
        runs=256,
        look=(1, 10, 50, 100),
        units=(*("m",) * 3, *("m/s",) * 3, *("m", "rad", "rad") * biased),
        about=(f"{radars} radars see range, azimuth and elevation every 2 s; {biased} have offsets of 50 m and 0.5°.",),
    )

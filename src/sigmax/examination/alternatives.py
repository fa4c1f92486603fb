"""Hypotheses that change the record or the prior as a whole: units, signs, conventions, an overconfident prior."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.examination.axes import of_axes
from sigmax.examination.envelope import Envelope, component_names, curved, input_names
from sigmax.examination.envelope_runs import shifted
from sigmax.examination.exchanged import of_exchanged
from sigmax.examination.record_data import Alternative, RecordData
from sigmax.modelling.model import Model

# What a reading costs that moves the prior, too.
_WITH_START = 5.0
# A start found so has its covariance times this: it stands where the first measurement after the prior was made.
_WIDER = 100.0

# What is mistaken for what: the factor that mends the values, as people know it, what they are in, what the model has.
UNITS = {
    np.pi / 180: ("π/180", "degrees", "radians"),
    180 / np.pi: ("180/π", "radians", "degrees"),
    0.3048: ("0.3048", "feet", "metres"),
    1 / 0.3048: ("1/0.3048", "metres", "feet"),
    1852.0: ("1852", "nautical miles", "metres"),
    1 / 1852.0: ("1/1852", "metres", "nautical miles"),
    0.5144444444444445: ("0.5144", "knots", "m/s"),
    1 / 3.6: ("1/3.6", "km/h", "m/s"),
    3.6: ("3.6", "m/s", "km/h"),
}
# Of lengths and speeds, in words.
FACTORS = {
    1e3: "in thousands of the model's unit (km for m)",
    1e-3: "in thousandths of the model's unit (m for km, mm for m)",
    **{c: f"in {a} where the model has {b}" for c, (_, a, b) in UNITS.items() if "radians" not in (a, b)},
}
_OF_LENGTH, _OF_SPEED = ("feet", "metres", "nautical miles"), ("knots", "m/s", "km/h")


def alternatives(family: Envelope, record: RecordData, timed: bool) -> list[Alternative]:
    """All of a record; those of time where the motion depends on it."""
    found = [*_of_measurements(family, record), *_of_inputs(family), *of_axes(family)]
    found += of_exchanged(family, record)
    if timed:
        for c, said in ((1e-3, "ms where the model has s"), (1 / 60, "s where the model has minutes"), (60.0, "min")):
            found.append(_time(c, f"times are in {said}"))
        found.append(_time(1e3, "times are in thousands of the model's unit"))
    for c in (100.0, 1e4):
        found.append(
            Alternative(
                "prior",
                f"covariance × {c:g}",
                f"the prior is surer than it has a right to be (its covariance times {c:g} fits)",
                f"multiply the prior's covariance by {c:g}, or start from the measurements: sigmax.start",
                lambda r, c=c: replace(r, cov=r.cov * c),  # type: ignore[misc]
                factor=c,
            )
        )
    return found


def with_starts(family: Envelope, some: Sequence[Alternative]) -> list[Alternative]:
    """Readings of a sensor whose prior was made from the same values: it begins where they say then."""
    found = []
    for a in some:
        if a.sensor is None:
            continue
        mend = f"{a.mend}, and begin where it says then"
        found.append(replace(a, mend=mend, cost=_WITH_START, change=_begun(family, a.sensor, a.change)))
    return found


def _begun(
    family: Envelope, sensor: str, change: Callable[[RecordData], RecordData]
) -> Callable[[RecordData], RecordData]:
    return lambda r: begun(family, sensor, change(r))


def _time(c: float, cause: str) -> Alternative:
    return Alternative(
        "time units", f"dt × {c:.4g}", cause, f"multiply dt by {c:.4g}", lambda r: replace(r, dt=r.dt * c), factor=c
    )


def _of_measurements(family: Envelope, record: RecordData) -> Iterator[Alternative]:
    for s, m in family.sizes:
        if curved(family.plain, s):
            continue  # of attitudes there are other axes alone
        yield from (replace(a, sensor=s) for a in _of_sensor(family, record, s, m))


def _of_sensor(family: Envelope, record: RecordData, s: str, m: int) -> Iterator[Alternative]:
    names, angular = component_names(family.model, s, m), family.model.measured_angular(s, m)
    dimensions = measured_in(family.plain, record, s)
    for j, name in enumerate(names):
        count = int(np.isfinite(record.z[s][:, j]).sum())
        if angular[j]:
            yield from _of_angle(s, j, name, count)
        else:
            for c, said in _factors(dimensions[j]):
                yield _multiplied("units", s, j, name, c, said, f"{c:.4g}", count)
        yield Alternative("sign", name, f"{name} has the wrong sign", f"take −{name}", _affine(s, j, -1.0, 0.0))
    for i, j in combinations(range(m), 2):
        yield _exchanged(names[i], names[j], _swapped(s, i, j))


def measured_in(model: Model, record: RecordData, sensor: str) -> list[str]:
    """The unit of what a sensor measures: of states in m/s a speed, else of states in m a length; else unknown, ""."""
    units = dict(model.units)
    u = (jnp.asarray(record.u[0]),) if model.sensor_inputs[sensor] else ()

    def seen(x: np.ndarray) -> np.ndarray:
        return np.asarray(model.sensors[sensor](jnp.asarray(x), *u))

    middle, spread = seen(record.mean), np.sqrt(np.diag(record.cov))
    found = [""] * len(middle)
    for unit in ("m", "m/s"):
        for i, name in enumerate(model.deviations):
            if units.get(str(name)) == unit:
                there = shifted(model, record.mean, (spread[i] or 1.0) * (np.arange(len(spread)) == i))
                moves = seen(there) != middle
                found = [unit if moves[j] else one for j, one in enumerate(found)]
    return found


def _factors(dimension: str) -> list[tuple[float, str]]:
    """The factors of a length, a speed or either, and what values are in that need them."""
    other = {"m": _OF_SPEED, "m/s": _OF_LENGTH}.get(dimension, ())
    return [(c, said) for c, said in FACTORS.items() if c not in UNITS or UNITS[c][1] not in other]


def _multiplied(kind: str, s: str, j: int, name: str, c: float, said: str, by: str, count: int) -> Alternative:
    """So many values of a component of a sensor in another unit, which c, in words `by`, brings to the model's."""
    mend = f"multiply {name} by {by}"
    return Alternative(kind, name, f"{name} is {said}", mend, _affine(s, j, c, 0.0), count * np.log(c), c)


def _exchanged(a: str, b: str, change: Callable[[RecordData], RecordData]) -> Alternative:
    return Alternative("swap", f"{a}, {b}", f"{a} and {b} stand in each other's place", "exchange them", change)


def _of_angle(s: str, j: int, name: str, count: int) -> Iterator[Alternative]:
    yield _multiplied("degrees", s, j, name, np.pi / 180, "in degrees; the model has radians", "π/180", count)
    for turn, said in ((np.pi, "180°"), (np.pi / 2, "−90°"), (-np.pi / 2, "90°")):
        yield Alternative(
            "turned",
            name,
            f"{name} is turned by {said}",
            f"add {turn / np.pi:g} π to {name}",
            _affine(s, j, 1.0, turn),
        )
    yield Alternative(
        "convention",
        name,
        f"{name} counts from the other axis and the other way round (north, clockwise against east, counter-clockwise)",
        f"take π/2 − {name}",
        _affine(s, j, -1.0, np.pi / 2),
    )


def _of_inputs(family: Envelope) -> Iterator[Alternative]:
    names = input_names(family.plain, family.driven)
    for i, name in enumerate(names):
        changes = (
            ("degrees", np.pi / 180, f"{name} is in degrees; the model has radians", f"multiply {name} by π/180"),
            ("sign", -1.0, f"{name} has the wrong sign", f"take −{name}"),
            ("units", 1e3, f"{name} is {FACTORS[1e3]}", f"multiply {name} by 1000"),
            ("units", 1e-3, f"{name} is {FACTORS[1e-3]}", f"multiply {name} by 0.001"),
        )
        for kind, c, cause, mend in changes:
            yield Alternative(kind, name, cause, mend, _input(i, c), factor=0.0 if kind == "sign" else c)
    for p in family.parameters:
        if p.kind == "input rotation":
            i, j = p.at
            yield _exchanged(names[i], names[j], _swapped_inputs(i, j))


def _affine(s: str, j: int, c: float, offset: float) -> Callable[[RecordData], RecordData]:
    return lambda r: r.with_values(s, j, c * r.z[s][:, j] + offset)


def _swapped(s: str, i: int, j: int) -> Callable[[RecordData], RecordData]:
    return lambda r: r.with_values(s, i, r.z[s][:, j]).with_values(s, j, r.z[s][:, i])


def _swapped_inputs(i: int, j: int) -> Callable[[RecordData], RecordData]:
    def change(r: RecordData) -> RecordData:
        u = r.u.copy()
        u[:, [i, j]] = u[:, [j, i]]
        return replace(r, u=u)

    return change


def _input(i: int, c: float) -> Callable[[RecordData], RecordData]:
    def change(r: RecordData) -> RecordData:
        u = r.u.copy()
        u[:, i] *= c
        return replace(r, u=u)

    return change


def begun(family: Envelope, sensor: str, record: RecordData) -> RecordData:
    """The record with a prior near the old one from which a sensor would see its first whole measurement.

    As many components move as the measurement tells of, by as few of their deviations as will do.
    """
    from scipy.optimize import least_squares

    z = record.z[sensor]
    whole = np.flatnonzero(np.isfinite(z).all(1))
    spread = np.sqrt(np.diag(record.cov))
    if not len(whole) or not spread.any():
        return record
    k = int(whole[0])
    model = family.plain
    u = (jnp.asarray(record.u[k]),) if model.sensor_inputs[sensor] else ()
    seen = jax.jit(model.sensors[sensor])
    space = model.measured_space(sensor, z.shape[1])
    size = np.where(space.periodic, 1.0, 1.0 if not space.flat else np.maximum(np.abs(z[k]), 1e-9))

    def miss(y: np.ndarray) -> np.ndarray:
        there = np.asarray(seen(jnp.asarray(shifted(model, record.mean, spread * y)), *u))
        return np.concatenate([space.difference(there, z[k]) / size, 1e-7 * y])

    with np.errstate(all="ignore"):
        start = miss(np.zeros(len(spread)))
        if not np.isfinite(start).all():
            return record
        found = least_squares(miss, np.zeros(len(spread)), diff_step=np.full(len(spread), 1e-4), max_nfev=60)
    if not np.isfinite(found.x).all():
        return record
    return replace(record, mean=shifted(model, record.mean, spread * found.x), cov=record.cov * _WIDER)

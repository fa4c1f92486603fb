"""Numbers of a record that are to be fitted, by their names, and where they stand."""

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sigmax.corrections.filter_numbers import NAMES, start_of
from sigmax.descriptions.trial import Trial
from sigmax.errors import InputError, unknown
from sigmax.files.units import parts_of_quantity
from sigmax.records.record import Record

Place = tuple[str | int, ...]
# Where numbers of a description may be freed, "*" for any name; the last is that of the number.
_FREE = (
    "motion.noise.*", "motion.*.noise.*", "motion.tau", "motion.*.tau", "modes.*.motion.noise.*",
    "modes.*.motion.*.noise.*", "modes.*.motion.tau", "sensors.*.noise.*", "sensors.*.origin.*",
    "sensors.*.reference.*", "sensors.*.speed", "prior.*.mean", "prior.*.std", "bias.*.mean", "bias.*.std",
    "bias.*.noise",
)  # fmt: skip
_ASKED = re.compile(r"\s*([^=]+?)\s*(?:=\s*(\S+?)\s*\.\.\s*(\S+)\s*)?")


class Number(NamedTuple):
    """One number that is freed.

    Attributes:
        name: as it was asked for.
        kind: "factor" of Q or R, "value" of a component of state or bias, "filter" for one of the filter or of its
            update, "place" in a description.
        start: where it stands now, in its unit.
        unit: of the description, or SI.
        positive: whether it has to be.
        bounds: or None.
        at: the place in the description, or the names behind Q and R.
    """

    name: str
    kind: str
    start: float
    unit: str
    positive: bool
    bounds: tuple[float, float] | None
    at: Place = ()


def asked(text: Sequence[str]) -> dict[str, tuple[float, float] | None]:
    """Names and bounds from "Q,range_scale", "tau=1..30".

    Raises:
        InputError: for other syntax, and a name that comes twice.
    """
    found: dict[str, tuple[float, float] | None] = {}
    for piece in filter(None, (p.strip() for one in text for p in one.split(","))):
        match = _ASKED.fullmatch(piece)
        if match is None or ("=" in piece and match[2] is None):
            raise InputError(f"--free {piece!r} should be NAME or NAME=LOW..HIGH, as in Q,tau=1..30")
        if match[1] in found:
            raise InputError(f"--free names {match[1]} twice")
        try:
            found[match[1]] = None if match[2] is None else (float(match[2]), float(match[3]))
        except ValueError:
            raise InputError(f"--free {piece!r}: the bounds are numbers, in the unit of the number") from None
    if not found:
        raise InputError("--free names no number, such as --free Q,R")
    return found


def find(
    record: Record, path: Path | None, trial: Trial, names: Mapping[str, tuple[float, float] | None]
) -> list[Number]:
    """The numbers of these names.

    Args:
        record: the record.
        trial: its filter.
        path: of its description, None for one that is built in.
        names: and bounds.

    Raises:
        InputError: for a name that is none, or stands for several numbers.
    """
    places = {} if path is None else dict(_places(tomllib.loads(path.read_text(encoding="utf-8"))))
    return [_number(record, places, trial, name, bounds) for name, bounds in names.items()]


def _number(
    record: Record, places: dict[Place, Any], trial: Trial, name: str, bounds: tuple[float, float] | None
) -> Number:
    head, _, rest = name.partition(".")
    if head in ("Q", "R"):
        at = _of_noise(record, head, rest, name)
        return Number(name, "factor", 1.0, "", True, bounds, at)
    if name in record.components:
        bias = record.model.bias
        mean = np.atleast_2d(record.prior.mean).mean(0)
        mean = mean if bias is None else np.concatenate([mean, np.atleast_2d(bias.prior.mean).mean(0)])
        if record.model.curved:
            raise InputError(f"--free {name}: the state has parts that turn or point; free numbers of the description")
        at_start = float(mean[list(record.components).index(name)])
        return Number(name, "value", at_start, record.components[name].symbol, False, bounds, (name,))
    if name in NAMES:
        return Number(name, "filter", start_of(record, trial, name), "", False, bounds or NAMES[name].bounds, (name,))
    parts = tuple(re.sub(r"\[(\d+)\]", r".\1", name).split("."))
    fitting = [p for p in places if tuple(map(str, p))[-len(parts) :] == parts]
    fitting = [p for p in fitting if tuple(map(str, p)) == parts] or fitting
    if not fitting:
        known = ["Q", "R", *map(str, record.components), *NAMES, *(".".join(map(str, p)) for p in places)]
        raise InputError(f"--free: {unknown('number', name, known)}")
    if len(fitting) > 1:
        listed = ", ".join(".".join(map(str, p)) for p in fitting)
        raise InputError(f"--free: {name!r} may be {listed}: write one of them")
    value, unit = _parsed(places[fitting[0]])
    positive = str(fitting[0][-1]) not in ("mean",) and fitting[0][-2] not in ("origin", "reference")
    if positive and bounds is None and not value > 0:
        raise InputError(f"--free {name}: it is {places[fitting[0]]!r}; start it above 0, or give it bounds")
    return Number(name, "place", value, unit, positive, bounds, fitting[0])


def _of_noise(record: Record, head: str, rest: str, name: str) -> Place:
    """The components of a factor of Q, sensor and component of one of R."""
    if not rest:
        return (head,)
    if head == "Q":
        if rest not in record.model.deviations:
            raise InputError(f"--free {name}: {unknown('component', rest, record.model.deviations)}")
        return head, rest
    sensor, _, component = rest.partition(".")
    if sensor not in record.model.sensors and "" in record.model.sensors:
        sensor, component = "", rest
    if sensor not in record.model.sensors:
        raise InputError(f"--free {name}: {unknown('sensor', sensor, record.model.sensors)}")
    known = record.model.measured_deviations(sensor) or ()
    if component and component not in known:
        raise InputError(f"--free {name}: {unknown('component', component, known)}")
    return (head, sensor, component) if component else (head, sensor)


def _places(given: Any, above: Place = ()) -> Iterator[tuple[Place, Any]]:
    """Numbers of a TOML that may be freed, with their places."""
    items = given.items() if isinstance(given, dict) else enumerate(given) if isinstance(given, list) else ()
    for key, value in items:
        at = (*above, key)
        if isinstance(value, dict | list):
            yield from _places(value, at)
        elif any(_fits(at, pattern.split(".")) for pattern in _FREE) and _parsed(value) is not None:
            yield at, value


def _fits(at: Place, pattern: list[str]) -> bool:
    return len(at) == len(pattern) and all(p in ("*", str(a)) for a, p in zip(at, pattern, strict=True))


def _parsed(value: Any) -> Any:
    """Number and unit of a quantity, None for what is none."""
    if isinstance(value, str):
        try:
            return parts_of_quantity(value)
        except InputError:
            return None
    return (float(value), "") if isinstance(value, int | float) and not isinstance(value, bool) else None

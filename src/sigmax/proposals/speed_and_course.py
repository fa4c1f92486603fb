"""Which columns are speed and course over ground, and in which units: by names and by how positions change."""

import itertools
import re

import numpy as np

from sigmax.descriptions.local import VELOCITY, with_local
from sigmax.files.description import Column, LocalPart
from sigmax.files.table import Table
from sigmax.files.units import ANGLE, SPEED, is_unit_of
from sigmax.proposals.column_meanings import labels_of
from sigmax.proposals.roles import base_and_unit, named

# Names that say a unit: of AIS, ADS-B and NMEA.
_NAMES_OF_UNITS = r"sog|gs|cog|course.*|true_.*|(true_)?heading|hdg|track.*|trk"
# So many times nearer to the positions another unit must come to be taken.
_BETTER = 0.5
_SPEEDS = ("kn", "m/s", "km/h", "mph")


def speed_and_course(
    table: Table, clock: np.ndarray, part: LocalPart, place: np.ndarray, track: str | None, but: tuple[str | None, ...]
) -> tuple[tuple[Column, Column] | None, str]:
    """Columns of speed and course that agree with how positions change, and what is said of them."""
    found = named(table, "speed", but), named(table, "course", but)
    if not found[0] or not found[1]:
        return None, ""
    labels = labels_of(table, track).to_numpy() if track else None
    for course, speed in itertools.product(found[1], found[0]):
        numbers, values = table.numbers(speed), table.numbers(course)
        unknown = [102.3] if np.isclose(numbers, 102.3, atol=1e-9, rtol=0).any() else []
        missing = [360.0] if (values == 360).any() else []
        fits = []
        for turn, unit in itertools.product(_turns(course, values), _paces(speed)):
            both = (
                Column(column=speed, unit=unit, missing=unknown),
                Column(column=course, unit=turn, missing=missing),
            )
            whole = with_local(table, part.model_copy(update=dict(zip(("speed", "course"), both, strict=True))))
            fits.append((_misfit(whole.columns[list(VELOCITY)].to_numpy(float), place, clock, labels), both))
        # Units as the names have them, unless positions contradict them.
        misfit, best = next((fit for fit in fits if fit[0] < np.inf), (np.inf, None))
        for other, both in fits:
            if other < misfit * _BETTER:
                misfit, best = other, both
        if best is not None:
            words = f"{speed!r} in {best[0].unit} and {course!r} in {best[1].unit} are taken for the velocity."
            return best, words + _against(speed, best[0].unit, "kn") + _against(course, best[1].unit, "deg")
    return None, f"{found[0][0]!r} and {found[1][0]!r} do not fit how positions change, and are not used."


def _turns(course: str, values: np.ndarray) -> list[str]:
    """Units of a course: the one in its name, else degrees as AIS, ADS-B and NMEA have it; then the other."""
    if np.nanmax(np.abs(values)) > 6.4:
        return ["deg"]
    return ["rad", "deg"] if base_and_unit(course)[1] == "rad" else ["deg", "rad"]


def _paces(speed: str) -> tuple[str, ...]:
    unit = base_and_unit(speed)[1]
    return (unit,) if is_unit_of(unit, SPEED) else _SPEEDS


def _against(name: str, unit: str, usual: str) -> str:
    """A doubt where positions contradict what a name says of its unit."""
    base, named_unit = base_and_unit(name)
    usual = named_unit if is_unit_of(named_unit, ANGLE) else usual
    if unit == usual or not re.fullmatch(_NAMES_OF_UNITS, base):
        return ""
    return f" By its name {name!r} is in {usual}, but positions change as if it were in {unit}: see to it."


def _misfit(velocity: np.ndarray, place: np.ndarray, clock: np.ndarray, labels: np.ndarray | None) -> float:
    """How far velocities (T, 2) are from the change of positions, in units of the speed; inf if those are others."""
    codes = np.zeros(len(clock), int) if labels is None else np.unique(labels.astype(str), return_inverse=True)[1]
    order = np.lexsort((clock, codes))
    order = order[~np.isnan(place[order]).any(1) & ~np.isnan(velocity[order]).any(1)]
    elapsed = np.diff(clock[order])
    good = (np.diff(codes[order]) == 0) & (elapsed > 0)
    if good.sum() < 2:
        return np.inf
    moved = np.diff(place[order], axis=0)[good] / elapsed[good, None]
    said = (velocity[order][1:] + velocity[order][:-1])[good] / 2
    fast = np.linalg.norm(said, axis=1) > 0.5
    if fast.sum() < 2:
        return np.inf
    moved, said = moved[fast], said[fast]
    along = np.median((moved * said).sum(1) / (said**2).sum(1))
    off = np.median(np.linalg.norm(moved - said, axis=1) / np.linalg.norm(said, axis=1))
    return float(off) if 0.85 < along < 1.18 else np.inf

"""What the gates say of each sensor: whether its units, its clock and its noise can be right."""

from collections.abc import Sequence
from typing import NamedTuple

from sigmax.tracking.state import Told


class SensorHealth(NamedTuple):
    """One sensor over a record.

    Attributes:
        sensor: its name.
        scans: how many.
        plots: how many.
        gated: how many of these lay in the gate of a track.
        expected: plots that confirmed tracks should have had.
        found: plots they had.
        nis: of these, divided by the components measured: 1 for an honest noise; NaN for none.
        words: what is wrong, "" where nothing is.
    """

    sensor: str
    scans: int
    plots: int
    gated: int
    expected: float
    found: float
    nis: float
    words: str


def health(history: Sequence[Told]) -> list[SensorHealth]:
    """The statistics of the gates by sensor."""
    made = []
    tracked = any(t.confirmed.any() for t in history)
    for sensor in dict.fromkeys(t.sensor for t in history):
        own = [t for t in history if t.sensor == sensor]
        expected, found = sum(t.gates.expected for t in own), sum(t.gates.found for t in own)
        dof = sum(t.gates.dof for t in own)
        nis = sum(t.gates.nis for t in own) / dof if dof > 0 else float("nan")
        plots = sum(t.gates.plots for t in own)
        words = ""
        if plots and not tracked:
            words = f"none of its {plots} plots led to a confirmed track: are units, origin and noise right?"
        elif expected >= 10 and found < 0.2 * expected:
            words = (
                f"it found {found:.0f} of the {expected:.0f} plots that confirmed tracks should have had: are its "
                "units, its clock and its origin right?"
            )
        elif found >= 20 and nis > 2.5:
            words = f"its plots lie {nis**0.5:.1f} times as far from the tracks as its noise says: R is too small"
        elif found >= 20 and nis < 0.25:
            words = f"its plots lie {nis**-0.5:.1f} times as near to the tracks as its noise says: R is too large"
        made.append(SensorHealth(sensor, len(own), plots, sum(t.gates.gated for t in own), expected, found, nis, words))
    return made

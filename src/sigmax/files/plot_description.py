"""The TOML that describes plots without identities."""

import tomllib
from pathlib import Path
from typing import Any

from pydantic import Field

from sigmax.errors import InputError
from sigmax.files.description import Description, Section, TimeGiven
from sigmax.files.units import LENGTH, quantity


class DetectionPart(Section):
    """How a sensor detects: probability, density of clutter, and the period of one that turns."""

    detection: float
    clutter: float
    scan: Any = None


class TargetsPart(Section):
    """Where targets really were: a table with a row for each time and target."""

    data: str
    target: str
    time: TimeGiven


class TrackingPart(Section):
    """How plots become tracks."""

    max_speed: Any
    sensors: dict[str, DetectionPart] = Field(min_length=1)
    within: Any = None
    associate: str = "jpda"
    confirm: list[int] | None = None
    coast: Any = None
    late: Any = 0.0
    extent: Any = 0.0
    cutoff: Any = None
    truth: TargetsPart | None = None


class PlotDescription(Description):
    """A description with a table [tracking]; its prior is that of components a plot does not tell."""

    tracking: TrackingPart
    prior: dict[str, Any] = Field(default_factory=dict)


def describes_plots(path: Path) -> bool:
    """Whether a TOML file has a table [tracking]; a file that cannot be read has none."""
    try:
        return "tracking" in tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return False


def extent_of(part: TrackingPart) -> tuple[float, float]:
    """How far a target's own plots may lie from its middle: on its course and beside it, or one length for both.

    Raises:
        InputError: for what are no lengths.
    """
    given = part.extent
    pair = given if isinstance(given, list) else [given, given]
    if len(pair) != 2:
        raise InputError(f"tracking.extent is a length, or two: [on the course, beside it]; it is {given!r}")
    along, across = (quantity(v, LENGTH, "tracking.extent") for v in pair)
    return along, across

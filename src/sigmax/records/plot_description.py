"""The TOML that describes plots without identities."""

import tomllib
from pathlib import Path
from typing import Any

from pydantic import Field

from sigmax.records.description import ColumnGiven, Description, Section


class DetectionPart(Section):
    """How a sensor detects: probability, density of clutter, and the period of one that turns."""

    detection: float
    clutter: float
    scan: Any = None


class TargetsPart(Section):
    """Where targets really were: a table with a row for each time and target."""

    data: str
    target: str
    time: ColumnGiven


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

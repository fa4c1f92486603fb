"""The TOML that describes a record, and its errors in words."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from sigmax.errors import InputError, unknown
from sigmax.files.table import Table
from sigmax.files.toml_errors import in_words


class Section(BaseModel):
    """A table of the TOML; keys that are not known are refused with the nearest that are."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            raise PydanticCustomError("table", "{text}", {"text": f"must be a table of keys; it is {given!r}"})
        for key in given:
            if key not in cls.model_fields:
                raise PydanticCustomError("key", "{text}", {"text": str(unknown("key", key, cls.model_fields))})
        return given


def _as_column(given: Any) -> Any:
    return {"column": given} if isinstance(given, str) else given


def _as_list(given: Any) -> Any:
    return given if isinstance(given, list) else [given]


class Column(Section):
    """A column of the data, its unit, and numbers that mean none; no unit means SI and radians."""

    column: str
    unit: str = ""
    missing: Annotated[list[float], BeforeValidator(_as_list)] = Field(default_factory=list)

    def numbers(self, table: Table) -> np.ndarray:
        """What a table has in this column, as it stands there, NaN where it is missing.

        Raises:
            InputError: where there is no such column, or something else than numbers in it.
        """
        return table.numbers(self.column, self.missing)


class TimeColumn(Column):
    """The column of times; `format` is that of strftime, for dates that are written in another way than ISO 8601."""

    format: str = ""


ColumnGiven = Annotated[Column, BeforeValidator(_as_column)]
TimeGiven = Annotated[TimeColumn, BeforeValidator(_as_column)]


def _as_prior(given: Any) -> Any:
    return {"from": "measurements"} if given == "from measurements" else given


# A standard deviation by component, a covariance as rows of numbers, or "file.py:function".
Noise = Any


class MotionPart(Section):
    """One motion, built in or "file.py:function"; several are joined in their order."""

    kind: str
    noise: Noise
    axes: list[str] | None = None
    tau: Any = None
    state: dict[str, str] | None = None
    inputs: dict[str, ColumnGiven] = Field(default_factory=dict)


class ModePart(Section):
    """One of several modes that take turns: its motion, seconds that it lasts, its probability at the prior."""

    motion: Annotated[list[MotionPart], BeforeValidator(_as_list), Field(min_length=1)]
    sojourn: Any
    probability: float | None = None
    filter: str | None = None


class SensorPart(Section):
    """One sensor, built in or "file.py:function", and the columns that hold what it measured."""

    kind: str
    columns: dict[str, ColumnGiven]
    noise: Noise
    at: list[str] | None = None
    origin: list[Any] | None = None
    scale: str | None = None
    radial_velocity: bool = False
    clock: str | None = None
    system: str | None = None
    earth: bool | None = None
    reference: list[Any] | None = None
    speed: Any = None
    heading: str | None = None
    landmark: str | None = None
    measurement: dict[str, str] | None = None
    inputs: dict[str, ColumnGiven] = Field(default_factory=dict)
    update: str | None = None
    delay: Any = 0


def _as_lists(given: Any) -> Any:
    return {k: _as_list(v) for k, v in given.items()} if isinstance(given, dict) else given


Components = Annotated[dict[str, list[str]], BeforeValidator(_as_lists)]


class BiasPart(Section):
    """One component of a random bias: its prior, what it gains in a second, and what it acts on."""

    std: Any
    mean: Any = 0
    noise: Any = 0
    offset: Components = Field(default_factory=dict)
    scale: Components = Field(default_factory=dict)
    drift: Annotated[list[str], BeforeValidator(_as_list)] = Field(default_factory=list)


class BoundPart(Section):
    """What is known of a component of the state at all times, and when a step takes it, see `constrain`."""

    low: Any = None
    high: Any = None
    when: str = "predicted"


class LocalPart(Section):
    """Latitude and longitude, to be metres east and north of an origin; with a height, up; with speed and course, too.

    The frame is a plane at the origin, or "utm". Places farther from the origin than `within` count as not measured.
    """

    latitude: ColumnGiven
    longitude: ColumnGiven
    height: ColumnGiven | None = None
    frame: str = "plane"
    origin: list[Any] | None = None
    within: Any = None
    speed: ColumnGiven | None = None
    course: ColumnGiven | None = None


class LandmarkPart(Section):
    """Where landmarks stand: a table with a row for each."""

    data: str
    id: str
    x: ColumnGiven
    y: ColumnGiven
    z: ColumnGiven | None = None

    @property
    def axes(self) -> dict[str, Column]:
        """The columns of their coordinates."""
        return {"x": self.x, "y": self.y} | ({} if self.z is None else {"z": self.z})


class TablePart(Section):
    """Another table, whose columns are called NAME.column: its file, its clock, and how much that is ahead."""

    time: TimeGiven
    data: str = ""
    table: str = ""
    header: list[str] = Field(default_factory=list)
    track: str | None = None
    ahead: Any = 0
    local: LocalPart | None = None


class Description(Section):
    """All of it; the README of the format is docs/bring-your-own-data.md."""

    data: str
    time: TimeGiven
    motion: Annotated[list[MotionPart], BeforeValidator(_as_list)] = Field(default_factory=list)
    modes: dict[str, ModePart] = Field(default_factory=dict)
    sensors: dict[str, SensorPart] = Field(min_length=1)
    prior: Annotated[dict[str, Any], BeforeValidator(_as_prior)]
    bias: dict[str, BiasPart] = Field(default_factory=dict)
    bounds: dict[str, BoundPart] = Field(default_factory=dict)
    table: str = ""
    header: list[str] = Field(default_factory=list)
    tables: dict[str, TablePart] = Field(default_factory=dict)
    landmarks: LandmarkPart | None = None
    title: str = ""
    track: str | None = None
    decimal: str = "."
    sort: bool = False
    local: LocalPart | None = None
    filters: list[str] = Field(default=["EKF", "SRCKFB"], min_length=1)
    position: list[str] | None = None
    truth: dict[str, ColumnGiven] = Field(default_factory=dict)
    source: str = ""
    licence: str = ""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if bool(self.motion) == bool(self.modes):
            says = "both say how it moves: keep one" if self.motion else "say how it moves: write one"
            raise PydanticCustomError("empty", "{text}", {"text": f"[motion] or several [modes.NAME] {says}"})
        for name, sensor in self.sensors.items():
            if not sensor.columns:
                raise PydanticCustomError("empty", "{text}", {"text": f"sensors.{name}.columns names no column"})
        if self.decimal not in (".", ","):
            raise PydanticCustomError("empty", "{text}", {"text": f'decimal is "." or ","; it is {self.decimal!r}'})
        return self


S = TypeVar("S", bound=Section)


def read_toml(path: Path, kind: type[S]) -> S:
    """What a TOML file describes.

    Raises:
        InputError: where there is no such file, it is no TOML, or keys are missing, unknown or of the wrong kind.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        beside = sorted(p.name for p in path.parent.glob("*.toml")) if path.parent.is_dir() else []
        raise InputError(
            f"there is no file {path}" + (f"; beside it lie {', '.join(beside)}" if beside else "")
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read: {error}") from error
    try:
        return kind.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path.name} is not valid TOML: {error}") from error
    except ValidationError as error:
        raise InputError(f"{path.name}: {in_words(error)}") from error

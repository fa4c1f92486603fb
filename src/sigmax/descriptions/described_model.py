"""What a description becomes: a model with what the edges know of it."""

from typing import NamedTuple

from sigmax.descriptions.bias import Biased
from sigmax.descriptions.sensor import Sensing
from sigmax.files.description import Column
from sigmax.files.units import Dimension
from sigmax.filters import Update
from sigmax.models import Model


class Input(NamedTuple):
    """One input: where it comes from, what it is, and whose it is (no sensor: the motion's).

    One that is a standard deviation is positive.
    """

    column: Column
    dimension: Dimension | None
    sensor: str | None
    where: str
    deviation: bool = False

    @property
    def name(self) -> str:
        """What it is called, its sensor in front where it has one."""
        own = self.where.rpartition(".")[2]
        return own if self.sensor is None else f"{self.sensor}.{own}"


class DescribedModel(NamedTuple):
    """A model with what the edges know of it."""

    model: Model
    dimensions: tuple[Dimension, ...]
    position: tuple[int, ...]
    sensings: dict[str, Sensing]
    inputs: tuple[Input, ...]
    biased: Biased | None

    @property
    def updates(self) -> dict[str, Update]:
        """How sensors correct, of those that say so."""
        return {name: sensing.update for name, sensing in self.sensings.items() if sensing.update is not None}

"""Estimates over time as tables and pictures take them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import InputError


class Series(NamedTuple):
    """Estimates over time, the tracks first. What was not kept is missing, or None.

    Attributes:
        title: what they are.
        batched: whether there are tracks to tell apart.
        time: seconds or datetime64 (B, T).
        numbers: estimates (B, T) by name, of state and bias.
        deviations: standard deviations (B, T) by name, which of curved parts are those of their deviations.
        spread: standard deviations (B, T) of the numbers themselves, by their names; to first order on curved parts.
        angles: names of the numbers that are angles.
        places: names of the numbers that may be coordinates of a place, as those of an attitude are not.
        steps: by name what else there is of each step (B, T): nis, dof, log_likelihood, fault.
        modes: probabilities (B, T) by mode.
        units: by name of a number or deviation, empty where they are not known.
        noises: what variances of noises were multiplied by (B, T), by the name of their column.
    """

    title: str
    batched: bool
    time: np.ndarray
    numbers: Mapping[str, np.ndarray]
    deviations: Mapping[str, np.ndarray]
    spread: Mapping[str, np.ndarray]
    angles: frozenset[str]
    places: frozenset[str]
    steps: Mapping[str, np.ndarray]
    modes: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    noises: Mapping[str, np.ndarray]

    def columns(self) -> dict[str, tuple[np.ndarray, str]]:
        """All there is by step (B, T), with its unit, by the name of its column.

        Raises:
            InputError: where two columns would have one name.
        """
        known = self.units.get
        pairs: list[tuple[str, tuple[np.ndarray, str]]] = [
            *((name, (v, known(name, ""))) for name, v in self.numbers.items()),
            *((f"{name}_std", (v, known(name, ""))) for name, v in self.deviations.items()),
            *((f"probability_{name}", (v, "")) for name, v in self.modes.items()),
            *((name, (v, "")) for name, v in (*self.noises.items(), *self.steps.items())),
        ]
        names = ["track", "time", *(name for name, _ in pairs)]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise InputError(
                f"two columns of the table would be called {sorted(twice)}: rename components of the model"
            )
        return dict(pairs)

    @property
    def dated(self) -> bool:
        """Whether times are instants rather than seconds."""
        return self.time.dtype.kind == "M"


def needed(package: str, what: str) -> Any:
    """A package, imported now that it is used.

    Raises:
        InputError: with what to install where it is not there.
    """
    import importlib

    try:
        return importlib.import_module(package)
    except ImportError as error:
        name = package.split(".")[0]
        raise InputError(f"{what} needs {name}, which is not installed: pip install {name}") from error

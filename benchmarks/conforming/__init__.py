"""Adapters for the conformance kit, a file for each library: its filters as its documentation has them used.

Settings that have a default keep it; points that have none are alpha = 1, beta = 2, kappa = 0. Where a library offers
hooks or types for angles, they are used; where it offers none, laws of angles do not apply to it. A measurement that is
missing altogether is told in the library's own way, or by not calling its update where steps are the caller's.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from sigmax.conformance import Adapter, Task

ANGLES, MISSING, PARTLY = "angles", "missing", "partly missing"

_LIBRARIES = {
    "sigmax": "own",
    "filterpy": "filterpy",
    "bayesian-filters": "filterpy",
    "stonesoup": "stonesoup",
    "dynamax": "dynamax",
    "cuthbert": "cuthbert",
    "kalman-py": "kalman_py",
    "kalbee": "kalbee",
    "turbo-ckf": "turbo_ckf",
    "pykalman": "pykalman",
}


def libraries() -> dict[str, str | None]:
    """Every library by its distribution, and the version that is installed, if any."""

    def found(name: str) -> str | None:
        try:
            return version(name)
        except PackageNotFoundError:
            return None

    from sigmax import __version__

    return {name: __version__ if name == "sigmax" else found(name) for name in _LIBRARIES}


def adapters() -> Iterator[Adapter]:
    """Those of the libraries that are installed."""
    for name, installed in libraries().items():
        if installed is not None:
            for made in import_module(f"conforming.{_LIBRARIES[name]}").adapters(name, installed):
                # None of them says that a second correction at one moment is not allowed.
                yield replace(made, offers=made.offers | {"second update"})


@dataclass
class Steps:
    """A filter under way from two functions of mean and covariance, for libraries that keep no state."""

    mean: Any
    cov: Any
    moved: Callable[[Any, Any], tuple[Any, Any]]
    corrected: Callable[[Any, Any, Any], tuple[Any, Any]]

    def predict(self) -> None:
        """One step on."""
        self.mean, self.cov = self.moved(self.mean, self.cov)

    def update(self, z: np.ndarray) -> None:
        """Correct with z."""
        self.mean, self.cov = self.corrected(self.mean, self.cov, z)


def skipping(running: Any) -> Any:
    """The same filter, its update not called for a measurement that is missing altogether."""

    class Skipping:
        mean = property(lambda self: running.mean)
        cov = property(lambda self: running.cov)

        def predict(self) -> None:
            running.predict()

        def update(self, z: np.ndarray) -> None:
            if not np.isnan(z).all():
                running.update(z)

    return Skipping()


def circular(angles: tuple[bool, ...]) -> Callable[[Any, Any], np.ndarray]:
    """The weighted mean of points (N, k), that of angles by their sines and cosines."""

    def mean(points: Any, weights: Any) -> np.ndarray:
        directions = np.arctan2(weights @ np.sin(points), weights @ np.cos(points))
        return np.where(angles, directions, weights @ points)

    return mean


def column(task: Task) -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """Motion and sensor on columns (n, 1)."""
    return (
        lambda x, *_: task.f(np.ravel(x)).reshape(-1, 1),
        lambda x, *_: task.h(np.ravel(x)).reshape(-1, 1),
    )

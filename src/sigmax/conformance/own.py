"""Our own filters as adapters."""

from functools import lru_cache
from typing import Any

import numpy as np

from sigmax.conformance.task import Adapter, Running, Task
from sigmax.filters import Filter, get
from sigmax.models import Gaussian, Model, angle
from sigmax.running import Live


@lru_cache(maxsize=4)
def _model(task: Task) -> Model:
    import jax.numpy as jnp

    return Model(
        motion=lambda x, dt: task.motion(x, jnp),
        sensor=lambda x: task.sensor(x, jnp),
        Q=lambda dt: jnp.asarray(task.Q),
        R=task.R,
        state=_named("x", task.state_angles),
        measurement=_named("z", task.angles),
    )


class _Live:
    def __init__(self, filter: Filter, task: Task, mean: np.ndarray, cov: np.ndarray) -> None:
        self._live = Live(filter, _model(task), Gaussian(mean, cov))

    mean = property(lambda self: self._live.mean)
    cov = property(lambda self: self._live.cov)

    def predict(self) -> None:
        self._live.predict(1.0)
        self._sound()

    def update(self, z: np.ndarray) -> None:
        self._live.update(z)
        self._sound()

    def _sound(self) -> None:
        if not self._live.ok:
            raise ArithmeticError(f"the step is not sound: {self._live.fault}")


def own(name: str, degree: int = 3, **parameters: Any) -> Adapter:
    """A filter of the catalogue, run by `sigmax.Live`.

    Args:
        name: as `sigmax.get` takes it.
        degree: to which its means are exact.
        parameters: of the filter.
    """
    from sigmax import __version__

    filter = get(name, **parameters)

    def start(task: Task, mean: np.ndarray, cov: np.ndarray) -> Running:
        return _Live(filter, task, mean, cov)

    return Adapter(f"sigmax {name}", start, degree=degree, version=__version__)


def _named(letter: str, angles: tuple[bool, ...]) -> list[Any]:
    return [angle(f"{letter}{i}") if turning else f"{letter}{i}" for i, turning in enumerate(angles)]

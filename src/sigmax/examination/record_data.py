"""A record under examination, and another reading of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class RecordData:
    """A record and its prior, which a hypothesis may change.

    Attributes:
        z: by sensor (T, m), NaN where missing.
        dt: (T,).
        u: (T, K), inputs of the model and R by row; K may be 0.
        mean: of the prior (n,).
        cov: of the prior (n, n).
        extra: variances added to R, (M,) over the deviations of all sensors.
        out: values that are left out (T, M): their R grows by `huge` (M,), so that their innovations stay known.
        huge: see there.
        q_factor: of Q in each step (T,).
    """

    z: dict[str, np.ndarray]
    dt: np.ndarray
    u: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    extra: np.ndarray
    out: np.ndarray
    huge: np.ndarray
    q_factor: np.ndarray

    @property
    def interval(self) -> float:
        """The median of the intervals above 0, 1 where there is none."""
        positive = self.dt[self.dt > 0]
        return float(np.median(positive)) if positive.size else 1.0

    def by_sensor(self, a: np.ndarray) -> list[np.ndarray]:
        """What stands along the last axis for the numbers of all sensors, sensor by sensor; of flat ones."""
        return np.split(a, np.cumsum([v.shape[1] for v in self.z.values()])[:-1], axis=-1)

    def first(self, rows: int) -> "RecordData":
        """The first rows."""
        if rows >= len(self.dt):
            return self
        cut = {name: getattr(self, name)[:rows] for name in ("dt", "u", "out", "q_factor")}
        return replace(self, z={s: v[:rows] for s, v in self.z.items()}, **cut)

    def with_values(self, sensor: str, j: int, values: np.ndarray) -> "RecordData":
        """Another series of one component."""
        own = self.z[sensor].copy()
        own[:, j] = values
        return replace(self, z=self.z | {sensor: own})


@dataclass(frozen=True)
class Alternative:
    """Another reading of a record as a whole.

    Attributes:
        kind: "degrees", "units", "sign", "turned", "convention", "swap", "axes", "time units", "prior" or "manoeuvre".
        where: what is changed.
        cause: in words.
        mend: what to do.
        change: of the record.
        jacobian: added to the log-likelihood of changed values, which is that of the values as they came.
        factor: what the values are multiplied by; 0 where they are changed in another way.
        sensor: whose values are read in another way; None for anything else.
        cost: what it costs in log-likelihood for the choice among them.
    """

    kind: str
    where: str
    cause: str
    mend: str
    change: Callable[[RecordData], RecordData]
    jacobian: float = 0.0
    factor: float = 0.0
    sensor: str | None = None
    cost: float = 2.0

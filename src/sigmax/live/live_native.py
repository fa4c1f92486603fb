"""The state of a live filter on steps compiled for this machine."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from sigmax.engine.job import bind, empty_innovation, one_step, record
from sigmax.engine.lowered import Lowered, lowered
from sigmax.engine.native_engine import smoother, started
from sigmax.filters import Filter
from sigmax.modelling.model import Model
from sigmax.native.calls import ready
from sigmax.native.driver import Squares, pointer
from sigmax.results.covariances import Moments
from sigmax.steps.step import Belief, Innovation

# A step of more numbers than this takes some ten microseconds: long enough to let other threads run.
_MANY = 100


class NativeState:
    """Rows of numbers (B, size), and compiled half-steps that move them on.

    Attributes:
        whole: by sensor (None is the only one), what takes (dt, None, z) as they were given and does a whole step,
            or returns NotImplemented where they need a closer look. Only of sensors that are known beforehand.
        read_mean: gives the mean (n,) or (B, n).
        read_cov: gives the covariance (n, n) or (B, n, n).
        read_moments: gives both.
    """

    def __init__(self, filter: Filter, model: Model, mean: np.ndarray, cov: np.ndarray) -> None:
        self.filter, self.model = filter, model
        self._batched = mean.ndim == 2
        self._alone = mean.ndim == 1 or len(mean) == 1
        self.dtype = mean.dtype
        self._low: dict[int, Lowered] = {}
        low = self._lowered(0, None)
        self.packing = low.packing
        # Where it is known what will be needed, all is compiled side by side.
        driven = model.motion_driven or any(map(model.sensor_driven, model.sensors))
        named = {} if driven else {s: len(m) for s, m in model.measurement.items() if m is not None}
        if not driven:
            low.need(("start",), ("predict",), *(("correct", *about) for about in named.items()))
        self.rows = started(low, bind(low, model, ("start",)), mean, cov, len(mean) if self._batched else 1)
        self.fault = np.zeros(len(self.rows), np.int8)
        self._calls: dict[Any, Callable[..., Any]] = {}
        self._smoothers: dict[int, Callable[..., tuple[Any, ...]]] = {}
        tracks = slice(None) if self._batched else 0
        points, n = self.packing[:2]
        mean = self.rows[tracks, :points]
        self.read_mean = ready(None, None, len(self.rows), (), (mean,), kept=self.rows)
        factors = self.rows[:, points : self.packing.head]
        P = np.empty((len(self.rows), n, n), self.dtype)
        squaring = Squares(n, low.packing.size, 1, pointer(factors), pointer(P))
        squares = low.driver["squares"], squaring, len(P), ()
        self.read_cov = ready(*squares, (P[tracks],), kept=factors)
        self.read_moments = ready(*squares, (mean, P[tracks]), Moments, kept=factors)
        self.whole: dict[str | None, Callable[..., Any]] = {
            (s if model.several else None): self._ready(s, size, True, None, None) for s, size in named.items()
        }

    @property
    def belief(self) -> Belief:
        """The belief, batch last."""
        return self.belief_of(self.rows)

    def belief_of(self, rows: np.ndarray) -> Belief:
        """Rows as a belief."""
        whole = self.packing.unpacked(rows)
        return whole if self._batched else jax.tree.map(lambda a: a[..., 0], whole)

    def rows_of(self, belief: Belief) -> np.ndarray:
        """A belief as rows."""
        batched = belief if self._batched else jax.tree.map(lambda a: np.asarray(a)[..., None], belief)
        return self.packing.packed(batched).astype(self.dtype, copy=False)

    def held(self) -> np.ndarray:
        """What `put_held` takes up again, bit for bit; nobody changes it."""
        return self.rows.copy()

    def put_held(self, held: np.ndarray, fault: Any) -> None:
        """Take up what was held, and the faults of the tracks."""
        self.rows[:] = held
        self.fault[...] = fault

    def kept(self, helds: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Means (B, T, n), factors (B, T, n, n) and what stands behind them of T that were held; without B of one."""
        rows, n = np.stack(helds, 1), self.packing.n
        S = np.zeros((*rows.shape[:2], n * n), self.dtype)
        S[..., np.flatnonzero(np.tri(n))] = rows[..., self.packing.points : self.packing.head]
        parts = rows[..., : self.packing.points], S.reshape(*rows.shape[:2], n, n), rows[..., self.packing.head :]
        mean, factor, rest = parts if self._batched else (a[0] for a in parts)
        return mean, factor, rest if self.packing.tail else None

    def backwards(self, kept: Any, dt: np.ndarray, u: np.ndarray | None) -> tuple[Any, ...]:
        """Means, factors, faults and the rest of several steps, smoothed, laid out as they are kept."""
        inputs = 0 if u is None else u.shape[-1]
        if inputs not in self._smoothers:
            self._smoothers[inputs] = smoother(self.filter, self.model, inputs, self.dtype)
        return self._smoothers[inputs](kept, dt, u)

    @property
    def factor(self) -> np.ndarray:
        """(n, n) or (B, n, n)."""
        return self.kept([self.rows])[1][..., 0, :, :]

    def put(self, belief: Any, fault: Any) -> None:
        """Take up another belief, and the faults of the tracks."""
        self.put_held(self.rows_of(belief), fault)

    def predict(self, dt: float, u: np.ndarray | None) -> None:
        """Move on."""
        self._ready(None, 0, True, u, None)(dt, u, None)

    def update(self, sensor: str, z: np.ndarray, R: Any, u: np.ndarray | None) -> Innovation:
        """Correct."""
        return self._ready(sensor, z.shape[-1], False, u, R)(0.0, u, z)

    def step(self, sensor: str, dt: float, z: np.ndarray, R: Any, u: np.ndarray | None) -> Innovation:
        """Move on and correct."""
        return self._ready(sensor, z.shape[-1], True, u, R)(dt, u, z)

    def _ready(self, sensor: str | None, size: int, moving: bool, u: Any, R: Any) -> Callable[..., Any]:
        """The call for arguments of this kind, made when first needed; one with its own R is made each time."""
        key = sensor, size, moving, None if u is None else u.shape
        go = self._calls.get(key) if R is None else None
        if go is None:
            go = self._made(sensor, size, moving, u, R)
            if R is None:
                self._calls[key] = go
        return go

    def _lowered(self, inputs: int, other: Model | None) -> Lowered:
        """The steps for this many inputs, of another model where R is given with the measurement."""
        if other is not None:
            return lowered(self.filter, other, inputs, self.dtype, False, self._alone)
        if inputs not in self._low:
            self._low[inputs] = lowered(self.filter, self.model, inputs, self.dtype, alone=self._alone)
        return self._low[inputs]

    def _made(self, sensor: str | None, size: int, moving: bool, u: Any, R: Any) -> Callable[..., Any]:
        """A function of dt, u and z that does it, bound to arrays of its own: only numbers change from call to call.

        Raises:
            Refused: for a model or filter that cannot be lowered.
            Unavailable: without a compiler, or where it fails.
        """
        model = self.model
        if R is not None:
            model = model.with_noise(str(sensor), R)
        low = self._lowered(0 if u is None else u.shape[-1], None if R is None else model)
        B, tracks = len(self.rows), (len(self.rows),) if self._batched else ()
        needed = [*([("predict",)] if moving else []), *([("correct", sensor, size)] if sensor is not None else [])]
        parts = bind(low, model, *needed)
        dt = np.zeros((), self.dtype)
        inputs = np.empty(0 if u is None else u.shape, self.dtype)
        z = np.empty((*tracks, size), self.dtype)
        told = None if sensor is None else empty_innovation(B, model.measured_space(sensor, size).dim, self.dtype)
        job = record(
            low.packing,
            parts,
            model,
            self.rows,
            {} if sensor is None else {sensor: z[..., None, :]},
            dt[None] if moving else None,
            None if u is None else inputs[..., None, :],
            one_step(sensor, told, self.fault),
        )
        outputs = () if told is None else tuple(told if self._batched else (a.reshape(a.shape[1:]) for a in told))
        kept = parts, told, self.rows, self.fault, low
        long = low.packing.size > _MANY
        kind = None if told is None else Innovation
        return ready(low.driver["record"], job, B, (dt, inputs, z), outputs, kind, long, kept)

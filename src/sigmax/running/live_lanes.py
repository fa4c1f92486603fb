"""The state of a live filter on steps compiled for this machine."""

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from sigmax.filters import Filter
from sigmax.models.model import Model
from sigmax.native.driver import EMPTY, Record, Sensor, Squares, driver, over_cores, pointer, series
from sigmax.running.lanes import started
from sigmax.running.lowered import Lowered, lowered
from sigmax.running.step import Belief, Innovation


class _Call(NamedTuple):
    """A call made ready: only numbers change from one to the next.

    Attributes:
        job: what the driver takes, and where it lies.
        dt: where it reads the seconds, u the inputs, z the measurement.
        told: where it writes what the measurement said, by track.
        alive: what must not be freed before the job.
    """

    job: Record
    address: int
    dt: np.ndarray
    u: np.ndarray | None
    z: np.ndarray | None
    told: tuple[np.ndarray, ...]
    alive: Any


class LaneState:
    """Rows of numbers (B, size), and compiled half-steps that move them on."""

    def __init__(self, filter: Filter, model: Model, mean: np.ndarray, cov: np.ndarray) -> None:
        self.filter, self.model = filter, model
        self._batched = mean.ndim == 2
        self.dtype = mean.dtype
        low = self._lowered(0, None)
        self.packing = low.packing
        # Where it is known what will be needed, all is compiled side by side.
        if not (model.motion_inputs or any(model.sensor_inputs.values())):
            named = [("correct", s, len(m)) for s, m in model.measurement.items() if m is not None]
            low.need(("start",), ("predict",), *named)
        self.rows = started(low, mean, cov, len(mean) if self._batched else 1)
        self.fault = np.zeros(len(self.rows), np.int8)
        self._calls: dict[Any, Callable[..., Any]] = {}
        single = self.dtype == np.float32
        self._run, self._squares = driver(single)["record"], driver(single)["squares"]
        self._P = np.empty((len(self.rows), low.n, low.n), self.dtype)
        factors = self.rows[:, low.n :]
        self._squaring = Squares(low.n, low.packing.size, 1, pointer(factors), pointer(self._P))
        self._squaring_at = ctypes.addressof(self._squaring)

    @property
    def belief(self) -> Belief:
        """The belief, batch last."""
        whole = self.packing.unpacked(self.rows)
        return whole if self._batched else jax.tree.map(lambda a: a[..., 0], whole)

    @belief.setter
    def belief(self, belief: Belief) -> None:
        batched = belief if self._batched else jax.tree.map(lambda a: np.asarray(a)[..., None], belief)
        self.rows[:] = self.packing.packed(batched)

    @property
    def mean(self) -> np.ndarray:
        """(n,) or (B, n)."""
        n = self.packing.n
        return self.rows[:, :n].copy() if self._batched else self.rows[0, :n].copy()

    @property
    def factor(self) -> np.ndarray:
        """(n, n) or (B, n, n)."""
        n = self.packing.n
        S = np.zeros((len(self.rows), n * n), self.dtype)
        S[:, np.flatnonzero(np.tri(n))] = self.rows[:, n : n + n * (n + 1) // 2]
        return S.reshape(-1, n, n) if self._batched else S.reshape(n, n)

    @property
    def cov(self) -> np.ndarray:
        """(n, n) or (B, n, n)."""
        if self._batched:
            over_cores(self._squares, self._squaring, len(self.rows), self.dtype == np.float32)
            return self._P.copy()
        self._squares(self._squaring_at, 0, 1)
        return self._P[0].copy()

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
            go = self._bound(self._made(sensor, size, moving, u, R))
            if R is None:
                self._calls[key] = go
        return go

    def _bound(self, call: _Call) -> Callable[..., Any]:
        """A function of dt, u and z around a call: everything is looked up once, for the call takes microseconds."""
        run, job, address, batched = self._run, call.job, call.address, self._batched
        dt_in, u_in, z_in, told = call.dt, call.u, call.z, call.told
        count, single = len(self.rows), self.dtype == np.float32
        if told and not batched:
            residual, factor, *_ = (a[0] for a in told)
            _, _, nis, likelihood, dof = told

        # The job points into what the call keeps alive: the function has to hold on to it.
        def go(dt: float, u: Any, z: Any, _kept: _Call = call) -> Any:
            dt_in[0] = dt
            if u is not None:
                u_in[...] = u  # type: ignore[index]
            if z is None:
                over_cores(run, job, count, single)
                return None
            z_in[...] = z  # type: ignore[index]
            if batched:
                over_cores(run, job, count, single)
                return Innovation(*[a.copy() for a in told])
            run(address, 0, 1)
            return Innovation(residual.copy(), factor.copy(), nis[0], likelihood[0], dof[0])

        return go

    def _lowered(self, inputs: int, model: Model | None) -> Lowered:
        return lowered(self.filter, model or self.model, inputs, self.dtype, known_zeros=model is None)

    def _made(self, sensor: str | None, size: int, moving: bool, u: Any, R: Any) -> _Call:
        """A call made ready.

        Raises:
            Refused: for a model or filter that cannot be lowered.
            Unavailable: without a compiler, or where it fails.
        """
        model = self.model
        if R is not None:
            model = jax.tree.map(lambda leaf: leaf, model)
            model.R = {**model.R, str(sensor): R}
        low = self._lowered(0 if u is None else u.shape[-1], None if R is None else model)
        B, n = len(self.rows), low.n
        wanted = [*([("predict",)] if moving else []), *([("correct", sensor, size)] if sensor is not None else [])]
        found = dict(zip([part[0] for part in wanted], low.need(*wanted), strict=True))
        numbers = low.parameters(model)
        constants = {name: step.setup(numbers) for name, step in found.items()}
        dt = np.zeros(1, self.dtype)
        inputs = None if u is None else np.empty(u.shape, self.dtype)
        z = None if sensor is None else np.empty((B, size) if self._batched else size, self.dtype)
        told: tuple[np.ndarray, ...] = ()
        sensors = (Sensor * 1)()
        if z is not None:
            told = (
                np.empty((B, size), self.dtype),
                np.empty((B, size, size), self.dtype),
                np.empty(B, self.dtype),
                np.empty(B, self.dtype),
                np.empty(B, np.int64),
            )
            sensors[0] = Sensor(
                found["correct"].address,
                pointer(constants["correct"]),
                series(z, 1, self._batched, False),
                pointer(told[0]),
                pointer(told[1]),
            )
        job = Record(
            B,
            1,
            n,
            low.packing.size,
            found["predict"].address if moving else None,
            pointer(constants.get("predict")),
            series(dt, 1, False, False),
            EMPTY if inputs is None else series(inputs, 1, inputs.ndim == 2, False),
            0 if z is None else 1,
            sensors,
            pointer(self.rows),
            None,
            None,
            None,
            *((pointer(told[2]), pointer(told[3])) if told else (None, None)),
            pointer(self.fault),
            pointer(told[4]) if told else None,
        )
        return _Call(job, ctypes.addressof(job), dt, inputs, z, told, (constants, sensors, low))

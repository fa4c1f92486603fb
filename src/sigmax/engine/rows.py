"""Half-steps of a filter on rows of beliefs, one row a track: any number of tracks, from call to call another."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from sigmax.engine.advance import Instant
from sigmax.engine.backend import attempt
from sigmax.engine.job import Parts, bind, empty_innovation, execute, one_step, record
from sigmax.engine.lowered import Lowered, lowered
from sigmax.engine.native_engine import started
from sigmax.engine.xla_engine import advancing, begun
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.functions.current import current_model
from sigmax.functions.functions import check_shapes, counted
from sigmax.modelling.model import Model
from sigmax.modelling.switching import check_one_mode
from sigmax.native.calls import extension, ready
from sigmax.native.driver import RecordJob
from sigmax.preparation.joining import check_named
from sigmax.preparation.prepare import as_filter, cast, run_type
from sigmax.results.covariances import covariances
from sigmax.steps.adaptive_noises import adapts
from sigmax.steps.step import Innovation

Corrected = tuple[np.ndarray, Innovation, np.ndarray]
# XLA compiles for each size of a batch: rows are padded to a power of two, at least this one.
_SMALLEST_BATCH = 8


class _Row(NamedTuple):
    """What a half-step gives: the row, an innovation spelt out, the fault."""

    state: np.ndarray
    residual: np.ndarray
    factor: np.ndarray
    nis: np.ndarray
    log_likelihood: np.ndarray
    dof: np.ndarray
    fault: np.ndarray


class RowSteps:
    """Start, predict and correct rows (B, size), each a belief: mean, lower factor.

    The functions are pure: they give new rows. Nothing is compiled again when B changes on the native
    engine; on XLA a compilation is made for each power of two.

    Args:
        filter: a name of the catalogue, or a filter.
        model: the model.
        dtype: float64 or float32.
        backend: as in `run`.

    Raises:
        InputError: where a function of the model gives a shape that does not fit, or the model has a bias.
    """

    def __init__(self, filter: Filter | str, model: Model, *, dtype: Any = "float64", backend: str | None = None):
        self.filter, self.dtype, self.backend = as_filter(filter), run_type(dtype), backend
        self._asked, model = model, current_model(model)
        check_one_mode(model, "a tracker")
        check_named(self.filter, model)
        if adapts(self.filter, model):
            raise InputError(
                f"{self.filter.name} finds noises as it goes. Trackers, which mix beliefs, and Stone Soup, which keeps "
                "mean and covariance, do not carry what it knows of them: take a filter without adaptive noises"
            )
        check_shapes(model, None, counted(model), self.dtype)
        if model.bias is not None:
            raise InputError(f"rows hold states alone, and {model} has a bias: give sigmax.models.augment(model)")
        self.model = cast(model, self.dtype)
        self.packing = lowered(self.filter, self.model, 0, self.dtype).packing
        self._lower = np.flatnonzero(np.tri(self.packing.n))
        self._leaves, self._structure = jax.tree.flatten(self.model)
        self._ready: dict[Any, tuple[Lowered, Parts]] = {}
        self._calls: dict[Any, Callable[..., Any]] = {}

    def __getstate__(self) -> tuple[Any, ...]:
        """How they were made: what is compiled is found again."""
        return self.filter, self._asked, str(self.dtype), self.backend

    def __setstate__(self, given: tuple[Any, ...]) -> None:
        filter, model, dtype, backend = given
        self.__init__(filter, model, dtype=dtype, backend=backend)  # type: ignore[misc]

    def start(self, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
        """The rows of means (B, n) and covariances (B, n, n)."""
        mean, cov = np.ascontiguousarray(mean, self.dtype), np.ascontiguousarray(cov, self.dtype)
        if not len(mean):
            return np.empty((0, self.packing.size), self.dtype)

        def xla() -> np.ndarray:
            belief = begun(self.filter, self.model, _padded(mean).T, np.moveaxis(_padded(cov), 0, -1))
            return self.packing.packed(belief)[: len(mean)]

        return attempt(
            self.backend,
            False,
            lambda: started(*self._parts(("start",), 0), mean, cov, len(mean)),
            xla,
        )

    def predict(self, rows: np.ndarray, dt: Any) -> tuple[np.ndarray, np.ndarray]:
        """The rows dt seconds later, dt one number or (B,), and the `Fault` (B,) of each."""
        dt = np.full((len(rows),), dt, self.dtype)
        if not len(rows):
            return rows, np.zeros(0, np.int8)

        def native() -> tuple[np.ndarray, np.ndarray]:
            moved, _, fault = self._native(rows, dt, None, None, None)
            return moved, fault

        def xla() -> tuple[np.ndarray, np.ndarray]:
            moved, _, fault = self._xla(rows, Instant({}, _padded(dt)))
            return moved, fault

        return attempt(self.backend, False, native, xla)

    def correct(self, rows: np.ndarray, sensor: str, z: np.ndarray, u: Any = None) -> Corrected:
        """The rows after measurements z (B, m) of one sensor, what they said, and the `Fault` (B,) of each.

        A row whose correction is not sound stays as it was, as does one whose measurement is missing.
        Inputs u (k,) are those of the sensor, where it takes them.
        """
        z = np.ascontiguousarray(z, self.dtype)
        if not len(rows):
            m = self.model.measured_space(sensor, z.shape[-1]).dim
            none = np.empty(0, self.dtype)
            told = Innovation(none.reshape(0, m), none.reshape(0, m, m), none, none, np.empty(0, int))
            return rows, told, np.zeros(0, np.int8)

        def xla() -> Corrected:
            moved, said, fault = self._xla(rows, Instant({sensor: _padded(z).T}, None, self._inputs(u)))
            cut = [np.moveaxis(np.asarray(a), -1, 0)[: len(rows)] for a in said[sensor]]
            return moved, Innovation(*cut), fault

        return attempt(self.backend, False, lambda: self._native(rows, None, sensor, z, u), xla)

    def mean(self, rows: np.ndarray) -> np.ndarray:
        """The means (B, n)."""
        return rows[:, : self.packing.points]

    def cov(self, rows: np.ndarray) -> np.ndarray:
        """The covariances (B, n, n)."""
        return covariances(self.factor(rows))

    def factor(self, rows: np.ndarray) -> np.ndarray:
        """The lower factors S of the covariances, P = S Sᵀ (B, n, n)."""
        n = self.packing.n
        S = np.zeros((len(rows), n * n), rows.dtype)
        S[:, self._lower] = rows[:, self.packing.points : self.packing.head]
        return S.reshape(-1, n, n)

    def _native(
        self, rows: np.ndarray, dt: np.ndarray | None, sensor: str | None, z: np.ndarray | None, u: Any
    ) -> Corrected:
        """One half-step in C.

        Raises:
            Refused: for a model or filter that cannot be lowered.
            Unavailable: without a compiler, or where it fails.
        """
        given = None if u is None else np.ascontiguousarray(u, self.dtype)
        if len(rows) == 1 and extension() is not None:
            state, *told, fault = self._alone(sensor, z, given)(rows, dt, z, given)
            return state, Innovation(*told), fault
        state, fault = rows.astype(self.dtype), np.zeros(len(rows), np.int8)
        low, job, told = self._job(state, fault, dt, sensor, z, given)
        execute(low, "record", job, len(rows))
        return state, told, fault

    def _alone(self, sensor: str | None, z: np.ndarray | None, u: np.ndarray | None) -> Callable[..., Any]:
        """The half-step of one row, bound to arrays of its own: only numbers change from call to call."""
        key = sensor, None if z is None else z.shape, None if u is None else u.shape
        if key not in self._calls:
            rows, fault = np.empty((1, self.packing.size), self.dtype), np.zeros(1, np.int8)
            dt = np.zeros(1, self.dtype)
            z, u = (None if a is None else np.empty(a.shape, self.dtype) for a in (z, u))
            low, job, told = self._job(rows, fault, None if z is not None else dt, sensor, z, u)
            # Nothing can be copied into what is not there; None leaves an array as it is.
            inputs = rows, dt, *(np.empty(0, self.dtype) if a is None else a for a in (z, u))
            kept = self._parts(*self._which(sensor, z, u))
            self._calls[key] = ready(low.driver["record"], job, 1, inputs, (rows, *told, fault), _Row, kept=kept)
        return self._calls[key]

    def _which(self, sensor: str | None, z: np.ndarray | None, u: np.ndarray | None) -> tuple[tuple[Any, ...], int]:
        """A half-step by name, and how many inputs it takes."""
        return ("predict",) if z is None else ("correct", sensor, z.shape[-1]), 0 if u is None else u.shape[-1]

    def _job(
        self,
        state: np.ndarray,
        fault: np.ndarray,
        dt: np.ndarray | None,
        sensor: str | None,
        z: np.ndarray | None,
        u: np.ndarray | None,
    ) -> tuple[Lowered, RecordJob, Innovation]:
        """A half-step on rows, in place, and where what it says will be."""
        m = 0 if z is None else self.model.measured_space(str(sensor), z.shape[-1]).dim
        low, parts = self._parts(*self._which(sensor, z, u))
        told = empty_innovation(len(state), m, self.dtype)
        job = record(
            self.packing,
            parts,
            self.model,
            state,
            {} if z is None else {str(sensor): z[:, None]},
            None if dt is None else dt[:, None],
            None if u is None else u[..., None, :],
            one_step(None if z is None else sensor, told, fault),
        )
        return low, job, told

    def _parts(self, part: tuple[Any, ...], inputs: int) -> tuple[Lowered, Parts]:
        """A compiled half-step with the model's numbers, looked up once."""
        if (part, inputs) not in self._ready:
            low = lowered(self.filter, self.model, inputs, self.dtype)
            self._ready[part, inputs] = low, bind(low, self.model, part)
        return self._ready[part, inputs]

    def _xla(self, rows: np.ndarray, given: Instant) -> tuple[np.ndarray, dict[str, Innovation], np.ndarray]:
        """One half-step on XLA, of rows that are padded as `given` is; what they said is not cut yet."""
        go = advancing(self.filter, self._structure)
        belief, said, fault = go(self._leaves, self.packing.unpacked(_padded(rows)), given)
        return self.packing.packed(belief)[: len(rows)], said, np.asarray(fault)[: len(rows)]

    def _inputs(self, u: Any) -> Any:
        return None if u is None else _padded(np.asarray(u, self.dtype)).T if np.ndim(u) == 2 else np.asarray(u)


def _padded(a: np.ndarray) -> np.ndarray:
    """An array with its last row repeated up to a length that many lengths share."""
    length = max(_SMALLEST_BATCH, 1 << (len(a) - 1).bit_length())
    return np.concatenate([a, np.repeat(a[-1:], length - len(a), 0)])

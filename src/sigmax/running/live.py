"""A filter at the end of a live sensor: the one object with a state."""

from datetime import timedelta
from functools import cached_property
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.models.fusion import Fused
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model, check_flat
from sigmax.models.switching import SwitchingModel
from sigmax.native import Refused, Unavailable
from sigmax.running.backend import attempt, native_failed, natively
from sigmax.running.covariances import covariances
from sigmax.running.current import current_model
from sigmax.running.fusing import Members, with_members_live
from sigmax.running.given import Given
from sigmax.running.intervals import seconds_of
from sigmax.running.joining import joined
from sigmax.running.layout import Layout
from sigmax.running.live_native import NativeState
from sigmax.running.live_xla import XlaState
from sigmax.running.prepare import as_filter, cast, run_type, typed
from sigmax.running.saved import identity, restored, saved
from sigmax.running.step import Fault, Innovation

_NUMBER, _INFINITY = (float, int), float("inf")
_SHARED = "another thread is using this live filter; give each thread one of its own, or hold a lock around its calls"


class Live:
    """Predict and update step by step, for one track or for a batch of them in step.

    Args:
        filter: as in `run`.
        model: as in `run`.
        prior: the state now, (n,) or (B, n).
        dtype: float64 or float32.
        backend: as in `run`.

    What a model needs is compiled when it is made or first used, for some seconds; then a step takes microseconds.
    One that is not sound leaves the state as it was; `ok` and `fault` tell.
    It belongs to one thread at a time, and can be pickled where the functions of the model can.

    Raises:
        InputError: for whatever does not fit, and where two threads call it at once.
    """

    def __init__(
        self,
        filter: Filter | str | None,
        model: Model,
        prior: Gaussian,
        *,
        dtype: Any = "float64",
        backend: str | None = None,
    ) -> None:
        self._asked = as_filter(filter, model), model, prior
        now = current_model(model)
        self.filter, model, prior = joined(self._asked[0], now, prior)
        layout = Layout.of(now, prior.mean.ndim == 2, self.filter.form.bias_first)
        self._biased, self._numbers, self._deviations = bool(layout.bias), layout.numbers, layout.deviations
        self.apart = model  # its sensors, where they are fused
        self._members, model = Members.of(model)
        self._dtype, self._batched = run_type(dtype), prior.mean.ndim == 2
        self._tracks = (len(prior.mean),) if self._batched else ()
        self._backend, self._busy = backend, False
        self.model = cast(model, self._dtype)
        self._given = Given(self.model, self._dtype, prior.mean.shape[:-1], now, self._asked[2])
        parts = self.filter, self.model, typed(prior.mean, self._dtype), typed(prior.cov, self._dtype)
        starting = [lambda: NativeState(*parts), lambda: XlaState.of_prior(*parts)]
        self._state: NativeState | XlaState = attempt(backend, False, *starting)

    @property
    def mean(self) -> np.ndarray:
        """The estimate (n,) or (B, n)."""
        if self._busy:
            raise InputError(_SHARED)
        mean = self._state.read_mean()
        return mean[..., self._numbers[0]] if self._biased else mean

    @property
    def bias_mean(self) -> np.ndarray:
        """The estimate of the bias (p,) or (B, p)."""
        return self._state.read_mean()[..., self._numbers[1]]

    @property
    def bias_cov(self) -> np.ndarray:
        """Its covariance (p, p) or (B, p, p)."""
        return self._state.read_cov()[..., self._deviations[1], self._deviations[1]]

    @property
    def bias_std(self) -> np.ndarray:
        """Its standard deviations (p,) or (B, p)."""
        return self._root_of_squares(self._deviations[1])

    @property
    def cov(self) -> np.ndarray:
        """Its covariance (n, n) or (B, n, n)."""
        if self._busy:
            raise InputError(_SHARED)
        cov = self._state.read_cov()
        return cov[..., self._deviations[0], self._deviations[0]] if self._biased else cov

    @property
    def std(self) -> np.ndarray:
        """Its standard deviations (n,) or (B, n)."""
        return self._root_of_squares(self._deviations[0])

    @property
    def probability(self) -> np.ndarray:
        """Probabilities of the modes (M,) or (B, M), in the order of the model's."""
        if not isinstance(self.model, SwitchingModel):
            raise InputError("this model has no modes: see sigmax.imm")
        return np.exp(np.asarray(self.belief.log_weight)).T

    @property
    def belief(self) -> Any:
        """Mean and factor of state and bias together, batch last."""
        if self._busy:
            raise InputError(_SHARED)
        return self._state.belief

    @property
    def ok(self) -> Any:
        """Whether the last call was sound: a bool, or one for each track."""
        fault = self._state.fault
        return np.asarray(fault) == 0 if self._batched else not fault.any()

    @property
    def fault(self) -> Any:
        """Why it was not: a `Fault`, or a list of one for each track."""
        found = [Fault(int(f)) for f in np.ravel(self._state.fault)]
        return found if self._batched else found[0]

    def predict(self, dt: float | timedelta, u: Any = None) -> None:
        """Move the state dt seconds on, with inputs u (k,) where the motion takes them."""
        u = u if self._members is None else self._members.inputs(u)
        self._do("predict", seconds_of(dt), self._given.inputs(u, "motion"))

    def update(self, z: Any, sensor: str | None = None, *, R: Any = None, u: Any = None) -> Innovation:
        """Correct with a measurement z (m,) or (B, m), NaN where a component is missing.

        Args:
            z: the measurement; a dict by name of those that came at once, where the model's sensors are fused.
            sensor: which of the model's sensors it comes from, where there are several.
            R: its covariance or variances this time, if not the model's.
            u: inputs (k,) where the sensor takes them.

        Returns:
            Residual, factor of its covariance, NIS and log-likelihood.
        """
        if self._members is not None:
            return self.update_together(self._members.together(z, sensor, R, u, self._tracks))
        name, value = self._given.measurement(z, sensor)
        return self._do("update", name, value, self._given.noise(name, R), self._given.inputs(u, "sensor", name))

    def update_together(self, together: Fused) -> Innovation:
        """Correct with what fused sensors made of their measurements."""
        name, value = self._given.measurement(together.z, next(iter(self.model.sensors)))
        told = self._do("update", name, value, None, self._given.inputs(together.u, "sensor", name))
        return with_members_live(told, together)

    def expect(self, sensor: str | None = None, *, R: Any = None, u: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """What a sensor should measure now, (m,) or (B, m), and the covariance of the innovation: for gates."""
        if self._members is not None:
            raise InputError("the sensors are fused; expect one of them with a filter on the model as it was before")
        check_flat(self.model, "expect")
        name = self._given.sensor(sensor)
        names = self.model.measurement[name]
        if names is None:
            raise InputError("name the components of the measurement in the model: R is a function and counts none")
        nothing = np.zeros((*self._tracks, len(names)), self._dtype)
        given = self._given.noise(name, R), self._given.inputs(u, "sensor", name)
        before, fault = self.belief, np.array(self._state.fault)
        told = self._do("update", name, nothing, *given)
        self.put(before, fault)
        return -np.asarray(told.residual), covariances(np.asarray(told.factor))

    def step(
        self, z: Any, dt: float | timedelta, sensor: str | None = None, *, R: Any = None, u: Any = None
    ) -> Innovation:
        """`predict(dt)` and `update(z)` in one compiled call."""
        if self._members is not None:
            together = self._members.together(z, sensor, R, u, self._tracks)
            self.predict(dt, u)
            return self.update_together(together)
        if R is None and u is None and z is not None and isinstance(dt, _NUMBER) and 0 <= dt < _INFINITY:
            whole = self._state.whole.get(sensor) if sensor is None or isinstance(sensor, str) else None
            if whole is not None:
                if self._busy:
                    raise InputError(_SHARED)
                self._busy = True
                try:
                    told = whole(dt, None, z)
                finally:
                    self._busy = False
                if told is not NotImplemented:
                    return told
        name, value = self._given.measurement(z, sensor)
        used = None if R is None else self._given.noise(name, R)
        given = self._given.inputs(u, "motion", name)
        return self._do("step", name, seconds_of(dt), value, used, given)

    def save(self) -> bytes:
        """The state as bytes; `restore` gives it back bit for bit, in another process too."""
        return saved(self.belief, self._state.fault, self._identity)

    def restore(self, bytes: bytes) -> None:
        """Take up a state that `save` gave, of the same filter, model, batch and version of the library.

        Raises:
            InputError: where the bytes are no such state, damaged, not finite, or of something else.
        """
        self.put(*restored(bytes, self.belief, self._state.fault, self._identity))

    @cached_property
    def _identity(self) -> dict[str, Any]:
        return identity(*self._asked[:2])

    def __getstate__(self) -> tuple[Any, ...]:
        """How it was made, and its state: what is compiled is found again."""
        return self._asked, str(self._dtype), self._backend, self.save()

    def __setstate__(self, given: tuple[Any, ...]) -> None:
        asked, dtype, backend, content = given
        self.__init__(*asked, dtype=dtype, backend=backend)  # type: ignore[misc]
        self.restore(content)

    def _root_of_squares(self, rows: slice) -> np.ndarray:
        S = self._state.factor[..., rows, :]
        return np.sqrt((S * S).sum(-1))

    def _do(self, what: str, *arguments: Any) -> Any:
        if self._busy:
            raise InputError(_SHARED)
        self._busy = True
        try:
            with natively():
                return getattr(self._state, what)(*arguments)
        except (Refused, Unavailable) as error:
            self._fall_back(error)
            return getattr(self._state, what)(*arguments)
        finally:
            self._busy = False

    def _fall_back(self, error: Exception) -> None:
        """Go on with XLA where a part turns out not to be lowered; an error where the native engine was asked for."""
        native_failed(self._backend, error)
        before, self._state = self._state, XlaState(self.filter, self.model, self._state.belief)
        self._state.put(before.belief, before.fault)

    def put(self, belief: Any, fault: Any) -> None:
        """Take up a belief laid out as `belief` gives it."""
        if self._busy:
            raise InputError(_SHARED)
        self._state.put(belief, fault)

"""A filter at the end of a live sensor: the one object with a state."""

from dataclasses import replace
from datetime import timedelta
from functools import cached_property
from typing import Any

import numpy as np

from sigmax.engine.backwards import check_smoothed
from sigmax.errors import InputError
from sigmax.filters import Filter, FromInformation
from sigmax.functions.current import current_model
from sigmax.live.clocked_engine import ClockedEngine
from sigmax.live.estimate import Estimate
from sigmax.live.live_arguments import LiveArguments, Observation
from sigmax.live.live_estimate import LiveEstimate
from sigmax.live.saved import identity, restored, saved
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model, check_flat
from sigmax.preparation.cautions import warn_before
from sigmax.preparation.from_information import check_straight, inputs_of, somewhere
from sigmax.preparation.fusing import Members
from sigmax.preparation.intervals import duration, instant, seconds_of
from sigmax.preparation.joining import joined, modes_of
from sigmax.preparation.layout import Layout
from sigmax.preparation.prepare import as_filter, cast, run_type, typed
from sigmax.preparation.times import seconds_since, since, zero_of
from sigmax.results.covariances import covariances
from sigmax.rewriting.fusion import Fused
from sigmax.steps.adaptive_noises import adapted_noises
from sigmax.steps.step import Innovation

_NUMBER, _INFINITY = (float, int), float("inf")
Span = float | timedelta | str


class Live(LiveEstimate):
    """Predict and update step by step, for one track or for a batch of them in step.

    Args:
        filter: as in `run`.
        model: as in `run`.
        prior: the state now, (n,) or (B, n).
        time: of the prior: seconds from whatever zero, or an instant, as in `run`; then all times are instants.
        window: how late a measurement may come: seconds, a timedelta or text such as "2 s". So much is kept.
        lag: how long ago `lagged` is; the same.
        dtype: float64 or float32.
        backend: as in `run`.

    Attributes:
        counts: measurements that were given a time or a window, by what became of them: "refused" (too late) and, in
            a window, "taken", "late" (taken in their place) and "repeated" (there already).

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
        time: Any = 0.0,
        window: Span = 0.0,
        lag: Span = 0.0,
        dtype: Any = "float64",
        backend: str | None = None,
    ) -> None:
        self._asked = as_filter(filter, model), model, prior
        now = current_model(model)
        self.filter, model, prior = joined(self._asked[0], now, prior)
        for own, part in modes_of(self.filter, model):
            warn_before(own, part, prior, None)
            if duration("lag", lag):
                check_smoothed(own)
        if singular := isinstance(self.filter, FromInformation):
            check_straight(now, inputs_of(now))
            if duration("lag", lag):
                raise InputError("lag= smooths, and the prior's information is singular: take a prior of sigmax.start")
        layout = Layout.of(now, prior.mean.ndim == 2, self.filter.form.bias_first)
        noises = adapted_noises(self.filter, model)
        self.layout = layout = layout._replace(filter=self._asked[0].name, noises=noises, from_information=singular)
        self._biased, self._numbers, self._deviations = bool(layout.bias), layout.numbers, layout.deviations
        self.apart = model  # its sensors, where they are fused
        members, model = Members.of(model)
        self._dtype, self._batched = run_type(dtype), layout.batched
        self._tracks = (len(prior.mean),) if self._batched else ()
        self.model = cast(model, self._dtype)
        here = somewhere(self._asked[2])
        self._arguments = LiveArguments(self.model, self._dtype, self._tracks, now, here, members)
        spans = duration("window", window), duration("lag", lag)
        self._how: dict[str, Any] = {"backend": backend, "window": spans[0], "lag": spans[1]}
        self._zero = zero_of(time)
        if self._zero is not None:
            self._how["time"] = time
        about = typed(prior.mean, self._dtype), typed(prior.cov, self._dtype), layout, backend
        self._clocked = ClockedEngine(self.filter, self.model, *about, self._seconds(time), *spans)
        self.counts = self._clocked.counts

    def predict(self, dt: Span | None = None, u: Any = None, *, time: Any = None) -> None:
        """Move the state dt seconds on, or to a time, with inputs u (k,) where the motion takes them."""
        if (dt is None) == (time is None):
            raise InputError("predict moves by dt seconds or to a time: give one of the two")
        # In a window the inputs of the motion that are not told are those of other steps.
        borrowed = u is None and self._clocked.keeps and not self._arguments.fused
        given = None if borrowed else self._arguments.moving(u)
        elapsed = None if dt is None else seconds_of(dt)
        self._clocked.take(None, given, elapsed, self._seconds(time))

    def update(
        self, z: Any, sensor: str | None = None, *, R: Any = None, u: Any = None, time: Any = None
    ) -> Innovation:
        """Correct with a measurement z (m,) or (B, m), NaN where a component is missing.

        Args:
            z: the measurement; a dict by name of those that came at once, where the model's sensors are fused.
            sensor: which of the model's sensors it comes from, where there are several.
            R: its covariance or variances this time, if not the model's.
            u: inputs (k,) where the sensor takes them, or the motion up to `time`.
            time: when it was measured, if not now. A late one is taken in its place, as if it had come in
                time, where it lies in the window; an older one is refused, and says what a missing one would.

        Returns:
            Residual, factor of its covariance, NIS and log-likelihood.
        """
        at = self._seconds(time)
        later = at is not None and at > self._clocked.time
        moved = u is not None or self._arguments.fused if self._clocked.keeps else later
        return self._take(self._arguments.observation(z, sensor, R, u, moved), None, at)

    def update_together(self, together: Fused) -> Innovation:
        """Correct with what fused sensors made of their measurements."""
        return self._take(self._arguments.together(together), None, None)

    def expect(self, sensor: str | None = None, *, R: Any = None, u: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """What a sensor should measure now, (m,) or (B, m), and the covariance of the innovation: for gates."""
        if self._arguments.fused:
            raise InputError("the sensors are fused; expect one of them with a filter on the model as it was before")
        check_flat(self.model, "expect")
        name = self._arguments.sensor(sensor)
        names = self.model.measurement[name]
        if names is None:
            raise InputError("name the components of the measurement in the model: R is a function and counts none")
        nothing = np.zeros((*self._tracks, len(names)), self._dtype)
        given = self._arguments.noise(name, R), self._arguments.inputs(u, "sensor", name)
        told = self._clocked.expected(name, nothing, *given)
        return -np.asarray(told.residual), covariances(np.asarray(told.factor))

    def step(self, z: Any, dt: Span, sensor: str | None = None, *, R: Any = None, u: Any = None) -> Innovation:
        """`predict(dt)` and `update(z)` in one compiled call."""
        clocked = self._clocked
        if R is None and u is None and z is not None and isinstance(dt, _NUMBER) and 0 <= dt < _INFINITY:
            told = clocked.at_once(sensor, dt, z)
            if told is not NotImplemented:
                return told
        return self._take(self._arguments.observation(z, sensor, R, u, True), seconds_of(dt), None)

    def at(self, time: Any, *, u: Any = None) -> Estimate:
        """What is known of a time from what was measured until then: of now, of later, or within the window.

        Args:
            time: the moment.
            u: inputs of the motion from the step before on; in a window those that are known do without.

        Raises:
            InputError: for a time of which nothing is kept.
        """
        given = None if u is None else self._arguments.moving(u)
        return self._dated(self._clocked.at(self._seconds(time), given))

    @property
    def lagged(self) -> Estimate | None:
        """The newest step that is at least `lag` old, by all that was measured until now; None before there is one.

        It is what `smooth` says of it after a run up to now, and costs a step of the smoother for each step since.
        """
        found = self._clocked.lagged()
        return None if found is None else self._dated(found)

    def save(self) -> bytes:
        """The state as bytes; `restore` gives it back bit for bit, in another process too."""
        return saved([*self._clocked.saved(), self._zero], self._identity)

    def restore(self, bytes: bytes) -> None:
        """Take up a state that `save` gave, of the same filter, model, batch and version of the library.

        Raises:
            InputError: where the bytes are no such state, damaged, not finite, or of something else.
        """
        *value, zero = restored(bytes, self._clocked.saved(), self._identity, self.layout.from_information)
        if (zero is None) != (self._zero is None):
            kinds = [("instants", "seconds")[one is None] for one in (zero, self._zero)]
            raise InputError(f"the saved state counts time in {kinds[0]}, this filter in {kinds[1]}: see time=")
        self._clocked.restore(value)
        self._zero = zero

    @cached_property
    def _identity(self) -> dict[str, Any]:
        return identity(*self._asked[:2], self._how["window"], self._how["lag"])

    def __getstate__(self) -> tuple[Any, ...]:
        """How it was made, and its state: what is compiled is found again."""
        return self._asked, str(self._dtype), self._how, self.save()

    def __setstate__(self, given: tuple[Any, ...]) -> None:
        asked, dtype, how, content = given
        self.__init__(*asked, dtype=dtype, **how)  # type: ignore[misc]
        self.restore(content)

    def _seconds(self, time: Any) -> Any:
        """A moment as the engine counts it; None for now."""
        if time is None:
            return None
        return instant("time", time) if self._zero is None else seconds_since(self._zero, time)

    def _dated(self, found: Estimate) -> Estimate:
        """An estimate with its time as it was given."""
        if self._zero is None:
            return found
        time = since(self._zero, found.stored_time).astype(np.int64)
        return replace(found, stored_time=time, layout=found.layout._replace(dated=True))

    def _take(self, heard: Observation, dt: float | None, time: float | None) -> Innovation:
        said = self._clocked.take(heard, heard.u, dt, time)
        return heard.missing(self.model) if said is None else said

    def put(self, belief: Any, fault: Any) -> None:
        """Take up a belief laid out as `belief` gives it; with a window, no measurement of before is taken any more."""
        self._clocked.put(belief, fault)

"""The way of a live filter through time: its engine, what time it is, and the steps that it keeps."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from sigmax.engine.backend import attempt, native_failed, natively
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.live.estimate import Estimate, ahead, left_as_it_was, smoothed
from sigmax.live.live_arguments import Observation
from sigmax.live.live_native import NativeState
from sigmax.live.live_xla import XlaState
from sigmax.live.window import Engine, Event, Standing, Window, reach
from sigmax.modelling.model import Model
from sigmax.native import Refused, Unavailable
from sigmax.preparation.layout import Layout
from sigmax.steps.step import Innovation

SHARED = "another thread is using this live filter; give each thread one of its own, or hold a lock around its calls"


class ClockedEngine:
    """An engine and a clock; with a window or a lag, the steps of so much time.

    Args:
        filter: the filter.
        model: as the engines take it.
        mean: of the prior (n,) or (B, n).
        cov: its covariance.
        layout: what the numbers of a belief mean.
        backend: as in `run`.
        time: of the prior, in seconds.
        window: seconds by which a measurement may be late.
        lag: seconds.

    Attributes:
        engine: the state, and what moves it on.
        time: of the state, in seconds.
        counts: measurements by what became of them, see `Live`.
        busy: whether a call is under way.
    """

    def __init__(
        self,
        filter: Filter,
        model: Model,
        mean: np.ndarray,
        cov: np.ndarray,
        layout: Layout,
        backend: str | None,
        time: float,
        window: float,
        lag: float,
    ) -> None:
        self._filter, self._model, self._layout, self._backend, self._lag = filter, model, layout, backend, lag
        self._tracks = (len(mean),) if layout.batched else ()
        parts = filter, model, mean, cov
        starting = [lambda: NativeState(*parts), lambda: XlaState.of_prior(*parts)]
        self.engine: Engine = attempt(backend, False, *starting)
        self.time, self.busy, self.counts = time, False, Counter[str]()
        self._window = (
            Window(self.engine, self._tracks, model, time, window, lag, self.counts) if window or lag else None
        )

    @property
    def keeps(self) -> bool:
        """Whether steps are kept."""
        return self._window is not None

    @property
    def still(self) -> Engine:
        """The engine, to be read while no call is under way."""
        if self.busy:
            raise InputError(SHARED)
        return self.engine

    def at_once(self, sensor: Any, dt: float, z: Any) -> Any:
        """What is said after dt seconds by z as it was given; NotImplemented where that needs a closer look."""
        whole = (
            self.engine.whole.get(sensor) if self._window is None and (sensor is None or type(sensor) is str) else None
        )
        if whole is None:
            return NotImplemented
        if self.busy:
            raise InputError(SHARED)
        self.busy = True
        try:
            said = whole(dt, None, z)
        finally:
            self.busy = False
        if said is not NotImplemented:
            self.time += dt
        return said

    def do(self, call: Callable[[Engine], Any]) -> Any:
        """What a call of the engine gives, of one thread at a time; on XLA where the native engine cannot do it."""
        if self.busy:
            raise InputError(SHARED)
        self.busy = True
        try:
            with natively():
                return call(self.engine)
        except (Refused, Unavailable) as error:
            self._fall_back(error)
            return call(self.engine)
        finally:
            self.busy = False

    def take(self, heard: Observation | None, u: Any, dt: float | None, time: float | None) -> Innovation | None:
        """What a measurement said, dt seconds on or at a time, or now; None where there is none, or it is too late.

        `u` are the inputs of the motion before it, None where they are not told with it.
        """
        if self._window is not None:
            event = Event(self.time + dt if dt else self.time if time is None else time, heard, u)
            said = self.do(lambda engine: self._window and self._window.take(engine, event))
            self.time = self._window.now.time
            return said
        if time is not None:
            dt = time - self.time
            if dt < 0:
                self.counts["refused"] += 1
                return None
        if heard is None:
            if dt or time is None:
                self.do(lambda engine: engine.predict(dt or 0.0, u))
            said = None
        elif dt is None or (dt == 0 and time is not None):
            said = heard.with_members(self.do(lambda engine: engine.update(heard.sensor, heard.z, heard.R, heard.u)))
        else:
            said = heard.with_members(self.do(lambda engine: engine.step(heard.sensor, dt, heard.z, heard.R, heard.u)))
        self.time = time if time is not None else self.time + (dt or 0.0)
        return said

    def at(self, time: float, u: Any) -> Estimate:
        """What is known of a time from what was measured until then; inputs u, or None for the known ones.

        Raises:
            InputError: for a time of which nothing is kept.
        """
        if self._window is not None:
            start, known = self._window.at(time)
        else:
            start, known = Standing(self.time, self.still.held(), np.zeros(self._tracks, np.int8)), None
        if time < start.time:
            raise InputError(
                f"nothing is kept of time {time:g}, it is {self.time:g} already: make the filter with window="
            )
        given = known if u is None else u
        if time > start.time and given is None and self._model.motion_driven:
            raise InputError("the motion takes inputs; give u=")
        found: Estimate = self.do(lambda engine: ahead(engine, self._layout, start, time, given))
        return found

    def lagged(self) -> Estimate | None:
        """See `Live`."""
        if self._window is None or not self._lag:
            raise InputError('there is no lag; make the filter with one: Live(…, lag="2 s")')
        steps = self._window.since(reach(self.time, self._lag, -1))
        if not steps:
            return None
        found: Estimate = self.do(lambda engine: smoothed(engine, self._layout, steps))
        return found

    def expected(self, sensor: str, *given: Any) -> Innovation:
        """What a measurement would say, from which nothing is learnt."""
        said: Innovation = self.do(lambda e: left_as_it_was(e, lambda: e.update(sensor, *given)))
        return said

    def put(self, belief: Any, fault: Any) -> None:
        """Take up a belief; what was before is not known any more."""
        self.still.put(belief, fault)
        if self._window is not None:
            self._window.begin(self.engine, self.time)

    def saved(self) -> list[Any]:
        """All that later steps depend on, as lists, numbers and arrays."""
        engine = self.still

        def belief(held: Any) -> list[np.ndarray]:
            return [np.asarray(a) for a in jax.tree.leaves(engine.belief_of(held))]

        fault = np.array(engine.fault, np.int8).reshape(self._tracks)
        steps = None if self._window is None else self._window.saved(belief)
        return [self.time, belief(engine.held()), fault, dict(self.counts), steps]

    def restore(self, saved: list[Any]) -> None:
        """Take up what `saved` gave."""
        engine = self.still
        structure = jax.tree.structure(engine.belief)

        def held(leaves: list[np.ndarray]) -> Any:
            return engine.rows_of(jax.tree.unflatten(structure, leaves))

        self.time, leaves, fault, counts, steps = saved
        self.counts.clear()
        self.counts.update(counts)
        engine.put_held(held(leaves), fault)
        if self._window is not None:
            self._window.restore(engine, steps, held)

    def _fall_back(self, error: Exception) -> None:
        """Go on with XLA where a part turns out not to be lowered; an error where the native engine was asked for."""
        native_failed(self._backend, error)
        before = self.engine
        self.engine = XlaState(self._filter, self._model, before.belief)
        self.engine.put(before.belief, before.fault)
        if self._window is not None:
            self._window.over(before.belief_of)

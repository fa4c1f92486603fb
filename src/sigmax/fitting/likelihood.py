"""The log-likelihoods of records at many parameters at once."""

import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.compiling import compiled
from sigmax.engine import native_engine, xla_engine
from sigmax.engine.backend import attempt
from sigmax.filters import Filter
from sigmax.fitting.parametric_model import Build, depends, model_and_prior, parametric_model_of
from sigmax.fitting.search import Search
from sigmax.functions.current import current
from sigmax.modelling.bias import joint
from sigmax.modelling.checks import is_traced, numbers
from sigmax.modelling.model import Model
from sigmax.native.fingerprint import fingerprint
from sigmax.preparation.prepare import as_filter, prepare
from sigmax.running.run import run

# Numbers of inputs that one batch may hold, 8 bytes each.
_MOST = 2e7
_KEPT = frozenset({"fault"})


class Data(NamedTuple):
    """A record as it is given to `run`, and the build of its model.

    Attributes:
        build: parameters -> (model, prior).
        z: measurements.
        dt: intervals.
        inputs: or None.
        R: or None.
        update_first: as in `run`.
    """

    build: Build
    z: Any
    dt: Any = 1.0
    inputs: Any = None
    R: Any = None
    update_first: bool = False


class Likelihood:
    """The log-likelihood of one record, all of its tracks added, as a function of parameters (V, p).

    Args:
        filter: whose.
        data: the record.
        search: the parameters.
        start: of them, where everything is checked.

    Raises:
        InputError: for what `run` refuses.
    """

    def __init__(self, filter: Filter, data: Data, search: Search, start: np.ndarray) -> None:
        self.data, self.search = data, search
        model, prior = model_and_prior(data.build, search.numbers(start))
        # Of a model of several modes, one filter for each.
        self.filter = as_filter(filter, model)
        self.ready = prepare(
            self.filter, model, prior, data.z, data.dt, data.inputs, "float64", data.update_first, R=data.R
        )
        self.steps = int(self.ready.dt.shape[-1])
        self.tracks = self.ready.batch or 1
        self._start = start
        self._moving: bool | None = None
        self._parametric: Model | None = None
        self._objective: Callable[..., Any] | None = None

    def __call__(self, theta: np.ndarray, until: int | None = None) -> np.ndarray:
        """Log-likelihoods (V,) of the steps before `until`; −∞ where a step failed."""
        T = self.steps if until is None else until
        if not self.search.size:
            return np.full(len(theta), self._alone(T))
        size = max(2, int(_MOST // (T * self.tracks * (self._width + 1))))
        blocks = [theta[i : i + size] for i in range(0, len(theta), size)]
        parts = [attempt(None, False, partial(self._natively, b, T), partial(self._by_xla, b, T)) for b in blocks]
        total = np.concatenate(parts)
        return np.where(np.isfinite(total), total, -np.inf)

    @property
    def _width(self) -> int:
        """Inputs of the parametric model."""
        return self.search.size + (0 if self.ready.u is None else self.ready.u.shape[-1])

    def parametric_model(self) -> Model:
        """The model that reads the parameters from its inputs, behind its own.

        Raises:
            Refused: where something depends on the parameters that does not read inputs.
        """
        if self._parametric is None:
            own = self._width - self.search.size
            noises = self.data.R if isinstance(self.data.R, Mapping) else () if self.data.R is None else ("",)
            known = fingerprint(self.data.build)
            self._parametric = parametric_model_of(
                current(self.data.build), known, self.search, self.ready.filter, self.ready.model, own, tuple(noises)
            )
        return self._parametric

    def _natively(self, theta: np.ndarray, T: int) -> np.ndarray:
        ready, asked_for = self.ready, len(theta)
        parametric = self.parametric_model()
        # One variant alone would be compiled by itself.
        theta = np.concatenate([theta, theta[-1:]]) if asked_for < 2 else theta
        V = len(theta)
        mean, cov = self._priors(theta)
        u = np.empty((V, self.tracks, T, self._width))
        if ready.u is not None:
            u[..., : -self.search.size] = ready.u[..., :T, :]
        u[..., -self.search.size :] = theta[:, None, None, :]
        z = {s: v[..., :T, :] for s, v in ready.z.items()}
        z = {s: v if v.ndim == 2 else np.tile(v, (V, 1, 1)) for s, v in z.items()}
        dt = ready.dt[..., :T]
        asked = ready._replace(
            model=parametric, mean=mean, cov=cov, z=z, dt=dt if dt.ndim == 1 else np.tile(dt, (V, 1)),
            u=u.reshape(V * self.tracks, T, -1), inputs=None, batch=V * self.tracks,
        )  # fmt: skip
        total, parts = native_engine.filtered(_KEPT, asked)
        failed = (np.asarray(parts["fault"]) > 0).any(-1)
        sums = np.where(failed, -np.inf, np.asarray(total)).reshape(V, -1).sum(1)
        return np.asarray(sums[:asked_for])

    def _priors(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means (V·B, n) and covariances (V·B, n, n) of the parameters."""
        first = self.ready.filter.form.bias_first
        if self._moving is None:
            self._moving = depends(lambda t: list(_joint(self.data.build, self.search, first, t)), self.search.size)
        each = theta if self._moving else self._start[None]
        made = [_joint(self.data.build, self.search, first, t) for t in each]
        found = []
        for parts, core in zip(zip(*made, strict=True), (1, 2), strict=True):
            arrays = [np.asarray(a, float) for a in parts]
            arrays = [a if a.ndim > core else np.broadcast_to(a, (self.tracks, *a.shape)) for a in arrays]
            whole = np.concatenate(arrays)
            found.append(whole if self._moving else np.tile(whole, (len(theta), *(1,) * core)))
        return found[0], found[1]

    def _alone(self, T: int) -> float:
        """The log-likelihood of a model without parameters."""
        ready = self.ready
        z = {s: v[..., :T, :] for s, v in ready.z.items()}
        cut = ready._replace(z=z, dt=ready.dt[..., :T], u=None if ready.u is None else ready.u[..., :T, :])
        total, parts = attempt(
            None,
            False,
            lambda: native_engine.filtered(_KEPT, cut),
            lambda: xla_engine.filtered(_KEPT, cut, False),
        )
        return -np.inf if (np.asarray(parts["fault"]) > 0).any() else float(np.sum(total))

    def _by_xla(self, theta: np.ndarray, T: int) -> np.ndarray:
        if self._objective is None:
            known = fingerprint(self.data.build)
            remembered = _objective if known is not None else _objective.__wrapped__
            self._objective = remembered(
                self.filter, current(self.data.build), known, self.search, self.data.update_first
            )
        return np.array([float(self._objective(jnp.asarray(t), *self._cut(T))) for t in theta])

    def _cut(self, T: int) -> tuple[Any, ...]:
        """The record as `run` takes it, its first steps."""
        z, R = (_by_sensor(what, given) for what, given in (("z", self.data.z), ("R", self.data.R)))
        inputs = None if self.data.inputs is None else numbers("inputs", self.data.inputs)
        cut = jax.tree.map(lambda a: jnp.asarray(a)[..., :T, :], (z, inputs))
        by_row = jax.tree.map(lambda a: _first(jnp.asarray(a), T, self.steps), R)
        return cut[0], jnp.asarray(self.ready.dt[..., :T]), cut[1], by_row


class Likelihoods:
    """The same of several records, which share the parameters."""

    def __init__(self, filter: Filter, records: list[Data], search: Search, start: np.ndarray) -> None:
        self.each = [Likelihood(filter, data, search, start) for data in records]
        self.search, self.evaluations = search, 0

    def __call__(self, theta: np.ndarray, share: float | None = None) -> np.ndarray:
        """Log-likelihoods (V,) of all records together, of the first `share` of the steps of each."""
        self.evaluations += len(theta)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of parameters that nobody believes
            return np.sum([one(theta, self.first(one, share)) for one in self.each], axis=0)

    def inside(self, share: float | None = None) -> Callable[[np.ndarray], np.ndarray]:
        """As a function of what is searched."""
        return lambda y: self(self.search.outside(y), share)

    @staticmethod
    def first(one: Likelihood, share: float | None) -> int | None:
        """How many steps the first `share` of a record are."""
        return None if share is None else max(1, min(one.steps - 1, round(share * one.steps)))


def _joint(build: Build, search: Search, first: bool, theta: Any) -> tuple[Any, Any]:
    """The prior of state and bias."""
    model, prior = model_and_prior(build, search.named(theta) if is_traced(theta) else search.numbers(theta))
    whole = prior if model.bias is None else joint(prior, model.bias.prior, first)
    return whole.mean, whole.cov


def _by_sensor(what: str, given: Any) -> Any:
    if isinstance(given, Mapping):
        return {s: numbers(f"{what}[{s!r}]", v, missing=True) for s, v in given.items()}
    return None if given is None else numbers(what, given, missing=True)


def _first(R: Any, T: int, steps: int) -> Any:
    """The first rows of variances (…, T, m) or covariances (…, T, m, m)."""
    axis = -3 if R.ndim > 2 and R.shape[-1] == R.shape[-2] and R.shape[-3] == steps else -2
    return jax.lax.slice_in_dim(R, 0, T, axis=R.ndim + axis)


@lru_cache(maxsize=32)
def _objective(
    filter: Filter, build: Build, known: str | None, search: Search, update_first: bool
) -> Callable[..., Any]:
    """The log-likelihood of a record by XLA, compiled once: numbers are arguments."""

    def total(theta: Any, z: Any, dt: Any, inputs: Any, R: Any) -> Any:
        model, prior = model_and_prior(build, search.named(theta))
        done = run(filter, model, prior, z, dt=dt, inputs=inputs, R=R, update_first=update_first, keep=("fault",))
        return jnp.where(done.ok.all(), jnp.sum(done.log_likelihood), -jnp.inf)

    return compiled(total)


def first_fault(data: Data, filter: Filter, search: Search, theta: np.ndarray) -> list[str]:
    """The first fault of a record at parameters, in words."""
    model, prior = model_and_prior(data.build, search.named(theta))
    done = run(filter, model, prior, data.z, dt=data.dt, inputs=data.inputs, R=data.R, update_first=data.update_first)
    return done.faults(1)

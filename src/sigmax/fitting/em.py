"""Expectation–maximisation of noises: Q and R as they are seen in the smoothed record."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import wrap
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.fitting.likelihood import Data, Likelihood
from sigmax.fitting.noise_factors import with_factor
from sigmax.fitting.search import Parameters, search_of
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.switching import check_one_mode
from sigmax.preparation.prepare import as_filter
from sigmax.running.run import run
from sigmax.running.smooth import smooth

# Factors that change by less than this are found.
_SETTLED = 1e-4


class Em(NamedTuple):
    """What `em` found.

    Attributes:
        Q: the factor of Q.
        R: factors of the variances (m,) by sensor.
        log_likelihood: at the start and after each step.
    """

    Q: float
    R: dict[str, np.ndarray]
    log_likelihood: np.ndarray


def em(
    filter: Filter | str,
    model: Model,
    prior: Gaussian,
    z: Any,
    *,
    dt: Any = 1.0,
    inputs: Any = None,
    update_first: bool = False,
    steps: int = 50,
) -> Em:
    """Factors of Q, and of R component by component, by expectation and maximisation (Shumway and Stoffer 1982).

    Each step smooths the record and takes for a noise what its residuals are there, exactly where the model is linear,
    else by its derivatives at the estimates. It climbs slowly and never far wrong: a start for `fit` where that one's
    is poor.

    Args:
        filter: of the passes.
        model: of one mode, its noises as they are to be multiplied.
        prior: as in `run`.
        z: as in `run`.
        dt: as in `run`.
        inputs: as in `run`.
        update_first: as in `run`.
        steps: at most so many.

    Raises:
        InputError: for what `run` and `smooth` refuse, several modes, curved parts, and a bias.
    """
    chosen = as_filter(filter)
    check_one_mode(model, "em")
    if model.curved or model.bias is not None:
        raise InputError("em knows numbers and angles, and no Bias: make it a part of the state, or use sigmax.fit")
    places = {"Q": ("Q",)} | {f"R.{s}.{j}": ("R", s, j) for s, j in _components(model)}

    def build(p: Parameters) -> tuple[Model, Gaussian]:
        made = model
        for name, at in places.items():
            made = with_factor(made, at, p[name])
        return made, prior

    search, theta = search_of(dict.fromkeys(places, 1.0), tuple(places), {})
    one = Likelihood(chosen, Data(build, z, dt, inputs, None, update_first), search, theta)
    found = [float(one(theta[None])[0])]
    moments = _moments(one)
    for _ in range(steps):
        new = moments(theta)
        theta, before = new, theta
        found.append(float(one(theta[None])[0]))
        if np.abs(np.log(theta / before)).max() < _SETTLED:
            break
    named = {name: float(v) for name, v in search.named(theta).items()}
    R = {s: np.array([named[f"R.{t}.{j}"] for t, j in _components(model) if t == s]) for s in model.sensors}
    return Em(named["Q"], R, np.array(found))


def _components(model: Model) -> list[tuple[str, str]]:
    """Sensors and their components.

    Raises:
        InputError: where they have no names.
    """
    found = []
    for s in model.sensors:
        names = model.measured_deviations(s)
        if names is None:
            raise InputError(f"em wants to know what {s or 'the sensor'} measures: give the model measurement=")
        found += [(s, str(name)) for name in names]
    return found


def _moments(one: Likelihood) -> Callable[[np.ndarray], np.ndarray]:
    """A function of parameters (p,): those of the next step."""
    ready, search = one.ready, one.search
    parametric = one.parametric_model()
    T, B = one.steps, one.tracks
    own = np.zeros((B, T, 0)) if ready.u is None else np.broadcast_to(ready.u, (B, T, ready.u.shape[-1]))
    dt = np.broadcast_to(ready.dt, (B, T))
    z = {s: np.broadcast_to(v, (B, T, v.shape[-1])) for s, v in ready.z.items()}
    whole = Gaussian(
        np.broadcast_to(ready.mean, (B, parametric.size)), np.broadcast_to(ready.cov, (B, *[parametric.dim] * 2))
    )

    @jax.jit
    def of_motion(later: Any, Ps: Any, before: Any, P0s: Any, at: Any, P: Any, step: Any, u: Any) -> Any:
        F = jax.jacfwd(parametric.motion)(at, step, u)
        Q = jnp.asarray(parametric.Q(at, step, u))
        Q = jnp.diag(Q) if Q.ndim == 1 else Q
        G = P @ F.T @ jnp.linalg.pinv(F @ P @ F.T + Q, hermitian=True)
        C = Ps @ G.T
        w = wrap(later - parametric.motion(before, step, u), parametric.angular)
        Fs = jax.jacfwd(parametric.motion)(before, step, u)
        W = jnp.outer(w, w) + Ps - C @ Fs.T - Fs @ C.T + Fs @ P0s @ Fs.T
        inverse = jnp.linalg.pinv(Q, hermitian=True)
        return jnp.trace(inverse @ W), jnp.trace(inverse @ Q)

    def of_sensor(s: str) -> Callable[..., Any]:
        turns = parametric.measured_angular(s, z[s].shape[-1])

        def seen(x: Any, P: Any, value: Any, u: Any) -> Any:
            H = jax.jacfwd(parametric.sensors[s])(x, u)
            R = jnp.asarray(parametric.R[s](x, u))
            R = R if R.ndim == 1 else jnp.diag(R)
            miss = wrap(value - parametric.sensors[s](x, u), turns)
            return jnp.where(jnp.isnan(value), 0, (miss**2 + jnp.diag(H @ P @ H.T)) / R)

        return jax.jit(jax.vmap(jax.vmap(seen)))

    moving, hearing = jax.vmap(jax.vmap(of_motion)), {s: of_sensor(s) for s in z}
    given = z if parametric.several else next(iter(z.values()))

    def step(theta: np.ndarray) -> np.ndarray:
        u = np.concatenate([own, np.broadcast_to(theta, (B, T, len(theta)))], -1)
        done = run(ready.filter, parametric, whole, given, dt=dt, inputs=u, update_first=one.data.update_first)
        back = smooth(ready.filter, parametric, done)
        x, P, m, C = (np.asarray(a) for a in (done.mean, done.cov, back.mean, back.cov))
        parts = m[:, 1:], C[:, 1:], m[:, :-1], C[:, :-1], x[:, :-1], P[:, :-1], dt[:, 1:], u[:, 1:]
        some, rank = (np.asarray(a) for a in moving(*parts))
        went = dt[:, 1:] > 0
        now = {name: float(v) for name, v in search.named(theta).items()}
        now["Q"] *= float(some[went].sum() / np.round(rank[went]).sum())
        for s, hear in hearing.items():
            ratio = np.asarray(hear(m, C, z[s], u))
            names = parametric.measured_deviations(s) or ()
            for j, name in enumerate(names):
                now[f"R.{s}.{name}"] *= float(ratio[..., j].sum() / np.isfinite(z[s][..., j]).sum())
        return search.flat(now)

    return step

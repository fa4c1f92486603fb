"""Sigma points that lie so far apart that angles fold: said before a run, for nothing fails when it happens."""

from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.dependence import reading
from sigmax.dependence.reads import components
from sigmax.filters import Filter
from sigmax.functions.current import found_once
from sigmax.modelling.checks import is_traced
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.rules import SigmaPoints
from sigmax.spaces import Flat

# Radians from the mean beyond which a pair of points no longer tells the slope of a sine by its sign and size.
_FAR = 1.0
# The deviation of an angle of which nothing is known.
_UNIFORM = np.pi / np.sqrt(3)


def folding(filter: Filter, model: Model, prior: Gaussian, inputs: int | None) -> Iterator[str]:
    """Where sigma points of the prior lie so far apart in an angle that they come back from the other side.

    Points at ±γσ of a course see opposite sines at half a turn, and filters then lock on to the opposite course
    (Sobolev, VIII.B with P0 as printed).

    Args:
        filter: on the model.
        model: with its bias in the state.
        prior: of that state.
        inputs: components of u; None where they are not known yet: then what takes u is supposed to bend.
    """
    turning, reach = _turning(model, filter)
    if not turning or is_traced(prior.mean) or is_traced(prior.cov) or prior.dim != model.dim:
        return
    # No point is further than its length in deviations, which costs no root.
    if max(prior.cov[..., i, i].max() for i in turning) * reach**2 < _FAR**2:
        return
    rules = {"motion": filter.predict} | dict.fromkeys(model.sensors, filter.correct)
    if not model.space.flat:
        yield from _wrapping(filter, model, prior)
        return
    said: set[int] = set()
    for what, rule in rules.items():
        if not isinstance(rule, SigmaPoints):
            continue
        away = np.abs(_root(prior) @ rule.points(model.dim).points.T).max(-1)
        away = away.reshape(-1, model.dim).max(0)
        far = [i for i in np.flatnonzero(away > _FAR) if model.angular[i] and i not in said]
        if not far:
            continue
        bends = _bending(model, what, inputs)
        where, instead = ("motion", "SRECKFB or EKF") if what == "motion" else ("sensor", "EKF")
        for i in (int(i) for i in far if bends is None or i in bends):
            said.add(i)
            sigma = float(np.sqrt(np.asarray(prior.cov)[..., i, i].max()))
            least = np.degrees(min(sigma * _FAR / away[i], _UNIFORM))
            yield (
                f"sigma points of {filter.name} lie up to ±{np.degrees(away[i]):.0f}° from the mean of "
                f"{model.state[i]} (σ {np.degrees(sigma):.0f}°), where the {where} bends: from "
                f"{np.degrees(_FAR):.0f}° on they fold over the circle, and the track may be lost. Take derivatives "
                f"there, as in {instead}, or a deviation of at most {least:.0f}° in the prior"
            )


@found_once
def _turning(model: Model, filter: Filter) -> tuple[list[int], float]:
    """Deviations that turn, none where there are no sigma points; and the length of the longest point."""
    found: list[int] = []
    rules = [rule for rule in (filter.predict, filter.correct) if isinstance(rule, SigmaPoints)]
    if not rules:
        return found, 0.0
    for p, _, to in model.space.parts():
        found += [to.start + k for k in range(p.dim) if (p.periodic[k] if isinstance(p, Flat) else k < p.turns)]
    return found, max(float(np.linalg.norm(rule.points(model.dim).points, axis=1).max()) for rule in rules)


def _root(prior: Gaussian) -> np.ndarray:
    """The factor of the prior's covariance; a variance of 0 is one like any other."""
    P = np.asarray(prior.cov, float)
    variances = np.einsum("...ii->...i", P)[..., None] * np.eye(prior.dim)
    root: np.ndarray = np.linalg.cholesky(P + 1e-9 * variances + np.finfo(float).tiny * np.eye(prior.dim))
    return root


def _bending(model: Model, what: str, inputs: int | None) -> frozenset[int] | None:
    """The components in which a function is no straight line; None where that cannot be known without its inputs."""
    motion = what == "motion"
    takes = model.motion_inputs if motion else model.sensor_inputs[what]
    if takes and inputs is None:
        return None
    u = [jnp.zeros(inputs or 0)] if takes else []
    function: Callable[..., Any] = model.motion if motion else model.sensors[what]
    read = reading(function, model.size, [jnp.ones(()), *u] if motion else u)
    return frozenset(components(read.nonlinear))


def _wrapping(filter: Filter, model: Model, prior: Gaussian) -> Iterator[str]:
    """The same of rotations and directions: half a turn is as far as one can turn."""
    for rule in {rule for rule in (filter.predict, filter.correct) if isinstance(rule, SigmaPoints)}:
        away = _root(prior) @ rule.points(model.dim).points.T
        for p, _, to in model.space.parts():
            far = np.linalg.norm(away[..., to.start : to.start + p.turns, :], axis=-2).max(initial=0.0)
            if far > np.pi:
                yield (
                    f"sigma points of {filter.name} lie up to {np.degrees(far):.0f}° from the mean of "
                    f"{model.deviations[to.start]}, more than half a turn, and come back from the other side: take a "
                    "Taylor rule, as in EKF, or points that lie closer, such as UKF with alpha below 1"
                )

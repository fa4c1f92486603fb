"""Several beliefs at once with the logarithms of their probabilities: what modes and the members of a bank share."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import pivoted, solve_lower
from sigmax.spaces import Flat, Space, moments
from sigmax.steps.step import Belief, Fault, Innovation

# The logarithm of the probability of what cannot be: no infinity, whose differences are no numbers.
NEVER = -1e30


class MixtureBelief(NamedTuple):
    """What a filter of several beliefs knows.

    Attributes:
        mean: of the mixture, with the components of all (n, ...).
        factor: of its covariance (n, n, ...).
        members: the belief of each, of its own components.
        log_weight: logarithms of their probabilities (M, ...).
    """

    mean: Any
    factor: Any
    members: tuple[Belief, ...]
    log_weight: Any


Corrected = tuple[Belief, Innovation, Any]
Moments = Callable[[Sequence[Belief], Any], Belief]


def log(p: Any) -> Any:
    """The logarithm of probabilities, that of 0 as a number."""
    return jnp.where(p > 0, jnp.log(jnp.where(p > 0, p, 1)), NEVER)


def normalised(logs: Sequence[Any]) -> tuple[Any, Any]:
    """Weights (M, ...) that sum to 1 of their logarithms, and the logarithm (...) of their sum."""
    most = logs[0]
    for one in logs[1:]:
        most = jnp.maximum(most, one)
    shares = [jnp.exp(one - most) for one in logs]
    total = sum(shares[1:], start=shares[0])
    return jnp.stack([s / total for s in shares]), jnp.maximum(most + jnp.log(total), NEVER)


def chosen(which: Any, new: Any, old: Any) -> Any:
    """What is new, or as it was before."""
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), new, old)


def where_any(which: Any, new: Callable[[], Any], old: Any) -> Any:
    """What a function makes where that is so, or as it was before; where it is so nowhere nothing is computed."""
    return jax.lax.cond(jnp.any(which), lambda: chosen(which, new(), old), lambda: old)


def weighed(log_weight: Sequence[Any], done: Sequence[Corrected]) -> list[Any]:
    """The logarithms of weights times the likelihood of a measurement; a member that failed has none."""
    return [
        jnp.where(fault <= 0, w + said.log_likelihood, NEVER)
        for w, (_, said, fault) in zip(log_weight, done, strict=True)
    ]


def innovation(onto: Space, log_weight: Sequence[Any], done: Sequence[Corrected]) -> Innovation:
    """What a measurement in a space said, of the mixture of what the members expected.

    `log_weight` are those before it.
    """
    said = [told for _, told, _ in done]
    before = [jnp.where(fault <= 0, w, NEVER) for w, (_, _, fault) in zip(log_weight, done, strict=True)]
    shares, _ = normalised(before)
    _, total = normalised(weighed(log_weight, done))
    dof = said[0].dof
    for told in said[1:]:
        dof = jnp.maximum(dof, told.dof)
    seen = ~jnp.isnan(said[0].residual)
    residual, factor = moments(
        Flat(onto.periodic), [jnp.where(seen, i.residual, 0) for i in said], [i.factor for i in said], shares
    )
    whitened = solve_lower(pivoted(factor), residual)
    return Innovation(
        residual=jnp.where(seen, residual, jnp.nan),
        factor=factor,
        nis=jnp.where(dof > 0, (whitened**2).sum(0), jnp.nan),
        log_likelihood=jnp.where(seen.any(0) & (total > NEVER / 2), total, 0),
        dof=dof,
    )


def settled(
    mixed: Moments,
    old: MixtureBelief,
    members: Sequence[Belief],
    log_weight: Sequence[Any],
    faults: Sequence[Any],
    lost: Fault = Fault.PREDICTION_INDEFINITE,
    heard: Any = True,
) -> tuple[MixtureBelief, Any]:
    """The belief of members that were moved on, with the moments of their mixture; the old one where all failed.

    `faults` need not be one a member; `lost` is the fault where the moments are not finite. Where nothing
    was `heard` it stays as it was to the last bit.
    """
    shares, total = normalised(log_weight)
    mean, factor = mixed(members, shares)
    finite = jnp.isfinite(mean.sum(0)) & jnp.isfinite(factor.sum((0, 1)))
    log_weight = [jnp.maximum(w - total, NEVER) for w in log_weight]
    new = MixtureBelief(mean, factor, tuple(members), jnp.stack(log_weight))
    fault = of_all(faults)
    fault = jnp.where((fault <= 0) & ~finite, jnp.int8(lost), fault)
    return chosen((fault <= 0) & heard, new, old), fault


def of_all(faults: Sequence[Any]) -> Any:
    """The fault (...) of several members: that of the first where all failed, else the first of less weight."""
    failed = jnp.stack([fault > 0 for fault in faults])
    fault = jnp.zeros_like(faults[0])
    for one in faults:
        fault = jnp.where((one < 0) & (fault == 0), one, fault)
    fault = jnp.where(failed.any(0), jnp.int8(Fault.MEMBER_FAILED), fault)
    return jnp.where(failed.all(0), faults[0], fault)


def least(values: Sequence[Any]) -> list[Any]:
    """Which of some values (...) is the least, the first of equals: a truth value for each.

    What is equal but for rounding is equal, so that another order of operations makes the same choice.
    """
    eps = float(np.finfo(values[0].dtype).eps)
    least, at = values[0], jnp.zeros(values[0].shape, int)
    for k, value in enumerate(values[1:], 1):
        less = value < least - (math.sqrt(eps) * jnp.abs(least) + eps)
        least, at = jnp.where(less, value, least), jnp.where(less, k, at)
    return [at == k for k in range(len(values))]


def picked(which: Sequence[Any], among: Sequence[Any]) -> Any:
    """The one of some that is marked."""
    found = among[0]
    for mark, one in zip(which[1:], among[1:], strict=True):
        found = chosen(mark, one, found)
    return found

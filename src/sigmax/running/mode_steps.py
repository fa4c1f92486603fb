"""Half-steps of a model that switches between modes: each mode's filter, mixed before the motion (IMM).

Blom and Bar-Shalom 1988. A mode that does not have a component of another
takes it by its declared entry, and forgets it on leaving.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import diagonal, inner, times
from sigmax.algebra.factor import Diagonal, absorb, cholesky, identity, pivoted, solve_lower, tria
from sigmax.filters import Filter
from sigmax.models.evaluate import noise_root
from sigmax.models.model import Model
from sigmax.models.switching import SwitchingModel
from sigmax.running import step
from sigmax.running.mode_components import entered, returned, way
from sigmax.running.smooth_step import back
from sigmax.running.step import Belief, Fault, Innovation
from sigmax.spaces import Flat, Space, moments

# The logarithm of the probability of what cannot be: no infinity, whose differences are no numbers.
_NEVER = -1e30
# A mode that is less probable may fail without the step being said to have failed.
_LITTLE = 1e-6


class ModesBelief(NamedTuple):
    """What a filter of several modes knows.

    Attributes:
        mean: of the mixture, with the components of all modes (n, ...).
        factor: of its covariance (n, n, ...).
        modes: the belief of each mode, of its own components.
        log_weight: logarithms of the probabilities of the modes (M, ...).
    """

    mean: Any
    factor: Any
    modes: tuple[Belief, ...]
    log_weight: Any


class ModeSteps:
    """The half-steps of filters on the modes of a model; pure functions that trace to plain operations.

    Args:
        filters: of the modes.
        model: the model.
    """

    def __init__(self, filters: Sequence[Filter], model: SwitchingModel) -> None:
        self.model, self.each = model, list(zip(filters, model.models, strict=True))
        self.roots = [noise_root(m.Q) for m in model.models]

    def begin(self, mean: Any, cov: Any) -> tuple[ModesBelief, Any]:
        """The belief of a prior of all components, and whether it is one (...)."""
        factor, sound = cholesky(cov)
        modes = []
        for m in self.model.models:
            found = way(self.model, m)
            at = np.array(found.deviations)
            own = factor if found.straight else cholesky(cov[at][:, at])[0]
            modes.append(Belief(mean[np.array(found.points)], own))
        initial = jnp.asarray(self.model.initial, mean.dtype)
        log_weight = jnp.broadcast_to(_log(initial).reshape(-1, *(1,) * (mean.ndim - 1)), (len(modes), *mean.shape[1:]))
        return ModesBelief(mean, factor, tuple(modes), log_weight), sound

    def predict(self, belief: ModesBelief, dt: Any, u: Any) -> tuple[ModesBelief, Any]:
        """The belief dt later, and the fault (...) of each member of the batch."""
        change = _log(self.model.transitions(dt))
        moved, faults, log_weight = [], [], []
        for i, ((filter, model), root) in enumerate(zip(self.each, self.roots, strict=True)):
            shares, total = _normalised([w + change[j, i] for j, w in enumerate(belief.log_weight)])
            new, fault = step.predict(filter, model, root, self._mixed(belief.modes, model, shares), dt, u)
            # A mode that failed stays as it was, and so does all where they all fail.
            moved.append(_chosen(fault <= 0, new, belief.modes[i]))
            faults.append(fault)
            log_weight.append(jnp.where(fault <= 0, total, _NEVER))
        return self._told(belief, tuple(moved), log_weight, faults)

    def correct(self, sensor: str, R: Any, belief: ModesBelief, z: Any, u: Any) -> tuple[ModesBelief, Innovation, Any]:
        """The belief after a measurement z (m, ...); the innovation is that of the mixture of predictions."""
        done = [
            step.correct(f, m, sensor, m.R[sensor] if R is None else R, b, z, u)
            for (f, m), b in zip(self.each, belief.modes, strict=True)
        ]
        faults, said = [fault for _, _, fault in done], [told for _, told, _ in done]
        log_weight = [
            jnp.where(fault <= 0, w + told.log_likelihood, _NEVER)
            for w, told, fault in zip(belief.log_weight, said, faults, strict=True)
        ]
        _, total = _normalised(log_weight)
        before = [jnp.where(fault <= 0, w, _NEVER) for w, fault in zip(belief.log_weight, faults, strict=True)]
        dof = said[0].dof
        for told in said[1:]:
            dof = jnp.maximum(dof, told.dof)
        told = self._innovation(sensor, z, said, _normalised(before)[0], total, dof)
        new, fault = self._told(belief, tuple(b for b, _, _ in done), log_weight, faults, Fault.CORRECTION_INDEFINITE)
        # To the last bit as it was where nothing was heard.
        return _chosen(~jnp.isnan(said[0].residual).all(0), new, belief), told, fault

    def back(
        self, filtered: ModesBelief, later: ModesBelief, later_fault: Any, dt: Any, u: Any
    ) -> tuple[ModesBelief, Any]:
        """The smoothed belief of a step, and its fault, from that of the step after it.

        What is heard later of the next mode is what its smoothed belief knows more than its predicted one: a likelihood
        by which each mode before is judged and from which it is smoothed on its own. Smoothing all of them from one
        smoothed belief, as Kim (1994) does, takes what two modes expected for one. What a mode has and the next has not
        follows by its regression on the rest. The work of two predictions and a smoothing for each of the M² pairs.
        """
        change = _log(self.model.transitions(dt))
        none = jnp.zeros_like(later_fault)
        M = len(self.each)
        pairs: dict[tuple[int, int], Belief] = {}
        weights: dict[tuple[int, int], Any] = {}
        failed = none
        for i, ((filter, model), root) in enumerate(zip(self.each, self.roots, strict=True)):
            shares, _ = _normalised([w + change[j, i] for j, w in enumerate(filtered.log_weight)])
            ahead, _ = step.predict(filter, model, root, self._mixed(filtered.modes, model, shares), dt, u)
            heard = []
            for j in range(M):
                begun = self._entered(filtered.modes[j], self.model.models[j], model)
                moved, fault = step.predict(filter, model, root, begun, dt, u)
                known, likelihood = _learnt(model.space, ahead, later.modes[i], moved)
                heard.append(jnp.where(fault <= 0, _log(shares[j]) + likelihood, _NEVER))
                pair, fault = back(filter, model, root, begun, known, none, dt, u)
                pairs[j, i] = returned(self.model.models[j], model, filtered.modes[j], Belief(*pair))
                failed = jnp.where((fault > 0) & (shares[j] > _LITTLE), fault, failed)
            shares, _ = _normalised(heard)
            weights |= {(j, i): _log(shares[j]) + later.log_weight[i] for j in range(M)}
        modes, log_weight = [], []
        for j, own in enumerate(self.model.models):
            shares, total = _normalised([weights[j, i] for i in range(M)])
            both = [pairs[j, i] for i in range(M)]
            modes.append(Belief(*moments(own.space, [b.mean for b in both], [b.factor for b in both], shares)))
            log_weight.append(total)
        new, _ = self._told(filtered, tuple(modes), log_weight, [none] * M)
        # A step whose prediction failed left the belief as it was: its smoothed one is the next one's.
        unmoved = (later_fault > 0) & (later_fault <= Fault.PREDICTION_INDEFINITE)
        return _chosen(unmoved, later, new), jnp.where(unmoved, 0, failed).astype(jnp.int8)

    def _told(
        self,
        old: ModesBelief,
        modes: tuple[Belief, ...],
        log_weight: list[Any],
        faults: list[Any],
        lost: Fault = Fault.PREDICTION_INDEFINITE,
    ) -> tuple[ModesBelief, Any]:
        """The belief of modes that were moved on, with the moments of their mixture; the old one where all failed."""
        failed = jnp.stack([fault > 0 for fault in faults])
        shares, total = _normalised(log_weight)
        mean, factor = self._mixed(modes, self.model, shares)
        finite = jnp.isfinite(mean.sum(0)) & jnp.isfinite(factor.sum((0, 1)))
        new = ModesBelief(mean, factor, modes, jnp.stack([jnp.maximum(w - total, _NEVER) for w in log_weight]))
        fault = jnp.zeros_like(faults[0])
        for one in faults:
            fault = jnp.where((one < 0) & (fault == 0), one, fault)
        fault = jnp.where(failed.any(0), jnp.int8(Fault.MODE_FAILED), fault)
        fault = jnp.where(failed.all(0), faults[0], fault)
        fault = jnp.where((fault <= 0) & ~finite, jnp.int8(lost), fault)
        return _chosen(fault <= 0, new, old), fault

    def _innovation(
        self, sensor: str, z: Any, said: Sequence[Innovation], shares: Any, total: Any, dof: Any
    ) -> Innovation:
        """What a measurement said, of the mixture of what the modes expected."""
        onto = self.model.measured_space(sensor, z.shape[0])
        seen = ~jnp.isnan(said[0].residual)
        residual, factor = moments(
            Flat(onto.periodic), [jnp.where(seen, i.residual, 0) for i in said], [i.factor for i in said], shares
        )
        whitened = solve_lower(pivoted(factor), residual)
        return Innovation(
            residual=jnp.where(seen, residual, jnp.nan),
            factor=factor,
            nis=jnp.where(dof > 0, (whitened**2).sum(0), jnp.nan),
            log_likelihood=jnp.where(seen.any(0) & (total > _NEVER / 2), total, 0),
            dof=dof,
        )

    def _entered(self, belief: Belief, source: Model, onto: Model) -> Belief:
        """The belief of one mode with the components of another model."""
        mean, root = entered(belief, way(source, onto, self.model.entry))
        return belief if root is belief.factor else Belief(mean, tria(root))

    def _mixed(self, beliefs: Sequence[Belief], onto: Model, shares: Any) -> Belief:
        """The mixture of the modes' beliefs with the components of another model."""
        each = [
            entered(belief, way(own, onto, self.model.entry))
            for belief, own in zip(beliefs, self.model.models, strict=True)
        ]
        return Belief(*moments(onto.space, [mean for mean, _ in each], [root for _, root in each], shares))


def _learnt(space: Space, ahead: Belief, smoothed: Belief, moved: Belief) -> tuple[tuple[Any, Any], Any]:
    """Another prediction with what a smoothed belief knows more than its own prediction, and that one's log-likelihood.

    P_s⁻¹ − P⁻¹ = S_s⁻ᵀ V Vᵀ S_s⁻¹ with V Vᵀ = I − S_sᵀ P⁻¹ S_s, as a measurement Vᵀ S_s⁻¹ (x − x⁻) of noise I. Where a
    mixture is wider than what was predicted it knows nothing.
    """
    x, L = ahead
    delta = space.difference(smoothed.mean, x)
    root = pivoted(space.turned_back(x, delta, smoothed.factor))
    inside = solve_lower(pivoted(L), root)
    V, _ = cholesky(identity(root) - inner(inside, inside))
    knows = diagonal(V) > 0
    said = jnp.where(knows, solve_lower(pivoted(V), solve_lower(root, delta)), 0)
    away = space.difference(moved.mean, x)
    S = space.turned_back(x, away, moved.factor)
    seen = inner(V, solve_lower(root, jnp.concatenate([away[:, None], S], axis=1)))
    innovation = said - seen[:, 0]
    Sy, gain, rest = absorb(Diagonal(jnp.ones_like(said)), seen[:, 1:], S)
    whitened = solve_lower(Sy, innovation)
    shift = away + times(gain, whitened)
    likelihood = -0.5 * (whitened**2).sum(0) - jnp.log(diagonal(Sy)).sum(0)
    return (space.add(x, shift), space.turned(x, shift, rest)), likelihood


def _log(p: Any) -> Any:
    """The logarithm of probabilities, that of 0 as a number."""
    return jnp.where(p > 0, jnp.log(jnp.where(p > 0, p, 1)), _NEVER)


def _normalised(logs: Sequence[Any]) -> tuple[Any, Any]:
    """Weights (M, ...) that sum to 1 of their logarithms, and the logarithm (...) of their sum."""
    most = logs[0]
    for one in logs[1:]:
        most = jnp.maximum(most, one)
    shares = [jnp.exp(one - most) for one in logs]
    total = sum(shares[1:], start=shares[0])
    return jnp.stack([s / total for s in shares]), jnp.maximum(most + jnp.log(total), _NEVER)


def _chosen(which: Any, new: Any, old: Any) -> Any:
    """What is new, or as it was before."""
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), new, old)

"""What a target may be doing: one filter, or several that take turns (interacting multiple models)."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.special import logsumexp

from sigmax.engine.rows import RowSteps
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.modelling.checks import members, numbers
from sigmax.modelling.model import Model, check_flat
from sigmax.tracking.mixture import merged, summed

# No mode is less probable: a target may always begin to do what it has not done for long.
LEAST = 1e-12


class Beliefs(NamedTuple):
    """What is known of B targets.

    Attributes:
        rows: for each mode, a row a target (B, size).
        weight: the probability of each mode (B, M), at least `LEAST`.
    """

    rows: tuple[np.ndarray, ...]
    weight: np.ndarray

    def take(self, index: Any) -> "Beliefs":
        """Some of the targets."""
        return Beliefs(tuple(r[index] for r in self.rows), self.weight[index])

    def joined(self, other: "Beliefs") -> "Beliefs":
        """These targets and others behind them."""
        rows = tuple(np.concatenate(pair) for pair in zip(self.rows, other.rows, strict=True))
        return Beliefs(rows, np.concatenate([self.weight, other.weight]))


class Corrections(NamedTuple):
    """What K plots make of the beliefs of the tracks they may belong to.

    Attributes:
        rows: for each mode, the corrected rows (K, size).
        log_likelihood: of the plot in each mode (K, M).
        nis: the smallest over the modes (K,).
        dof: components seen (K,); 0 where the correction was not sound.
    """

    rows: tuple[np.ndarray, ...]
    log_likelihood: np.ndarray
    nis: np.ndarray
    dof: np.ndarray

    def take(self, index: np.ndarray) -> "Corrections":
        """Some of the plots."""
        return Corrections(tuple(r[index] for r in self.rows), *(a[index] for a in self[1:]))


class Modes:
    """Filters on models of one state, and how a target changes between them.

    With several modes this is the IMM filter (Blom and Bar-Shalom 1988): beliefs are mixed before the
    prediction by p(i at the start | j at the end). A target stays in a mode for `sojourn` seconds on average
    and then takes any other, so that scans at any times are treated alike: the transition matrix over dt
    is the exponential of the rates. Probabilities are weighed as logarithms and have a floor, so that a mode
    comes back even without `sojourn`, where it is judged by the measurements alone.

    Args:
        modes: pairs (filter, model); the models have the same state and sensors of the same names.
        sojourn: seconds, one for each mode.
        dtype: float64 or float32.
        backend: as in `run`.

    Raises:
        InputError: where the models do not fit each other.
    """

    def __init__(
        self,
        modes: Sequence[tuple[Filter | str, Model]],
        sojourn: Any = None,
        *,
        dtype: Any = "float64",
        backend: str | None = None,
    ) -> None:
        modes = members(modes) or []
        if not modes or not all(isinstance(mode, list | tuple) and len(mode) == 2 for mode in modes):
            raise InputError("modes must be a list of pairs (filter, model), at least one")
        for _, m in modes:
            if not isinstance(m, Model):
                raise InputError(f"a mode is a filter and a sigmax.Model; this one has {type(m).__name__}")
            check_flat(m, "a tracker")
        self.steps = [RowSteps(f, m, dtype=dtype, backend=backend) for f, m in modes]
        self.model: Model = modes[0][1]
        for _, m in modes[1:]:
            if m.state != self.model.state or set(m.sensors) != set(self.model.sensors):
                raise InputError(
                    f"all modes need the same state and sensors; {m.state} with {sorted(m.sensors)} differs from "
                    f"{self.model.state} with {sorted(self.model.sensors)}"
                )
        M = len(modes)
        times = numbers("sojourn", sojourn if sojourn is not None else [np.inf] * M)
        if times.shape != (M,) or not (times > 0).all():
            raise InputError(f"sojourn must be {M} positive numbers of seconds, one for each mode; it is {sojourn}")
        leaving = 1 / times[:, None]
        self._rates = (np.ones((M, M)) - np.eye(M)) * leaving / max(M - 1, 1) - np.eye(M) * leaving
        share = times / times.sum() if np.isfinite(times).all() else np.full(M, 1 / M)
        self._at_first = share if M > 1 else np.ones(1)

    def empty(self) -> Beliefs:
        """No targets."""
        n = self.model.size
        return self.start(np.empty((0, n)), np.empty((0, n, n)))

    def start(self, mean: np.ndarray, cov: np.ndarray) -> Beliefs:
        """Targets at means (B, n) with covariances (B, n, n), in each mode alike."""
        rows = tuple(s.start(mean, cov) for s in self.steps)
        return Beliefs(rows, np.tile(self._at_first, (len(mean), 1)))

    def predict(self, beliefs: Beliefs, dt: float) -> tuple[Beliefs, np.ndarray]:
        """The beliefs dt seconds later, and whether each (B,) is sound."""
        if len(self.steps) > 1 and dt > 0 and len(beliefs.weight):
            beliefs = self._mixed(beliefs, expm(self._rates * dt))
        moved = [s.predict(r, dt) for s, r in zip(self.steps, beliefs.rows, strict=True)]
        faults = np.stack([fault for _, fault in moved])
        return Beliefs(tuple(r for r, _ in moved), beliefs.weight), (faults == 0).all(0)

    def _mixed(self, beliefs: Beliefs, transition: np.ndarray) -> Beliefs:
        B, M = beliefs.weight.shape
        joint = beliefs.weight[:, :, None] * transition
        later = joint.sum(1)
        means = np.concatenate([s.mean(r) for s, r in zip(self.steps, beliefs.rows, strict=True)])
        covs = np.concatenate([s.cov(r) for s, r in zip(self.steps, beliefs.rows, strict=True)])
        group = np.tile(np.arange(B), M)
        rows = []
        for j, s in enumerate(self.steps):
            weight = (joint[:, :, j] / later[:, j, None]).T.ravel()
            rows.append(s.start(*merged(means, covs, weight, group, B, self.model.angular)))
        return Beliefs(tuple(rows), _floored(later))

    def expect(self, beliefs: Beliefs, sensor: str, size: int, u: Any) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """What a sensor should measure, (B, m) for each mode, and the deviation of each component."""
        nothing = np.zeros((len(beliefs.weight), size))
        told = [s.correct(r, sensor, nothing, u)[1] for s, r in zip(self.steps, beliefs.rows, strict=True)]
        return [-t.residual for t in told], [np.sqrt((t.factor**2).sum(-1)) for t in told]

    def correct(self, beliefs: Beliefs, track: np.ndarray, sensor: str, z: np.ndarray, u: Any) -> Corrections:
        """Correct the tracks at places (K,) with plots z (K, m), pair by pair."""
        made = [s.correct(r[track], sensor, z, u) for s, r in zip(self.steps, beliefs.rows, strict=True)]
        sound = np.stack([told.dof > 0 for _, told, _ in made], axis=1)
        likelihood = np.stack([told.log_likelihood for _, told, _ in made], axis=1)
        nis = np.stack([told.nis for _, told, _ in made], axis=1)
        return Corrections(
            tuple(rows for rows, _, _ in made),
            np.where(sound, likelihood, -np.inf),
            np.where(sound, nis, np.inf).min(1, initial=np.inf),
            np.stack([told.dof for _, told, _ in made], axis=1).max(1, initial=0),
        )

    def update(self, before: Beliefs, made: Corrections, track: np.ndarray, share: np.ndarray) -> Beliefs:
        """The beliefs after plots that belong to their tracks with probability `share` (K,), rest: no plot at all.

        Exact for what the shares say: mode and plot are weighted jointly, and each mode's mixture becomes one
        Gaussian (PDA, Bar-Shalom and Tse 1975; with modes, Houles and Bar-Shalom 1989).
        """
        # A plot whose correction is sound in no mode belongs to nothing.
        chosen = (share > 0) & np.isfinite(made.log_likelihood).any(1)
        track, share = track[chosen], share[chosen]
        rest = np.clip(1 - np.bincount(track, share, len(before.weight)), 0, 1)
        with np.errstate(divide="ignore"):
            prior = np.log(before.weight)
            joint = prior[track] + made.log_likelihood[chosen]
            joint += np.log(share)[:, None] - logsumexp(joint, axis=1, keepdims=True)
            silent = prior + np.log(rest)[:, None]
            total = _logarithm_of_sums(silent, joint, track)
            weight = np.exp(total - total.max(1, keepdims=True))
        # A mode that is out of the question has no plots and is not silent either.
        known = np.where(np.isfinite(total), total, 0.0)
        joint, silent = np.exp(joint - known[track]), np.exp(silent - known)
        rows = tuple(
            _mode_updated(s, before.rows[m], made.rows[m][chosen], track, joint[:, m], silent[:, m])
            for m, s in enumerate(self.steps)
        )
        return Beliefs(rows, _floored(weight))

    def moments(self, beliefs: Beliefs) -> tuple[np.ndarray, np.ndarray]:
        """Means (B, n) and covariances (B, n, n) over the modes."""
        means = [s.mean(r) for s, r in zip(self.steps, beliefs.rows, strict=True)]
        covs = [s.cov(r) for s, r in zip(self.steps, beliefs.rows, strict=True)]
        B, M = beliefs.weight.shape
        if M == 1:
            return means[0].copy(), covs[0]
        group = np.tile(np.arange(B), M)
        stacked = np.concatenate(means), np.concatenate(covs), beliefs.weight.T.ravel()
        return merged(*stacked, group, B, self.model.angular)


def _logarithm_of_sums(alone: np.ndarray, added: np.ndarray, group: np.ndarray) -> np.ndarray:
    """log(Σ exp) of what each group (B, M) has alone and of the members (K, M) that are added to it."""
    most = alone.copy()
    np.maximum.at(most, group, added)
    most = np.where(np.isfinite(most), most, 0.0)
    total: np.ndarray = np.log(np.exp(alone - most) + summed(np.exp(added - most[group]), group, len(most))) + most
    return total


def _floored(weight: np.ndarray) -> np.ndarray:
    """Probabilities (B, M) of weights."""
    share = np.maximum(weight / weight.sum(1, keepdims=True), LEAST)
    return share / share.sum(1, keepdims=True)


def _mode_updated(
    steps: RowSteps, before: np.ndarray, after: np.ndarray, track: np.ndarray, share: np.ndarray, silent: np.ndarray
) -> np.ndarray:
    """Rows of one mode: of a single plot where it is certain, else the moments of the mixture.

    `share` (K,) of each plot and `silent` (B,) of none sum to 1 for each track; to 0 where the mode is out of the
    question: it stays as it was.
    """
    rows = before.copy()
    certain = share > 1 - 1e-9
    rows[track[certain]] = after[certain]
    mixed = np.zeros(len(before), bool)
    mixed[track[(share > 0) & ~certain]] = True
    mixed[track[certain]] = False
    if mixed.any():
        place = np.cumsum(mixed) - 1
        part = mixed[track]
        members = np.concatenate([before[mixed], after[part]])
        group = np.concatenate([np.arange(mixed.sum()), place[track[part]]])
        shares = np.concatenate([silent[mixed], share[part]])
        mean, cov = steps.mean(members), steps.cov(members)
        rows[mixed] = steps.start(*merged(mean, cov, shares, group, int(mixed.sum()), steps.model.angular))
    return rows

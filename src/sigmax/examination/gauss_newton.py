"""Gauss–Newton on the Huberised log-likelihood, from many points at once."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sigmax.examination.envelope_runs import Runner, Variant, log_likelihood
from sigmax.examination.record_data import RecordData
from sigmax.examination.scores import scores

_FORWARD = 1e-3
# A climb ends where the next step promises less than this, where one gained but little (the next, of Newton's, would
# gain next to nothing, and a noise that wants to be 0 would go on for ever), or where so small a share does not gain.
_ENOUGH, _LITTLE, _SMALLEST, _MOST = 0.02, 0.1, 0.02, 15


class Slope(NamedTuple):
    """The log-likelihood at a point, its gradient along some directions (d,) and their Fisher information (d, d)."""

    L: float
    gradient: np.ndarray
    info: np.ndarray

    def along(self, basis: np.ndarray) -> "Slope":
        """The same along the columns of a basis (d, q)."""
        return Slope(self.L, basis.T @ self.gradient, basis.T @ self.info @ basis)

    def deviations(self) -> np.ndarray:
        """Standard errors (d,) of the directions, each with the others unknown."""
        variances = np.diag(np.linalg.pinv(self.info, hermitian=True))
        return np.asarray(np.sqrt(np.maximum(variances, 0)))


class Start(NamedTuple):
    """Where a climb begins: θ (p,), the directions (p, d), the longest step along each (d,), the record."""

    theta: np.ndarray
    basis: np.ndarray
    limits: np.ndarray
    record: RecordData


class Climber(NamedTuple):
    """A filter on an envelope, what is a small change of each parameter (p,), and which components turn, by sensor."""

    runner: Runner
    steps: np.ndarray
    angular: dict[str, tuple[bool, ...]]

    def slopes(self, points: Sequence[tuple[Variant, np.ndarray]]) -> list[Slope]:
        """What it is like at each point along the columns of its basis (p, q), all in one batch."""
        variants, steps = list[Variant](), list[np.ndarray]()
        for (theta, record), basis in points:
            steps.append(_FORWARD * np.array([self._shortest(b) for b in basis.T]))
            moved = (Variant(theta + h * b, record) for h, b in zip(steps[-1], basis.T, strict=True))
            variants += [Variant(theta, record), *moved]
        out, found, at = self.runner(variants), list[Slope](), 0
        L = log_likelihood(out)
        for one in steps:
            some = out.some(slice(at, at + 1 + len(one)))
            slope = scores(some, one, self.angular) if len(one) else (np.zeros(0), np.zeros((0, 0)))
            found.append(Slope(float(L[at]), *slope))
            at += 1 + len(one)
        return found

    def _shortest(self, direction: np.ndarray) -> float:
        on = direction != 0
        return float((self.steps[on] / np.abs(direction[on])).min())

    def climb(self, starts: Sequence[Start], first: Sequence[Slope] | None = None) -> list[tuple[np.ndarray, Slope]]:
        """How far each goes along its directions (d,) to where the likelihood is largest, and what it is like there.

        Args:
            starts: where they begin.
            first: what it is like there, where that is known.
        """
        if not starts:
            return []
        value = [np.zeros(s.basis.shape[1]) for s in starts]
        here = list(first or self.slopes([(Variant(s.theta, s.record), s.basis) for s in starts]))
        share = np.ones(len(starts))
        active = [i for i in range(len(starts)) if len(value[i])]
        for _ in range(_MOST):
            steps = {i: share[i] * _step(here[i], starts[i].limits) for i in active}
            steps = {i: s for i, s in steps.items() if here[i].gradient @ s - 0.5 * s @ here[i].info @ s > _ENOUGH}
            if not steps:
                break
            active = list(steps)
            tries = [value[i] + steps[i] for i in active]
            points = [
                (Variant(starts[i].theta + starts[i].basis @ v, starts[i].record), starts[i].basis)
                for i, v in zip(active, tries, strict=True)
            ]
            for i, v, there in zip(active, tries, self.slopes(points), strict=True):
                gained = there.L - here[i].L
                if gained > 0:
                    value[i], here[i], share[i] = v, there, 1.0 if gained > _LITTLE else 0.0
                else:
                    share[i] /= 3
            active = [i for i in active if share[i] > _SMALLEST]
        return list(zip(value, here, strict=True))


def _step(here: Slope, limits: np.ndarray) -> np.ndarray:
    step = np.linalg.lstsq(here.info, here.gradient, rcond=1e-10)[0]
    return np.asarray(np.clip(step, -limits, limits))

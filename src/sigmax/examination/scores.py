"""Score and information of parameters from one run for each: how likely it is that one of them is not 0."""

import numpy as np

from sigmax.algebra.arrays import wrapped
from sigmax.examination.envelope_runs import Innovations, cut


def scores(
    outcome: Innovations, steps: np.ndarray, angular: dict[str, tuple[bool, ...]]
) -> tuple[np.ndarray, np.ndarray]:
    """The gradient of the log-likelihood (q,) and the Fisher information (q, q), by forward differences.

    Args:
        outcome: of 1 + q variants, the first where the gradient is wanted, the others a step away.
        steps: the q steps.
        angular: which components turn, by sensor.
    """
    g = np.zeros(len(steps))
    rows = []
    for s, nu in outcome.nu.items():
        S = outcome.S[s]
        inverse = 1 / np.sqrt(S[0]) if S.shape[-1] == 1 else np.linalg.inv(np.linalg.cholesky(S[0]))
        e = np.einsum("tij,tj->ti", inverse, nu[0])
        nis, c = (e * e).sum(1), cut(outcome.seen[s].sum(-1))
        w = np.where(nis > c, np.sqrt(c / np.maximum(nis, 1e-300)), 1.0)
        change = wrapped(nu[1:] - nu[:1], angular[s]) / steps[:, None, None]
        spread = (S[1:] - S[:1]) / steps[:, None, None, None]
        one = S.shape[-1] == 1
        D = change * inverse[:, 0] if one else np.einsum("tij,qtj->qti", inverse, change)
        M = spread * inverse**2 if one else inverse @ spread @ np.swapaxes(inverse, 1, 2)
        quadratic = np.einsum("ti,qtij,tj->qt", e, M, e)
        g += (-w * np.einsum("qti,ti->qt", D, e) + 0.5 * (w * quadratic - np.einsum("qtii->qt", M))).sum(1)
        rows += [(D * np.sqrt(w)[None, :, None]).reshape(len(steps), -1), M.reshape(len(steps), -1) / np.sqrt(2)]
    stacked = np.nan_to_num(np.concatenate(rows, 1))
    return np.nan_to_num(g), stacked @ stacked.T

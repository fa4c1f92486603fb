"""Whether normalised innovations have the tails of a Gaussian."""

from typing import NamedTuple

import numpy as np


class Tails(NamedTuple):
    """What tails longer than a Gaussian's look like.

    Attributes:
        kind: "tails" like Student's, or "outliers": a share of values from a wider Gaussian.
        gain: in log-likelihood against a Gaussian of free scale, less what its parameters cost.
        size: degrees of freedom, or the share.
        times: how many deviations wide the outliers are.
    """

    kind: str
    gain: float
    size: float
    times: float


def tails(e: np.ndarray) -> Tails | None:
    """Of whitened values (N,) of any scale; None where their kurtosis says nothing."""
    from scipy.optimize import minimize
    from scipy.special import gammaln

    N, square = len(e), e * e
    v = square.mean()
    if N < 30 or v <= 0 or (square**2).mean() / v**2 - 3 < 1.5 * np.sqrt(24 / N):
        return None
    gaussian = -0.5 * N * (np.log(2 * np.pi * v) + 1)
    core = max(1.4826 * float(np.median(np.abs(e))), 1e-12)

    def student(q: np.ndarray) -> float:
        nu, s = 2 + np.exp(np.clip(q[0], -5, 8)), np.exp(q[1])
        c = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * np.log(nu * np.pi) - np.log(s)
        return float(-(N * c - (nu + 1) / 2 * np.log1p(square / (nu * s * s)).sum()))

    def mixed(q: np.ndarray) -> float:
        share, s, k = 1 / (1 + np.exp(-np.clip(q[0], -12, 0))), np.exp(q[1]), 3 + np.exp(np.clip(q[2], -6, 8))
        a = -square / (2 * s * s)
        density = (1 - share) / s * np.exp(a) + share / (s * k) * np.exp(a / k**2)
        return float(-np.log(density + 1e-300).sum() + 0.5 * N * np.log(2 * np.pi))

    one = minimize(student, [1.0, np.log(core)], method="Nelder-Mead", options={"maxiter": 100})
    two = minimize(mixed, [-3.5, np.log(core), 1.5], method="Nelder-Mead", options={"maxiter": 150})
    as_student, as_mixed = -one.fun - 0.5 * np.log(N), -two.fun - np.log(N)
    if as_student >= as_mixed:
        return Tails("tails", as_student - gaussian, float(2 + np.exp(np.clip(one.x[0], -5, 8))), 0.0)
    share = float(1 / (1 + np.exp(-np.clip(two.x[0], -12, 0))))
    return Tails("outliers", as_mixed - gaussian, share, float(3 + np.exp(np.clip(two.x[2], -6, 8))))

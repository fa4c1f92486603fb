"""FilterPy's estimator of interacting models, with mode probabilities from log-likelihoods."""

from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy.base import measured, shown


class IMMEstimator:
    """Several filters of one state, mixed by the probabilities of their models (Blom and Bar-Shalom 1988).

    States are averaged and subtracted by the hooks of the first filter, where it has them.

    Args:
        filters: two or more, with states of one shape.
        mu: their probabilities now (N,).
        M: M[i, j], the probability that model i is followed by model j (N, N).

    Attributes:
        x, P: the combined estimate.
        mu: probabilities of the models.
        cbar: probabilities of the models before the next measurement.
        omega: omega[i, j], the probability that model j, next, comes from i.
        likelihood: of the last measurement under each model.
    """

    def __init__(self, filters: Any, mu: Any, M: Any) -> None:
        if len(filters) < 2:
            raise InputError(f"models interact from two on; filters has {len(filters)}")
        if len({np.shape(f.x) for f in filters}) > 1:
            raise InputError(f"all filters must have states of one shape; {[np.shape(f.x) for f in filters]}")
        self.filters = filters
        self.N = len(filters)
        self.M = np.asarray(M, float)
        self.mu = np.asarray(mu, float) / np.sum(mu)
        if self.mu.shape != (self.N,) or self.M.shape != (self.N, self.N):
            raise InputError(f"{self.N} filters need mu ({self.N},) and M {(self.N, self.N)}")
        self.likelihood = np.zeros(self.N)
        self._mix()
        self._combine()
        self.x_prior, self.P_prior = self.x_post, self.P_post = self.x.copy(), self.P.copy()

    def __repr__(self) -> str:
        return shown(self, "x", "P", "mu", "M", "likelihood")

    def predict(self, u: Any = None) -> None:
        """Mix the states, then predict with every filter."""
        mixed = [moments(self.filters, weights) for weights in self.omega.T]
        for f, (x, P) in zip(self.filters, mixed, strict=True):
            f.x, f.P = x, P
            f.predict(**({} if u is None else {"u": u}))
        self._combine()
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def update(self, z: Any) -> None:
        """Correct every filter with z; a missing one leaves the models' probabilities as predicted."""
        z = measured(z)
        if z is None or np.isnan(z).all():
            for f in self.filters:
                f.update(None)
            self.mu = self.cbar
        else:
            for f in self.filters:
                f.update(z)
            logs = np.array([f.log_likelihood for f in self.filters])
            self.likelihood = np.array([f.likelihood for f in self.filters])
            weights = self.cbar * np.exp(logs - logs[self.cbar > 0].max())
            self.mu = weights / weights.sum()
        self._mix()
        self._combine()
        self.x_post, self.P_post = self.x.copy(), self.P.copy()

    def _mix(self) -> None:
        self.cbar = self.mu @ self.M
        joint = self.M * self.mu[:, None]
        self.omega = np.divide(joint, self.cbar, out=np.zeros_like(joint), where=self.cbar > 0)

    def _combine(self) -> None:
        self.x, self.P = moments(self.filters, self.mu)


def moments(filters: Any, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the weighted sum of the filters' Gaussians, by the hooks of the first."""
    first = filters[0]
    mean_of = getattr(first, "x_mean", None)
    residual = getattr(first, "residual_x", np.subtract)
    xs = np.array([np.ravel(f.x) for f in filters], float)
    mean = weights @ xs if mean_of is None else np.ravel(mean_of(xs, weights))
    off = np.array([np.ravel(residual(x.copy(), mean.copy())) for x in xs])
    P = sum(w * (np.outer(d, d) + f.P) for w, d, f in zip(weights, off, filters, strict=True))
    return mean.reshape(np.shape(first.x)), np.asarray(P)

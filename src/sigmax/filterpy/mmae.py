"""FilterPy's bank of filters of which one is right."""

from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy.base import measured, shown
from sigmax.filterpy.imm import moments


class MMAEFilterBank:
    """Filters side by side, weighed by how well they foretell the measurements (Magill 1965); they never interact.

    Args:
        filters: of one state.
        p: their probabilities at the start (N,).
        dim_x: n.
        H: the sensor, for linear filters; None for that of each filter.

    Attributes:
        x, P: the combined estimate, with hooks as in `IMMEstimator`.
        p: probabilities of the filters.
    """

    def __init__(self, filters: Any, p: Any, dim_x: int, H: Any = None) -> None:
        if len(filters) != len(p) or not len(filters):
            raise InputError(f"p must have a probability for each filter; it has {len(p)} for {len(filters)}")
        wrong = [np.size(f.x) for f in filters if np.size(f.x) != dim_x]
        if wrong:
            raise InputError(f"filters must have dim_x = {dim_x} components; one has {wrong[0]}")
        self.filters, self.dim_x, self.H = filters, dim_x, H
        self.p = np.asarray(p, float) / np.sum(p)
        self.z: Any = None
        self.x, self.P = moments(filters, self.p)
        self.x_prior, self.P_prior = self.x_post, self.P_post = self.x.copy(), self.P.copy()

    def __repr__(self) -> str:
        return shown(self, "x", "P", "p")

    def predict(self, u: Any = None) -> None:
        """Predict with every filter."""
        for f in self.filters:
            f.predict(**({} if u is None else {"u": u}))
        self.x, self.P = moments(self.filters, self.p)
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def update(self, z: Any, R: Any = None, H: Any = None) -> None:
        """Correct every filter with z; a missing one leaves the probabilities as they are."""
        H = self.H if H is None else H
        given = {"R": R, **({} if H is None else {"H": H})}
        z = measured(z)
        missing = z is None or bool(np.isnan(z).all())
        for f in self.filters:
            f.update(None if missing else z, **given)
        if not missing:
            logs = np.array([f.log_likelihood for f in self.filters])
            # In logarithms: after many measurements the likelihood of the wrong filter is no number any more.
            weights = self.p * np.exp(logs - logs[self.p > 0].max())
            self.p = weights / weights.sum()
        self.z = None if missing else np.copy(z)
        self.x, self.P = moments(self.filters, self.p)
        self.x_post, self.P_post = self.x.copy(), self.P.copy()

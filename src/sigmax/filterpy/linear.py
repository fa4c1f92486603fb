"""FilterPy's linear filter."""

from copy import copy
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy import steps, user_steps
from sigmax.filterpy.base import Base, matrix, measured
from sigmax.filterpy.compiled import Predicted


class KalmanFilter(Base):
    """FilterPy's linear filter: x ← F x + B u, z = H x.

    Args:
        dim_x: n.
        dim_z: m.
        dim_u: number of inputs.

    Attributes:
        F, B, H: motion (n, n), effect of the input (n, k) or None, sensor (m, n).
        M: covariance of the motion's noise with the sensor's (n, m), for `update_correlated`.
        alpha: the fading memory.
    """

    def __init__(self, dim_x: int, dim_z: int, dim_u: int = 0) -> None:
        super().__init__(dim_x, dim_z, column=True)
        self.dim_u = dim_u
        self.F: Any = np.eye(dim_x)
        self.B: Any = None
        self.H: Any = np.zeros((dim_z, dim_x))
        self.M: Any = np.zeros((dim_x, dim_z))
        self._fading = 1.0

    @property
    def alpha(self) -> float:
        """The fading memory: standard deviations grow by this factor in a prediction, 1 for none."""
        return self._fading

    @alpha.setter
    def alpha(self, value: float) -> None:
        if not value >= 1:
            raise InputError(f"alpha must be 1 or more; it is {value}")
        self._fading = float(value)

    def predict(self, u: Any = None, B: Any = None, F: Any = None, Q: Any = None) -> None:
        """Move the state on: x ← F x + B u, P ← α² F P Fᵀ + Q."""
        if u is not None or self._fading != 1 or not self._linear_prediction(self.F if F is None else F, Q):
            self._predicted(*self._moved(u, B, F, Q))

    def get_prediction(self, u: Any = None, B: Any = None, F: Any = None, Q: Any = None) -> tuple[Any, Any]:
        """State and covariance that `predict` would give; the filter stays as it is."""
        x, made = self._moved(u, B, F, Q)
        return x.reshape(np.shape(self.x)), made.cov

    def predict_steadystate(self, u: Any = None, B: Any = None) -> None:
        """Move the state on and leave P as it is."""
        self.x = self._ahead(self.F, u, self.B if B is None else B).reshape(np.shape(self.x))
        self.x_prior, self.P_prior = self.x.copy(), np.array(self.P)

    def update(self, z: Any, R: Any = None, H: Any = None) -> None:
        """Correct with z, a number, (m,) or (m, 1), None or NaN where it is missing."""
        z = measured(z)
        if z is None:
            self._updated(None)
            return
        if not self._linear_correction(z, R, H):
            y, H = self._off(z, H)
            self._correct(z, y, steps.straight(H @ self._factor()), self.R if R is None else R)

    def _linear_correction(self, z: Any, R: Any, H: Any) -> bool:
        """Correct in one compiled call; False where there is none."""
        seen = np.asarray(z, float)
        if seen.size != self.dim_z:
            return False
        S, Lr = self._factor(), self._noise_factor("R", self.R if R is None else R, self.dim_z)
        made = user_steps.SEEING(self.x, S, Lr, seen, self.H if H is None else H)
        if made is NotImplemented or not made.sound:
            return False
        self._take_correction(made)
        return True

    def get_update(self, z: Any = None) -> tuple[Any, Any]:
        """State and covariance that `update` would give; the filter stays as it is."""
        other = copy(self)
        other._kept = {name: copy(kept) for name, kept in self._kept.items()}
        other.update(z)
        return other.x, other.P

    def update_steadystate(self, z: Any) -> None:
        """Correct x by the gain K as it is, and leave P, S and K."""
        z = measured(z)
        missing = z is None or np.isnan(z)
        if np.any(missing) and not np.all(missing):
            raise InputError("a steady gain takes whole measurements; where a component is missing, use update")
        z = None if np.any(missing) else z
        if z is not None:
            y, _ = self._off(z, None)
            self.x = self.x + (self.K @ y).reshape(np.shape(self.x))
            self.y = y.reshape(-1, 1) if np.ndim(self.x) == 2 else y
            self._whitened = np.linalg.solve(self._innovation_factor, y)
        self._updated(None if z is None else np.array(z))

    def update_correlated(self, z: Any, R: Any = None, H: Any = None) -> None:
        """Correct where the noise of the motion before and that of the sensor have the covariance `M` (n, m)."""
        z = measured(z)
        if z is None:
            self._updated(None)
            return
        y, H = self._off(z, H)
        m, seen = len(y), np.flatnonzero(~np.isnan(y))
        if not len(seen):
            self._updated(None)
            return
        noise, y, H, M = (
            matrix("R", self.R if R is None else R, m)[np.ix_(seen, seen)],
            y[seen],
            H[seen],
            np.asarray(self.M)[:, seen],
        )
        # State and noise of the sensor as one Gaussian, of which H x + v is a straight line.
        together = np.block([[np.asarray(self.P, float), M], [M.T, noise]])
        joint = steps.factor(together)
        line = steps.straight(H @ joint[: self.dim_x] + joint[self.dim_x :])
        made = steps.correct(joint[: self.dim_x], line, np.zeros((len(y), len(y))), y)
        self._take(z, y, made, np.add)
        if len(seen) < m:
            self._widen(seen, m)

    def update_sequential(self, start: int, z_i: Any, R_i: Any = None, H_i: Any = None) -> None:
        """Correct with the components of a measurement from `start` on; `y`, `z` and `K` keep the others.

        Args:
            start: the first component.
            z_i: the value, or values.
            R_i: their covariance, if not that part of R.
            H_i: their rows, if not those of H.
        """
        z_i = measured(z_i)
        part = slice(start, start + np.size(z_i))
        n, m, column = self.dim_x, self.dim_z, np.ndim(self.x) == 2
        known = np.size(self.z) == m and self.z is not None
        z = np.array(self.z, float).ravel() if known else np.full(m, np.nan)
        y, K = np.resize(self.y, m), np.resize(self.K, (n, m))
        R = matrix("R", self.R, m)[part, part] if R_i is None else R_i
        self.update(z_i, R=R, H=np.asarray(self.H)[part] if H_i is None else H_i)
        y[part], K[:, part], z[part] = np.ravel(self.y), self.K, np.ravel(z_i)
        self.y, self.K, self.z = y.reshape(-1, 1) if column else y, K, z.reshape(-1, 1) if column else z

    def batch_filter(
        self, zs: Any, Fs: Any = None, Qs: Any = None, Hs: Any = None, Rs: Any = None, Bs: Any = None,
        us: Any = None, update_first: bool = False, saver: Any = None,
    ) -> tuple[Any, Any, Any, Any]:  # fmt: skip
        """Predict and update for each of zs, None where one is missing.

        Returns:
            Means and covariances after the measurements, means and covariances after the predictions.
        """

        def at(values: Any, k: int) -> Any:
            return None if values is None else values[k]

        after, before = [], []
        for k, z in enumerate(zs):
            for what in ("update", "predict") if update_first else ("predict", "update"):
                if what == "predict":
                    self.predict(at(us, k), at(Bs, k), at(Fs, k), at(Qs, k))
                    before.append((self.x, self.P))
                else:
                    self.update(z, at(Rs, k), at(Hs, k))
                    after.append((self.x, self.P))
            if saver is not None:
                saver.save()
        means, covs, means_p, covs_p = (
            np.array([pair[i] for pair in done]) for done in (after, before) for i in (0, 1)
        )
        return means, covs, means_p, covs_p

    def rts_smoother(self, Xs: Any, Ps: Any, Fs: Any = None, Qs: Any = None) -> tuple[Any, Any, Any, Any]:
        """Smooth what `batch_filter` gave; Fs[k] and Qs[k] belong to the step that led to k.

        Returns:
            Means, covariances, gains, predicted covariances.
        """
        if len(Xs) != len(Ps):
            raise InputError(f"Xs and Ps must have the same length; they have {len(Xs)} and {len(Ps)}")
        xs, ps = np.array(Xs, float), np.array(Ps, float)
        gains, predicted = np.zeros_like(ps), ps.copy()
        later = steps.factor(ps[-1])
        for k in range(len(xs) - 2, -1, -1):
            F = np.asarray(self.F if Fs is None else Fs[k + 1], float)
            Lq = self._noise_factor("Q", self.Q if Qs is None else Qs[k + 1], self.dim_x)
            S = steps.factor(ps[k])
            later, gains[k], predicted[k] = steps.smooth(S, steps.straight(F @ S), Lq, later)
            xs[k] += gains[k] @ (xs[k + 1] - F @ xs[k])
            ps[k] = later @ later.T
        return xs, ps, gains, predicted

    def log_likelihood_of(self, z: Any) -> float:
        """Of a measurement z, by the state and the covariance S of after the last one."""
        return super().log_likelihood if z is None else self._density(self._off(z, None)[0])

    def residual_of(self, z: Any) -> np.ndarray:
        """Z − H x of the last prediction."""
        return np.reshape(np.asarray(z, float), self.y.shape) - np.dot(self.H, self.x_prior)

    def measurement_of_state(self, x: Any) -> np.ndarray:
        """H x."""
        return np.dot(self.H, x)

    def test_matrix_dimensions(self, z: Any = None, H: Any = None, R: Any = None, F: Any = None, Q: Any = None) -> None:
        """Whether everything has the shape it should have, those given taken in place of the filter's own.

        Raises:
            InputError: says what has another shape, and what it should be.
        """
        n, H = self.dim_x, np.asarray(self.H if H is None else H)
        m = len(H) if H.ndim == 2 else self.dim_z
        number: list[tuple[int, ...]] = [(), (1,)] if m == 1 else []
        wanted: dict[str, tuple[Any, list[tuple[int, ...]]]] = {
            "x": (self.x, [(n,), (n, 1)]),
            "P": (self.P, [(n, n)]),
            "Q": (self.Q if Q is None else Q, [(n, n)]),
            "F": (self.F if F is None else F, [(n, n)]),
            "H": (H, [(m, n)]),
            "R": (self.R if R is None else R, [(m, m), *number]),
            "z": (np.zeros(m) if z is None else z, [(m,), (m, 1), *number]),
        }
        for name, (value, shapes) in wanted.items():
            if np.shape(value) not in shapes:
                raise InputError(f"{name} must have the shape {shapes[0]}; it has {np.shape(value)}")

    def _ahead(self, F: Any, u: Any, B: Any) -> np.ndarray:
        F, x = np.asarray(F, float), np.ravel(self.x)
        if F.shape != (self.dim_x, self.dim_x) or len(x) != self.dim_x:
            raise InputError(f"dim_x is {self.dim_x}; x has {len(x)} components, F the shape {F.shape}")
        moved = F @ x
        return moved if B is None or u is None else moved + np.ravel(np.dot(B, u))

    def _moved(self, u: Any, B: Any, F: Any, Q: Any) -> tuple[np.ndarray, Predicted]:
        F = np.asarray(self.F if F is None else F, float)
        ahead = self._ahead(F, u, self.B if B is None else B)
        noise = self._noise_factor("Q", self.Q if Q is None else Q, self.dim_x)
        slope = F @ self._factor()
        made = steps.predict(steps.straight(slope if self._fading == 1 else self._fading * slope), noise)
        return ahead, made

    def _off(self, z: Any, H: Any) -> tuple[np.ndarray, np.ndarray]:
        """What z (m,) is off the expected, and H."""
        H = np.asarray(self.H if H is None else H, float)
        H = H if H.ndim == 2 else np.atleast_2d(H)
        measured, x = np.asarray(z, float).ravel(), np.ravel(self.x)
        if H.shape[1] != len(x):
            raise InputError(f"x has {len(x)} components, H {H.shape[1]} columns")
        if len(measured) != len(H):
            raise InputError(f"z has {len(measured)} components, H has {len(H)} rows")
        return measured - H @ x, H

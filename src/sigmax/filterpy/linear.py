"""FilterPy's linear and extended filters: the line is given, as F and H or by a Jacobian."""

from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy import steps
from sigmax.filterpy.base import Base, tuple_of


class KalmanFilter(Base):
    """FilterPy's linear filter: x ← F x + B u, z = H x.

    Args:
        dim_x: n.
        dim_z: m.
        dim_u: number of inputs.
    """

    def __init__(self, dim_x: int, dim_z: int, dim_u: int = 0) -> None:
        super().__init__(dim_x, dim_z, column=True)
        self.dim_u = dim_u
        self.F: Any = np.eye(dim_x)
        self.B: Any = None
        self.H: Any = np.zeros((dim_z, dim_x))
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
        F, B = self.F if F is None else np.asarray(F, float), self.B if B is None else B
        moved = F @ np.ravel(self.x)
        if B is not None and u is not None:
            moved = moved + np.ravel(np.dot(B, u))
        noise = self._noise_factor("Q", self.Q if Q is None else Q, self.dim_x)
        self._predicted(moved, steps.predict(steps.straight(self._fading * F @ self._factor()), noise))

    def update(self, z: Any, R: Any = None, H: Any = None) -> None:
        """Correct with z, a number, (m,) or (m, 1), None or NaN where it is missing."""
        if z is None:
            self._updated(None)
            return
        H = np.atleast_2d(np.asarray(self.H if H is None else H, float))
        measured = np.ravel(np.asarray(z, float))
        if len(measured) != len(H):
            raise InputError(f"z has {len(measured)} components, H has {len(H)} rows")
        line = steps.straight(H @ self._factor())
        self._correct(z, measured - H @ np.ravel(self.x), line, self.R if R is None else R)

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

    def residual_of(self, z: Any) -> np.ndarray:
        """Z − H x of the last prediction."""
        return np.reshape(np.asarray(z, float), self.y.shape) - np.dot(self.H, self.x_prior)

    def measurement_of_state(self, x: Any) -> np.ndarray:
        """H x."""
        return np.dot(self.H, x)


class ExtendedKalmanFilter(Base):
    """FilterPy's extended filter: override `predict_x`, or set F; the sensor comes with each measurement.

    Args:
        dim_x: n.
        dim_z: m.
        dim_u: number of inputs.
    """

    def __init__(self, dim_x: int, dim_z: int, dim_u: int = 0) -> None:
        super().__init__(dim_x, dim_z, column=True)
        self.dim_u = dim_u
        self.F: Any = np.eye(dim_x)
        self.B: Any = 0

    def predict_x(self, u: Any = 0) -> None:
        """X ← F x + B u; override it for a motion that is not linear, and set F there."""
        self.x = np.dot(self.F, self.x) + np.dot(self.B, u)

    def predict(self, u: Any = 0) -> None:
        """Move the state on: `predict_x`, then P ← F P Fᵀ + Q."""
        S = self._factor()
        self.predict_x(u)
        line = steps.straight(np.asarray(self.F, float) @ S)
        self._predicted(np.ravel(np.asarray(self.x, float)), steps.predict(line, self._noise_factor("Q", self.Q, self.dim_x)))

    def update(
        self, z: Any, HJacobian: Any, Hx: Any, R: Any = None, args: Any = (), hx_args: Any = (),
        residual: Any = np.subtract,
    ) -> None:  # fmt: skip
        """Correct with z, None or NaN where it is missing.

        Args:
            z: the measurement, a number, (m,) or (m, 1).
            HJacobian: x, *args -> H (m, n).
            Hx: x, *hx_args -> the expected measurement, of z's shape.
            R: its covariance or variance, if not the filter's.
            args: for HJacobian.
            hx_args: for Hx.
            residual: z, expected -> their difference.
        """
        if z is None:
            self._updated(None)
            return
        H = np.atleast_2d(np.asarray(HJacobian(self.x, *tuple_of(args)), float))
        expected = np.asarray(Hx(self.x, *tuple_of(hx_args)), float)
        measured = np.asarray(z, float)
        if measured.size != expected.size:
            raise InputError(f"z has {measured.size} components, Hx gives {expected.size}")
        y = np.ravel(np.asarray(residual(measured.reshape(expected.shape), expected), float))
        self._correct(z, y, steps.straight(H @ self._factor()), self.R if R is None else R)

    def predict_update(
        self, z: Any, HJacobian: Any, Hx: Any, args: Any = (), hx_args: Any = (), u: Any = 0
    ) -> None:  # fmt: skip
        """`predict(u)` and `update(z, HJacobian, Hx)`: the sensor is linearised at the predicted state."""
        self.predict(u)
        self.update(z, HJacobian, Hx, args=args, hx_args=hx_args)

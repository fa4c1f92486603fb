"""FilterPy's extended filter: the line is given, as F and by a Jacobian."""

from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy import steps
from sigmax.filterpy.base import Base, measured, tuple_of


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
        self._predicted(
            np.ravel(np.asarray(self.x, float)), steps.predict(line, self._noise_factor("Q", self.Q, self.dim_x))
        )

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
        z = measured(z)
        if z is None:
            self._updated(None)
            return
        H = np.atleast_2d(np.asarray(HJacobian(self.x, *tuple_of(args)), float))
        expected = np.asarray(Hx(self.x, *tuple_of(hx_args)), float)
        seen = np.asarray(z, float)
        if seen.size != expected.size:
            raise InputError(f"z has {seen.size} components, Hx gives {expected.size}")
        y = np.ravel(np.asarray(residual(seen.reshape(expected.shape), expected), float))
        self._correct(z, y, steps.straight(H @ self._factor()), self.R if R is None else R)

    def predict_update(
        self, z: Any, HJacobian: Any, Hx: Any, args: Any = (), hx_args: Any = (), u: Any = 0
    ) -> None:  # fmt: skip
        """`predict(u)` and `update(z, HJacobian, Hx)`: the sensor is linearised at the predicted state."""
        self.predict(u)
        self.update(z, HJacobian, Hx, args=args, hx_args=hx_args)

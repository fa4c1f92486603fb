"""FilterPy's extended filter: the line is given, as F and by a Jacobian."""

from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy import steps, user_steps
from sigmax.filterpy.base import Base, measured, tuple_of
from sigmax.filterpy.compiled_calls import CompiledCall, Recent


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
        self._recent = Recent()

    def predict_x(self, u: Any = 0) -> None:
        """X ← F x + B u; override it for a motion that is not linear, and set F there."""
        self.x = np.dot(self.F, self.x) + np.dot(self.B, u)

    def predict(self, u: Any = 0) -> None:
        """Move the state on: `predict_x`, then P ← F P Fᵀ + Q."""
        own = getattr(self.predict_x, "__func__", None) is ExtendedKalmanFilter.predict_x
        driven = not (type(u) is int and u == 0) and not (type(self.B) is int and self.B == 0)
        if own and not driven and self._linear_prediction(self.F):
            return
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
        if not (args or hx_args) and residual is np.subtract and self._at_once(z, HJacobian, Hx, R):
            return
        H = np.atleast_2d(np.asarray(HJacobian(self.x, *tuple_of(args)), float))
        expected = np.asarray(Hx(self.x, *tuple_of(hx_args)), float)
        seen = np.asarray(z, float)
        if seen.size != expected.size:
            raise InputError(f"z has {seen.size} components, Hx gives {expected.size}")
        y = np.ravel(np.asarray(residual(seen.reshape(expected.shape), expected), float))
        self._correct(z, y, steps.straight(H @ self._factor()), self.R if R is None else R)

    def _at_once(self, z: Any, jacobian: Any, hx: Any, R: Any) -> bool:
        """Correct in one compiled call; False where there is none."""
        seen, (last, step) = np.asarray(z, float), self._recent.last[False]
        if seen.size != self.dim_z:
            return False
        if last[0] is not jacobian or last[1] is not hx:
            now = jacobian, hx

            def make() -> CompiledCall:
                def calls(x: Any, *_: Any) -> Any:
                    return [(function, (x,)) for function in now]

                return CompiledCall(lambda: user_steps.extended_correction(*now), now, user_steps.Seen, calls=calls)

            step = self._recent.compiled(False, now, make)
            self._recent.last[False] = now, step
        S, Lr = self._factor(), self._noise_factor("R", self.R if R is None else R, self.dim_z)
        made = step(self.x, S, Lr, seen)
        if made is NotImplemented or not made.sound:
            return False
        self._take_correction(made)
        return True

    def predict_update(
        self, z: Any, HJacobian: Any, Hx: Any, args: Any = (), hx_args: Any = (), u: Any = 0
    ) -> None:  # fmt: skip
        """`predict(u)` and `update(z, HJacobian, Hx)`: the sensor is linearised at the predicted state."""
        self.predict(u)
        self.update(z, HJacobian, Hx, args=args, hx_args=hx_args)

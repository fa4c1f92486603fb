"""What FilterPy's filters have in common: the attributes, and a factor that follows P."""

import sys
from math import isnan
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy import steps, user_steps
from sigmax.filterpy.compiled import Corrected, Predicted
from sigmax.modelling.checks import numbers

_FLOOR = sys.float_info.min


class Base:
    """State, noise and the results of the last measurement, by FilterPy's names.

    Attributes:
        x: the state (n,) or (n, 1), whichever it was given as.
        P: its covariance (n, n).
        Q: covariance of the motion's noise over a step (n, n).
        R: covariance of the sensor's noise (m, m).
        x_prior, P_prior: after the last prediction.
        x_post, P_post: after the last measurement.
        z: the last measurement, None where it was missing.
        y: innovation, NaN where a component was missing.
        S: covariance of the innovation, of the components that were there.
        K: gain (n, m).
    """

    def __init__(self, dim_x: int, dim_z: int, column: bool) -> None:
        if dim_x < 1 or dim_z < 1:
            raise InputError(f"dim_x and dim_z must be 1 or more; they are {dim_x} and {dim_z}")
        self.dim_x, self.dim_z = dim_x, dim_z
        self.x: Any = np.zeros((dim_x, 1) if column else dim_x)
        self.P: Any = np.eye(dim_x)
        self.Q: Any = np.eye(dim_x)
        self.R: Any = np.eye(dim_z)
        self.K = np.zeros((dim_x, dim_z))
        self.y = np.zeros((dim_z, 1) if column else dim_z)
        self.S = np.zeros((dim_z, dim_z))
        self.z: Any = None
        self._kept = {name: steps.Kept(name) for name in "PQR"}
        self._whitened: np.ndarray | None = None
        self._innovation_factor = np.zeros((0, 0))
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()
        self.x_post, self.P_post = self.x.copy(), self.P.copy()

    @property
    def SI(self) -> np.ndarray:
        """The inverse of S."""
        return np.linalg.inv(self.S) if self.S.any() else np.zeros_like(self.S)

    @property
    def inv(self) -> Any:
        """`numpy.linalg.inv`; nothing is inverted here, so another function is refused."""
        return np.linalg.inv

    @inv.setter
    def inv(self, function: Any) -> None:
        raise InputError(f"inv = {function!r} would have no effect: factors are solved with, no matrix is inverted")

    @property
    def log_likelihood(self) -> float:
        """Of the last measurement, the logarithm of the density of its innovation."""
        return float(np.log(_FLOOR)) if self._whitened is None else self._log_density(self._whitened)

    @property
    def likelihood(self) -> float:
        """Its exponential, never below the smallest normal number."""
        return max(float(np.exp(self.log_likelihood)), _FLOOR)

    @property
    def mahalanobis(self) -> float | None:
        """The length of the last innovation in its own standard deviations."""
        return None if self._whitened is None else float(np.linalg.norm(self._whitened))

    def __repr__(self) -> str:
        return shown(self, "x", "P", "Q", "R", "y", "S", "K", "log_likelihood", "mahalanobis")

    def _factor(self) -> np.ndarray:
        """The factor of P: the one that made P, or a new one where P was set by the user."""
        return self._noise_factor("P", self.P, self.dim_x)

    def _density(self, y: np.ndarray) -> float:
        """The logarithm of the density of an innovation y (m,) by the last S."""
        return self._log_density(np.linalg.solve(self._innovation_factor, y))

    def _log_density(self, w: np.ndarray) -> float:
        determinant = np.log(self._innovation_factor.diagonal()).sum()
        return float(-0.5 * (w @ w + len(w) * np.log(2 * np.pi)) - determinant)

    def _noise_factor(self, name: str, given: Any, n: int) -> np.ndarray:
        kept = self._kept[name]
        if given is kept.of and given.tobytes() == kept.content:
            return kept.made
        found = kept.factor(matrix(name, given, n))
        if type(given) is np.ndarray and given.dtype == float and given.shape == (n, n):
            kept.of = given
        return found

    def _linear_prediction(self, F: Any, Q: Any = None) -> bool:
        """Predict by F in one compiled call; False where there is none."""
        S, Lq = self._factor(), self._noise_factor("Q", self.Q if Q is None else Q, self.dim_x)
        made = user_steps.MOVING(self.x, S, Lq, F)
        if made is NotImplemented or not made.sound:
            return False
        self._take_prediction(made)
        return True

    def _take_prediction(self, made: Any) -> None:
        """What a compiled prediction gives."""
        self.x, S, self.P, self.x_prior, self.P_prior, _, _ = made
        self._kept["P"].keep(self.P, S)

    def _take_correction(self, made: Any) -> None:
        """What a compiled correction gives."""
        self.x, S, self.P, self.x_post, self.P_post, self.z, self.y, self.K, w, Sy, self.S, _, _, _ = made
        self._whitened, self._innovation_factor = w, Sy
        self._kept["P"].keep(self.P, S)

    def _hold(self, x: np.ndarray, S: np.ndarray, P: np.ndarray) -> None:
        self.x, self.P = x.reshape(np.shape(self.x)), P
        self._kept["P"].keep(P, S)

    def _predicted(self, x: np.ndarray, made: Predicted) -> None:
        self._hold(x, made.factor, made.cov)
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def _updated(self, z: Any) -> None:
        self.z = z
        self.x_post, self.P_post = np.array(self.x), np.array(self.P)

    def _correct(self, z: Any, y: np.ndarray, line: steps.Line, R: Any, add: Any = np.add) -> None:
        """Correct with the innovation y (m,), components that are NaN left out."""
        m = len(y)
        if not isnan(y @ y):
            self._take(z, y, steps.correct(self._factor(), line, self._noise_factor("R", R, m), y), add)
            return
        if not np.isnan(np.asarray(z, float)).any():
            raise InputError("z is a number and what was expected is none: look at x, and at what hx gives there")
        seen = np.flatnonzero(~np.isnan(y))
        if not len(seen):
            self._updated(None)
            return
        Lr = steps.factor(matrix("R", R, m)[np.ix_(seen, seen)], "R")
        made = steps.correct(self._factor(), steps.Line(*(part[seen] for part in line)), Lr, y[seen])
        self._take(z, y[seen], made, add)
        self._widen(seen, m)

    def _widen(self, seen: np.ndarray, m: int) -> None:
        """Results of the components that were seen, in their places among all m."""
        y_seen, K_seen, S_seen = self.y, self.K, self.S
        self.y = np.full((m, *y_seen.shape[1:]), np.nan)
        self.K, self.S = np.zeros((self.dim_x, m)), np.full((m, m), np.nan)
        self.y[seen], self.K[:, seen], self.S[np.ix_(seen, seen)] = y_seen, K_seen, S_seen

    def _take(self, z: Any, y: np.ndarray, made: Corrected, add: Any) -> None:
        """The state after a correction, and its results."""
        self._hold(np.asarray(add(np.ravel(self.x), made.shift), float), made.factor, made.cov)
        self.K, self.S = made.gain, made.innovation
        self.y = y.reshape(-1, 1) if np.ndim(self.x) == 2 else y
        self._whitened, self._innovation_factor = made.whitened, made.innovation_factor
        self._updated(np.array(z))


def shown(filter: Any, *names: str) -> str:
    """Some attributes of a filter, a line each."""
    return "\n".join([type(filter).__name__, *(f"{name} = {getattr(filter, name)}" for name in names)])


def matrix(name: str, given: Any, n: int) -> np.ndarray:
    """A covariance (n, n), from one or from a variance.

    Raises:
        InputError: for any other shape.
    """
    value = np.asarray(given, float)
    if value.size == 1:
        return np.eye(n) * value.item()
    if value.shape != (n, n):
        raise InputError(f"{name} must be a number or a covariance of shape {(n, n)}; it has the shape {value.shape}")
    return value


def measured(z: Any) -> Any:
    """A measurement as floats, NaN where it is None, NA or masked; None where there is none.

    Raises:
        InputError: for what is no number.
    """
    if z is None or isinstance(z, float) or (type(z) is np.ndarray and z.dtype == float):
        return z
    return numbers("z", z, missing=True)


def tuple_of(arguments: Any) -> tuple[Any, ...]:
    """Further arguments of a callback, given as a tuple or as the only one."""
    return arguments if isinstance(arguments, tuple) else (arguments,)

"""The unscented and the cubature filter of FilterPy: points through functions, with its hooks."""

from collections import deque
from collections.abc import Callable
from operator import is_
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy import steps
from sigmax.filterpy.base import Base, measured, tuple_of
from sigmax.filterpy.calls import Pointwise, is_same
from sigmax.filterpy.compiled_calls import Recent
from sigmax.filterpy.points import Cubature, plain
from sigmax.filterpy.user_steps import of_points

Hook = Callable[..., Any] | None


class _Sampled(Base):
    """A filter over sigma points; x_mean, z_mean, residual_x, residual_z, state_add are used wherever they belong."""

    def __init__(
        self, dim_x: int, dim_z: int, dt: float, hx: Any, fx: Any, points: Any,
        x_mean: Hook, z_mean: Hook, residual_x: Hook, residual_z: Hook, state_add: Hook,
    ) -> None:  # fmt: skip
        super().__init__(dim_x, dim_z, column=False)
        self._dt = dt
        self.hx, self.fx, self.points_fn = hx, fx, points
        self.x_mean, self.z_mean = x_mean, z_mean
        self.residual_x = np.subtract if residual_x is None else residual_x
        self.residual_z = np.subtract if residual_z is None else residual_z
        self.state_add = np.add if state_add is None else state_add
        self.Wm, self.Wc = points.Wm, points.Wc
        self.sigmas_f = np.zeros((len(self.Wm), dim_x))
        self.sigmas_h = np.zeros((len(self.Wm), dim_z))
        # Functions given with a call may be others every time: no more than these are kept.
        self._calls: deque[Pointwise] = deque(maxlen=8)
        self._recent = Recent()

    def _predict(self, dt: float | None, fx: Any, arguments: tuple[Any, ...], named: dict[str, Any]) -> None:
        S = self._factor()
        dt, fx = self._dt if dt is None else dt, fx or self.fx
        Lq = self._noise_factor("Q", self.Q, self.dim_x)
        made = self._at_once(fx, True, (S, Lq, dt), arguments, named)
        if made is not NotImplemented and made.sound:
            self._take_prediction(made)
            self.sigmas_f = made.points
            return
        mean, line = self._moved(np.ravel(self.x), S, self._through(fx), dt, *arguments, **named)
        self._predicted(mean, steps.predict(line, Lq))
        self.sigmas_f = self._draw(mean, self._factor())

    def _update(self, z: Any, R: Any, hx: Any, arguments: tuple[Any, ...], named: dict[str, Any]) -> None:
        z = measured(z)
        if z is None:
            self._updated(None)
            return
        S, hx = self._factor(), hx or self.hx
        seen = np.asarray(z, float)
        if seen.size == self.dim_z:
            Lr = self._noise_factor("R", self.R if R is None else R, self.dim_z)
            made = self._at_once(hx, False, (S, Lr, seen), arguments, named)
            if made is not NotImplemented and made.sound:
                self._take_correction(made)
                self.sigmas_f, self.sigmas_h = made.points, made.seen
                return
        # Anew each time: a second sensor at the same moment sees what the first has left.
        self.sigmas_f = self._draw(self.x, S)
        self.sigmas_h = self._through(hx)(self.sigmas_f, *arguments, **named)
        mean = _mean(self.z_mean, self.sigmas_h, self.Wm)
        line = self._line(S, self.sigmas_f, np.ravel(self.x), _differences(self.residual_z, self.sigmas_h, mean))
        seen = np.ravel(seen)
        if seen.shape != mean.shape:
            raise InputError(f"z has {seen.size} components, hx gives {mean.size}")
        y = np.ravel(np.asarray(self.residual_z(seen, mean), float))
        self._correct(z, y, line, self.R if R is None else R, self.state_add)

    def _moved(
        self, x: np.ndarray, S: np.ndarray, fx: Pointwise, dt: float, *arguments: Any, **named: Any
    ) -> tuple[np.ndarray, steps.Line]:
        drawn = self._draw(x, S)
        moved = fx(drawn, dt, *arguments, **named)
        mean = _mean(self.x_mean, moved, self.Wm)
        if mean.shape != x.shape:
            raise InputError(f"x has {x.size} components, fx gives {mean.size}")
        return mean, self._line(S, drawn, x, _differences(self.residual_x, moved, mean))

    def _line(self, S: np.ndarray, drawn: np.ndarray, x: np.ndarray, deviations: np.ndarray) -> steps.Line:
        """Regression of deviations (N, m) on the points they come from, in units of S."""
        if plain(self.points_fn) and self.points_fn.sqrt is None:
            xi = self.points_fn.unit.T
        else:
            known = np.diag(S) <= 0
            xi = np.linalg.solve(S + np.diag(known.astype(float)), _differences(self.residual_x, drawn, x).T)
            xi[known] = 0
        w = self.Wc
        slope = (deviations.T * w) @ xi.T
        missed = (deviations.T - slope @ xi) * np.sqrt(np.abs(w))
        return steps.Line(slope, missed[:, w > 0], missed[:, w < 0])

    def _draw(self, x: Any, S: np.ndarray) -> np.ndarray:
        if plain(self.points_fn):
            return self.points_fn.around(x, S)
        return np.asarray(self.points_fn.sigma_points(np.ravel(x), S @ S.T), float)

    def _at_once(
        self, function: Any, moving: bool, given: tuple[Any, ...], arguments: tuple[Any, ...], named: dict[str, Any]
    ) -> Any:
        """A compiled half-step, NotImplemented where there is none."""
        mean, residual = (self.x_mean, self.residual_x) if moving else (self.z_mean, self.residual_z)
        last, step = self._recent.last[moving]
        now = function, self.points_fn, self.Wm, self.Wc, mean, residual, self.state_add
        if named or not all(map(is_, last, now)):
            names = tuple(named)
            step = self._recent.compiled((moving, names), now, lambda: of_points(now, moving, names))
            if not named:
                self._recent.last[moving] = now, step
        return step(self.x, *given, *arguments, *named.values())

    def _through(self, function: Any) -> Pointwise:
        for known in self._calls:
            if is_same(known.function, function):
                return known
        self._calls.append(Pointwise(function))
        return self._calls[-1]

    def batch_filter(self, zs: Any, Rs: Any = None, dts: Any = None, saver: Any = None) -> tuple[Any, Any]:
        """Predict and update for each of zs (T, m), None where one is missing.

        Returns:
            Means (T, n) or (T, n, 1), covariances (T, n, n).
        """
        means, covs = [], []
        for k, z in enumerate(zs):
            self._predict(None if dts is None else _at(dts, k), None, (), {})
            self._update(z, None if Rs is None else Rs[k], None, (), {})
            means.append(self.x)
            covs.append(self.P)
            if saver is not None:
                saver.save()
        return np.array(means), np.array(covs)

    def rts_smoother(self, Xs: Any, Ps: Any, Qs: Any = None, dts: Any = None) -> tuple[Any, Any, Any]:
        """Smooth what `batch_filter` gave; Qs[k] and dts[k] belong to the step that led to k.

        Returns:
            Means (T, n), covariances (T, n, n), gains (T, n, n).
        """
        if len(Xs) != len(Ps):
            raise InputError(f"Xs and Ps must have the same length; they have {len(Xs)} and {len(Ps)}")
        xs, ps = np.array(Xs, float), np.array(Ps, float)
        gains = np.zeros_like(ps)
        fx = self._through(self.fx)
        later = steps.factor(ps[-1])
        for k in range(len(xs) - 2, -1, -1):
            S, x = steps.factor(ps[k]), xs[k].ravel()
            mean, line = self._moved(x, S, fx, self._dt if dts is None else _at(dts, k + 1))
            Lq = self._noise_factor("Q", self.Q if Qs is None else Qs[k + 1], self.dim_x)
            later, gains[k], _ = steps.smooth(S, line, Lq, later)
            shift = gains[k] @ np.ravel(self.residual_x(xs[k + 1].ravel(), mean))
            xs[k] = np.reshape(self.state_add(x, shift), xs[k].shape)
            ps[k] = later @ later.T
        return xs, ps, gains


class UnscentedKalmanFilter(_Sampled):
    """FilterPy's unscented filter, with its arguments; `points` may be any class of FilterPy's shape.

    Args:
        dim_x: n.
        dim_z: m.
        dt: the usual time between steps, in seconds.
        hx: x (n,), ... -> z (m,).
        fx: x (n,), dt, ... -> x (n,).
        points: sigma points with `Wm`, `Wc`, `num_sigmas()`, `sigma_points(x, P)`.
        sqrt_fn: kept for the signature; FilterPy too draws points with the `sqrt_method` of `points`.
        x_mean_fn: points (N, n), weights (N,) -> their mean.
        z_mean_fn: the same for measurements.
        residual_x: a, b -> a − b of two states.
        residual_z: a, b -> a − b of two measurements.
        state_add: x, correction -> x, where states do not simply add.

    Raises:
        InputError: for a `sqrt_fn` or `UT`, which would have no effect.
    """

    def __init__(
        self, dim_x: int, dim_z: int, dt: float, hx: Any, fx: Any, points: Any, sqrt_fn: Any = None,
        x_mean_fn: Hook = None, z_mean_fn: Hook = None, residual_x: Hook = None, residual_z: Hook = None,
        state_add: Hook = None,
    ) -> None:  # fmt: skip
        if sqrt_fn is not None:
            raise InputError("sqrt_fn would have no effect: give it to the points, as sqrt_method=")
        super().__init__(
            dim_x, dim_z, dt, hx, fx, points, x_mean_fn, z_mean_fn, residual_x, residual_z, state_add
        )  # fmt: skip

    def predict(self, dt: float | None = None, UT: None = None, fx: Any = None, **fx_args: Any) -> None:
        """Move the state on; `fx_args` go to fx."""
        _no_transform(UT)
        self._predict(dt, fx, (), fx_args)

    def update(self, z: Any, R: Any = None, UT: None = None, hx: Any = None, **hx_args: Any) -> None:
        """Correct with z (m,), None or NaN where it is missing; `hx_args` go to hx."""
        _no_transform(UT)
        self._update(z, R, hx, (), hx_args)


class CubatureKalmanFilter(_Sampled):
    """FilterPy's cubature filter, with points drawn anew after Q and every hook in use.

    Its arguments are those of `UnscentedKalmanFilter`, without points.
    """

    def __init__(
        self, dim_x: int, dim_z: int, dt: float, hx: Any, fx: Any,
        x_mean_fn: Hook = None, z_mean_fn: Hook = None, residual_x: Hook = None, residual_z: Hook = None,
        state_add: Hook = None,
    ) -> None:  # fmt: skip
        points = Cubature(dim_x)
        super().__init__(
            dim_x, dim_z, dt, hx, fx, points, x_mean_fn, z_mean_fn, residual_x, residual_z, state_add
        )  # fmt: skip

    def predict(self, dt: float | None = None, fx_args: Any = ()) -> None:
        """Move the state on; `fx_args` go to fx after dt."""
        self._predict(dt, None, tuple_of(fx_args), {})

    def update(self, z: Any, R: Any = None, hx_args: Any = ()) -> None:
        """Correct with z (m,), None or NaN where it is missing; `hx_args` go to hx."""
        self._update(z, R, None, tuple_of(hx_args), {})


def _mean(hook: Hook, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    if hook is not None:
        return np.ravel(np.asarray(hook(points, weights), float))
    # About the first point: far from the origin, Σ w y with large weights of both signs loses digits.
    return points[0] + weights @ (points - points[0])


def _differences(residual: Any, points: np.ndarray, mean: np.ndarray) -> np.ndarray:
    if residual is np.subtract:
        return points - mean
    # A copy each: FilterPy's own examples wrap angles in place.
    return np.array([np.ravel(residual(row.copy(), mean.copy())) for row in points], float)


def _at(dts: Any, k: int) -> float:
    return float(dts if np.ndim(dts) == 0 else dts[k])


def _no_transform(UT: Any) -> None:
    if UT is not None:
        raise InputError("UT would have no effect here; use x_mean_fn, z_mean_fn, residual_x and residual_z")

"""The maximum of a smooth function that is evaluated at many points at once."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Many = Callable[[np.ndarray], np.ndarray]

# Steps of the differences: so many of the deviations that the curvature gives.
_SHARE = 0.1
# What one step may still gain, in log-likelihood, where the search ends; where rough values hide it, more.
_GAIN, _ROUGH = 1e-7, 1e-2
_FOUND = "at a maximum"
# The farthest that a number moves at a time, and from its start, in units.
_FAR, _FARTHEST = 3.0, 16.0
_DAMPING = np.array([0.0, 1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e4])


class Summit(NamedTuple):
    """Where the function is greatest.

    Attributes:
        y: the place (p,).
        value: there.
        gradient: (p,).
        curvature: the negative second derivatives (p, p).
        steps: of the differences (p,).
        converged: whether it is a maximum as far as differences tell.
        message: how the search ended.
        evaluations: points at which the function was evaluated.
    """

    y: np.ndarray
    value: float
    gradient: np.ndarray
    curvature: np.ndarray
    steps: np.ndarray
    converged: bool
    message: str
    evaluations: int


def derivatives(f: Many, y: np.ndarray, h: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Value, gradient and second derivatives by central differences, in one call of 1 + p + p² points.

    Points at which the function is not finite count as those on the other side.
    """
    p = len(y)
    pairs = [(i, j) for i in range(p) for j in range(i)]
    eye = np.eye(p) * h
    moves = [np.zeros(p), *eye, *-eye, *(s * (eye[i] + eye[j]) for i, j in pairs for s in (1, -1))]
    at = f(y + np.array(moves))
    top, up, down = at[0], at[1 : 1 + p].copy(), at[1 + p : 1 + 2 * p].copy()
    up, down = np.where(np.isfinite(up), up, 2 * top - down), np.where(np.isfinite(down), down, 2 * top - up)
    with np.errstate(invalid="ignore"):
        H = np.diag((up - 2 * top + down) / h**2)
        for (i, j), (both, neither) in zip(pairs, at[1 + 2 * p :].reshape(-1, 2), strict=True):
            cross = (both - up[i] - up[j] + 2 * top - down[i] - down[j] + neither) / (2 * h[i] * h[j])
            H[i, j] = H[j, i] = cross
        return float(top), np.nan_to_num((up - down) / (2 * h)), np.nan_to_num(H)


def climb(
    f: Many,
    start: np.ndarray,
    unit: np.ndarray,
    straight: np.ndarray | None = None,
    progress: Callable[[str], object] | None = None,
    most: int = 60,
) -> Summit:
    """Newton's method with differences for derivatives, eight dampings of each step tried at once.

    Args:
        f: of points (V, p), values (V,), −∞ where there is none.
        start: where it is finite.
        unit: about the size of each number.
        straight: which numbers may be of any size (p,); others change by a factor of e in a unit.
        progress: is told of each step.
        most: steps.
    """
    if not len(start):
        none = np.zeros((0, 0))
        return Summit(start, float(f(start[None])[0]), start, none, start, True, _FOUND, 1)
    y, h, count, tries = start.astype(float), 1e-2 * unit, 0, 0
    straight = np.zeros(len(y), bool) if straight is None else straight
    reach = np.where(straight, 1e9, _FARTHEST) * unit
    message, converged = f"not at a maximum after {most} steps", False
    for k in range(most):
        value, g, H = derivatives(f, y, h)
        count += 1 + len(y) + len(y) ** 2
        before, h = h, _steps(h, -np.diag(H), value, unit, straight)
        if (np.abs(np.log(h / before)) > np.log(4)).any() and tries < 8:
            tries += 1
            continue
        tries = 0
        moves, expected, top = _moves(g, H, h)
        if progress is not None:
            progress(f"step {k + 1}, log-likelihood {value:,.2f}")
        if expected < _GAIN and top:
            message, converged = _FOUND, True
            break
        limit = np.where(straight, np.maximum(_FAR * unit, 1e3 * h), _FAR * unit)
        moves /= np.maximum(1, (np.abs(moves) / limit).max(1))[:, None]
        tried = np.clip(y + moves, start - reach, start + reach)
        at = f(tried)
        count += len(tried)
        best = int(np.argmax(np.where(np.isfinite(at), at, -np.inf)))
        if not at[best] > value:
            # Rounding, a step of a gate, or a plain on which nothing changes.
            converged = bool(expected < _ROUGH or np.abs(H * np.outer(h, h)).max() < 1e-6)
            message = _FOUND if converged else "no step gains, and the slope is not 0: the likelihood is rough"
            break
        y = tried[best]
    if converged:
        y, value, more = _polished(f, y, value, H, h)
        count += more
    return Summit(y, value, g, -H, h, converged, message, count)


def _moves(g: np.ndarray, H: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """Newton's step by dampings (8, p), what it should gain, and whether the curvature is that of a maximum."""
    w, V = np.linalg.eigh(-H * np.outer(h, h))
    size = np.maximum(np.abs(w), max(1e-10 * np.abs(w).max(), 1e-300))
    along = V.T @ (g * h)
    damped = size[None] + _DAMPING[:, None] * size.max()
    return (along / damped) @ V.T * h, 0.5 * float((along**2 / size).sum()), bool((w > 0).all())


def _polished(f: Many, y: np.ndarray, value: float, H: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, float, int]:
    """The maximum by slopes over a tenth of the steps, whose error is a hundredth."""
    fine, p = np.diag(h / 10), len(y)
    at = f(np.concatenate([y + fine, y - fine]))
    slope = (at[:p] - at[p:]) / (h / 5)
    moves, expected, _ = _moves(slope, H, h) if np.isfinite(slope).all() else (np.zeros((1, p)), np.inf, False)
    if not expected < _ROUGH:
        return y, value, 2 * p
    now = float(f((y + moves[0])[None])[0])
    better = now > value - 1e-9 * max(1.0, abs(value))
    return (y + moves[0], now, 2 * p + 1) if better else (y, value, 2 * p + 1)


def _steps(h: np.ndarray, curvature: np.ndarray, value: float, unit: np.ndarray, straight: np.ndarray) -> np.ndarray:
    """Steps of which the differences stand out from rounding, and which are small for the curvature."""
    rounding = 1e-12 * max(1.0, abs(value))
    better = np.where(
        curvature * h**2 > 30 * rounding,
        _SHARE / np.sqrt(np.maximum(curvature, 1e-300)),
        np.where(-curvature * h**2 > 30 * rounding, h, 10 * h),
    )
    # What is searched by its logarithm is straight over no more than this.
    return np.asarray(np.clip(better, 1e-9 * unit, np.where(straight, 1e9, 0.3) * unit))

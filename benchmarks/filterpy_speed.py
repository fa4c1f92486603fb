"""A step of FilterPy's filters, of those of `sigmax.filterpy` and of `sigmax.Live`, with the same NumPy functions.

python benchmarks/filterpy_speed.py
"""

import time
from types import ModuleType
from typing import Any

import filterpy.kalman
import numpy as np

import sigmax
import sigmax.filterpy

_STEPS, _ROUNDS = 300, 9
N, M = 5, 2
X = np.array([8e3, 6e3, 150.0, 1.0, 0.01])
P, Q = np.diag([2500.0, 2500.0, 100.0, 0.01, 1e-5]), np.diag([1.0, 1.0, 1.0, 1e-5, 1e-7])
R = np.diag([400.0, 1e-5])
Z = np.array([1e4, 0.64])


def fx(x: Any, dt: float) -> np.ndarray:
    """A turn: place, speed, course and rate of turn."""
    ahead = dt * x[2]
    return np.array([x[0] + ahead * np.cos(x[3]), x[1] + ahead * np.sin(x[3]), x[2], x[3] + dt * x[4], x[4]])


def hx(x: Any) -> np.ndarray:
    """Range and azimuth."""
    return np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])])


def jacobian(x: Any) -> np.ndarray:
    """Of `hx`."""
    a, b = np.ravel(x)[:2]
    r = np.hypot(a, b)
    return np.array([[a / r, b / r, 0, 0, 0], [-b / r**2, a / r**2, 0, 0, 0]])


def made(lib: ModuleType, kind: str) -> Any:
    """A filter of a library."""
    if kind.startswith("UKF"):
        points = lib.MerweScaledSigmaPoints(N, 0.1 if "0.1" in kind else 1.0, 2.0, 0.0)
        return lib.UnscentedKalmanFilter(N, M, 1.0, hx, fx, points)
    if kind == "CKF":
        return lib.CubatureKalmanFilter(N, M, 1.0, hx, fx)
    k = (lib.ExtendedKalmanFilter if kind == "EKF" else lib.KalmanFilter)(N, M)
    k.F, k.H = np.eye(N) + np.diag(np.ones(N - 1), 1), np.eye(N)[:M]
    return k


def seconds(k: Any, kind: str) -> float:
    """Processor time of a step."""
    k.x, k.P, k.Q, k.R = X.reshape(np.shape(k.x)).copy(), P.copy(), Q, R
    column = Z.reshape(-1, 1)
    started = time.process_time()
    for _ in range(_STEPS):
        k.predict()
        if kind == "EKF":
            k.update(column, jacobian, hx)
        else:
            k.update(Z if np.ndim(k.x) == 1 else column)
    return (time.process_time() - started) / _STEPS


def live(kind: str) -> Any:
    """The same filter at the end of a sensor; of the extended one the functions alone, without a Jacobian."""
    A = np.eye(N) + np.diag(np.ones(N - 1), 1)
    straight = kind in ("EKF", "KF")
    model = sigmax.Model(
        motion=(lambda x, dt: A @ x) if straight else fx,
        sensor=(lambda x: x[:M]) if kind == "KF" else hx,
        Q=lambda dt: Q,
        R=R,
        state=tuple("abcde"),
        measurement=("range", "azimuth"),
    )
    filter = sigmax.get("UKF", alpha=0.1, beta=2.0, kappa=0.0) if "0.1" in kind else sigmax.get(kind)
    return sigmax.Live(filter, model, sigmax.Gaussian(X, P))


def seconds_live(k: Any) -> float:
    """Processor time of a step."""
    saved = k.save()
    k.step(Z, 1.0)
    k.restore(saved)
    started = time.process_time()
    for _ in range(_STEPS):
        k.step(Z, 1.0)
    taken = (time.process_time() - started) / _STEPS
    k.restore(saved)
    return taken


def main() -> None:
    """A row for each filter: the least of some rounds, the libraries by turns."""
    print("| filter | FilterPy, µs a step | sigmax.filterpy | FilterPy / it | sigmax.Live | FilterPy / it |")
    print("|---|--:|--:|--:|--:|--:|")
    for kind in ("UKF", "UKF, alpha 0.1", "CKF", "EKF", "KF"):
        pair, alive = [made(lib, kind) for lib in (filterpy.kalman, sigmax.filterpy)], live(kind)
        rounds = [[*(seconds(k, kind) for k in pair), seconds_live(alive)] for _ in range(_ROUNDS)]
        theirs, ours, step = np.min(rounds, axis=0) * 1e6
        print(
            f"| {kind} | {theirs:.0f} | {ours:.1f} | {theirs / ours:.1f} | {step:.2f} | {theirs / step:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()

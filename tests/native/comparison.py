"""Filters of the library beside the plain ones: the same functions, numbers and measurements."""

from collections.abc import Mapping
from typing import Any

import numpy as np

import sigmax
from tests.native.plain_filter import Plain

FILTERS = ("EKF", "UKF", "CKF", "SRCKFB")
NAMES = ("a", "b", "c", "d")
U = np.array([[0.4, -0.3], [0.1, 0.6], [-0.5, 0.2]])
DT = np.array([0.5, 1.0, 0.25])
MEAN = np.array([0.35, -0.6, 0.9, 0.15])
COV = np.array([[0.3, 0.1, 0.0, 0.05], [0.1, 0.4, 0.1, 0.0], [0.0, 0.1, 0.2, 0.02], [0.05, 0.0, 0.02, 0.25]])
Q = np.array([0.02, 0.01, 0.03, 0.02])


def measurements(sizes: Mapping[str, int], seed: int) -> dict[str, np.ndarray]:
    """Three steps, whole, in part, or missing."""
    rng = np.random.default_rng(seed)
    z = {s: rng.normal(0, 1, (len(DT), m)) for s, m in sizes.items()}
    for k, (s, m) in enumerate(sizes.items()):
        z[s][1, k % m :] = np.nan
        z[s][k % 3, 0] = np.nan
    return z


def apart(
    kind: str, motion: Any, sensors: Mapping[str, Any], z: Mapping[str, np.ndarray], backends: Any = (None, "xla")
) -> list[str] | None:
    """What a filter says otherwise than the plain one, by backend.

    None where there is nothing to compare: where the plain one breaks down or hangs on the last bits of its prior,
    or where JAX itself has no derivative of a function. Where a function rounds to a narrower type, JAX rounds its
    derivatives too, which then depend on the directions in which they are taken; by as much results may differ.
    """
    R = {s: np.linspace(0.1, 0.3, v.shape[1]) for s, v in z.items()}
    plain = Plain("CKF" if kind == "SRCKFB" else kind, motion, sensors, Q, R)
    rng = np.random.default_rng(0)
    try:
        mean, cov = plain.filtered(MEAN, COV, z, DT, U)
        nudged = [plain.filtered(MEAN * (1 + 1e-12 * rng.choice([-1, 1], 4)), COV, z, DT, U) for _ in range(3)]
        turned = [plain.filtered(MEAN, COV, z, DT, U, np.linalg.qr(rng.normal(size=(4, 4)))[0]) for _ in range(4)]
    except (np.linalg.LinAlgError, NotImplementedError, TypeError, ValueError):
        return None
    spread, rounding = (
        max(np.abs(m - mean).max() + np.abs(c - cov).max() for m, c in others) for others in (nudged, turned)
    )
    if not (np.isfinite(mean).all() and np.isfinite(cov).all() and spread < 1e-8 and rounding < 1e-3):
        return None
    model, found = sigmax.Model(motion=motion, sensor=dict(sensors), Q=Q, R=R, state=NAMES), []
    for backend in backends:
        made = sigmax.run(kind, model, sigmax.Gaussian(MEAN, COV), dict(z), dt=DT, inputs=U, backend=backend)
        off = max(np.abs(made.mean - mean).max(), np.abs(made.cov - cov).max())
        if not (made.ok.all() and off < 1e-9 + 1e4 * spread + 4 * rounding):
            found.append(f"{kind} on {backend or 'the default engine'} is {off:.3g} off, faults {made.faults()}")
    return found

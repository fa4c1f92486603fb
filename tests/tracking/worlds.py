"""Small worlds for the tracker: targets on straight lines, plots in Cartesian or polar coordinates."""

from functools import cache

import numpy as np

from sigmax.models import Model, motions, sensors
from sigmax.tracking import Cycle, Detector, Modes, Scan, Truth, gnn, m_of_n, polar, positions, two_point

AREA = 4000.0
NOISE = 5.0


@cache
def model(density=0.1):
    cv = motions.constant_velocity(("x", "y"))
    return Model(motion=cv, sensor=sensors.position((0, 1)), Q=cv.noise(density), R=[NOISE**2] * 2)


@cache
def modes(filter="EKF", density=0.1):
    return Modes([(filter, model(density))])


def cycle(clutter=1.0, detection=0.9, **parts):
    """A cycle for so many false plots a scan."""
    detector = Detector(detection, max(clutter, 1e-3) / (2 * AREA) ** 2, positions([NOISE**2] * 2))
    given = {"associate": gnn, "rule": m_of_n(3, 5, 5)} | parts
    return Cycle(given.pop("modes", modes()), {"": detector}, given.pop("initiate", two_point(40.0, 7.0)), **given)


def world(targets=4, scans=30, clutter=5.0, detection=0.9, dt=2.0, seed=0, speed=20.0):
    """Scans and truths."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-AREA / 2, AREA / 2, (targets, 2))
    velocity = rng.normal(size=(targets, 2))
    velocity *= speed / np.linalg.norm(velocity, axis=1, keepdims=True)
    time = dt * np.arange(scans)
    path = start[:, None] + velocity[:, None] * time[None, :, None]
    made = []
    for k, t in enumerate(time):
        seen = rng.random(targets) < detection
        z = path[seen, k] + NOISE * rng.standard_normal((int(seen.sum()), 2))
        false = rng.uniform(-AREA, AREA, (rng.poisson(clutter), 2))
        made.append(Scan(float(t), "", rng.permutation(np.concatenate([z, false]))))
    return made, [Truth(str(i), time, p) for i, p in enumerate(path)]


@cache
def radar_model():
    cv = motions.constant_velocity(("north", "east"))
    seen = sensors.range_azimuth(velocity=(2, 3))
    return Model(motion=cv, sensor=seen, Q=cv.noise(1.0), R=[30.0**2, 0.002**2, 1.0])


@cache
def radar_modes():
    return Modes([("SREKF", radar_model())])


def radar_cycle(**parts):
    detector = Detector(0.95, 1e-6, polar([30.0**2, 0.002**2, 1.0]))
    initiate = parts.pop("initiate", two_point(300.0, 9.0))
    return Cycle(radar_modes(), {"": detector}, initiate, rule=m_of_n(3, 4, 4), **parts)


def radar_scan(time, states, rng=None):
    """Plots of (north, east, v_north, v_east)."""
    x = np.atleast_2d(states)
    r, a = np.hypot(x[:, 0], x[:, 1]), np.arctan2(x[:, 1], x[:, 0])
    z = np.stack([r, a, (x[:, :2] * x[:, 2:]).sum(1) / r], axis=1)
    if rng is not None:
        z = z + rng.standard_normal(z.shape) * [30.0, 0.002, 1.0]
    return Scan(time, "", np.stack([z[:, 0], (z[:, 1] + np.pi) % (2 * np.pi) - np.pi, z[:, 2]], axis=1))

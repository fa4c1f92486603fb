"""A drive of the KITTI data: inertial sensors and satellite positions, from the data files inside the package gtsam."""

import importlib.util
from pathlib import Path

import numpy as np

from sigmax.errors import InputError
from sigmax.models import Model, navigation
from sigmax.records.record import Record, parse_trial
from sigmax.records.units import ACCELERATION, ANGLE, LENGTH, SPEED, TURN_RATE

# Densities and standard deviations: the most likely ones of a coarse grid, factors of 3, on the first half.
GYRO, ACCELEROMETER, GYRO_BIAS, ACCELEROMETER_BIAS = 9e-3, 0.09, 3e-5, 1e-3
PLACE, HEIGHT = 0.011, 0.0025
SIDEWAYS, UPWARD, EVERY = 0.004, 0.033, 50


def _table(name: str, **options: str) -> np.ndarray:
    # Found, not imported: importing gtsam takes seconds and only its files are wanted.
    package = importlib.util.find_spec("gtsam")
    if package is None or not package.submodule_search_locations:
        raise InputError("kitti-imu needs the data inside the package gtsam: pip install 'sigmax[plaza]'")
    path = Path(package.submodule_search_locations[0]) / "Data" / name
    try:
        return np.loadtxt(path, skiprows=1, **options)  # type: ignore[call-overload]
    except (OSError, ValueError) as error:
        raise InputError(
            f"the gtsam that is installed has no readable {path.name} ({error}): pip install 'sigmax[plaza]'"
        ) from error


def kitti_imu() -> Record:
    """A car's way through streets: attitude, velocity, position and the biases of its inertial sensors.

    Gyroscopes and accelerometers drive it at 100 Hz, a position comes once a second, and each half second the car is
    said not to slide. A position between two inertial samples splits the interval.

    Raises:
        InputError: where the data files are not installed.
    """
    imu, fixes = _table("KittiEquivBiasedImu.txt")[1:], _table("KittiGps_converted.txt", delimiter=",")
    edges, inputs = imu[:, 0], np.concatenate([imu[:, 5:8], imu[:, 2:5]], axis=1)
    before, after = fixes[0], fixes[1]
    fixes = fixes[(fixes[:, 0] > edges[0]) & (fixes[:, 0] <= edges[-1])]
    times = np.concatenate([edges[1:], fixes[:, 0]])
    order = np.argsort(times, kind="stable")
    time, T = times[order], len(times)
    interval = np.minimum(np.searchsorted(edges[1:], time), len(edges) - 2)
    seen = np.concatenate([np.full((len(edges) - 1, 3), np.nan), fixes[:, 1:]])[order]
    straight = np.full((T, 2), np.nan)
    straight[::EVERY] = 0.0
    motion = navigation.strapdown("car")
    model = Model(
        motion=motion,
        Q=motion.noise(GYRO, ACCELEROMETER, GYRO_BIAS, ACCELEROMETER_BIAS),
        sensor={"satellites": navigation.satellite_position(), "wheels": navigation.body_velocity((1, 2))},
        R={"satellites": np.square([PLACE, PLACE, HEIGHT]), "wheels": np.square([SIDEWAYS, UPWARD])},
    )
    velocity = (after[1:] - before[1:]) / (after[0] - before[0])
    prior = navigation.start(
        (0.0, 0.0, np.arctan2(velocity[1], velocity[0])),
        (*velocity[:2], 0.0),
        before[1:] + velocity * (edges[0] - before[0]),
        attitude_std=[*np.radians([3.0, 3.0, 10.0])],
        velocity_std=5.0,
        position_std=5.0,
        gyro_bias_std=0.005,
        accelerometer_bias_std=0.3,
    )
    return Record(
        name="kitti-imu",
        title="KITTI: a car with inertial sensors and satellite positions",
        model=model,
        prior=prior,
        tracks=("drive",),
        time=time[None] - edges[0],
        steps=np.array([T]),
        z={"satellites": seen[None], "wheels": straight[None]},
        dt=np.diff(np.concatenate([edges[:1], time]))[None],
        inputs=inputs[interval][None],
        truth=np.full((1, T, model.size), np.nan),
        position=(7, 8, 9),
        dimensions=(*[ANGLE] * 3, *[SPEED] * 3, *[LENGTH] * 3, *[TURN_RATE] * 3, *[ACCELERATION] * 3),
        trials=tuple(parse_trial(t) for t in ("EKF", "EKF:update=student")),
        source="KITTI raw data, a drive of 2011 (Geiger, Lenz, Stiller and Urtasun 2013), as packed in gtsam",
        licence="KITTI: CC BY-NC-SA 3.0; the package is under the simplified BSD licence",
        notes=(
            "The car is said not to slide: its velocity across and upwards is 0, with a deviation of "
            f"{SIDEWAYS} m/s, each half second.",
            "Densities and deviations are the most likely ones of a coarse grid on the first half of the drive.",
            "There is no truth beside the positions themselves, which jump now and then: see the weights.",
        ),
    )

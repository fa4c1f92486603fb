"""A drive of the KITTI data: inertial sensors and satellite positions, from the data files inside the package gtsam."""

from functools import partial
from typing import NamedTuple

import numpy as np

from sigmax.descriptions.trial import parse_trial
from sigmax.files.units import ACCELERATION, ANGLE, LENGTH, SPEED, TURN_RATE
from sigmax.models import Model, navigation
from sigmax.records.gtsam_data import gtsam_data
from sigmax.records.record import Record

SIDEWAYS_EVERY = 50


class Noises(NamedTuple):
    """Densities and standard deviations, in units of radians, metres and seconds.

    The defaults are the most likely ones on the first half of the drive, by factors of 3:
    `python benchmarks/navigation.py --noises` finds them.

    Attributes:
        gyro: of the white noise of the gyroscopes, rad/s/√Hz.
        accelerometer: of the white noise of the accelerometers, m/s²/√Hz.
        gyro_bias: of the walk of their biases.
        accelerometer_bias: likewise.
        place: of a position, m.
        height: of its height, m.
        sideways: of the velocity across, which is said to be 0, m/s.
        upward: of that upwards, m/s.
    """

    gyro: float = 9e-3
    accelerometer: float = 0.09
    gyro_bias: float = 3e-5
    accelerometer_bias: float = 1e-3
    place: float = 0.011
    height: float = 0.0025
    sideways: float = 0.004
    upward: float = 0.033


NOISES = Noises()


def car(noises: Noises = NOISES) -> Model:
    """A car with inertial sensors and satellite positions, which slides neither sideways nor upwards."""
    motion = navigation.strapdown("car")
    return Model(
        motion=motion,
        Q=motion.noise(noises.gyro, noises.accelerometer, noises.gyro_bias, noises.accelerometer_bias),
        sensor={"satellites": navigation.satellite_position(), "wheels": navigation.body_velocity((1, 2))},
        R={
            "satellites": np.square([noises.place, noises.place, noises.height]),
            "wheels": np.square([noises.sideways, noises.upward]),
        },
    )


def kitti_imu() -> Record:
    """A car's way through streets: attitude, velocity, position and the biases of its inertial sensors.

    Gyroscopes and accelerometers drive it at 100 Hz, a position comes once a second, and each half second the car is
    said not to slide. A position between two inertial samples splits the interval.

    Raises:
        InputError: where the data files are not installed.
    """
    imu = gtsam_data("kitti-imu", "KittiEquivBiasedImu.txt", partial(np.loadtxt, skiprows=2))
    fixes = gtsam_data("kitti-imu", "KittiGps_converted.txt", partial(np.loadtxt, skiprows=1, delimiter=","))
    edges, inputs = imu[:, 0], np.concatenate([imu[:, 5:8], imu[:, 2:5]], axis=1)
    before, after = fixes[0], fixes[1]
    fixes = fixes[(fixes[:, 0] > edges[0]) & (fixes[:, 0] <= edges[-1])]
    times = np.concatenate([edges[1:], fixes[:, 0]])
    order = np.argsort(times, kind="stable")
    time, T = times[order], len(times)
    interval = np.minimum(np.searchsorted(edges[1:], time), len(edges) - 2)
    seen = np.concatenate([np.full((len(edges) - 1, 3), np.nan), fixes[:, 1:]])[order]
    straight = np.full((T, 2), np.nan)
    straight[::SIDEWAYS_EVERY] = 0.0
    model = car()
    velocity = (after[1:] - before[1:]) / (after[0] - before[0])
    prior = navigation.prior(
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
            f"{NOISES.sideways} m/s, each half second.",
            "Densities and deviations are the most likely ones, by factors of 3, on the first half of the drive.",
            "There is no truth beside the positions themselves, which jump now and then: see the weights.",
        ),
    )

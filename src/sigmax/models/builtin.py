"""Models that come with the library, with numbers that make sense: for trying, testing and exporting."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import unknown
from sigmax.modelling.bias import Bias
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.parts import Motion, Sensor
from sigmax.models import motions, sensors
from sigmax.models.terrain import hills, inertial_errors, radio_altimeter


class Scenario(NamedTuple):
    """A model ready to run.

    Attributes:
        model: the model.
        prior: the state one dt before the first measurement.
        dt: seconds between measurements.
        inputs: what its motion and sensors are given, (k,), or None.
        linear: whether the exact Kalman filter applies.
        about: what it is, in words.
    """

    model: Model
    prior: Gaussian
    dt: float
    inputs: np.ndarray | None
    linear: bool
    about: str


def _made(
    about: str,
    motion: Motion,
    sensor: Sensor,
    Q: Any,
    R: Any,
    mean: Any,
    deviation: Any,
    dt: float = 1.0,
    inputs: Any = None,
    linear: bool = False,
) -> Scenario:
    u = None if inputs is None else np.array(inputs, float)
    prior = Gaussian(np.array(mean, float), np.diag(np.square(deviation)))
    return Scenario(Model(motion=motion, sensor=sensor, Q=Q, R=R), prior, dt, u, linear, about)


def _radar_ct() -> Scenario:
    turn = motions.coordinated_turn()
    return _made(
        "an aircraft in a coordinated turn seen by a radar with Doppler (Sobolev)",
        turn,
        sensors.range_azimuth(polar_velocity=(2, 3)),
        turn.noise(position=1.0, speed=0.1, course=np.deg2rad(0.3), turn_rate=np.deg2rad(0.04)),
        np.square([50.0, np.deg2rad(0.008), 0.016]),
        [200e3, 100e3, 100.0, np.deg2rad(45.0), 0.0],
        [86.6, 86.6, 29.6, np.deg2rad(20.6), np.deg2rad(0.04)],
    )


def _radar_ct_cartesian() -> Scenario:
    turn = motions.coordinated_turn_cartesian()
    return _made(
        "the same by Cartesian velocity, without Doppler",
        turn,
        sensors.range_azimuth(),
        turn.noise(acceleration=0.5, turn_rate=np.deg2rad(0.1)),
        np.square([50.0, np.deg2rad(0.1)]),
        [20e3, 10e3, 70.0, 70.0, 0.0],
        [100.0, 100.0, 20.0, 20.0, np.deg2rad(1.0)],
        dt=2.0,
    )


def _radar_ca() -> Scenario:
    accelerated = motions.constant_acceleration(("north", "east", "up"))
    return _made(
        "constant acceleration in three axes seen by a radar: range, azimuth, elevation, Doppler (n = 9)",
        accelerated,
        sensors.range_azimuth(at=(0, 1, 2), velocity=(3, 4, 5)),
        accelerated.noise(density=0.05),
        np.square([30.0, np.deg2rad(0.1), np.deg2rad(0.1), 0.5]),
        [30e3, -12e3, 6e3, -150.0, 80.0, 5.0, 0.0, 0.0, 0.0],
        [100.0, 100.0, 100.0, 30.0, 30.0, 10.0, 2.0, 2.0, 2.0],
    )


def _position_cv() -> Scenario:
    straight = motions.constant_velocity()
    return _made(
        "constant velocity with measured positions: linear",
        straight,
        sensors.position(),
        straight.noise(density=0.2),
        np.square([5.0, 5.0]),
        [0.0, 0.0, 10.0, -5.0],
        [10.0, 10.0, 3.0, 3.0],
        linear=True,
    )


def _bearings_singer() -> Scenario:
    manoeuvring = motions.singer(tau=20.0)
    return _made(
        "a manoeuvring target (Singer) of which only the bearing is seen",
        manoeuvring,
        sensors.bearing(origin=(0.0, -500.0)),
        manoeuvring.noise(acceleration=0.3),
        np.square([np.deg2rad(0.5)]),
        [1500.0, 800.0, -8.0, 6.0, 0.0, 0.0],
        [50.0, 50.0, 1.0, 1.0, 0.3, 0.3],
    )


def _rover() -> tuple[Motion, Motion, Motion, Sensor]:
    drive, scale = motions.unicycle(), motions.random_walk(("range_scale",))
    return drive, scale, motions.join(drive, scale), sensors.range_only(scale=3)


def _rover_driven(x: Any, dt: Any, u: Any) -> Any:
    """The motion by the first two inputs, speed and turn rate."""
    return _rover()[2].function(x, dt, u[:2])


def _beacon_heard(x: Any, u: Any) -> Any:
    """The range by the other two, where the beacon is."""
    return _rover()[3].function(x, u[2:])


def _rover_beacon() -> Scenario:
    drive, scale, both, beacon = _rover()

    return _made(
        "a vehicle with odometry that hears radio beacons; the scale of the ranges is a state",
        Motion(_rover_driven, both.state, both.noise, units=both.units),
        Sensor(_beacon_heard, beacon.measurement),
        both.noise(drive.noise(position=0.05, heading=0.02), scale.noise(0.0)),
        [0.09],
        [0.0, 0.0, 0.3, 1.0],
        [1.0, 1.0, 0.1, 0.1],
        dt=0.5,
        inputs=[1.2, 0.2, 12.0, 25.0],
    )


def _radar_offset() -> Scenario:
    straight, radar = motions.constant_velocity(("north", "east")), sensors.range_azimuth()
    offset = Gaussian([0.0, 0.0], np.square([50.0, np.deg2rad(1.0)]))
    model = Model(
        motion=straight,
        sensor=radar,
        Q=straight.noise(density=0.5),
        R=np.square([30.0, np.deg2rad(0.1)]),
        bias=Bias(
            sensor=np.eye(2),
            Q=np.square([0.1, np.deg2rad(0.001)]),
            prior=offset,
            names=("range_offset", "azimuth_offset"),
        ),
    )
    prior = Gaussian([20e3, 10e3, -70.0, 90.0], np.square([200.0, 200.0, 20.0, 20.0]))
    about = "constant velocity seen by a radar with unknown offsets of range and azimuth: a random bias"
    return Scenario(model, prior, 2.0, None, False, about)


def _terrain() -> Scenario:
    errors = inertial_errors()
    return _made(
        "the errors of an inertial system over made-up hills, by a radio altimeter (Belov); see also: sigmax terrain",
        errors,
        radio_altimeter(hills()),
        errors.noise(height=0.1, vertical=0.02, acceleration=1e-4, velocity=0.02, position=0.5),
        [25.0],
        [0.0] * 7,
        [30.0, 0.3, 0.005, 0.5, 0.5, 100.0, 100.0],
        inputs=[1500.0, 6000.0, 5000.0],
    )


BUILTIN: dict[str, Callable[[], Scenario]] = {
    "radar-ct": _radar_ct,
    "radar-ct-cartesian": _radar_ct_cartesian,
    "radar-ca": _radar_ca,
    "position-cv": _position_cv,
    "bearings-singer": _bearings_singer,
    "rover-beacon": _rover_beacon,
    "radar-offset": _radar_offset,
    "terrain": _terrain,
}


def builtin(name: str) -> Scenario:
    """A built-in model by its name.

    Raises:
        InputError: for a name that is not known, with a suggestion.
    """
    if not isinstance(name, str) or name not in BUILTIN:
        raise unknown("built-in model", name, BUILTIN)
    return _once(name)


@cache
def _once(name: str) -> Scenario:
    return BUILTIN[name]()

"""Problems on which nonlinear filters are usually shown."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.filters import get
from sigmax.models import Gaussian, Model, motions, sensors
from sigmax.studies.study import Study

_FILTERS = ("EKF", "UKF", "CKF", "SRECKFB", "HCKF", "GHKF", "PF")


def growth() -> Study:
    """The univariate nonstationary growth model: two states fit each measurement (Gordon et al. 1993)."""
    T = 50

    def motion(x: Any, dt: Any, u: Any) -> Any:
        return x / 2 + 25 * x / (1 + x**2) + 8 * u

    def sensor(x: Any) -> Any:
        return x**2 / 20

    return Study(
        name="growth",
        model=Model(motion=motion, sensor=sensor, Q=[10.0], R=[1.0], state=("x",), measurement=("z",)),
        prior=Gaussian([0.0], [[5.0]]),
        steps=T,
        title="Univariate nonstationary growth",
        inputs=np.cos(1.2 * np.arange(T))[:, None],
        filters={name: get(name) for name in _FILTERS},
        runs=2000,
        look=(1, 5, 20, 50),
        mirror=lambda x: -x,
        particles=1000,
        optimum_runs=512,
        about=("x' = x/2 + 25 x/(1 + x²) + 8 cos 1.2k + w, z = x²/20 + v; variances 10 and 1. z does not tell ±x.",),
    )


# Metres and seconds; Julier and Uhlmann (2004) give the same in kilometres.
_EARTH, _GRAVITY, _HEIGHT, _BALLISTIC = 6374e3, 3.9860e14, 13.406e3, 0.59783


def _falling(x: Any) -> Any:
    """The derivative of position, velocity and ballistic parameter over time."""
    position, velocity, parameter = x[:2], x[2:4], x[4]
    distance = jnp.sqrt((position**2).sum())
    speed = jnp.sqrt((velocity**2).sum())
    # Densities are per kilometre in the source.
    drag = -_BALLISTIC * jnp.exp(parameter) * jnp.exp((_EARTH - distance) / _HEIGHT) * speed / 1000.0
    gravity = -_GRAVITY / distance**3
    return jnp.concatenate([velocity, drag * velocity + gravity * position, jnp.zeros(1)])


def reentry() -> Study:
    """A vehicle enters the atmosphere and is tracked by a radar; its drag is unknown (Julier and Uhlmann 2004)."""

    def motion(x: Any, dt: Any) -> Any:
        a = _falling(x)
        b = _falling(x + dt / 2 * a)
        c = _falling(x + dt / 2 * b)
        d = _falling(x + dt * c)
        return x + dt / 6 * (a + 2 * b + 2 * c + d)

    radar = sensors.range_azimuth(origin=(_EARTH, 0.0))
    mean = [6500.4e3, 349.14e3, -1809.3, -6796.7, 0.0]
    return Study(
        name="reentry",
        model=Model(
            motion=motion,
            sensor=radar,
            Q=[0.0, 0.0, 24.064, 24.064, 1e-5],
            R=np.square([1.0, 0.017]),
            state=("x", "y", "vx", "vy", "ballistic"),
        ),
        # The source: 1e-6 km², 1e-6 (km/s)², and 1 for the parameter.
        prior=Gaussian(mean, np.ones(5)),
        steps=400,
        dt=0.5,
        title="A vehicle enters the atmosphere",
        filters={name: get(name) for name in ("EKF", "UKF", "CKF", "SRECKFB", "SRCKFB")},
        runs=1000,
        look=(1, 20, 100, 200, 400),
        units=("m", "m", "m/s", "m/s", ""),
        about=(
            "Position, velocity and a ballistic parameter that is drawn from N(0, 1) in each run; a radar on the "
            "ground measures range to 1 m and azimuth to 17 mrad twice a second.",
        ),
    )


def bearings() -> Study:
    """A target on a straight course of which a moving platform sees the bearing only."""
    T, dt = 60, 10.0
    # The platform turns half way: before, no bearing tells the range.
    course = np.where(np.arange(T) < T // 2, 60.0, 330.0) * np.pi / 180
    path = np.cumsum(8.0 * dt * np.column_stack([np.cos(course), np.sin(course)]), axis=0)
    straight = motions.constant_velocity(("north", "east"))
    return Study(
        name="bearings-only",
        model=Model(
            motion=straight,
            sensor=sensors.camera_bearing(),
            Q=straight.noise(density=3e-4),
            R=np.square([np.deg2rad(0.5)]),
        ),
        prior=Gaussian([6000.0, 3000.0, -3.0, 2.0], np.square([1500.0, 1500.0, 2.0, 2.0])),
        steps=T,
        dt=dt,
        title="Bearings only from a moving platform",
        inputs=np.column_stack([path, np.zeros((T, 1))]),
        filters={name: get(name) for name in _FILTERS},
        runs=2000,
        look=(1, 10, 30, 40, 60),
        particles=1000,
        optimum="bank",
        optimum_runs=256,
        units=("m", "m", "m/s", "m/s"),
        about=("A target known to 1.5 km and 2 m/s; bearings to 0.5° every 10 s; the platform turns after 5 minutes.",),
    )

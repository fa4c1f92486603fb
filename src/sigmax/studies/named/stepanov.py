"""The polynomial filter on problems where it, the second-order and the extended filter part (Stepanov et al.)."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.filters import get
from sigmax.models import Gaussian, Model, motions, sensors
from sigmax.studies.study import Study

_FILTERS = ("EKF", "SOKF", "PF", "UKF", "CKF")
# Four scalar problems: motion, sensor, variances of both noises, mean and variance of the start.
_EXAMPLES: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any], float, float, float, float]] = {
    "A": (lambda x: 0.8 * x - 0.08 * x**2, lambda x: x + 0.3 * x**2, 0.05, 0.1, 1.0, 0.5),
    "B": (lambda x: 1 + 0.8 * x - 0.2 * x**2, lambda x: x + 0.5 * x**2, 0.3, 0.02, 1.0, 1.0),
    "C": (lambda x: 1 + 0.8 * x - 0.3 * x**2, lambda x: x, 0.01, 0.5, 1.0, 0.25),
    "D": (lambda x: x, lambda x: jnp.exp(x / 2), 0.05, 0.01, 1.0, 1.0),
}
_ABOUT = {
    "A": "x' = 0.8 x − 0.08 x² + w, z = x + 0.3 x² + v",
    "B": "x' = 1 + 0.8 x − 0.2 x² + w, z = x + 0.5 x² + v",
    "C": "x' = 1 + 0.8 x − 0.3 x² + w, z = x + v",
    "D": "x' = x + w, z = exp(x / 2) + v",
}


def _example(letter: str) -> Study:
    f, h, q, r, mean, variance = _EXAMPLES[letter]
    model = Model(motion=lambda x, dt: f(x), sensor=h, Q=[q], R=[r], state=("x",), measurement=("z",))
    return Study(
        name=f"stepanov-{letter}",
        model=model,
        prior=Gaussian([mean], [[variance]]),
        steps=20,
        title=f"Stepanov, scalar example {letter}: {_ABOUT[letter]}",
        filters={name: get(name) for name in _FILTERS},
        runs=2000,
        look=(1, 2, 5, 20),
        reach=[10.0],
        particles=1000,
        optimum_runs=2000,
        about=(f"{_ABOUT[letter]}; w ~ N(0, {q:g}), v ~ N(0, {r:g}), start N({mean:g}, {variance:g}).",),
    )


def scalar() -> list[Study]:
    """The four scalar examples, each with the optimum."""
    return [_example(letter) for letter in _EXAMPLES]


def single_beacon() -> Study:
    """An underwater vehicle with compass and log that ranges to one beacon; the square of the range is measured."""
    T, dt, speed = 120, 10.0, 1.5
    # A square around the beacon: without turns one range leaves the position ambiguous.
    course = np.repeat([90.0, 180.0, 270.0, 0.0], T // 4) * np.pi / 180

    def motion(x: Any, dt: Any, u: Any) -> Any:
        return jnp.concatenate([x[:2] + dt * (u + x[2:]), x[2:]])

    def sensor(x: Any) -> Any:
        return (x[0] ** 2 + x[1] ** 2)[None]

    model = Model(
        motion=motion,
        sensor=sensor,
        Q=np.square([0.2, 0.2, 1e-3, 1e-3]),
        # 3 m of range at 300 m.
        R=[(2 * 300.0 * 3.0) ** 2],
        state=("north", "east", "current_north", "current_east"),
        measurement=("squared_range",),
    )
    return Study(
        name="single-beacon",
        model=model,
        prior=Gaussian([225.0, -225.0, 0.0, 0.0], np.square([75.0, 75.0, 0.1, 0.1])),
        steps=T,
        dt=dt,
        title="One beacon, compass and log",
        inputs=speed * np.column_stack([np.cos(course), np.sin(course)]),
        filters={name: get(name) for name in (*_FILTERS, "SRECKFB", "GHKF")},
        runs=2000,
        look=(1, 5, 20, 60, 120),
        particles=1000,
        optimum="bank",
        optimum_runs=256,
        units=("m", "m", "m/s", "m/s"),
        about=(
            "A vehicle runs a square of 450 m around a beacon at 1.5 m/s through the water; compass and log give its "
            "velocity, a current of 0.1 m/s is unknown, and every 10 s it measures the square of its range.",
        ),
    )


def vector() -> Study:
    """Quadratic motion and sensor in three and two components."""
    turn = 0.9 * np.array([[1.0, 0.2, 0.0], [-0.2, 1.0, 0.1], [0.0, 0.0, 1.0]])
    bend = np.zeros((3, 3, 3))
    bend[0, 0, 1], bend[1, 2, 2], bend[2, 0, 0] = 0.05, 0.06, -0.05
    view = np.array([[1.0, 0.0, 0.4], [0.0, 1.0, 0.0]])
    curve = np.zeros((2, 3, 3))
    curve[0, 0, 0], curve[0, 1, 2], curve[1, 2, 2], curve[1, 0, 1] = 0.5, 0.3, 0.5, -0.3
    # A step is taken whole whatever dt is.
    motion = motions.quadratic(np.array([0.1, 0.0, 0.05]), turn, bend)
    sensor = sensors.quadratic(np.zeros(2), view, curve)
    return Study(
        name="quadratic-vector",
        model=Model(motion=motion, sensor=sensor, Q=np.square([0.1, 0.1, 0.1]), R=np.square([0.05, 0.05])),
        prior=Gaussian([0.5, -0.3, 0.4], 0.25 * np.eye(3)),
        steps=30,
        title="A quadratic motion and a quadratic sensor in several components",
        filters={name: get(name) for name in (*_FILTERS, "GHKF")},
        runs=2000,
        look=(1, 3, 10, 30),
        particles=1000,
        optimum_runs=256,
        about=("Three components, two measured; all functions quadratic: the polynomial filter's moments are exact.",),
    )

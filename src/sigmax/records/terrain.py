"""A flight over an elevation map with an inertial system that drifts, and a radio altimeter."""

from typing import Any, NamedTuple

import numpy as np

from sigmax.descriptions.trial import parse_trial
from sigmax.errors import InputError
from sigmax.files.units import ACCELERATION, LENGTH, SPEED
from sigmax.models import Elevation, Gaussian, Model, inertial_errors, radio_altimeter
from sigmax.records.record import Backdrop, Record

# Standard deviations of the inertial system at the start: height, vertical velocity and acceleration, horizontal
# velocities and positions; and of their noise after one second.
START = np.array([20.0, 0.3, 0.005, 0.5, 0.5, 150.0, 150.0])
NOISE = {"height": 0.1, "vertical": 0.02, "acceleration": 1e-4, "velocity": 0.02, "position": 0.5}
# Of the altimeter with the errors of the map, m.
ALTIMETER = 5.0
SPEED_OVER_GROUND, CLEARANCE = 120.0, 300.0
# The flight, as fractions of the map; of large maps the middle is taken, m.
_CORNERS = np.array([[0.12, 0.15], [0.5, 0.8], [0.85, 0.3]])
LARGEST = 40_000.0
TRIALS = ("EKF", "CKF:permute=1", "UKF:permute=1", "SKF:permute=1", "SKF:moireau=1,permute=1", "PF")


class Flight(NamedTuple):
    """Where an aircraft was.

    Attributes:
        place: (T, 3), height, x and z of its track, m.
        dt: seconds between its points.
    """

    place: np.ndarray
    dt: float


def middle(ground: Elevation, size: float = LARGEST) -> Elevation:
    """The middle of a map, `size` metres at most along each side."""
    kept, origin = [], []
    for count, step, first in zip(ground.heights.shape[::-1], ground.spacing, ground.origin, strict=True):
        left_out = max(0, int(np.ceil((count - 1 - size / step) / 2)))
        kept.append(slice(left_out, count - left_out))
        origin.append(first + left_out * step)
    across, along = kept
    return Elevation(ground.heights[along, across], ground.spacing, (origin[0], origin[1]), ground.method)


def flight(ground: Elevation, dt: float = 1.0) -> Flight:
    """Two legs over a map at constant speed, above its highest point.

    Raises:
        InputError: for a map that is too small for a flight, or has no heights.
    """
    (x0, x1), (z0, z1) = ground.extent
    if np.isnan(ground.heights).all():
        raise InputError("the map has no heights: all of them are missing")
    corners = np.array([x0, z0]) + _CORNERS * [x1 - x0, z1 - z0]
    along = np.r_[0.0, np.hypot(*np.diff(corners, axis=0).T).cumsum()]
    way = np.arange(0.0, along[-1], SPEED_OVER_GROUND * dt)[1:]
    if len(way) < 2:
        raise InputError(
            f"the map is {x1 - x0:.0f} m by {z1 - z0:.0f} m: too small for a flight at {SPEED_OVER_GROUND:g} m/s; are "
            "its units right?"
        )
    track = [np.interp(way, along, corners[:, k]) for k in (0, 1)]
    height = np.full(len(way), np.nanmax(ground.heights) + CLEARANCE)
    return Flight(np.column_stack([height, *track]), dt)


def terrain_model(ground: Any) -> Model:
    """The errors of the inertial system by the radio altimeter (Belov et al., (10) and (11))."""
    errors = inertial_errors()
    return Model(motion=errors, sensor=radio_altimeter(ground), Q=errors.noise(**NOISE), R=[ALTIMETER**2])


def terrain(ground: Elevation, name: str = "terrain", seed: int = 1, flights: int = 1) -> Record:
    """Flights over a map with a synthetic inertial system of stated errors.

    The truth is the planned track; errors of the inertial system are drawn from the model by the seed, and what the
    altimeter says from the map itself, so that errors of the map are part of its noise.
    """
    model, planned = terrain_model(ground), flight(ground)
    rng, (T, n) = np.random.default_rng(seed), (len(planned.place), len(START))
    A = np.column_stack([np.asarray(model.motion(column, planned.dt)) for column in np.eye(n)])
    root = np.sqrt(np.asarray(model.Q.entries) * planned.dt)
    errors = np.empty((flights, T, n))
    error = rng.standard_normal((flights, n)) * START
    for t in range(T):
        error = error @ A.T + rng.standard_normal((flights, n)) * root
        errors[:, t] = error
    told = planned.place - errors[..., [0, 5, 6]]
    heights = np.asarray(ground(planned.place[:, 1], planned.place[:, 2]))
    z = planned.place[:, 0] - heights + ALTIMETER * rng.standard_normal((flights, T))
    time = planned.dt * np.arange(1, T + 1)
    return Record(
        name=name,
        title=f"Terrain-aided navigation over {name}",
        model=model,
        prior=Gaussian(np.zeros(n), np.square(START)),
        tracks=tuple(f"flight {k + 1}" for k in range(flights)),
        time=np.tile(time, (flights, 1)),
        steps=np.full(flights, T),
        z=z[..., None],
        dt=np.full((flights, T), planned.dt),
        inputs=told,
        truth=errors,
        position=(5, 6),
        dimensions=(LENGTH, SPEED, ACCELERATION, SPEED, SPEED, LENGTH, LENGTH),
        trials=tuple(parse_trial(t) for t in TRIALS),
        source=f"the map {name}; flight, inertial system and altimeter are simulated, seed {seed}",
        backdrop=Backdrop(ground.heights, ground.spacing, ground.origin, told[..., 1:], "inertial system alone"),
        notes=(
            "The state is what has to be added to the inertial system: height, vertical velocity and acceleration, "
            "velocities and positions to the east (x) and north (z). On the map it is drawn added.",
            "Standard deviations at the start: "
            + ", ".join(f"{name} {value:g}" for name, value in zip(model.state, START, strict=True))
            + f" (m, s); of the altimeter with the map {ALTIMETER:g} m.",
            f"The look-up is {ground.method}. permute=1 draws the points in the order in which the map is looked up "
            "least: sigmax explain shows it.",
        ),
    )

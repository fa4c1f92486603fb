"""The CMU Plaza range-only runs, from the data files inside the PyPI package gtsam."""

import jax
import numpy as np

from sigmax.descriptions.trial import parse_trial
from sigmax.files.units import ANGLE, LENGTH, NUMBER
from sigmax.models import Gaussian, Model, motions, sensors
from sigmax.records.gtsam_data import gtsam_data
from sigmax.records.record import Record

# Standard deviations. These four were chosen once, as the most likely of a coarse grid on run 2, and not
# touched for run 1: a range 0.5, 0.55 or 0.6 m, a position 0.02, 0.05 or 0.1 m and a heading 0.005, 0.01,
# 0.015, 0.02 or 0.03 rad after one second of driving by odometry. The scale is a constant.
RANGE, POSITION, HEADING, SCALE = 0.55, 0.05, 0.02, 0.0
# The start is surveyed; the scale is what a data sheet would let one believe.
START_POSITION, START_HEADING, START_SCALE = 1.0, 0.1, 0.1


def _model() -> Model:
    drive, scale = motions.unicycle(), motions.random_walk(("range_scale",))
    vehicle = motions.join(drive, scale)
    ranging = sensors.range_only(scale=3)

    def motion(x: jax.Array, dt: jax.Array, u: jax.Array) -> jax.Array:
        return vehicle.function(x, dt, u[:2])

    def sensor(x: jax.Array, u: jax.Array) -> jax.Array:
        return ranging.function(x, u[2:])

    return Model(
        motion=motion,
        sensor=sensor,
        Q=vehicle.noise(drive.noise(POSITION, HEADING), scale.noise(SCALE)),
        R=[RANGE**2],
        state=vehicle.state,
        measurement=ranging.measurement,
    )


def plaza(run: int) -> Record:
    """Run 1 or 2: position, heading and the scale of the ranges from odometry and ranges to four beacons.

    Each row of odometry and each range is a step of its own. A row of odometry tells the way and the
    turn since the row before; between them the mower is taken to drive one arc at one speed, so that
    a range in between splits the arc and loses nothing.

    Raises:
        InputError: where the data files are not installed.
    """
    from scipy.io import loadmat

    data = gtsam_data(f"plaza{run}", f"Plaza{run}_.mat", loadmat)
    known, odometry, heard = data["GT"], data["DR"], data["TD"]
    beacons = {int(number): (float(x), float(y)) for number, x, y in data["TL"]}
    edges = np.concatenate([known[:1, 0], odometry[:, 0]])
    heard = heard[(heard[:, 0] > edges[0]) & (heard[:, 0] <= edges[-1])]
    # A stable sort keeps odometry before a range of the same time, and ranges of one time in their order.
    times = np.concatenate([odometry[:, 0], heard[:, 0]])
    order = np.argsort(times, kind="stable")
    time, T = times[order], len(times)
    interval = np.searchsorted(edges[1:], time)
    elapsed = np.diff(edges)[interval]
    z, place = np.full((len(odometry), 1), np.nan), np.zeros((len(odometry), 2))
    z = np.concatenate([z, heard[:, 3:]])[order]
    place = np.concatenate([place, [beacons[int(number)] for number in heard[:, 2]]])[order]
    inputs = np.column_stack([odometry[interval, 1] / elapsed, odometry[interval, 2] / elapsed, place])
    # The heading that run 2 gives as truth points backwards: its odometry drives the other way.
    turned = np.pi if run == 2 else 0.0
    columns = [known[:, 1], known[:, 2], np.unwrap(known[:, 3]) + turned]
    truth = np.column_stack([*(np.interp(time, known[:, 0], c) for c in columns), np.full(T, np.nan)])
    start = [known[0, 1], known[0, 2], known[0, 3] + turned, 1.0]
    deviation = [START_POSITION, START_POSITION, START_HEADING, START_SCALE]
    notes = [
        "The radios measure about 7 % too long, at every beacon alike. The scale of the ranges is therefore a "
        "component of the state, from a prior of 1 ± 0.1; 'range_scale fixed at 1' is the same filter told that "
        "the ranges are right.",
        f"Standard deviations: range {RANGE} m; position {POSITION} m and heading {HEADING} rad after one second. "
        "They are the most likely ones of a coarse grid on run 2, and are used unchanged on run 1.",
        "The prior is the surveyed start, ± 1 m and ± 0.1 rad. Errors are against the truth at the time of each "
        "estimate.",
    ]
    if run == 2:
        notes.append(
            "The heading of the published truth is turned by π here: as it stands, the mower drives backwards."
        )
    return Record(
        name=f"plaza{run}",
        title=f"Plaza, run {run}: a robot mower among four radio beacons",
        model=_model(),
        prior=Gaussian(start, np.square(deviation)),
        tracks=(f"plaza{run}",),
        time=time[None] - edges[0],
        steps=np.array([T]),
        z=z[None],
        dt=np.diff(np.concatenate([edges[:1], time]))[None],
        inputs=inputs[None],
        truth=truth[None],
        position=(0, 1),
        dimensions=(LENGTH, LENGTH, ANGLE, NUMBER),
        trials=tuple(parse_trial(t) for t in ("EKF", "SRCKFB", "SRECKFB", "EKF:fixed=range_scale")),
        landmarks={f"beacon {number}": at for number, at in beacons.items()},
        source="CMU navigating-with-ranging-radios data (Djugash, Hamner, Roth 2009), as packed in gtsam",
        licence="the package is under the simplified BSD licence and states no other terms for its data",
        notes=tuple(notes),
    )

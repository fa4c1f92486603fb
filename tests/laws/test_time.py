"""Laws of time: whatever the order of arrival, a window gives the run in order; a lag gives the smoother's answer."""

import itertools
import pickle
from datetime import timedelta
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sigmax
from sigmax.live.timeline import Timeline
from sigmax.models import opaque
from sigmax.spaces import rotate
from tests.laws.problems import APART, TURNING_PRIOR, made

WINDOW = 2.0
ENGINES = ["native", pytest.param("xla", marks=pytest.mark.slow)]


class Plot(NamedTuple):
    time: float
    sensor: str | None
    z: np.ndarray
    R: np.ndarray | None = None
    u: np.ndarray | None = None


class World(NamedTuple):
    """A model, a prior, and what its sensors might give: rng -> (z, R, u)."""

    model: sigmax.Model
    prior: sigmax.Gaussian
    sensors: dict
    filter: str = "SRCKFB"


def coasting(x, dt):
    return jnp.stack([x[0] + dt * x[2], x[1] + dt * x[3], x[2], x[3]])


def maneuvering(x, dt, u):
    return coasting(x, dt) + jnp.concatenate([u * dt**2 / 2, u * dt])


def bearing(x):
    return jnp.arctan2(x[1], x[0])[None]


def place(x):
    return x[:2]


SEEN = {"bearing": bearing, "place": place}
NAMES = {"bearing": [sigmax.angle("azimuth")], "place": ["px", "py"]}
FLAT = sigmax.Model(
    motion=coasting,
    sensor=SEEN,
    Q=[0.1, 0.1, 0.2, 0.2],
    R={"bearing": [1e-3], "place": [1.0, 2.0]},
    state=("x", "y", "vx", "vy"),
    measurement=NAMES,
)
WILD = FLAT.with_noise("place", np.array([[1.0, 0.3], [0.3, 4.0]]))
START = sigmax.Gaussian([-20.0, 1.0, 1.0, 0.0], [4.0, 4.0, 1.0, 1.0])
PLANE = {
    "bearing": lambda rng: (np.array([np.pi]) + rng.normal(0, 0.05, 1), None, None),
    "place": lambda rng: (rng.normal([-18, 1], 2), rng.uniform(0.5, 2, 2) if rng.random() < 0.3 else None, None),
}


def attitude_seen(x):
    return rotate(x, jnp.array([0.0, 0.6, 0.8]))


WORLDS = {
    "angles": World(FLAT, START, PLANE),
    "bias, inputs": World(
        APART,
        sigmax.Gaussian(*TURNING_PRIOR),
        {
            "antenna": lambda rng: (rng.normal(0.5, 0.2, 1), None, rng.normal(size=1)),
            "ruler": lambda rng: (rng.normal(5, 0.3, 1), None, rng.normal(size=1)),
        },
        "TSCKF",
    ),
    "modes": World(sigmax.imm({"calm": FLAT, "wild": WILD}, sojourn=[20.0, 5.0]), START, PLANE, "SREKF"),
    "attitude": World(
        sigmax.Model(
            motion=lambda x, dt: x,
            sensor={"star": attitude_seen},
            Q=[1e-3] * 3,
            R={"star": [0.01] * 3},
            state=sigmax.rotation("attitude"),
            measurement={"star": ["a", "b", "c"]},
        ),
        sigmax.Gaussian([1.0, 0.0, 0.0, 0.0], 0.2 * np.eye(3)),
        {"star": lambda rng: (rng.normal([0, 0.6, 0.8], 0.1), None, None)},
        "SREKFB",
    ),
}


def stream(world, seed, count=14):
    """Measurements in the order of time, some of one time, some missing, and their order of arrival."""
    rng = np.random.default_rng(seed)
    names = list(world.sensors)
    plots, time = [], 0.0
    while len(plots) < count:
        time += rng.uniform(0.05, 0.5)
        for sensor in [s for s in names if rng.random() < 0.6] or names[:1]:
            z, R, u = world.sensors[sensor](rng)
            z = np.where(rng.random(len(z)) < 0.1, np.nan, z)
            plots.append(Plot(time, sensor, z, R, u))
    late = np.array([p.time for p in plots]) + rng.uniform(0, WINDOW, len(plots))
    return plots, [plots[k] for k in np.argsort(late)]


def live(world, filter=None, backend=None, **given):
    return sigmax.Live(filter or made(world.filter), world.model, world.prior, backend=backend, **given)


def hear(filter, plots):
    return [filter.update(p.z, p.sensor, R=p.R, u=p.u, time=p.time) for p in plots]


def same(a, b):
    for one, other in zip(jax.tree.leaves(a.belief), jax.tree.leaves(b.belief), strict=True):
        assert np.array_equal(one, other)
    assert a.time == b.time


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.one_in(2)
def test_any_order_of_arrival_is_the_run_in_order(name, backend):
    """To the last bit: beliefs, and what each measurement that closes a stream says."""
    world = WORLDS[name]
    for seed in range(12):
        plots, arrived = stream(world, seed)
        plain, window = live(world, backend=backend), live(world, backend=backend, window=WINDOW)
        hear(plain, plots)
        told = hear(window, arrived)
        same(plain, window)
        assert window.counts["taken"] + window.counts["late"] == len(plots)
        assert window.counts["late"] == sum(
            p.time < max((q.time for q in arrived[:k]), default=0) for k, p in enumerate(arrived)
        )
        # The last to arrive found all others there: it says what it says in order.
        last = plots.index(arrived[-1])
        again = live(world, backend=backend)
        for one, other in zip(hear(again, plots[: last + 1])[-1], told[-1], strict=True):
            assert np.array_equal(one, other, equal_nan=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", sigmax.names())
def test_any_order_is_the_run_in_order_for_every_filter(name):
    world = WORLDS["bias, inputs"]
    if sigmax.get(name).linear:
        world = world._replace(model=sigmax.Model(
            motion=coasting, sensor={"place": SEEN["place"]}, Q=FLAT.Q, R={"place": [1.0, 2.0]}, state=FLAT.state,
            measurement={"place": NAMES["place"]},
        ), prior=START, sensors={"place": PLANE["place"]})  # fmt: skip
    for seed in range(5):
        plots, arrived = stream(world, seed)
        plain, window = live(world, made(name)), live(world, made(name), window="2000 ms")
        hear(plain, plots)
        hear(window, arrived)
        same(plain, window)


def kalman(plots, until=np.inf):
    """The exact filter of FLAT's place measurements, in textbook form."""
    x, P, now = START.mean, START.cov, 0.0
    H = np.eye(2, 4)
    for p in plots:
        if p.time > until:
            break
        F = np.eye(4) + (p.time - now) * np.eye(4, k=2)
        x, P, now = F @ x, F @ P @ F.T + (p.time - now) * np.diag([0.1, 0.1, 0.2, 0.2]), p.time
        seen = ~np.isnan(p.z)
        if seen.any():
            h, R = H[seen], np.diag([1.0, 2.0] if p.R is None else p.R)[np.ix_(seen, seen)]
            K = P @ h.T @ np.linalg.inv(h @ P @ h.T + R)
            x, P = x + K @ (p.z[seen] - h @ x), P - K @ h @ P
    if np.isfinite(until):
        F = np.eye(4) + (until - now) * np.eye(4, k=2)
        x, P = F @ x, F @ P @ F.T + (until - now) * np.diag([0.1, 0.1, 0.2, 0.2])
    return x, P


@given(seed=st.integers(0, 2**32 - 1), query=st.floats(0, 1))
@settings(max_examples=30)
def test_a_window_is_the_exact_filter_at_every_time(seed, query):
    """The state, and `at` for times within the window and beyond: what was measured until then, predicted."""
    world = WORLDS["angles"]._replace(sensors={"place": PLANE["place"]})
    plots, arrived = stream(world, seed)
    window = live(world, window=WINDOW)
    hear(window, arrived)
    before = window.save()
    when = plots[-1].time + (query * 1.5 - 1) * WINDOW
    for got, wanted in (((window.mean, window.cov), kalman(plots)), (window.at(when), kalman(plots, when))):
        mean, cov = got if isinstance(got, tuple) else (got.mean, got.cov)
        assert np.allclose(mean, wanted[0], rtol=1e-9, atol=1e-9)
        assert np.allclose(cov, wanted[1], rtol=1e-9, atol=1e-9)
    assert window.at(when).time == when
    assert window.save() == before


def test_what_is_too_late_is_refused_and_counted():
    world = WORLDS["angles"]
    plots, _ = stream(world, 3)
    window, plain = live(world, window=WINDOW), live(world)
    hear(window, plots)
    hear(plain, plots)
    now, before = plots[-1].time, window.save()
    for filter, time in ((window, now - WINDOW - 0.01), (plain, now - 0.01)):
        told = filter.update([3.0], "bearing", time=time)
        assert filter.counts["refused"] == 1
        assert told.dof == 0
        assert np.isnan(told.residual).all()
        assert np.isnan(told.nis)
        assert told.log_likelihood == 0
    del window.counts["refused"]
    assert window.save() == before
    # As late as the window, whatever rounding makes of it, is not too late; nor is the time of the prior.
    window.update([3.0], "bearing", time=now - WINDOW)
    assert window.counts["late"] == 1
    fresh = live(world, window=WINDOW, time=5.0)
    fresh.update([3.0], "bearing", time=4.9)
    fresh.update([3.0], "bearing", time=5.0)
    assert fresh.counts == {"refused": 1, "taken": 1}


def test_what_comes_twice_counts_once():
    world = WORLDS["angles"]
    plots, arrived = stream(world, 4)
    window, once = live(world, window=WINDOW), live(world, window=WINDOW)
    hear(window, [p for p in arrived for _ in range(2)])
    hear(once, arrived)
    same(window, once)
    assert window.counts["repeated"] == len(plots)
    # Of one time and sensor, but not the same.
    one, other = np.array([-18.0, 1.0]), np.array([-18.5, 1.0])
    results = []
    for order in ((one, other), (other, one)):
        window = live(world, window=WINDOW)
        for z in order:
            window.update(z, "place", time=1.0)
        results.append(window)
    same(*results)
    assert results[0].counts["taken"] == 2


def test_a_measurement_is_kept_as_it_was_given():
    """Whoever fills one buffer again and again does not change what has been measured."""
    world = WORLDS["angles"]
    buffers = live(world, window=WINDOW), live(world, window=WINDOW)
    z = np.array([-18.0, 1.0])
    buffers[0].update(z, "place", time=1.0)
    buffers[1].update(z.copy(), "place", time=1.0)
    z[:] = 1e3
    for filter in buffers:
        filter.update([3.1], "bearing", time=0.5)
    same(*buffers)


@pytest.mark.parametrize("name", ["angles", "modes", "bias, inputs"])
def test_a_saved_window_goes_on_bit_for_bit(name):
    world = WORLDS[name]
    _, arrived = stream(world, 5)
    window, other = (live(world, window=WINDOW, lag=1.0) for _ in range(2))
    for plot in arrived:
        hear(window, [plot])
        other.restore(window.save())
        same(window, other)
    assert other.counts == window.counts
    assert np.array_equal(window.lagged.mean, other.lagged.mean)
    with pytest.raises(sigmax.InputError, match=r"another window: it has 2\.0, here it needs 3\.0"):
        live(world, window=3.0, lag=1.0).restore(window.save())


def test_a_window_can_be_pickled():
    _, arrived = stream(WORLDS["angles"], 5)
    window = live(WORLDS["angles"], window=WINDOW, lag=1.0)
    hear(window, arrived[:-4])
    copied = pickle.loads(pickle.dumps(window))
    hear(window, arrived[-4:])
    hear(copied, arrived[-4:])
    same(window, copied)
    assert np.array_equal(window.lagged.cov, copied.lagged.cov)


def test_memory_is_bounded():
    world, rng = WORLDS["angles"], np.random.default_rng(0)
    window = live(world, window=0.5, lag=1.0)
    sizes = []
    for k in range(600):
        window.update(rng.normal([-18, 1], 1), "place", time=0.01 * (k - rng.integers(0, 40)))
        sizes.append(len(window.save()))
    assert max(sizes[300:]) < 1.3 * min(sizes[300:])


DRIVEN = sigmax.Model(motion=maneuvering, sensor=SEEN, Q=FLAT.Q, R=FLAT.R, state=FLAT.state, measurement=NAMES)


@pytest.mark.parametrize("backend", ENGINES)
def test_inputs_that_come_on_their_own_hold_since_the_last(backend):
    """An accelerometer moves the state; what else is measured takes the inputs of the next of its steps."""
    world = WORLDS["angles"]._replace(model=DRIVEN)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        plots, _ = stream(world, seed)
        steps = [Plot(t, None, None, None, rng.normal(size=2)) for t in np.arange(0.1, plots[-1].time + 0.1, 0.2)]
        order = sorted([*plots, *steps], key=lambda p: (p.time, p.sensor is not None))
        filled = []
        for k, p in enumerate(order):
            nexts = [q.u for q in order[k:] if q.sensor is None]
            filled.append(p._replace(u=nexts[0] if nexts else steps[-1].u))
        plain, window = live(world, backend=backend), live(world, backend=backend, window=WINDOW)
        for filter, some in ((plain, filled), (window, sorted(order, key=lambda p: p.time + rng.uniform(0, WINDOW)))):
            # What is heard before any input is known must wait for one.
            some = some if filter is plain else [steps[0], *(p for p in some if p is not steps[0])]
            for p in some:
                if p.sensor is None:
                    filter.predict(u=p.u, time=p.time)
                else:
                    filter.update(p.z, p.sensor, R=p.R, u=p.u, time=p.time)
        same(plain, window)
        assert np.allclose(window.at(window.time + 1).mean, maneuvering(window.mean, 1.0, steps[-1].u), atol=1e-9)


def test_inputs_that_nobody_knows_are_asked_for_and_nothing_changes():
    window = live(WORLDS["angles"]._replace(model=DRIVEN), window=WINDOW)
    before = window.save()
    for call in (
        lambda: window.update([3.0], "bearing", time=1.0),
        lambda: window.predict(1.0),
        lambda: window.at(3.0),
    ):
        with pytest.raises(sigmax.InputError, match="give u="):
            call()
        assert window.save() == before


def test_a_failure_in_its_place_is_told_and_is_that_of_the_run():
    world = WORLDS["angles"]
    plots, _ = stream(world, 6)
    bad = plots[4]._replace(z=np.full_like(plots[4].z, np.inf), sensor=plots[4].sensor)
    plain, window = live(world), live(world, window=10.0)
    hear(plain, [*plots[:4], bad, *plots[5:]])
    hear(window, [*plots[:4], *plots[5:]])
    assert window.ok
    hear(window, [bad])
    assert window.fault == sigmax.running.Fault.SENSOR_NOT_FINITE
    same(plain, window)
    hear(window, [Plot(window.time + 1, "bearing", np.array([3.1]))])
    assert window.ok


@cache
def smoothed(name, backend, filter=None):
    """A world's run of steps, which may hold several sensors, and what `smooth` says of it."""
    world = WORLDS[name]
    plots, _ = stream(world, 7)
    groups = [(t, list(g)) for t, g in itertools.groupby(plots, key=lambda p: p.time)]
    groups = [(t, [p._replace(R=None, u=g[0].u) for p in g]) for t, g in groups]
    z = {s: np.full((len(groups), len(names)), np.nan) for s, names in world.model.measurement.items()}
    for k, (_, group) in enumerate(groups):
        for p in group:
            z[p.sensor][k] = p.z
    u = None if groups[0][1][0].u is None else np.array([g[0].u for _, g in groups])
    times = np.array([t for t, _ in groups])
    arguments = filter or made(world.filter), world.model
    back = []
    for k in range(1, len(times) + 1):
        dt = np.diff(times[:k], prepend=0.0)
        so_far = {s: v[:k] for s, v in z.items()}
        run = sigmax.run(*arguments, world.prior, so_far, dt=dt, inputs=None if u is None else u[:k], backend=backend)
        back.append(sigmax.smooth(*arguments, run, backend=backend))
    return groups, times, back


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.one_in(2)
def test_a_lag_is_the_smoother(name, backend):
    world, lag = WORLDS[name], 1.0
    groups, times, back = smoothed(name, backend)
    filter = live(world, backend=backend, lag=lag)
    assert filter.lagged is None
    for k, (time, group) in enumerate(groups):
        hear(filter, group)
        old = np.flatnonzero(times[: k + 1] <= time - lag)
        got = filter.lagged
        if not len(old):
            assert got is None or got.time == 0
            continue
        assert got.time == times[old[-1]]
        assert got.ok
        for what in ("mean", "cov", "std", *(["bias_mean", "bias_cov"] if got.bias else [])):
            assert np.allclose(getattr(got, what), getattr(back[k], what)[old[-1]], rtol=1e-9, atol=1e-9), what
        if got.modes:
            assert np.allclose(got.probability, back[k].probability[old[-1]], atol=1e-9)


def test_a_lag_follows_late_measurements():
    world = WORLDS["angles"]
    plots, arrived = stream(world, 8)
    filter, plain = live(world, window=WINDOW, lag=1.5), live(world, window=WINDOW, lag=1.5)
    hear(filter, arrived)
    hear(plain, plots)
    assert np.array_equal(filter.lagged.mean, plain.lagged.mean)
    assert filter.lagged.time <= filter.time - 1.5


def test_a_batch_has_one_time():
    world = WORLDS["angles"]
    batch = world._replace(prior=sigmax.Gaussian(np.stack([START.mean, START.mean + 1]), START.cov))
    filters = [live(batch, window=WINDOW, lag=1.0), *(live(world._replace(prior=sigmax.Gaussian(m, START.cov)),
               window=WINDOW, lag=1.0) for m in batch.prior.mean)]  # fmt: skip
    _, arrived = stream(world, 9)
    for p in arrived:
        R = None if p.R is None else np.diag(p.R)
        filters[0].update(np.stack([p.z, p.z]), p.sensor, R=R, time=p.time)
        hear(filters[1], [p._replace(R=R)])
        hear(filters[2], [p._replace(R=R)])
    assert np.allclose(filters[0].mean, [f.mean for f in filters[1:]], rtol=1e-12)
    for what in ("mean", "cov", "ok"):
        assert np.allclose(getattr(filters[0].lagged, what), [getattr(f.lagged, what) for f in filters[1:]], rtol=1e-9)
        assert np.allclose(getattr(filters[0].at(9.0), what), [getattr(f.at(9.0), what) for f in filters[1:]])


def test_fused_sensors_come_late_together():
    model = sigmax.models.fused(FLAT)
    rng = np.random.default_rng(0)
    events = [
        (t, {s: PLANE[s](rng)[0] for s in PLANE if rng.random() < 0.7} or {"bearing": np.array([3.0])})
        for t in np.arange(0.2, 3, 0.2)
    ]
    filters = [sigmax.Live("SRCKF", model, START, window=w) for w in (0.0, 5.0)]
    for filter, order in zip(filters, (np.arange(len(events)), rng.permutation(len(events))), strict=True):
        for k in order:
            filter.update(events[k][1], time=events[k][0])
    same(*filters)


def test_a_window_goes_over_to_xla_where_a_part_is_not_lowered():
    """A sensor whose columns are counted when they come, and which C cannot do, after steps that it could."""
    model = sigmax.Model(
        motion=coasting,
        sensor={"place": SEEN["place"], "odd": opaque(lambda x: np.hypot(x[:, :1], x[:, 1:2]), 1)},
        Q=FLAT.Q,
        R={"place": [1.0, 2.0], "odd": lambda x: jnp.ones(1)},
        state=FLAT.state,
        measurement={"place": NAMES["place"]},
    )
    window = sigmax.Live("CKF", model, START, window=9.0)
    window.update([-19.0, 1.0], "place", time=1.0)
    window.update([-17.0, 1.0], "place", time=3.0)
    window.update([18.5], "odd", time=2.0)
    plain = sigmax.Live("CKF", model, START, backend="xla")
    for time, z, sensor in ((1.0, [-19.0, 1.0], "place"), (2.0, [18.5], "odd"), (3.0, [-17.0, 1.0], "place")):
        plain.update(z, sensor, time=time)
    assert np.allclose(window.mean, plain.mean, rtol=1e-9)
    assert window.counts == {"taken": 2, "late": 1}


@given(st.lists(st.tuples(st.integers(0, 8), st.integers(0, 99)), max_size=12, unique=True), st.randoms())
def test_a_timeline_ends_as_if_all_had_come_in_order(events, random):
    """On a state that remembers its whole history."""
    line, state = Timeline(lambda s, e: ((*s, e), len(s))), ()
    shuffled = random.sample(events, len(events))
    for event in shuffled:
        place = line.place(event)
        state = line.redo(place, [(event, event), *line.events(place)], state)
    assert state == tuple(sorted(events))
    assert [e.told for e in line.entries] == list(range(len(events)))
    settled = line.settle(4)
    assert [e.event for e in settled] == sorted(e for e in events if e[0] < 4)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: live(WORLDS["angles"], window=-1.0), "window must be one number of seconds"),
        (lambda: live(WORLDS["angles"], lag="2 parsec"), 'lag is a span of time such as "2 s"'),
        (lambda: live(WORLDS["angles"], time=np.nan), "time must be one finite number"),
        (lambda: live(WORLDS["angles"]).update([3.0], "bearing", time="noon"), "time must be"),
        (lambda: live(WORLDS["angles"]).predict(1.0, time=2.0), "give one of the two"),
        (lambda: live(WORLDS["angles"]).predict(), "give one of the two"),
        (lambda: live(WORLDS["angles"]).at(-1.0), "make the filter with window="),
        (lambda: live(WORLDS["angles"], window=1.0).at(-1.0), "nothing is kept of time -1"),
        (lambda: live(WORLDS["angles"]).lagged, "there is no lag"),
    ],
)
def test_what_does_not_fit_is_a_message(call, words):
    with pytest.raises(sigmax.InputError, match=words):
        call()


def test_spans_of_time_are_numbers_timedeltas_or_words():
    for span in (2, 2.0, timedelta(seconds=2), "2 s", "2000 ms", " 2.0s"):
        window = live(WORLDS["angles"], window=span, time=2.01)
        window.predict("500 ms")
        for time in (5.0, 2.99, 3.01):
            window.update([3.0], "bearing", time=time)
        assert window.counts == {"refused": 1, "late": 1, "taken": 1}

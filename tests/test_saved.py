"""What is kept of filters and models: pickles in any process, and states that know what they belong to."""

import itertools
import multiprocessing
import pickle
import sys
import threading
from concurrent.futures import ProcessPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sigmax
from sigmax import motions, sensors
from sigmax.models.builtin import BUILTIN
from sigmax.models.terrain import hills, inertial_errors, radio_altimeter
from sigmax.tracking import (
    Cycle,
    Detector,
    Modes,
    Scan,
    Tracker,
    by_existence,
    hypotheses,
    m_of_n,
    polar,
    positions,
    reports,
    single_plot,
    two_point,
)

FLAT = motions.constant_velocity()
UNICYCLE, SCALE = motions.unicycle(), motions.random_walk(("scale",))
MOTIONS = {
    "random_walk": (motions.random_walk(("a", "b")), (0.1,)),
    "constant_velocity": (FLAT, (0.1,)),
    "constant_velocity by axis": (FLAT, ([0.1, 0.2],)),
    "constant_acceleration": (motions.constant_acceleration(["x"]), (0.1,)),
    "singer": (motions.singer(tau=20.0), (0.1,)),
    "coordinated_turn": (motions.coordinated_turn(), (0.1, 0.2, 0.3, 0.4)),
    "coordinated_turn_cartesian": (motions.coordinated_turn_cartesian(), (0.1, 0.2)),
    "unicycle": (UNICYCLE, (0.1, 0.2)),
    "join": (motions.join(UNICYCLE, SCALE), (UNICYCLE.noise(0.1, 0.2), SCALE.noise(0.3))),
    "join of functions": (motions.join(FLAT, SCALE), (FLAT.noise(0.1), SCALE.noise(0.3))),
    "quadratic": (motions.quadratic([0.0], [[0.9]], [[[0.1]]]), ([[0.2]],)),
    "inertial_errors": (inertial_errors(), (0.1, 0.2, 0.3, 0.4, 0.5)),
}
SENSORS = {
    "position": sensors.position(),
    "relative_position": sensors.relative_position(),
    "range_only": sensors.range_only(),
    "range_only of a scale": sensors.range_only(origin=(1.0, 2.0), scale=2),
    "bearing": sensors.bearing(),
    "camera_bearing": sensors.camera_bearing(),
    "range_azimuth": sensors.range_azimuth(velocity=(2, 3)),
    "quadratic": sensors.quadratic([0.0], [[0.9]], [[[0.1]]]),
    "radio_altimeter": radio_altimeter(hills()),
}
X, U = jnp.arange(1.0, 10.0), jnp.array([0.3, 0.2, 0.1])


def test_no_ready_made_part_is_left_out():
    for module, known in ((motions, MOTIONS), (sensors, SENSORS)):
        made = {name for name, f in vars(module).items() if getattr(f, "__module__", "") == module.__name__}
        assert {n for n in made if not n.startswith("_")} - {"mirrored_speed"} <= {name.split()[0] for name in known}


@pytest.mark.parametrize("name", MOTIONS)
def test_motions_and_their_noises_pickle(name):
    motion, deviations = MOTIONS[name]
    noise = motion.noise(*deviations)
    copied, noise_copied = pickle.loads(pickle.dumps((motion, noise)))
    n = len(motion.state)
    arguments = (X[:n], 0.5, U[:2])[: 3 if motion.inputs else 2]
    assert copied.state == motion.state
    assert np.array_equal(copied.function(*arguments), motion.function(*arguments))
    for of in (noise, copied.noise(*deviations)):
        at = [Q(0.5) if callable(Q) else Q for Q in (noise_copied, of)]
        assert np.array_equal(*at)
    # Found again rather than made anew: what was compiled for one is compiled for both.
    assert copied.function is motion.function or name in ("quadratic",)
    assert noise_copied is noise or not callable(noise) or name in ("quadratic",)


@pytest.mark.parametrize("name", SENSORS)
def test_sensors_pickle(name):
    sensor = SENSORS[name]
    copied = pickle.loads(pickle.dumps(sensor))
    arguments = (X[: 1 if name == "quadratic" else 7], U)[: 2 if sensor.inputs else 1]
    assert copied.measurement == sensor.measurement
    assert np.array_equal(copied.function(*arguments), sensor.function(*arguments))


def test_domains_pickle():
    domain = motions.mirrored_speed(2, 3)
    assert pickle.loads(pickle.dumps(domain)) is domain


def stepped(live, inputs):
    m = len(live.model.measurement[""])
    live.step(np.zeros(m), 0.1, u=inputs)
    return live.mean, live.cov


@pytest.mark.parametrize("name", BUILTIN)
@pytest.mark.one_in(2)
def test_models_results_and_live_filters_pickle(name):
    made = sigmax.builtin(name)
    model, prior, live = pickle.loads(
        pickle.dumps((made.model, made.prior, sigmax.Live("EKF", made.model, made.prior)))
    )
    want = stepped(sigmax.Live("EKF", made.model, made.prior), made.inputs)
    for copied in (live, sigmax.Live("EKF", model, prior), pickle.loads(pickle.dumps(live))):
        for got, wanted in zip(stepped(copied, made.inputs), want, strict=True):
            assert np.array_equal(got, wanted)


def test_results_pickle():
    made = sigmax.builtin("radar-offset")
    result = sigmax.run("TSCKF", made.model, made.prior, np.zeros((3, 2)), dt=made.dt)
    for record in (result, sigmax.smooth("TSCKF", made.model, result, dt=made.dt)):
        again = pickle.loads(pickle.dumps(record))
        assert np.array_equal(again.mean, record.mean)
        assert np.array_equal(again.cov, record.cov)
        assert np.array_equal(again.bias_mean, record.bias_mean)


PLANE = sigmax.Model(motion=FLAT, sensor=sensors.position(), Q=FLAT.noise(0.1), R=[0.25, 0.25])
RADAR = sigmax.Model(motion=FLAT, sensor=sensors.range_azimuth(), Q=FLAT.noise(0.1), R=[0.25, 1e-4])


@pytest.mark.parametrize(("model", "locate"), [
    (PLANE, positions([0.25, 0.25])), (PLANE, reports([0.25, 0.25, 1, 1])), (RADAR, polar([0.25, 1e-4])),
])  # fmt: skip
@pytest.mark.parametrize("initiate", [single_plot(5.0), two_point(5.0, 3.0), hypotheses(5.0, clutter=1e-4)])
@pytest.mark.parametrize("rule", [m_of_n(), by_existence()])
def test_trackers_pickle(model, locate, initiate, rule):
    cycle = Cycle(Modes([("EKF", model)] * 2, sojourn=[9, 9]), {"": Detector(0.9, 1e-4, locate)}, initiate, rule=rule)
    assert pickle.loads(pickle.dumps(cycle.rule)) is rule
    copied = pickle.loads(pickle.dumps(cycle))
    assert copied.initiate is initiate
    assert copied.detectors[""].locate is locate


def test_a_tracker_goes_on_from_its_pickle():
    def fed(tracker, times):
        for t in times:
            tracker.step(Scan(t, "", np.array([[t, 2 * t], [40.0 - t, 3.0]])))
        return tracker.cycle.modes.moments(tracker.state.tracks.beliefs)

    cycle = Cycle(Modes([("EKF", PLANE)]), {"": Detector(0.9, 1e-4, positions([0.25, 0.25]))}, two_point(5.0, 3.0))
    tracker = Tracker(cycle)
    fed(tracker, (1.0, 2.0, 3.0))
    copied = pickle.loads(pickle.dumps(tracker))
    for got, want in zip(fed(copied, (4.0, 5.0)), fed(tracker, (4.0, 5.0)), strict=True):
        assert len(got)
        assert np.array_equal(got, want)


def mean_elsewhere(live):
    live.step([1.0, 2.0], 1.0)
    return live.mean, live.save()


def test_a_live_filter_goes_to_a_process_that_was_spawned():
    live = sigmax.Live("SRCKFB", PLANE, sigmax.Gaussian(np.zeros(4), np.eye(4)))
    live.step([0.5, 0.5], 1.0)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        mean, saved = pool.submit(mean_elsewhere, live).result(timeout=120)
    live.step([1.0, 2.0], 1.0)
    assert np.array_equal(live.mean, mean)
    other = sigmax.Live("SRCKFB", PLANE, sigmax.Gaussian(np.zeros(4), np.eye(4)))
    other.restore(saved)
    assert np.array_equal(other.cov, live.cov)


START = sigmax.Gaussian(np.zeros(4), np.eye(4))
LIVE = sigmax.Live("SREKF", PLANE, START)
LIVE.step([0.5, 0.4], 1.0)
SAVED = LIVE.save()
BEFORE = LIVE.mean


@given(st.integers(0, len(SAVED) - 1), st.integers(1, 255))
def test_any_changed_byte_is_refused(place, change):
    damaged = bytearray(SAVED)
    damaged[place] ^= change
    with pytest.raises(sigmax.InputError, match=r"no saved state"):
        LIVE.restore(bytes(damaged))
    assert np.array_equal(LIVE.mean, BEFORE)


@given(st.integers(0, len(SAVED) - 1), st.binary(min_size=1, max_size=50))
def test_so_is_one_that_is_cut_off_or_longer(length, more):
    head, tail = SAVED[:length], SAVED[length:]
    for damaged in (head, tail[1:], SAVED + more, more + SAVED, head + more + tail):
        with pytest.raises(sigmax.InputError, match=r"no saved state"):
            LIVE.restore(damaged)
    assert np.array_equal(LIVE.mean, BEFORE)


OTHERS = {
    "another filter": lambda: sigmax.Live("SRCKF", PLANE, START),
    "another form": lambda: sigmax.Live("SREKFB", PLANE, START),
    "another motion": lambda: sigmax.Live("SREKF", model_of(motion=motions.coordinated_turn_cartesian()), FIVE),
    "another Q": lambda: sigmax.Live("SREKF", model_of(Q=FLAT.noise(0.2)), START),
    "another R": lambda: sigmax.Live("SREKF", model_of(R=[0.25, 0.3]), START),
    "another sensor": lambda: sigmax.Live("SREKF", model_of(sensor=sensors.position(at=(1, 0))), START),
    "other names": lambda: sigmax.Live("SREKF", model_of(state=("p", "q", "r", "s")), START),
    "a batch": lambda: sigmax.Live("SREKF", PLANE, sigmax.Gaussian(np.zeros((2, 4)), np.eye(4))),
    "float32": lambda: sigmax.Live("SREKF", PLANE, START, dtype="float32"),
}
FIVE = sigmax.Gaussian(np.zeros(5), np.eye(5))


def model_of(**changes):
    given = dict(motion=FLAT, sensor=sensors.position(), Q=FLAT.noise(0.1), R=[0.25, 0.25])
    if changes.get("motion"):
        given["Q"] = changes["motion"].noise(0.1, 0.1)
    return sigmax.Model(**given | changes)


@pytest.mark.parametrize("case", OTHERS)
def test_a_state_is_refused_by_whoever_it_does_not_belong_to(case):
    with pytest.raises(sigmax.InputError, match="the saved state"):
        OTHERS[case]().restore(SAVED)


def test_a_parameter_of_a_filter_tells_one_from_another():
    one, other = (sigmax.Live(sigmax.get("UKF", alpha=a), PLANE, START) for a in (0.5, 0.6))
    with pytest.raises(sigmax.InputError, match="another filter"):
        other.restore(one.save())


def test_a_state_of_another_version_is_refused(monkeypatch):
    other = sigmax.Live("SREKF", PLANE, START)
    monkeypatch.setattr(sigmax, "__version__", "0.0.9")
    with pytest.raises(sigmax.InputError, match="another version"):
        other.restore(SAVED)


@pytest.mark.parametrize("backends", [("native", "xla"), ("xla", "native")])
def test_a_state_goes_from_one_engine_to_the_other(backends):
    one, other = (sigmax.Live("SREKF", PLANE, START, backend=backend) for backend in backends)
    one.step([0.5, np.nan], 1.0)
    other.restore(one.save())
    assert np.array_equal(other.cov, one.cov)


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_a_state_that_is_not_finite_is_refused(backend):
    live = sigmax.Live("SREKF", PLANE, START, backend=backend)
    live.put(live.belief._replace(mean=np.full(4, np.nan)), 0)
    with pytest.raises(sigmax.InputError, match="not finite"):
        sigmax.Live("SREKF", PLANE, START, backend=backend).restore(live.save())


@pytest.mark.parametrize(("backend", "n"), [("native", 14), ("xla", 3)])
def test_two_threads_on_one_live_filter_are_told(backend, n):
    """Either somebody is told, or nobody was disturbed: the state is that of as many steps as were taken."""
    motion = motions.random_walk(tuple(f"x{i}" for i in range(n)))
    model = sigmax.Model(motion=motion, sensor=lambda x: x, Q=motion.noise(0.1), R=np.ones(n), state=motion.state)
    live = sigmax.Live("SREKF", model, sigmax.Gaussian(np.zeros(n), np.eye(n)), backend=backend)
    live.step(np.zeros(n), 1.0)
    start = live.save()
    told, taken = [], []
    ready, old = threading.Barrier(2), sys.getswitchinterval()

    def steps():
        ready.wait()
        for _ in range(300):
            try:
                live.step(np.zeros(n), 1.0)
                taken.append(1)
            except sigmax.InputError as error:
                told.append(str(error))

    sys.setswitchinterval(1e-5)
    threads = [threading.Thread(target=steps) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    sys.setswitchinterval(old)
    assert all("another thread" in words for words in told)
    assert len(told) + len(taken) == 600
    got = live.cov
    live.restore(start)
    for _ in taken:
        live.step(np.zeros(n), 1.0)
    assert np.array_equal(live.cov, got)


def test_a_live_filter_in_use_refuses_all_that_would_disturb_it():
    """Whatever reads or changes the state, from inside a step: an opaque sensor stands for the other thread."""
    calls = itertools.count()
    uses = [
        lambda: live.step([0.0], 1.0),
        lambda: live.predict(1.0),
        lambda: live.update([0.0]),
        lambda: live.expect(),
        lambda: live.save(),
        lambda: live.at(1e9),
        lambda: live.restore(saved),
        lambda: live.mean,
        lambda: live.cov,
        lambda: live.belief,
    ]
    refused = set()

    def asks(x):
        k = next(calls) % len(uses)
        try:
            uses[k]()
        except sigmax.InputError as error:
            if "another thread" in str(error):
                refused.add(k)
        return x[:, :1]

    model = sigmax.Model(
        motion=motions.random_walk(("a", "b")),
        sensor=sigmax.models.opaque(asks, 1),
        Q=[0.1, 0.1],
        R=[1.0],
        measurement=("z",),
    )
    live = sigmax.Live("CKF", model, sigmax.Gaussian([0.0, 0.0], np.eye(2)))
    saved = live.save()
    for _ in range(3 * len(uses)):
        live.step([0.0], 1.0)
    assert refused == set(range(len(uses)))
    live.step([0.0], 1.0)


def nonnegative(x):
    return x[0]


def with_noise_inside(x, v):
    return x[:1] * (1 + v[0])


def test_a_state_is_refused_by_a_model_that_differs_in_a_constraint_or_a_noise_inside():
    def model(**changes):
        given = dict(motion=motions.random_walk(("x",)), Q=[0.1], sensor=lambda x: x, R=[1.0], state=("x",))
        return sigmax.Model(**given | changes)

    inside = [model(sensor=sigmax.models.inside(with_noise_inside, [a]), R=None) for a in (0.1, 0.2)]
    bounded = [sigmax.constrain(model(), nonnegative, low=a) for a in (0.0, 0.5)]
    prior = sigmax.Gaussian([1.0], [[1.0]])
    for one, other in ((model(), bounded[0]), bounded, inside):
        state = sigmax.Live("EKF", one, prior).save()
        sigmax.Live("EKF", one, prior).restore(state)
        with pytest.raises(sigmax.InputError):
            sigmax.Live("EKF", other, prior).restore(state)

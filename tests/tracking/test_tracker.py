"""The cycle on small worlds: found, held, ended; late, doubled and broken input."""

import numpy as np
import pytest

from sigmax.errors import InputError
from sigmax.models import Model, motions, sensors
from sigmax.tracking import (
    Cycle,
    Detector,
    Layout,
    Modes,
    Scan,
    Tracker,
    Truth,
    by_existence,
    crowded,
    gnn,
    gospa,
    health,
    hypotheses,
    in_shadow,
    jpda,
    m_of_n,
    nearest,
    ospa,
    pda,
    positions,
    quality,
    reports,
    single_plot,
    two_point,
)
from sigmax.tracking.extent import covered
from tests.tracking.worlds import NOISE, cycle, model, radar_cycle, radar_scan, world

INITIATE = {
    "two": two_point(40.0, 7.0),
    "one": single_plot(40.0),
    "many": hypotheses(40.0, clutter=1e-7),
}


def same(one, other):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert (a.time, a.sensor) == (b.time, b.sensor)
        np.testing.assert_array_equal(a.id, b.id)
        np.testing.assert_array_equal(a.mean, b.mean)
        np.testing.assert_array_equal(a.cov, b.cov)


@pytest.mark.parametrize("associate", [gnn, jpda, pda, nearest], ids=lambda a: a.__name__)
def test_targets_in_clutter_are_found_and_held(associate):
    scans, truth = world(targets=5, scans=40, clutter=5.0, seed=1)
    q = quality(Tracker(cycle(5.0, associate=associate)).run(scans), truth, (0, 1), 50.0)
    assert min(q.held.values()) > 0.8
    assert max(q.rmse.values()) < 2 * NOISE
    assert q.switches == 0
    assert q.false_tracks <= 3


@pytest.mark.parametrize("name", INITIATE)
def test_every_way_to_begin_finds_the_targets(name):
    scans, truth = world(targets=5, scans=25, clutter=3.0, seed=2)
    q = quality(Tracker(cycle(3.0, initiate=INITIATE[name])).run(scans), truth, (0, 1), 50.0)
    assert min(q.held.values()) > 0.6
    assert q.switches == 0


@pytest.mark.parametrize("name", INITIATE)
def test_a_track_at_birth_is_honest(name):
    """The state at birth misses the truth by as much as its covariance says."""
    rng = np.random.default_rng(0)
    nees = []
    for k in range(60):
        v = rng.uniform(5, 35) * np.array([np.cos(k), np.sin(k)])
        scans = [Scan(2.0 * i, "", (v * 2 * i + NOISE * rng.standard_normal(2))[None]) for i in range(3)]
        told = Tracker(cycle(1e-6, initiate=INITIATE[name])).run(scans)[-1]
        d = told.mean[0] - [*v * 4, *v]
        nees.append(d @ np.linalg.solve(told.cov[0], d))
    assert 2.6 < np.mean(nees) < 5.5


def test_two_plots_leave_what_least_squares_leave():
    """Position and velocity through two plots: the velocity's error goes with that of the later position."""
    told = Tracker(cycle(1e-6)).run([Scan(0.0, "", [[0.0, 0.0]]), Scan(2.0, "", [[30.0, 10.0]])])[-1]
    A = np.kron([[1.0, 0.0], [1.0, -2.0]], np.eye(2))  # the later plot, the earlier one
    np.testing.assert_allclose(told.mean[0], np.linalg.solve(A, [30.0, 10, 0, 0]), atol=1e-9)
    np.testing.assert_allclose(told.cov[0], np.linalg.inv(A.T @ A) * NOISE**2, atol=1e-9)


def test_the_radial_velocity_decides_at_birth():
    state = np.array([20e3, 5e3, 100.0, -50.0])
    other = state + np.array([300.0, 0, -180, 120])
    c = radar_cycle()
    told = Tracker(c).run([radar_scan(0.0, state), radar_scan(4.0, other)])
    assert len(told[-1].id) == 0
    along = state + np.array([400.0, -200, 0, 0])
    told = Tracker(c).run([radar_scan(0.0, state), radar_scan(4.0, along)])
    assert len(told[-1].id) == 1
    e = along[:2] / np.linalg.norm(along[:2])
    assert e @ told[-1].cov[0][2:, 2:] @ e < 1.1
    np.testing.assert_allclose(told[-1].mean[0], along, atol=1e-6)


def test_a_target_may_cross_the_line_where_azimuth_turns_over():
    rng = np.random.default_rng(4)
    path = [np.array([-20e3, -1500 + 100.0 * 4 * k, 0.0, 100.0]) for k in range(10)]
    straight = Tracker(radar_cycle()).run(radar_scan(4.0 * k, x, rng) for k, x in enumerate(path))[-1]
    assert straight.confirmed.tolist() == [True]
    assert straight.id.tolist() == [0]
    assert np.linalg.norm(straight.mean[0, :2] - path[-1][:2]) < 150


def test_a_state_by_speed_and_course_begins_too():
    turn = motions.coordinated_turn()
    m = Model(
        motion=turn, sensor=sensors.position((0, 1), ("north", "east")), Q=turn.noise(0.5, 0.5, 0.01, 0.003), R=[25, 25]
    )
    layout = Layout((0, 1), None, (2, 3), {"turn_rate": (0.0, 0.02)})
    c = Cycle(Modes([("SRECKFB", m)]), {"": Detector(0.9, 1e-9, positions([25.0, 25.0]))}, two_point(40, 5), layout)
    rng = np.random.default_rng(1)
    t = 2.0 * np.arange(25)
    path = np.stack([400 * np.sin(0.05 * t), 400 - 400 * np.cos(0.05 * t)], axis=1)
    scans = [Scan(float(a), "", (p + 5 * rng.standard_normal(2))[None]) for a, p in zip(t, path, strict=True)]
    told = Tracker(c).run(scans)[-1]
    assert told.confirmed.tolist() == [True]
    assert told.mean[0, 2] == pytest.approx(20, abs=2)
    assert told.mean[0, 4] == pytest.approx(0.05, abs=0.015)
    with pytest.raises(InputError, match="turn_rate"):
        Tracker(Cycle(c.modes, c.detectors, two_point(40, 5), Layout((0, 1), None, (2, 3)))).run(scans[:2])


def test_tracks_are_confirmed_coast_and_end():
    scans, _ = world(targets=1, clutter=0, detection=1.0, scans=8, seed=3)
    silent = [Scan(16.0 + 2 * k, "", np.empty((0, 2))) for k in range(6)]
    told = Tracker(cycle(1e-6, rule=m_of_n(3, 4, 3))).run([*scans, *silent])
    assert [t.confirmed.sum() for t in told[:4]] == [0, 0, 1, 1]
    assert [len(t.id) for t in told[7:]] == [1, 1, 1, 0, 0, 0, 0]
    assert told[10].ended.tolist() == [0]
    spread = [np.trace(t.cov[0]) for t in told[7:10]]
    assert spread == sorted(spread)


def test_existence_alone_confirms_and_ends():
    scans, _ = world(targets=1, clutter=0, detection=1.0, scans=8, seed=3)
    silent = [Scan(16.0 + 2 * k, "", np.empty((0, 2))) for k in range(8)]
    told = Tracker(cycle(1.0, rule=by_existence(0.99, 0.01))).run([*scans, *silent])
    assert told[7].confirmed.all()
    assert len(told[-1].id) == 0


def test_what_stands_still_or_flies_too_fast_is_no_target():
    rng = np.random.default_rng(0)
    paths = [np.array([[0, 0], [0, 0]]), np.array([[500, 0], [5, 0]]), np.array([[0, 900], [0, 35]])]
    scans = [
        Scan(2.0 * k, "", np.array([a + v * 2 * k for a, v in paths]) + NOISE * rng.standard_normal((3, 2)))
        for k in range(20)
    ]
    free = Tracker(cycle(1e-3)).run(scans)[-1]
    assert free.confirmed.sum() == 3
    told = Tracker(cycle(1e-3, moving=(30.0, 2.0), max_speed=20.0)).run(scans)[-1]
    assert told.confirmed.sum() == 1
    assert np.linalg.norm(told.mean[told.confirmed][0, :2] - [500 + 5 * 38, 0]) < 20


def test_where_a_target_has_plots_no_other_begins():
    rng = np.random.default_rng(1)
    scans = [
        Scan(2.0 * k, "", np.array([[10.0 * k, 0], [10.0 * k - 25, 0]]) + rng.standard_normal((2, 2)) * 2)
        for k in range(20)
    ]
    alone = [s._replace(z=s.z[:1]) if s.time < 12 else s for s in scans]
    assert Tracker(cycle(1e-3)).run(alone)[-1].confirmed.sum() == 2
    assert Tracker(cycle(1e-3, extent=(40.0, 40.0))).run(alone)[-1].confirmed.sum() == 1


def test_a_boat_abreast_is_no_part_of_a_ship():
    """On the course of a ship lie its own ends, beside it another; turning the world turns the answer."""
    rng = np.random.default_rng(3)
    mean = np.array([[100.0, 50, 6, 0], [0, 0, 0.1, 0]])
    cov = np.tile(np.diag([4.0, 4, 0.04, 0.04]), (2, 1, 1))
    astern, abreast, far, near_the_idle = [80.0, 51], [101.0, 63], [100.0, 90], [0.0, 20]
    place = np.array([astern, abreast, far, near_the_idle])
    for angle in rng.uniform(-4, 4, 5):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s], [s, c]])
        whole = np.kron(np.eye(2), turn)
        told = covered(place @ turn.T, mean @ whole.T, whole @ cov @ whole.T, Layout(), 25.0, 8.0)
        assert told.tolist() == [True, False, False, True]
    polar = np.array([[100.0, 50, 6, 0.0]])
    assert covered(place, polar, cov[:1], Layout((0, 1), None, (2, 3)), 25.0, 8.0).tolist() == [True, *[False] * 3]
    assert not covered(place, mean, cov, Layout(), 0.0, 0.0).any()
    assert not covered(place, mean[:0], cov[:0], Layout(), 25.0, 8.0).any()


def test_a_report_of_position_and_velocity_begins_a_track_with_both():
    R = np.array([25.0, 25.0, 0.25, 0.25])
    cv = motions.constant_velocity(("x", "y"))
    m = Model(motion=cv, sensor=lambda x: x, measurement=("x", "y", "vx", "vy"), Q=cv.noise(0.01), R=R)
    c = Cycle(Modes([("EKF", m)]), {"": Detector(0.9, 1e-9, reports(R))}, single_plot(30.0))
    told = Tracker(c).step(Scan(0.0, "", [[10.0, 20.0, 3.0, -4.0], [500.0, 0.0, np.nan, np.nan]]))
    # The prior of an axis has the variance 30² / 3; a report without a velocity begins nothing here.
    shrink = 300 / (300 + 0.25)
    np.testing.assert_allclose(told.mean, [[10, 20, 3 * shrink, -4 * shrink]])
    np.testing.assert_allclose(told.cov[0], np.diag([25, 25, 0.25 * shrink, 0.25 * shrink]), atol=1e-12)


def test_no_track_is_confirmed_before_its_age():
    scans, _ = world(targets=1, clutter=0, detection=1.0, scans=8, seed=3)
    told = Tracker(cycle(1e-3, rule=by_existence(0.99, 0.01, age=7.0))).run(scans)
    assert [int(t.confirmed.sum()) for t in told] == [0, 0, 0, 0, 0, 1, 1, 1]


@pytest.mark.parametrize("seed", [0, 1])
def test_late_scans_within_the_window_change_nothing(seed):
    scans, _ = world(targets=4, scans=20, clutter=3.0, seed=seed)
    rng = np.random.default_rng(seed)
    mixed = sorted(scans, key=lambda s: s.time + rng.uniform(0, 6))
    late = Tracker(cycle(3.0), window=6.0)
    same(late.run(mixed), Tracker(cycle(3.0)).run(scans))
    assert late.counts["late"] > 0
    assert late.counts["refused"] == 0


def test_later_ones_are_refused_and_counted():
    scans, _ = world(scans=12, clutter=1.0)
    without = [*scans[:3], *scans[4:]]
    tracker = Tracker(cycle(), window=3.0)
    same(tracker.run([*without, scans[3]]), Tracker(cycle()).run(without))
    assert tracker.counts == {"taken": 11, "refused": 1}


def test_a_jump_of_the_clock_is_refused_and_a_clock_set_back_begins_anew():
    scans, _ = world(scans=30, clutter=1.0)
    wrong = scans[10]._replace(time=1e9)
    tracker = Tracker(cycle())
    same(tracker.run([*scans[:11], wrong, *scans[11:]]), Tracker(cycle()).run(scans))
    assert tracker.counts["jumped"] == 1
    back = Tracker(cycle())
    back.run([s._replace(time=s.time + 1e6) for s in scans])
    back.run(scans)
    assert back.counts["restarts"] == 1
    assert back.counts["refused"] == 9
    assert back.history[-1].confirmed.any()


def test_doubled_plots_and_scans_count_once():
    scans, _ = world(scans=15, clutter=2.0, seed=6)
    plain = Tracker(cycle(2.0)).run(scans)
    doubled = Tracker(cycle(2.0))
    for scan in scans:
        doubled.step(scan._replace(z=np.concatenate([scan.z, scan.z])))
        doubled.step(scan._replace(z=np.concatenate([scan.z, scan.z])))
    for one, other in zip(plain, doubled.history, strict=True):
        np.testing.assert_array_equal(one.mean, other.mean)
    assert doubled.counts["repeated"] == sum(len(s.z) > 0 for s in scans)


def test_a_thousand_plots_on_one_spot_begin_few_tracks():
    rng = np.random.default_rng(0)
    scans, truth = world(targets=3, scans=12, clutter=1.0, seed=9)
    spot = [s._replace(z=np.concatenate([s.z, 3000 + rng.normal(size=(1000, 2))])) for s in scans]
    told = Tracker(cycle()).run(spot)
    assert max(len(t.id) for t in told) < 40
    assert min(quality(told, truth, (0, 1), 50.0).held.values()) > 0.5


def test_empty_and_missing_are_no_trouble():
    told = Tracker(cycle()).run(
        [Scan(0.0, "", []), Scan(1.0, "", np.full((3, 2), np.nan)), Scan(2.0, "", [[1.0, 2.0]])]
    )
    assert [len(t.id) for t in told] == [0, 0, 0]


def test_a_plot_that_lacks_a_component_still_corrects():
    scans, _ = world(targets=1, clutter=0, detection=1.0, scans=8, seed=3)
    c = cycle(1e-6)
    state = Tracker(c)
    state.run(scans[:6])
    half = scans[6].z.copy()
    half[:, 1] = np.nan
    told = state.step(scans[6]._replace(z=half))
    whole = Tracker(c).run(scans[:7])[-1]
    assert told.plot[0] == 0
    assert told.cov[0, 0, 0] == pytest.approx(whole.cov[0, 0, 0])
    assert told.cov[0, 1, 1] > whole.cov[0, 1, 1]


def test_wrong_units_are_told():
    rng = np.random.default_rng(0)
    cv = motions.constant_velocity(("x", "y"))
    seen = {"gps": sensors.position((0, 1)), "camera": sensors.bearing((0, 1))}
    m = Model(motion=cv, sensor=seen, Q=cv.noise(0.1), R={"gps": [25, 25], "camera": [1e-4]})
    detectors = {"gps": Detector(0.9, 1e-8, positions([25.0, 25.0])), "camera": Detector(0.9, 0.1)}
    c = Cycle(Modes([("EKF", m)]), detectors, two_point(40, 5), rule=m_of_n(3, 4, 5))
    words = {}
    for unit in (1.0, np.degrees(1.0)):
        scans = []
        for t in np.arange(0, 60, 2.0):
            x = np.array([500 + 15 * t, 300 - 10 * t])
            scans.append(Scan(t, "gps", (x + 5 * rng.standard_normal(2))[None]))
            bearing = np.arctan2(x[1], x[0]) + 0.01 * rng.standard_normal()
            scans.append(Scan(t + 1, "camera", np.array([[bearing * unit]])))
        words[unit] = {h.sensor: h.words for h in health(Tracker(c).run(scans))}
    assert words[1.0] == {"gps": "", "camera": ""}
    assert "units" in words[np.degrees(1.0)]["camera"]
    far = [s._replace(z=s.z * 1e3) for s in world(scans=20, clutter=0.0)[0]]
    assert "units" in health(Tracker(cycle()).run(far))[0].words


def test_asynchronous_sensors_on_a_moving_platform():
    rng = np.random.default_rng(2)
    cv = motions.constant_velocity(("x", "y"))
    seen = {"lidar": sensors.relative_position((0, 1)), "camera": sensors.camera_bearing((0, 1))}
    m = Model(motion=cv, sensor=seen, Q=cv.noise(0.05), R={"lidar": [9, 9], "camera": [0.01**2]})

    def near(expected):
        return np.where(np.linalg.norm(expected, axis=1) < 200, 0.9, 0.0)

    detectors = {"lidar": Detector(near, 1e-7, positions([9.0, 9.0], from_inputs=True)), "camera": Detector(0.9, 0.05)}
    c = Cycle(Modes([("SREKFB", m)]), detectors, two_point(20, 3), rule=m_of_n(3, 5, 8))
    scans, out = [], []
    for k in range(120):
        t = 0.5 * k
        own, x = np.array([2.0 * t, -1.0 * t]), np.array([50 + 6 * t, 40 + 3.0 * t])
        d = x - own
        if k % 2 == 0:
            z = d + 3 * rng.standard_normal(2)
            scans.append(Scan(t, "lidar", z[None] if np.linalg.norm(d) < 200 else np.empty((0, 2)), own))
        else:
            bearing = np.arctan2(d[1], d[0]) - 0.3 + 0.01 * rng.standard_normal()
            scans.append(Scan(t, "camera", np.array([[bearing]]), np.array([*own, 0.3])))
        out.append(np.linalg.norm(d) > 200)
    told = Tracker(c).run(scans)
    assert sum(out) > 20
    # Bearings alone keep the track where the lidar does not reach, and what cannot see it does not end it.
    assert told[-1].confirmed.tolist() == [True]
    assert told[-1].id.tolist() == told[10].id.tolist()
    direction = np.array([50 + 6 * 59.5, 40 + 3 * 59.5]) - np.array([2 * 59.5, -59.5])
    miss = told[-1].mean[0, :2] - (np.array([2 * 59.5, -59.5]) + direction)
    side = abs(np.cross([*direction, 0], [*miss, 0])[2]) / np.linalg.norm(direction)
    assert side < 10


def test_who_stands_behind_another_is_in_its_shadow():
    expected = np.array([[100.0, 0], [200, 3], [200, 60], [-200, 0], [105, 0]])
    assert in_shadow(expected, 10.0, 10.0).tolist() == [False, True, False, False, False]


def test_who_stands_near_another_is_not_told_apart():
    expected = np.array([[100.0, 0], [120, 0], [200, 60]])
    assert crowded(expected, 30.0).tolist() == [True, True, False]
    assert crowded(expected[:1], 30.0).tolist() == [False]


def test_distances_of_sets():
    x, y = np.array([[0.0, 0], [100, 0]]), np.array([[3.0, 4.0]])
    assert ospa(x, y, 20.0) == pytest.approx(np.sqrt((25 + 400) / 2))
    found = gospa(x, y, 20.0)
    assert found.distance == pytest.approx(np.sqrt(25 + 200))
    assert (found.localisation, found.missed, found.false) == pytest.approx((25, 0, 200))
    assert ospa(x[:0], y[:0], 20.0) == gospa(x[:0], y[:0], 20.0).distance == 0
    assert gospa(x, y + 500, 20.0).missed == pytest.approx(200)


def test_distances_are_those_of_stone_soup():
    metrics = pytest.importorskip("stonesoup.metricgenerator.ospametric", reason="Stone Soup is not installed")
    from stonesoup.types.state import State

    rng = np.random.default_rng(0)
    for a, b in [(3, 5), (4, 4), (6, 2)]:
        x, y = rng.uniform(0, 50, (a, 2)), rng.uniform(0, 50, (b, 2))
        states = [[State(p, timestamp=0) for p in s] for s in (x, y)]
        theirs, _ = metrics.GOSPAMetric(c=20, p=2).compute_gospa_metric(*states)
        assert gospa(x, y, 20.0).distance == pytest.approx(theirs.value["distance"])
        assert ospa(x, y, 20.0) == pytest.approx(metrics.OSPAMetric(c=20, p=2).compute_OSPA_distance(*states).value)


def test_breaks_switches_and_false_tracks_are_counted():
    from sigmax.tracking.state import Gates, Told

    t = np.arange(6.0)
    truth = [Truth("a", t, np.zeros((6, 2))), Truth("b", t, np.full((6, 2), 100.0))]
    places = {1: [0, 0, 0, 100, 100, 100], 2: [100, 100, 100, 0, 0, 0], 9: [500] * 6}

    def told(k):
        ids = np.array([1, 2, 9])
        mean = np.array([[places[int(i)][k]] * 2 for i in ids], float)
        rest = np.full(3, np.nan), 0, Gates(0, 0, 0, 0, 0, 0), ids[:0], 0
        return Told(
            t[k],
            "",
            ids,
            np.ones(3, bool),
            np.ones(3),
            mean,
            np.zeros((3, 2, 2)),
            np.ones((3, 1)),
            ids,
            rest[0],
            *rest[2:],
        )

    q = quality([told(k) for k in range(6)], truth, (0, 1), 20.0)
    assert (q.switches, q.breaks, q.false_tracks) == (2, 2, 1)
    assert q.held == {"a": 1.0, "b": 1.0}


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Detector(0.0, 1.0), "probability"),
        (lambda: Detector(0.5, 0.0), "density"),
        (lambda: m_of_n(4, 3), "m of n"),
        (lambda: by_existence(0.1, 0.5), "drop < confirm"),
        (lambda: two_point(0.0, 1.0), "max_speed"),
        (lambda: hypotheses(10.0, courses=1), "bank"),
        (lambda: cycle(gate=1.0), "gate"),
        (lambda: Modes([]), "at least one"),
        (lambda: Modes([("EKF", model())], sojourn=[0.0]), "sojourn"),
        (lambda: Tracker(cycle(), window=-1.0), "window"),
        (lambda: Cycle(cycle().modes, {"radar": Detector(0.5, 1.0)}, single_plot(1.0)), "unknown sensor"),
        (lambda: Cycle(cycle().modes, {"": Detector(0.5, 1.0)}, single_plot(1.0)), "none tells where its plots are"),
        (lambda: Tracker(cycle()).step(Scan(0.0, "", [[1.0, 2.0, 3.0]])), "shape"),
        (lambda: Tracker(cycle()).step(Scan(np.nan, "", [[1.0, 2.0]])), "time"),
    ],
)
def test_what_does_not_fit_is_refused_in_words(make, words):
    with pytest.raises(InputError, match=words):
        make()

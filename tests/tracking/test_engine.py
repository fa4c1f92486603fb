"""Rows of many tracks: both engines agree, with the one-track filter too; modes and mixtures are exact."""

import numpy as np
import pytest

import sigmax
from sigmax.engine.rows import RowSteps
from sigmax.tracking import Modes, Scan, gnn, pda
from sigmax.tracking.mixture import firsts, merged
from tests.tracking.worlds import NOISE, cycle, model, modes, radar_model, world

RNG = np.random.default_rng(3)


def gaussians(count, n):
    A = RNG.normal(size=(count, n, n))
    return RNG.normal(size=(count, n)) * 100, A @ A.swapaxes(1, 2) + np.eye(n)


@pytest.mark.parametrize("filter", ["SRECKFB", "CIF"])
def test_rows_are_the_same_on_both_engines(filter):
    mean, cov = gaussians(11, 4)
    z = np.stack([np.hypot(*mean.T[:2]), np.arctan2(mean[:, 1], mean[:, 0]), RNG.normal(size=11)], axis=1)
    z[2, 1], z[5] = np.nan, np.nan
    made = []
    for backend in ("native", "xla"):
        steps = RowSteps(filter, radar_model(), backend=backend)
        rows, fault = steps.predict(steps.start(mean, cov), np.linspace(0, 2, 11))
        assert not fault.any()
        after, told, fault = steps.correct(rows, "", z)
        assert not fault.any()
        np.testing.assert_array_equal(after[5], rows[5])
        made.append((steps.mean(after), steps.cov(after), told.nis, told.dof))
    for one, other in zip(*made, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8)


def test_a_row_does_not_depend_on_the_others():
    steps = RowSteps("SRECKFB", radar_model())
    mean, cov = gaussians(13, 4)
    z = np.stack([np.hypot(*mean.T[:2]) + 1, np.arctan2(mean[:, 1], mean[:, 0]), mean[:, 2]], axis=1)
    whole = steps.correct(steps.start(mean, cov), "", z)[0]
    for i in (0, 7, 12):
        alone = steps.correct(steps.start(mean[i : i + 1], cov[i : i + 1]), "", z[i : i + 1])[0]
        np.testing.assert_allclose(alone[0], whole[i], rtol=1e-12, atol=1e-12)


def test_one_bad_track_leaves_the_others_alone():
    c = cycle()
    beliefs = c.modes.start(*gaussians(3, 4))
    beliefs.rows[0][1] = np.nan
    moved, sound = c.modes.predict(beliefs, 1.0)
    assert sound.tolist() == [True, False, True]
    assert np.isfinite(moved.rows[0][[0, 2]]).all()


def test_one_target_without_clutter_is_the_plain_filter():
    scans, _ = world(targets=1, clutter=0, detection=1.0, scans=20, seed=5)
    c = cycle(clutter=1e-6, detection=0.999, associate=gnn)
    state = c.begin()
    told = []
    for scan in scans:
        state, one = c.advance(state, scan)
        told.append(one)
    began = told[1]
    prior = sigmax.Gaussian(began.mean[0], began.cov[0])
    z = np.array([s.z[0] for s in scans[2:]])
    run = sigmax.run("EKF", model(), prior, z, dt=2.0)
    np.testing.assert_allclose([t.mean[0] for t in told[2:]], run.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose([t.cov[0] for t in told[2:]], run.cov, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose([t.nis[0] for t in told[2:]], run.nis, rtol=1e-7)


def test_pda_is_the_mixture_of_its_hypotheses():
    c = cycle(clutter=50.0, detection=0.8, associate=pda)
    mean, cov = np.array([[0.0, 0, 5, 5]]), np.diag([100.0, 100, 4, 4])[None]
    state = c.begin()
    beliefs = c.modes.start(mean, cov)
    z = np.array([[4.0, 3.0], [-12.0, 8.0]])
    from sigmax.tracking.associate import Evidence
    from sigmax.tracking.gate import gated

    pairs = gated(c.modes, beliefs, Scan(0.0, "", z), c.gate)
    density = c.detectors[""].clutter
    ratio = pairs.log_likelihood(beliefs.weight) + np.log(0.8 / density)
    found = pda(Evidence(pairs.track, pairs.plot, ratio, np.log([1 - 0.8 * c.gate]), np.array([1 - 1e-12]), 2))
    after = c.modes.moments(c.modes.update(beliefs, pairs.made, pairs.track, found.share))
    # The textbook, by hand (Bar-Shalom and Tse 1975).
    H = np.eye(2, 4)
    S = H @ cov[0] @ H.T + NOISE**2 * np.eye(2)
    like = [np.exp(-0.5 * v @ np.linalg.solve(S, v)) / (2 * np.pi * np.sqrt(np.linalg.det(S))) for v in z]
    weight = np.array([1 - 0.8 * c.gate, *(0.8 * g / density for g in like)])
    weight /= weight.sum()
    K = cov[0] @ H.T @ np.linalg.inv(S)
    means = np.array([mean[0], *(mean[0] + K @ v for v in z)])
    covs = np.array([cov[0], *([cov[0] - K @ S @ K.T] * 2)])
    center = weight @ means
    P = sum(w * (C + np.outer(m - center, m - center)) for w, m, C in zip(weight, means, covs, strict=True))
    np.testing.assert_allclose(after[0][0], center, atol=1e-9)
    np.testing.assert_allclose(after[1][0], P, atol=1e-8)
    assert state.next_id == 0


def test_equal_modes_are_one_filter():
    scans, _ = world(targets=2, scans=12, clutter=2.0, seed=8)
    double = Modes([("EKF", model()), ("SREKF", model())], sojourn=[10.0, 30.0])
    one, two = (run(cycle(modes=m), scans)[-1] for m in (modes(), double))
    np.testing.assert_array_equal(one.id, two.id)
    np.testing.assert_allclose(one.mean, two.mean, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(one.cov, two.cov, rtol=1e-6, atol=1e-6)


def test_modes_find_out_which_holds():
    """A target that manoeuvres is given to the noisier mode, one that does not to the quiet one."""
    both = Modes([("EKF", model(0.01)), ("EKF", model(30.0))], sojourn=[30.0, 30.0])
    rng = np.random.default_rng(0)
    t = 2.0 * np.arange(60)
    x = np.stack([20 * t, np.where(t > 60, 400 * np.sin((t - 60) / 12), 0)], axis=1)
    scans = [Scan(float(a), "", (p + NOISE * rng.standard_normal(2))[None]) for a, p in zip(t, x, strict=True)]
    told = run(cycle(clutter=1e-6, modes=both, initiate=fast()), scans)
    noisy = np.array([one.mode[0, 1] for one in told[5:]])
    assert noisy[:24].mean() < 0.3
    assert noisy[34:].mean() > max(0.5, 2 * noisy[:24].mean())


def fast():
    from sigmax.tracking import two_point

    return two_point(60.0, 7.0)


def run(c, scans):
    state, told = c.begin(), []
    for scan in scans:
        state, one = c.advance(state, scan)
        told.append(one)
    return told


def test_moments_of_mixtures_turn_with_angles():
    mean, cov = np.array([[3.1, 1.0], [-3.1, 2.0]]), np.tile(np.eye(2) * 0.01, (2, 1, 1))
    args = np.array([0.5, 0.5]), np.zeros(2, int), 1, (True, False)
    m, P = merged(mean, cov, *args)
    turned, same = merged(mean + np.array([0.7, 0.0]), cov, *args)
    assert abs(abs(m[0, 0]) - np.pi) < 1e-9
    np.testing.assert_allclose(P, same, atol=1e-12)
    np.testing.assert_allclose((turned[0, 0] - m[0, 0]) % (2 * np.pi), 0.7, atol=1e-12)
    assert P[0, 0, 0] < 0.02


def test_repeated_rows_are_found():
    rows = np.array([[1.0, np.nan], [2, 3], [1, np.nan], [2, 3], [2, 4]])
    assert firsts(rows).tolist() == [True, True, False, False, True]
    assert firsts(np.empty((0, 2))).tolist() == []

"""Components for Stone Soup: the numbers of its own filters, its associators on ours, its models in ours."""

import copy
import pickle
from datetime import datetime, timedelta

import numpy as np
import pytest

pytest.importorskip("stonesoup")

from stonesoup.dataassociator.probability import JPDA
from stonesoup.functions import gm_reduce_single
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import (
    Cartesian2DToBearing,
    CartesianToBearingRange,
    CartesianToElevationBearingRange,
    CartesianToElevationBearingRangeRate,
)
from stonesoup.models.transition.linear import (
    CombinedLinearGaussianTransitionModel,
    ConstantAcceleration,
    ConstantVelocity,
    LinearGaussianTimeInvariantTransitionModel,
    RandomWalk,
    Singer,
)
from stonesoup.models.transition.nonlinear import ConstantTurn
from stonesoup.predictor.kalman import ExtendedKalmanPredictor, KalmanPredictor, UnscentedKalmanPredictor
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.types.update import GaussianStateUpdate
from stonesoup.updater.kalman import ExtendedKalmanUpdater, KalmanUpdater, UnscentedKalmanUpdater

import sigmax
from sigmax.errors import InputError
from sigmax.stonesoup import SigmaxPredictor, SigmaxUpdater, model_of, motion_of, sensor_of

START = datetime(2026, 1, 1)
CV = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.5), ConstantVelocity(0.2)])
FLAT = CartesianToBearingRange(4, (0, 2), np.diag([0.01**2, 5.0**2]), translation_offset=StateVector([[10.0], [-5.0]]))


@pytest.mark.parametrize(
    "model",
    [
        CV,
        CombinedLinearGaussianTransitionModel([ConstantAcceleration(0.3), RandomWalk(0.2), ConstantVelocity(2.0)]),
        LinearGaussianTimeInvariantTransitionModel(np.array([[1.0, 0.5], [0, 1]]), np.diag([0.1, 0.2])),
        CombinedLinearGaussianTransitionModel(
            [ConstantVelocity(0.3), LinearGaussianTimeInvariantTransitionModel(np.eye(1) * 0.9, np.eye(1))]
        ),
        ConstantTurn(np.array([0.3, 0.4]), 0.01),
    ],
    ids=lambda m: type(m).__name__,
)
def test_motions_are_theirs(model):
    x = np.linspace(1.0, 0.2, model.ndim_state)
    moved, step = motion_of(model), timedelta(seconds=2.5)
    theirs = model.function(GaussianState(x, np.eye(len(x))), noise=False, time_interval=step)
    np.testing.assert_allclose(moved.function(x, 2.5), np.ravel(theirs).astype(float), rtol=1e-12)
    np.testing.assert_allclose(moved.Q(2.5), model.covar(time_interval=step), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    "model",
    [
        LinearGaussian(6, (4, 0), np.eye(2)),
        CartesianToBearingRange(
            6,
            (0, 2),
            np.eye(2),
            translation_offset=StateVector([[3.0], [1]]),
            rotation_offset=StateVector([[0], [0], [0.4]]),
        ),
        Cartesian2DToBearing(6, (0, 2), np.eye(1)),
        CartesianToElevationBearingRange(6, (0, 2, 4), np.eye(3), rotation_offset=StateVector([[0.1], [0.2], [0.4]])),
        CartesianToElevationBearingRangeRate(
            6,
            (0, 2, 4),
            np.eye(4),
            velocity_mapping=(1, 3, 5),
            velocity=StateVector([[1.0], [2], [3]]),
            translation_offset=StateVector([[3.0], [1], [2]]),
        ),
    ],
    ids=lambda m: type(m).__name__,
)
def test_sensors_are_theirs(model):
    x = np.array([-30.0, 4, -20, 3, 9, -1])
    seen = sensor_of(model)
    ours = seen.function(x) if seen.u is None else seen.function(x, seen.u)
    theirs = model.function(GaussianState(x, np.eye(6)), noise=False)
    np.testing.assert_allclose(ours, np.ravel(theirs).astype(float), rtol=1e-12)
    assert seen.angles == tuple(type(v) if "mod_angle" in dir(v) else None for v in np.ravel(theirs))


def test_an_unknown_model_says_how_to_add_it():
    with pytest.raises(InputError, match=r"motion_of\.register"):
        motion_of(Singer(1.0, 0.5))


def test_what_does_not_fit_a_model_is_told():
    later, place = START + timedelta(seconds=1), LinearGaussian(4, (0, 2), np.eye(2))
    state = GaussianState(np.zeros((3, 1)), np.eye(3), timestamp=START)
    with pytest.raises(InputError, match="the state has 3 components, the model 4"):
        SigmaxPredictor(CV).predict(state, timestamp=later)
    known = GaussianState(np.zeros((4, 1)), np.eye(4), timestamp=START)
    short = Detection([[1.0]], timestamp=START, measurement_model=place)
    with pytest.raises(InputError, match="the detection has 1 components, the measurement model 2"):
        SigmaxUpdater(place).update(SingleHypothesis(known, short))
    with pytest.raises(InputError, match="negative variance"):
        SigmaxPredictor(CV).predict(GaussianState(np.zeros((4, 1)), -np.eye(4), timestamp=START), timestamp=later)
    with pytest.raises(InputError, match="state names 1"):
        model_of(CV, place, state=["a"])
    with pytest.raises(InputError, match="a measurement model 5"):
        model_of(CV, LinearGaussian(5, (0, 2), np.eye(2)))


@pytest.mark.parametrize("name", ["EKF", "SRECKFB"])
def test_components_and_states_are_pickled(name):
    predictor = SigmaxPredictor(CV, filter=name)
    state = GaussianState(np.ones((4, 1)), np.eye(4), timestamp=START)
    made = [predictor.predict(state, timestamp=START + timedelta(seconds=k)) for k in (1, 2)]
    kept, other = pickle.loads(pickle.dumps((made[0], predictor)))
    again = other.predict(kept, timestamp=START + timedelta(seconds=2))
    np.testing.assert_allclose(again.covar[0, 0], predictor.predict(made[0], timestamp=again.timestamp).covar[0, 0])
    np.testing.assert_allclose(np.ravel(again.state_vector), np.ravel(made[1].state_vector), rtol=1e-12)


def unscented(n=4):
    return sigmax.get("UKF", alpha=0.5, beta=2, kappa=3 - n)


TURN = ConstantTurn(np.array([0.3, 0.3]), 1e-4)
PLACE = LinearGaussian(5, (0, 2), np.diag([25.0, 25.0]))
# Their EKF differentiates by finite differences, ours exactly; their UKF takes the mean of bearings on the circle, ours
# that of their differences. Where neither comes in, all digits are the same.
PAIRS = {
    "EKF, bearing": ("EKF", ExtendedKalmanPredictor, ExtendedKalmanUpdater, CV, FLAT, 1e-3),
    "UKF, bearing": (unscented(4), UnscentedKalmanPredictor, UnscentedKalmanUpdater, CV, FLAT, 1e-2),
    "EKF, turn": ("EKF", ExtendedKalmanPredictor, ExtendedKalmanUpdater, TURN, PLACE, 1e-3),
    "UKF, turn": (unscented(5), UnscentedKalmanPredictor, UnscentedKalmanUpdater, TURN, PLACE, 1e-8),
}


@pytest.mark.parametrize("name", PAIRS)
def test_the_numbers_are_those_of_their_own_filter(name):
    ours, predictor, updater, motion, sensor, digits = PAIRS[name]
    mine = SigmaxPredictor(motion, filter=ours), SigmaxUpdater(sensor, filter=ours)
    theirs = predictor(motion), updater(sensor)
    rng = np.random.default_rng(1)
    n = motion.ndim_state
    states = [GaussianState([-100.0, 6, 60, -5, 0.01][:n], np.diag([100.0, 9, 100, 9, 1e-4][:n]), timestamp=START)] * 2
    truth = GaussianState([-95.0, 5, 55, -4, 0.02][:n], np.eye(n))
    step = timedelta(seconds=2)
    for k in range(1, 25):
        # The bearing passes ±π on the way.
        truth = GaussianState(motion.function(truth, noise=False, time_interval=step), np.eye(n))
        seen = sensor.function(truth, noise=False)
        z = Detection(
            seen + (rng.normal(size=2) * np.sqrt(np.diag(sensor.covar())))[:, None], timestamp=START + k * step
        )
        made = []
        for state, (p, u) in zip(states, (mine, theirs), strict=True):
            prediction = p.predict(state, timestamp=z.timestamp)
            expected = u.predict_measurement(prediction)
            made.append((prediction, expected, u.update(SingleHypothesis(prediction, z))))
        for a, b in zip(*made, strict=True):
            scale = np.sqrt(np.diagonal(b.covar))
            apart = np.ravel(a.state_vector - b.state_vector).astype(float)
            np.testing.assert_allclose(apart / scale, 0, atol=digits)
            np.testing.assert_allclose(a.covar / np.outer(scale, scale), b.covar / np.outer(scale, scale), atol=digits)
        (_, one, _), (before, two, _) = made
        assert type(one.state_vector[0, 0]) is type(two.state_vector[0, 0])
        scale = np.outer(np.sqrt(np.diagonal(before.covar)), np.sqrt(np.diagonal(two.covar)))
        np.testing.assert_allclose(one.cross_covar / scale, two.cross_covar / scale, atol=digits)
        states = [m[2] for m in made]


def jpda(predictor, updater, scans):
    """Stone Soup's tutorial of joint probabilistic data association, with these components."""
    associator = JPDA(PDAHypothesiser(predictor, updater, clutter_spatial_density=1e-4, prob_detect=0.9))
    tracks = [
        Track([GaussianState(x, np.diag([1.5, 0.5, 1.5, 0.5]), timestamp=START)])
        for x in ([0.0, 1, 0, 1], [0.0, 1, 20, -1])
    ]
    for time, detections in scans:
        hypotheses = associator.associate(set(tracks), detections, time)
        for track in tracks:
            several = hypotheses[track]
            posteriors, weights = [], []
            for hypothesis in several:
                posteriors.append(updater.update(hypothesis) if hypothesis else hypothesis.prediction)
                weights.append(hypothesis.probability)
            means = StateVectors([p.state_vector for p in posteriors])
            covs = np.stack([p.covar for p in posteriors], axis=2)
            mean, cov = gm_reduce_single(means, covs, np.asarray(weights))
            track.append(GaussianStateUpdate(mean, cov, several, time))
    return tracks


def crossing(model, seed=7):
    rng = np.random.default_rng(seed)
    scans = []
    for k in range(1, 21):
        time = START + timedelta(seconds=k)
        plots = [p for p in ([k, k], [k, 20 - k]) if rng.random() < 0.9]
        found = {Detection(p + rng.normal(size=2) * 0.8, timestamp=time, measurement_model=model) for p in plots}
        clutter = rng.uniform([k - 10, -5], [k + 10, 25], (rng.poisson(4), 2))
        found |= {Detection(c, timestamp=time, measurement_model=model) for c in clutter}
        scans.append((time, found))
    return scans


def test_their_jpda_runs_on_our_components_with_the_same_tracks():
    transition = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.005), ConstantVelocity(0.005)])
    model = LinearGaussian(4, (0, 2), np.diag([0.75, 0.75]))
    scans = crossing(model)
    theirs = jpda(KalmanPredictor(transition), KalmanUpdater(model), scans)
    ours = jpda(SigmaxPredictor(transition, filter="KF"), SigmaxUpdater(model, filter="KF"), scans)
    for a, b in zip(ours, theirs, strict=True):
        for one, two in zip(a, b, strict=True):
            np.testing.assert_allclose(one.state_vector, two.state_vector, rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(one.covar, two.covar, rtol=1e-8, atol=1e-10)
    ends = sorted(float(t.state_vector[2, 0]) for t in ours)
    assert ends == pytest.approx([0, 20], abs=2)


def test_a_sensor_that_moves_is_compiled_once():
    from sigmax.stonesoup.components import _compiled

    updater = SigmaxUpdater(filter="EKF")
    state = GaussianState([-100.0, 6, 60, -5], np.diag([100.0, 9, 100, 9]), timestamp=START)
    before = _compiled.cache_info().currsize
    for k in range(5):
        moved = copy.copy(FLAT)
        moved.translation_offset = StateVector([[10.0 * k], [3.0 * k]])
        expected = updater.predict_measurement(state, moved).state_vector
        theirs = moved.function(state, noise=False)
        np.testing.assert_allclose(np.ravel(expected - theirs).astype(float), 0, atol=1e-9)
    assert _compiled.cache_info().currsize <= before + 1


def test_their_models_run_in_ours():
    model = model_of(CV, LinearGaussian(4, (0, 2), np.diag([4.0, 4.0])))
    rng = np.random.default_rng(2)
    z = np.cumsum(rng.normal(size=(12, 2)), axis=0)
    prior = sigmax.Gaussian(np.zeros(4), np.diag([10.0, 4, 10, 4]))
    result = sigmax.run("KF", model, prior, z, dt=1.0)
    predictor, updater = KalmanPredictor(CV), KalmanUpdater(LinearGaussian(4, (0, 2), np.diag([4.0, 4.0])))
    state = GaussianState(np.zeros(4), np.diag([10.0, 4, 10, 4]), timestamp=START)
    for k, seen in enumerate(z, 1):
        detection = Detection(seen, timestamp=START + timedelta(seconds=k))
        state = updater.update(SingleHypothesis(predictor.predict(state, timestamp=detection.timestamp), detection))
    np.testing.assert_allclose(np.asarray(result.mean)[-1], np.ravel(state.state_vector), rtol=1e-9)

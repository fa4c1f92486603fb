"""What goes into the components for Stone Soup: models changed in place, and states that are none."""

from datetime import datetime, timedelta

import numpy as np
import pytest

pytest.importorskip("stonesoup")

from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import (
    EnsembleState,
    GaussianState,
    InformationState,
    ParticleState,
    SqrtGaussianState,
    State,
    TaggedWeightedGaussianState,
    WeightedGaussianState,
)
from stonesoup.updater.kalman import ExtendedKalmanUpdater

from sigmax.errors import InputError
from sigmax.stonesoup import SigmaxPredictor, SigmaxUpdater

START = datetime(2026, 1, 1)


def changed_noise(model):
    model.noise_covar = np.diag([0.02**2, 9.0])


def changed_entry(model):
    model.noise_covar[1, 1] = 9.0


def changed_place(model):
    model.translation_offset = StateVector([[20.0], [10.0]])


def changed_angle(model):
    model.rotation_offset[2, 0] = 0.3


@pytest.mark.parametrize("change", [changed_noise, changed_entry, changed_place, changed_angle])
def test_a_measurement_model_changed_in_place_counts_as_it_is(change):
    """With the same state, of which what was expected before is kept."""
    model = CartesianToBearingRange(
        4,
        (0, 2),
        np.diag([0.01**2, 5.0**2]),
        translation_offset=StateVector([[10.0], [-5.0]]),
        rotation_offset=StateVector([[0.0], [0.0], [0.1]]),
    )
    updater, state = SigmaxUpdater(model), GaussianState([50.0, 1, 40, 1], np.eye(4), timestamp=START)
    for step in (lambda m: None, change):
        step(model)
        one, two = updater.predict_measurement(state), ExtendedKalmanUpdater(model).predict_measurement(state)
        np.testing.assert_allclose(np.ravel(one.state_vector - two.state_vector).astype(float), 0, atol=1e-9)
        np.testing.assert_allclose(one.covar, two.covar, rtol=1e-4, atol=1e-8)
        detection = Detection(np.ravel(one.state_vector) + 0.01, timestamp=START)
        one, two = (u.update(SingleHypothesis(state, detection)) for u in (updater, ExtendedKalmanUpdater(model)))
        np.testing.assert_allclose(one.state_vector, two.state_vector, rtol=1e-5)


def test_a_transition_model_changed_in_place_counts_as_it_is():
    transition = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.5), ConstantVelocity(0.2)])
    predictor, time = SigmaxPredictor(transition), START + timedelta(seconds=2)
    state = GaussianState(np.arange(4.0), np.eye(4), timestamp=START)
    compiled = []
    for density in (0.2, 30.0, 30.0):
        transition.model_list[1].noise_diff_coeff = density
        theirs = KalmanPredictor(transition).predict(state, timestamp=time)
        np.testing.assert_allclose(predictor.predict(state, timestamp=time).covar, theirs.covar, rtol=1e-9)
        compiled.append(predictor.steps)
    assert compiled[0] is not compiled[1]
    assert compiled[1] is compiled[2]


class Listed(LinearGaussian):
    """A model of the user's that keeps something that cannot be a key."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.aside = {"names": ["a", "b"]}


def test_what_cannot_be_compared_counts_as_long_as_it_is_the_same():
    updater = SigmaxUpdater(Listed(4, (0, 2), np.eye(2)))
    state = GaussianState(np.arange(4.0), np.eye(4), timestamp=START)
    np.testing.assert_allclose(updater.predict_measurement(state).covar, 2 * np.eye(2))


INDEFINITE = np.array([[1.0, 2.0], [2.0, 1.0]])
LOPSIDED = np.array([[1.0, 0.5], [0.2, 1.0]])


@pytest.mark.parametrize("filter", ["EKF", "SRCKFB"])
@pytest.mark.parametrize(("cov", "says"), [(INDEFINITE, "eigenvalue -1"), (LOPSIDED, "must be symmetric")])
def test_a_state_whose_covariance_is_none_is_refused(filter, cov, says):
    predictor = SigmaxPredictor(ConstantVelocity(0.1), filter=filter)
    updater = SigmaxUpdater(LinearGaussian(2, (0,), np.eye(1)), filter=filter)
    state = GaussianState([0.0, 1.0], cov, timestamp=START)
    with pytest.raises(InputError, match=says):
        predictor.predict(state, timestamp=START + timedelta(seconds=1))
    with pytest.raises(InputError, match=says):
        updater.predict_measurement(state)


@pytest.mark.parametrize("filter", ["EKF", "SRCKFB"])
@pytest.mark.parametrize("cov", [np.zeros((2, 2)), np.ones((2, 2)), np.ones((2, 2)) + 1e-12 * np.eye(2)[::-1]])
def test_a_singular_covariance_is_one_and_so_is_one_with_rounding(filter, cov):
    state = GaussianState([0.0, 1.0], cov, timestamp=START)
    found = SigmaxPredictor(ConstantVelocity(0.1), filter=filter).predict(state, timestamp=START + timedelta(seconds=1))
    F, Q = np.array([[1.0, 1], [0, 1]]), 0.1 * np.array([[1 / 3, 1 / 2], [1 / 2, 1]])
    np.testing.assert_allclose(found.covar, F @ cov @ F.T + Q, rtol=1e-9)


P = np.array([[4.0, 0.5], [0.5, 0.2]])
GAUSSIAN = {
    "covariance": lambda: GaussianState([[1.0], [2.0]], P, timestamp=START),
    "root": lambda: SqrtGaussianState([[1.0], [2.0]], np.linalg.cholesky(P), timestamp=START),
    "another root": lambda: SqrtGaussianState([[1.0], [2.0]], ROOT, timestamp=START),
    "weight": lambda: WeightedGaussianState([[1.0], [2.0]], P, timestamp=START, weight=0.3),
    "weight and tag": lambda: TaggedWeightedGaussianState([[1.0], [2.0]], P, timestamp=START, weight=0.3, tag="a"),
}
ROOT = np.linalg.cholesky(P) @ np.array([[0.6, -0.8], [0.8, 0.6]])
LINE, SEEN = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.1)]), LinearGaussian(2, (0,), np.eye(1))
LATER = START + timedelta(seconds=1)


@pytest.mark.parametrize("filter", ["EKF", "SRCKFB"])
@pytest.mark.parametrize("kind", GAUSSIAN)
def test_every_kind_of_gaussian_state_stays_what_it_is(kind, filter):
    """Beside Stone Soup's own filter; what a state stores, its covariance or a root of it, it goes on to store."""
    plain, state = GAUSSIAN["covariance"](), GAUSSIAN[kind]()
    predictor, updater = SigmaxPredictor(LINE, filter=filter), SigmaxUpdater(SEEN, filter=filter)
    own, other = KalmanPredictor(LINE).predict(plain, LATER), predictor.predict(state, LATER)
    detection = Detection(StateVector([1.5]), timestamp=LATER)
    after = [
        u.update(SingleHypothesis(p, detection)) for u, p in ((ExtendedKalmanUpdater(SEEN), own), (updater, other))
    ]
    for want, got in ((own, other), after):
        assert isinstance(got, type(state))
        np.testing.assert_allclose(got.state_vector, want.state_vector, rtol=1e-9)
        np.testing.assert_allclose(got.covar, want.covar, rtol=1e-9)
        assert getattr(got, "weight", None) == getattr(state, "weight", None)
    expected = updater.predict_measurement(other)
    np.testing.assert_allclose(expected.covar, ExtendedKalmanUpdater(SEEN).predict_measurement(own).covar, rtol=1e-9)


NOT_GAUSSIAN = {
    "information": lambda: InformationState([[1.0], [2.0]], np.linalg.inv(P), timestamp=START),
    "particles": lambda: ParticleState(StateVectors([[1.0, 2], [1, 2]]), weight=np.full(2, 0.5), timestamp=START),
    "an ensemble": lambda: EnsembleState(StateVectors([[1.0, 2], [1, 2]]), timestamp=START),
    "a state without covariance": lambda: State([[1.0], [2.0]], timestamp=START),
}


@pytest.mark.parametrize("kind", NOT_GAUSSIAN)
def test_a_state_that_is_not_gaussian_is_refused_with_the_way_to_make_one(kind):
    with pytest.raises(InputError, match=r"must be Gaussian.*GaussianState\("):
        SigmaxPredictor(LINE).predict(NOT_GAUSSIAN[kind](), LATER)


@pytest.mark.parametrize("missing", [np.nan, None])
def test_a_detection_of_nothing_leaves_the_prediction(missing):
    """A mask never arrives: Stone Soup's own vectors drop it."""
    prediction = SigmaxPredictor(LINE).predict(GAUSSIAN["covariance"](), LATER)
    detection = Detection([[missing]], timestamp=LATER)
    after = SigmaxUpdater(SEEN).update(SingleHypothesis(prediction, detection))
    np.testing.assert_array_equal(after.state_vector, prediction.state_vector)
    np.testing.assert_array_equal(after.covar, prediction.covar)

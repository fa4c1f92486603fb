"""What goes into the components for Stone Soup: models changed in place, and states that are none."""

from datetime import datetime, timedelta

import numpy as np
import pytest

pytest.importorskip("stonesoup")

from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.array import StateVector
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
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

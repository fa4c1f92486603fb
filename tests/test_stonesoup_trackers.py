"""Stone Soup's simulators, initiators, associators, trackers, metrics and plotters on our components, step by step."""

from datetime import datetime, timedelta

import numpy as np
import pytest

pytest.importorskip("stonesoup")

from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.deleter.error import CovarianceBasedDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.metricgenerator.ospametric import OSPAMetric
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import ExtendedKalmanPredictor, KalmanPredictor
from stonesoup.simulator.simple import MultiTargetGroundTruthSimulator, SimpleDetectionSimulator
from stonesoup.tracker.simple import MultiTargetTracker
from stonesoup.types.array import StateVector
from stonesoup.types.detection import Detection
from stonesoup.types.groundtruth import GroundTruthPath, GroundTruthState
from stonesoup.types.mixture import GaussianMixture
from stonesoup.types.numeric import Probability
from stonesoup.types.state import GaussianState, TaggedWeightedGaussianState
from stonesoup.types.track import Track
from stonesoup.types.update import GaussianMixtureUpdate
from stonesoup.updater.kalman import ExtendedKalmanUpdater, KalmanUpdater

from sigmax.stonesoup import SigmaxPredictor, SigmaxUpdater

START = datetime(2026, 1, 1)
MOTION = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.05), ConstantVelocity(0.05)])
SENSOR = CartesianToBearingRange(
    4, (0, 2), np.diag([0.002**2, 2.0]), translation_offset=StateVector([[-500.0], [-500.0]])
)
PRIOR = GaussianState([0.0, 0, 0, 0], np.diag([1e4, 9.0, 1e4, 9.0]))


@pytest.fixture(scope="module")
def scene():
    """Their simulators: targets that come and go, plots of a radar with clutter."""
    truth = MultiTargetGroundTruthSimulator(
        transition_model=MOTION,
        initial_state=GaussianState([0.0, 0, 0, 0], np.diag([1e4, 4, 1e4, 4]), timestamp=START),
        timestep=timedelta(seconds=1),
        number_steps=25,
        birth_rate=0.2,
        death_probability=0.01,
        seed=3,
    )
    plots = SimpleDetectionSimulator(
        groundtruth=truth,
        measurement_model=SENSOR,
        meas_range=np.array([[-200.0, 200], [-200, 200]]),
        detection_probability=0.95,
        clutter_rate=1.0,
        seed=4,
    )
    paths, scans = set(), []
    for time, found in plots:
        scans.append((time, set(found)))
        paths |= set(truth.current[1])
    return paths, scans


def tracks_of(scans, predictor, updater):
    """Their tracker of several targets: a deleter, an initiator and global nearest neighbours."""
    associator = GNNWith2DAssignment(DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4))
    deleter = CovarianceBasedDeleter(covar_trace_thresh=2000.0)
    initiator = MultiMeasurementInitiator(
        PRIOR,
        deleter=deleter,
        data_associator=associator,
        updater=updater,
        measurement_model=SENSOR,
        min_points=3,
    )
    tracker = MultiTargetTracker(
        initiator=initiator, deleter=deleter, detector=scans, data_associator=associator, updater=updater
    )
    tracks = set()
    for _, now in tracker:
        tracks |= now
    return sorted(tracks, key=lambda t: (t[0].timestamp, len(t), float(t[0].state_vector[0])))


def ospa(tracks, paths):
    both = tracks, list(paths)
    states = [[(s, str(k)) for k, way in enumerate(some) for s in way.states] for some in both]
    flat = [list(column) for pairs in states for column in zip(*pairs, strict=True)]
    return np.array([one.value for one in OSPAMetric(c=30, p=1).compute_over_time(*flat).value])


def test_a_whole_tracker_gives_the_same_tracks(scene):
    paths, scans = scene
    ours = tracks_of(scans, SigmaxPredictor(MOTION), SigmaxUpdater(SENSOR))
    theirs = tracks_of(scans, ExtendedKalmanPredictor(MOTION), ExtendedKalmanUpdater(SENSOR))
    assert len(ours) >= 3
    assert [len(t) for t in ours] == [len(t) for t in theirs]
    for a, b in zip(ours, theirs, strict=True):
        for one, two in zip(a, b, strict=True):
            gap = np.ravel(one.state_vector - two.state_vector).astype(float)
            assert np.abs(gap / np.sqrt(np.diagonal(two.covar))).max() < 5e-3
    mine, other = ospa(ours, paths), ospa(theirs, paths)
    np.testing.assert_allclose(mine, other, atol=0.05)
    # At the end most targets have a track, some metres away.
    assert mine[-5:].max() < 20


def test_their_plotter_draws_our_tracks(scene):
    pytest.importorskip("plotly")
    from stonesoup.plotter import Plotterly

    paths, scans = scene
    tracks = tracks_of(scans, SigmaxPredictor(MOTION), SigmaxUpdater(SENSOR))
    plotter = Plotterly()
    plotter.plot_ground_truths(paths, [0, 2])
    plotter.plot_tracks(set(tracks), [0, 2], uncertainty=True)
    drawn = [np.asarray(trace.x, float) for trace in plotter.fig.data if trace.x is not None]
    for track in tracks:
        way = np.array([float(s.state_vector[0]) for s in track])
        assert any(len(x) == len(way) and np.allclose(x, way) for x in drawn)


def test_hypotheses_over_several_scans_are_the_same(scene):
    """Their multi-frame assignment, two targets that cross among clutter."""
    pytest.importorskip("ortools", reason="multi-frame assignment of Stone Soup needs ortools")
    from stonesoup.dataassociator.mfa import MFADataAssociator
    from stonesoup.hypothesiser.mfa import MFAHypothesiser

    rng = np.random.default_rng(7)
    sensor = LinearGaussian(4, (0, 2), np.diag([0.75, 0.75]))
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.005), ConstantVelocity(0.005)])
    scans = []
    for k in range(1, 9):
        places = [*(np.array([[k, k], [k, 20 - k]]) + 0.8 * rng.normal(size=(2, 2)))]
        places += list(rng.uniform([k - 10, -5], [k + 10, 25], (2, 2)))
        time = START + timedelta(seconds=k)
        scans.append((time, {Detection(p, timestamp=time, measurement_model=sensor) for p in places}))

    def ends(predictor, updater):
        hypothesiser = MFAHypothesiser(PDAHypothesiser(predictor, updater, 1e-4, 0.9, prob_gate=0.99))
        associator = MFADataAssociator(hypothesiser, slide_window=3)

        def component(mean, cov, time, weight, tag):
            return TaggedWeightedGaussianState(mean, cov, timestamp=time, weight=weight, tag=tag)

        tracks = [
            Track([GaussianMixture([component(x, np.diag([1.5, 0.5, 1.5, 0.5]), START, Probability(1), [])])])
            for x in ([0.0, 1, 0, 1], [0.0, 1, 20, -1])
        ]
        for time, found in scans:
            for track, several in associator.associate(tracks, found, time).items():
                made = []
                for h in several:
                    state = updater.update(h) if h else h.prediction
                    made.append(component(state.state_vector, state.covar, time, h.prediction.weight, h.prediction.tag))
                track.append(GaussianMixtureUpdate(hypothesis=several, components=made))
        return [(len(t[-1].components), np.ravel(t[-1].state_vector).astype(float)) for t in tracks]

    ours = ends(SigmaxPredictor(motion, filter="KF"), SigmaxUpdater(sensor, filter="KF"))
    for (count, x), (other, y) in zip(ours, ends(KalmanPredictor(motion), KalmanUpdater(sensor)), strict=True):
        assert count == other
        assert count > 1
        np.testing.assert_allclose(x, y, rtol=1e-9)


def test_a_truth_is_followed_from_their_own_path():
    """A path made by hand, as in the first tutorials: predict, update, append."""
    truth = GroundTruthPath([GroundTruthState([0, 1, 0, 1], timestamp=START)])
    rng = np.random.default_rng(0)
    sensor = LinearGaussian(4, (0, 2), np.diag([5.0, 5.0]))
    predictor, updater = SigmaxPredictor(MOTION, filter="KF"), SigmaxUpdater(sensor, filter="KF")
    from stonesoup.types.hypothesis import SingleHypothesis

    track = Track([GaussianState([0.0, 1, 0, 1], np.diag([1.5, 0.5, 1.5, 0.5]), timestamp=START)])
    for k in range(1, 21):
        time = START + timedelta(seconds=k)
        truth.append(
            GroundTruthState(
                MOTION.function(truth[k - 1], noise=False, time_interval=timedelta(seconds=1)), timestamp=time
            )
        )
        z = Detection(sensor.function(truth[k], noise=False) + rng.normal(size=(2, 1)) * 5**0.5, timestamp=time)
        track.append(updater.update(SingleHypothesis(predictor.predict(track[-1], timestamp=time), z)))
    error = np.ravel(track[-1].state_vector - truth[-1].state_vector).astype(float)
    assert error @ np.linalg.solve(track[-1].covar, error) < 18.5  # 99.9 % of a χ² of 4

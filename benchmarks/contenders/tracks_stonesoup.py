"""Stone Soup's multi-target tracking, set up as its tutorials (JPDA, initiators and deleters) and demos do."""

import time
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.dataassociator.probability import JPDA
from stonesoup.deleter.time import UpdateTimeDeleter
from stonesoup.functions import gm_reduce_single
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import ExtendedKalmanPredictor, KalmanPredictor
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.update import GaussianStateUpdate
from stonesoup.updater.kalman import ExtendedKalmanUpdater, KalmanUpdater

from sigmax.records.plots import PlotRecord
from sigmax.tracking import Scan, Told
from sigmax.tracking.state import Gates

_START = datetime(2020, 1, 1)


def jpda(record: PlotRecord) -> list[Told]:
    """Confirmed tracks of JPDA with the motion, the noises and the clutter of the record's own cycle."""
    transition = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.1), ConstantVelocity(0.1)])
    seen = {
        "radar": LinearGaussian(4, (0, 2), np.diag([25.0, 25.0])),
        "lidar": LinearGaussian(4, (0, 2), np.diag([9.0, 9.0])),
    }
    predictor, updater = KalmanPredictor(transition), KalmanUpdater(None)
    # PDA's weights know one clutter density and one probability of detection.
    hypothesiser = PDAHypothesiser(predictor, updater, clutter_spatial_density=1e-5, prob_detect=0.9)
    associator = JPDA(hypothesiser=hypothesiser)
    deleter = UpdateTimeDeleter(timedelta(seconds=15))
    prior = GaussianState([0.0, 0.0, 0.0, 0.0], np.diag([0.0, 16.0, 0.0, 16.0]), timestamp=_START)
    initiator = MultiMeasurementInitiator(
        prior,
        deleter=UpdateTimeDeleter(timedelta(seconds=5)),
        data_associator=GNNWith2DAssignment(DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4)),
        updater=updater,
        measurement_model=None,
        min_points=5,
        updates_only=True,
    )
    tracks: set[Any] = set()
    numbers: dict[str, int] = {}
    history = []
    for scan in record.scans:
        moment = _START + timedelta(seconds=scan.time + 10)
        place = scan.z + (0 if scan.u is None else scan.u[:2])
        plots = {Detection(p[:, None], timestamp=moment, measurement_model=seen[scan.sensor]) for p in place}
        hypotheses = associator.associate(tracks, plots, moment)
        used = set()
        for track, several in hypotheses.items():
            states, weights = [], []
            for one in several:
                if one:
                    states.append(updater.update(one))
                    used.add(one.measurement)
                else:
                    states.append(one.prediction)
                weights.append(one.probability)
            mean, cov = gm_reduce_single(
                StateVectors([s.state_vector for s in states]),
                np.stack([s.covar for s in states], axis=2),
                np.array(weights),
            )
            if any(one for one in several):
                track.append(GaussianStateUpdate(mean, cov, several, moment))
            else:
                track.append(several[0].prediction)
        tracks -= deleter.delete_tracks(tracks)
        tracks |= initiator.initiate(plots - used, moment)
        history.append(_told(scan, list(tracks), numbers))
    return history


def _told(scan: Scan, tracks: list[Any], numbers: dict[str, int]) -> Told:
    ids = np.array([numbers.setdefault(t.id, len(numbers)) for t in tracks], int)
    mean = np.array([np.asarray(t.state_vector).ravel()[[0, 2, 1, 3]] for t in tracks], float).reshape(-1, 4)
    B = len(ids)
    nothing = np.full(B, np.nan)
    return Told(
        scan.time, scan.sensor, ids, np.ones(B, bool), np.ones(B), mean, np.zeros((B, 4, 4)), np.ones((B, 1)),
        np.full(B, -1), nothing, Gates(len(scan.z), 0, 0.0, 0.0, 0.0, 0.0), ids[:0], 0,
    )  # fmt: skip


def scale(n: int, world: list[tuple[Scan, np.ndarray]]) -> tuple[list[float], np.ndarray, np.ndarray]:
    """Milliseconds of each scan, the last positions of tracks, the last true ones, of GNN with an EKF."""
    transition = CombinedLinearGaussianTransitionModel([ConstantVelocity(1.0), ConstantVelocity(1.0)])
    # Its x, y are our north, east. Of its models with a radial velocity none in the plane can begin tracks.
    seen = CartesianToBearingRange(4, (0, 2), np.diag([np.radians(0.1) ** 2, 50.0**2]))
    predictor, updater = ExtendedKalmanPredictor(transition), ExtendedKalmanUpdater(seen)
    associator = GNNWith2DAssignment(DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4))
    deleter = UpdateTimeDeleter(timedelta(seconds=17))
    prior = GaussianState([0.0] * 4, np.diag([0.0, 3e4, 0.0, 3e4]), timestamp=_START)
    initiator = MultiMeasurementInitiator(
        prior, deleter=deleter, data_associator=associator, updater=updater, measurement_model=seen, min_points=3
    )
    tracks: set[Any] = set()
    took = []
    for scan, _ in world:
        moment = _START + timedelta(seconds=scan.time)
        plots = {Detection(p[[1, 0]][:, None], timestamp=moment, measurement_model=seen) for p in scan.z}
        started = time.process_time()
        used = set()
        for track, one in associator.associate(tracks, plots, moment).items():
            if one:
                track.append(updater.update(one))
                used.add(one.measurement)
            else:
                track.append(one.prediction)
        tracks -= deleter.delete_tracks(tracks)
        tracks |= initiator.initiate(plots - used, moment)
        took.append(1e3 * (time.process_time() - started))
    place = np.array([np.asarray(t.state_vector).ravel()[[0, 2]] for t in tracks], float).reshape(-1, 2)
    return took, place, world[-1][1]

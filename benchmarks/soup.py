"""Components in Stone Soup: the same work with its own predictor and updater, and with sigmax's.

python benchmarks/soup.py
"""

import time
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.dataassociator.probability import JPDA
from stonesoup.functions import gm_reduce_single
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import ExtendedKalmanPredictor, UnscentedKalmanPredictor
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.types.update import GaussianStateUpdate
from stonesoup.updater.kalman import ExtendedKalmanUpdater, UnscentedKalmanUpdater

import sigmax
from sigmax.stonesoup import SigmaxPredictor, SigmaxUpdater, model_of

START = datetime(2026, 1, 1)
MOTION = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.05), ConstantVelocity(0.05)])
SENSOR = CartesianToBearingRange(4, (0, 2), np.diag([0.005**2, 10.0]))
PRIOR = GaussianState([300.0, 2, 400, 3], np.diag([20.0, 1, 20, 1]), timestamp=START)


def plots(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Bearing and range of positions (k, 2)."""
    return np.stack([np.arctan2(x[:, 1], x[:, 0]), np.hypot(*x.T)], 1) + rng.normal(size=x.shape) * [0.005, 10**0.5]


def filtered(predictor: Any, updater: Any, z: np.ndarray) -> np.ndarray:
    """One track through all measurements (T, 2)."""
    state = PRIOR
    for k, seen in enumerate(z, 1):
        detection = Detection(seen, timestamp=START + timedelta(seconds=k), measurement_model=SENSOR)
        state = updater.update(SingleHypothesis(predictor.predict(state, timestamp=detection.timestamp), detection))
    return np.ravel(state.state_vector).astype(float)


def associated(predictor: Any, updater: Any, scans: list[np.ndarray], start: np.ndarray) -> np.ndarray:
    """Stone Soup's JPDA over all scans; positions at the end."""
    associator = JPDA(PDAHypothesiser(predictor, updater, clutter_spatial_density=1e-2, prob_detect=0.9))
    tracks = [Track([GaussianState(x, PRIOR.covar, timestamp=START)]) for x in start]
    for k, z in enumerate(scans, 1):
        time_ = START + timedelta(seconds=k)
        found = {Detection(p, timestamp=time_, measurement_model=SENSOR) for p in z}
        hypotheses = associator.associate(set(tracks), found, time_)
        for track in tracks:
            posteriors = [updater.update(h) if h else h.prediction for h in hypotheses[track]]
            weights = np.array([float(h.probability) for h in hypotheses[track]])
            means = StateVectors([p.state_vector for p in posteriors])
            mean, cov = gm_reduce_single(means, np.stack([p.covar for p in posteriors], axis=2), weights)
            track.append(GaussianStateUpdate(mean, cov, hypotheses[track], time_))
    return np.array([np.ravel(t.state_vector).astype(float)[[0, 2]] for t in tracks])


def best(work: Callable[[], np.ndarray], times: int = 3) -> tuple[float, np.ndarray]:
    """The least processor time of some runs, in seconds, after one that compiles."""
    result, took = work(), []
    for _ in range(times):
        started = time.process_time()
        result = work()
        took.append(time.process_time() - started)
    return min(took), result


def main() -> None:
    rng = np.random.default_rng(1)
    way = np.array([300.0, 400]) + np.arange(1, 301)[:, None] * [2.0, 3.0]
    z = plots(way, rng)
    start = np.array([[300.0 + 25 * i, 2, 400 - 25 * i, 3] for i in range(4)])
    scans = []
    for k in range(1, 41):
        x = start[:, [0, 2]] + k * start[:, [1, 3]]
        clutter = x.mean(0) + rng.uniform(-100, 100, (4, 2))
        scans.append(plots(np.concatenate([x[rng.random(4) < 0.9], clutter]), rng))
    unscented = sigmax.get("UKF", alpha=0.5, beta=2, kappa=-1)
    pairs = {
        "EKF": ("EKF", ExtendedKalmanPredictor, ExtendedKalmanUpdater),
        "UKF": (unscented, UnscentedKalmanPredictor, UnscentedKalmanUpdater),
    }
    works: dict[str, tuple[int, Callable[[Any, Any], np.ndarray]]] = {
        "one track, 300 steps": (len(z), lambda p, u: filtered(p, u, z)),
        "JPDA, 4 tracks, 40 scans": (len(scans), lambda p, u: associated(p, u, scans, start)),
    }
    print("| work | filter | Stone Soup, CPU µs a step | sigmax's components | ratio | apart at the end, m |")
    print("|---|---|---|---|---|---|")
    for name, (filter, predictor, updater) in pairs.items():
        for what, (steps, work) in works.items():
            # Each run has components of its own: both keep what they have computed.
            theirs, a = best(lambda p=predictor, u=updater, w=work: w(p(MOTION), u(SENSOR)))
            ours, b = best(
                lambda f=filter, w=work: w(SigmaxPredictor(MOTION, filter=f), SigmaxUpdater(SENSOR, filter=f))
            )
            apart = np.abs(a - b).max()
            print(
                f"| {what} | {name} | {1e6 * theirs / steps:.0f} | {1e6 * ours / steps:.0f} "
                f"| {theirs / ours:.1f} | {apart:.1e} |",
                flush=True,
            )
        model = model_of(MOTION, SENSOR)
        prior = sigmax.Gaussian(np.ravel(PRIOR.state_vector).astype(float), np.asarray(PRIOR.covar))
        theirs, a = best(lambda p=predictor, u=updater: filtered(p(MOTION), u(SENSOR), z))
        ours, b = best(lambda f=filter, m=model, g=prior: np.asarray(sigmax.run(f, m, g, z, dt=1.0).mean)[-1])
        print(
            f"| one track, 300 steps, by `sigmax.run` on `model_of` | {name} | {1e6 * theirs / len(z):.0f} "
            f"| {1e6 * ours / len(z):.1f} | {theirs / ours:.0f} | {np.abs(a - b).max():.1e} |",
            flush=True,
        )


if __name__ == "__main__":
    main()

"""Our own library, as its documentation shows it."""

from functools import partial
from typing import Any

import numpy as np

import sigmax
from contenders import Entry
from scenario import DT, MEAN, PRIOR, Estimate, Q, R

BATCH = ("SRCKFB", "SRECKFB", "CKF", "SRUKFB", "EKF", "SREKFB")
ONE = ("SRCKFB", "EKF")
_KIND = {"EKF": "EKF", "SREKFB": "EKF", "CKF": "CKF", "SRCKFB": "CKF"}
_PARAMETERS = {"SRUKFB": {"alpha": 0.45, "beta": 2.0, "kappa": -2.0}}


def _model() -> sigmax.Model:
    turn, radar = sigmax.motions.coordinated_turn(), sigmax.sensors.range_azimuth(polar_velocity=(2, 3))
    return sigmax.Model(
        motion=turn.function, sensor=radar.function, Q=Q, R=R, state=turn.state, measurement=radar.measurement
    )


def _entry(filter: str, what: str, gives: str, call: Any, *arguments: Any) -> Entry:
    chosen = sigmax.get(filter, **_PARAMETERS.get(filter, {}))
    name = f"sigmax {filter}{what}"
    return Entry(name, _KIND.get(filter, filter), gives, partial(call, chosen, _model(), *arguments))


def _prior() -> sigmax.Gaussian:
    return sigmax.Gaussian(MEAN, np.diag(PRIOR))


def _run(filter: sigmax.Filter, model: sigmax.Model, z: np.ndarray) -> Estimate:
    result = sigmax.run(filter, model, _prior(), z, dt=DT, keep=("mean", "factor"))
    return Estimate(result.mean, result.cov)


def _run_all(filter: sigmax.Filter, model: sigmax.Model, z: np.ndarray) -> Estimate:
    result = sigmax.run(filter, model, _prior(), z, dt=DT)
    return Estimate(result.mean, result.cov)


def batch(z: np.ndarray) -> list[Entry]:
    """Thousands of tracks in one call."""
    few, all_parts = "mean, cov, log-likelihood", "all parts: also faults, NIS, innovations, likelihoods"
    entries = [_entry(f, "", few, _run, z) for f in BATCH]
    return entries + [_entry(f, ", all parts", all_parts, _run_all, z) for f in ONE]


def offline(z: np.ndarray) -> list[Entry]:
    """A whole record in one call."""
    return [_entry(f, "", "mean, cov, log-likelihood", _run, z) for f in ONE]


def live(z: np.ndarray) -> list[Entry]:
    """Step by step, in one compiled call or in two."""

    def steps(filter: sigmax.Filter, model: sigmax.Model, halves: bool) -> Estimate:
        tracker = sigmax.Live(filter, model, _prior())
        means, covs = [], []
        for measured in z:
            if halves:
                tracker.predict(DT)
                tracker.update(measured)
            else:
                tracker.step(measured, DT)
            means.append(tracker.mean)
            covs.append(tracker.cov)
        return Estimate(np.array(means), np.array(covs))

    gives = "mean, cov, innovation, NIS, log-likelihood, soundness"
    entries = [_entry(f, ", step", gives, steps, False) for f in ONE]
    return [*entries, _entry("SRCKFB", ", predict + update", gives, steps, True)]

"""Our own library, as its documentation shows it: on its native engine where there is a compiler."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

import sigmax
from contenders import Entry
from scenario import DT, MEAN, PRIOR, Estimate, Q, R

BATCH = ("SRCKFB", "SRECKFB", "CKF", "SRUKFB", "EKF", "SREKFB")
ONE = ("SRCKFB", "EKF")
_KIND = {"EKF": "EKF", "SREKFB": "EKF", "CKF": "CKF", "SRCKFB": "CKF"}
_UNSCENTED = {"alpha": 0.45, "beta": 2.0, "kappa": -2.0}
_PARAMETERS = {"SRUKFB": _UNSCENTED, "SREUKFB": _UNSCENTED}


def _model() -> sigmax.Model:
    turn, radar = sigmax.motions.coordinated_turn(), sigmax.sensors.range_azimuth(polar_velocity=(2, 3))
    return sigmax.Model(
        motion=turn.function, sensor=radar.function, Q=Q, R=R, state=turn.state, measurement=radar.measurement
    )


def _entry(filter: str, what: str, gives: str, call: Any, *arguments: Any) -> Entry:
    chosen = sigmax.get(filter, **_PARAMETERS.get(filter, {}))
    name = f"sigmax {filter}{what}"
    return Entry(name, _KIND.get(filter, filter), gives, partial(call, chosen, _model(), *arguments))


@cache
def _prior() -> sigmax.Gaussian:
    return sigmax.Gaussian(MEAN, np.diag(PRIOR))


def _run(filter: sigmax.Filter, model: sigmax.Model, z: np.ndarray, backend: str | None = None) -> Estimate:
    result = sigmax.run(filter, model, _prior(), z, dt=DT, keep=("mean", "factor"), backend=backend)
    return Estimate(result.mean, result.cov)


def _run_all(filter: sigmax.Filter, model: sigmax.Model, z: np.ndarray) -> Estimate:
    result = sigmax.run(filter, model, _prior(), z, dt=DT)
    return Estimate(result.mean, result.cov)


def batch(z: np.ndarray) -> list[Entry]:
    """Thousands of tracks in one call."""
    few, all_parts = "mean, cov, log-likelihood", "all parts: also faults, NIS, innovations, likelihoods"
    entries = [_entry(f, "", few, _run, z) for f in BATCH]
    entries += [_entry(f, ", all parts", all_parts, _run_all, z) for f in ONE]
    return [*entries, _entry("SRCKFB", ", XLA", few, _run, z, "xla")]


def offline(z: np.ndarray) -> list[Entry]:
    """A whole record in one call."""
    gives = "mean, cov, log-likelihood"
    return [*(_entry(f, "", gives, _run, z) for f in ONE), _entry("SRCKFB", ", XLA", gives, _run, z, "xla")]


def live(z: np.ndarray) -> list[Entry]:
    """Step by step, in one compiled call or in two."""

    def steps(filter: sigmax.Filter, model: sigmax.Model, halves: bool, backend: str | None = None) -> Estimate:
        tracker = sigmax.Live(filter, model, _prior(), backend=backend)
        means, covs = [], []
        for measured in z:
            if halves:
                tracker.predict(DT)
                tracker.update(measured)
            else:
                tracker.step(measured, DT)
            mean, cov = tracker.moments
            means.append(mean)
            covs.append(cov)
        return Estimate(np.array(means), np.array(covs))

    def means(filter: sigmax.Filter, model: sigmax.Model) -> Estimate:
        tracker = sigmax.Live(filter, model, _prior())
        found = []
        for measured in z:
            tracker.step(measured, DT)
            found.append(tracker.mean)
        return Estimate(np.array(found), None)

    def last(filter: sigmax.Filter, model: sigmax.Model) -> Estimate:
        tracker = sigmax.Live(filter, model, _prior())
        for measured in z:
            tracker.step(measured, DT)
        return Estimate(tracker.mean[None], tracker.cov[None])

    gives = "mean, cov, innovation, NIS, log-likelihood, soundness"
    entries = [_entry(f, ", step", gives, steps, False) for f in ONE]
    halves = _entry("SRCKFB", ", predict + update", gives, steps, True)
    alone = _entry("SRCKFB", ", step, mean read alone", "mean, innovation, NIS, log-likelihood, soundness", means)
    gives_last = "innovation, NIS, log-likelihood, soundness; mean and cov once"
    end = _entry("SRCKFB", ", step, state read at the end", gives_last, last)
    return [*entries, alone, end, halves, _entry("SRCKFB", ", step, XLA", gives, steps, False, "xla")]


@cache
def _native(filter: str) -> tuple[sigmax.Filter, sigmax.Model]:
    return sigmax.get(filter, **_PARAMETERS.get(filter, {})), _model()


def alone(filter: str, z: np.ndarray) -> Callable[[], object]:
    """A call of the native engine that hands over no more than it must, to be timed beside programs in C.

    For z (B, T, 3) the means of all steps; for z (T, 3) live steps after which nobody reads the state.
    """
    chosen, model = _native(filter)
    if z.ndim == 3:
        return lambda: sigmax.run(chosen, model, _prior(), z, dt=DT, keep=("mean",), backend="native").mean
    tracker = sigmax.Live(chosen, model, _prior(), backend="native")
    beginning = tracker.save()
    tracker.step(z[0], DT)  # what is set up once
    tracker.restore(beginning)
    return lambda: [tracker.step(measured, DT) for measured in z]

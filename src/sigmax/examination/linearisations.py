"""Whether another linearisation than the filter's explains a record better."""

from dataclasses import replace

import numpy as np

from sigmax.dependence import reading
from sigmax.examination.search import Candidate, Setup, masked
from sigmax.examination.variants import RecordData, Runner, Variant, log_likelihood
from sigmax.filters import Filter, Update, get, once
from sigmax.modelling.model import Model

# Of degree 3, of order 2, of degree 5, and iterated.
_OTHERS = ("CKF", "SOKF", "HCKF", "IEKF")


def other_linearisations(setup: Setup, theta: np.ndarray, record: RecordData, as_it_stands: float) -> list[Candidate]:
    """What other filters gain in log-likelihood on a record of a nonlinear model; none has a number to fit."""
    if not _nonlinear(setup.runner.family.plain, record):
        return []
    names = [name for name in _OTHERS if name != setup.runner.filter.name]
    return [_with(setup, theta, record, name, as_it_stands) for name in names]


def with_filter(setup: Setup, name: str) -> Setup:
    """The same search by another filter."""
    old = setup.runner
    runner = Runner(judging(get(name)), old.family, old.update_first)
    return replace(setup, climber=setup.climber._replace(runner=runner))


def judging(filter: Filter) -> Filter:
    """A filter without weights, which would hide outliers; one that iterates goes on doing so."""
    update = filter.update
    if isinstance(update, Update) and update.iterations:
        return replace(filter, update=replace(update, weight=None))
    return replace(filter, update=once)


def _with(setup: Setup, theta: np.ndarray, record: RecordData, name: str, as_it_stands: float) -> Candidate:
    L = float(log_likelihood(masked(with_filter(setup, name), [Variant(theta, record)])[1])[0])
    gain = L - as_it_stands if np.isfinite(as_it_stands) else 1e9 + L / 1e3
    return Candidate("linearisation", name, gain, np.zeros(0), np.nan)


def _nonlinear(model: Model, record: RecordData) -> bool:
    """Whether the motion or a sensor is, found without computing anything."""
    u, dt = record.u[0], np.ones(())
    given = [(model.motion, [dt, u] if model.motion_inputs else [dt])]
    given += [(h, [u] if model.sensor_inputs[s] else []) for s, h in model.sensors.items()]
    return any(reading(function, model.size, rest).nonlinear for function, rest in given)

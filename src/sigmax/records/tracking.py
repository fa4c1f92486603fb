"""Running a trial on a record."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmax.descriptions.trial import Trial
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.modelling.model import Model
from sigmax.native.refusal import user_line
from sigmax.preparation.prepare import prepare
from sigmax.records.record import Record
from sigmax.results.result import Result
from sigmax.rules import SigmaPoints
from sigmax.running.run import run
from sigmax.running.tails import fit_tails
from sigmax.steps.updating import update_on

_KEPT = ("mean", "factor", "fault", "nis", "dof")
# A run longer than this is not repeated to measure it without its compilation.
_TIMED_AGAIN_BELOW = 20.0


@dataclass(frozen=True)
class Outcome:
    """What came of a trial.

    Attributes:
        trial: what was run.
        result: the estimates (B, T, …), None where the filter could not be run at all.
        seconds: the run, compiled.
        compile_seconds: what the first call took longer; None where it was the only one, and is in `seconds`.
        failure: why there is no result, empty where there is one.
    """

    trial: Trial
    result: Result | None
    seconds: float
    compile_seconds: float | None
    failure: str = ""


def check(record: Record, trials: tuple[Trial, ...]) -> None:
    """Refuse what can be known not to work, before anything long begins.

    Raises:
        InputError: with the trial or the function of the model that does not fit.
    """
    for trial in trials:
        filter, model, prior = record.of_trial(trial)
        try:
            # Checks of the engine look at the functions and the first step; the record itself is checked already.
            z = {s: v[:, :1] for s, v in record.z.items()} if isinstance(record.z, dict) else record.z[:, :1]
            inputs = None if record.inputs is None else record.inputs[:, :1]
            prepare(filter, model, prior, z, record.dt[:, :1], inputs, "float64", record.update_first)
            for rule in (filter.predict, filter.correct):
                if isinstance(rule, SigmaPoints):
                    rule.points(model.size + model.biases)
        except InputError as error:
            raise InputError(f"{trial.name}: {error}") from error
        except Exception as error:
            # A function of the user's file may fail in any way.
            where = user_line(error)
            raise InputError(
                f"{trial.name}: {type(error).__name__}: {error}{f' ({where})' if where else ''}"
            ) from error


def _weighs(filter: Filter, model: Model) -> bool:
    return any(update_on(filter, model, sensor).weight is not None for sensor in model.sensors)


def robust_trial(record: Record, trial: Trial) -> Trial | None:
    """A trial with a Student update for each sensor of heavy tails, see `fit_tails`; None where none gains by it."""
    filter, model, prior = record.of_trial(trial)
    if model.fusion is not None or _weighs(filter, model):
        return None
    given: dict[str, Any] = {"dt": record.dt, "inputs": record.inputs, "update_first": record.update_first}
    found = fit_tails(filter, model, prior, record.z, **given)
    return None if found == filter else Trial(f"{trial.name}, {found.update}", found, trial.fixed)


def track(record: Record, trial: Trial) -> Outcome:
    """Run one filter over all tracks of a record; a failure is told in the outcome."""
    filter, model, prior = record.of_trial(trial)
    # Innovations are large, and only what weighs them is asked of them.
    kept = (*_KEPT, "modes", *(("innovation",) if _weighs(filter, model) else ()))

    def once() -> tuple[Result, float]:
        started = time.perf_counter()
        result = run(
            filter,
            model,
            prior,
            record.z,
            dt=record.dt,
            inputs=record.inputs,
            update_first=record.update_first,
            keep=kept,
        )
        # Looking at the numbers waits for them.
        np.asarray(result.mean)
        return result, time.perf_counter() - started

    try:
        result, first = once()
        if first > _TIMED_AGAIN_BELOW:
            return Outcome(trial, result, first, None)
        result, second = once()
    except Exception as error:
        return Outcome(trial, None, float("nan"), None, f"{type(error).__name__}: {error}")
    return Outcome(trial, result, second, max(first - second, 0.0))

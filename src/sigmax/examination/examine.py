"""`sigmax.doctor`: a model, a prior and a record go in, causes come out."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.examination.envelope import component_names, curved, envelope, parameters_of
from sigmax.examination.envelope_runs import Runner, Variant
from sigmax.examination.forward_selection import ForwardSelection
from sigmax.examination.gauss_newton import Climber
from sigmax.examination.hypotheses import axes_of, groups_of, hypotheses, moved, natural_steps, noise_at
from sigmax.examination.linearisations import judging
from sigmax.examination.record_data import RecordData
from sigmax.examination.report import Examination, Finding
from sigmax.examination.search import Setup
from sigmax.filters import Bank, Filter
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.preparation.prepare import Prepared, as_filter, prepare
from sigmax.preparation.times import times_of
from sigmax.running.run import steps_given
from sigmax.steps.adaptive_noises import adapts

# Fewer values than these, beyond the start, say nothing.
_FEWEST = 30


def doctor(
    model: Model,
    prior: Gaussian,
    z: Any,
    *,
    filter: Filter | str = "EKF",
    dt: Any = None,
    t: Any = None,
    t0: Any = None,
    inputs: Any = None,
    R: Any = None,
    update_first: bool = False,
    progress: Callable[[str], Any] | None = None,
) -> Examination:
    """Say what is wrong with a model, from a record: causes with evidence, size, standard error and remedy.

    Args:
        model: the model, with or without a bias, of one or several sensors.
        prior: as in `run`.
        z: one record (T, m), as in `run`.
        filter: whose likelihood judges; weights of its update against outliers are left out, iterations stay.
        dt: as in `run`.
        t: as in `run`.
        t0: as in `run`.
        inputs: as in `run`.
        R: as in `run`.
        update_first: as in `run`.
        progress: is told what is being done, in words; a long record takes tens of seconds.

    Returns:
        The examination: print it. How often a sound model has findings stands in the docs, with the command.

    Raises:
        InputError: for whatever `run` refuses, a batch of records, modes, and banks.
    """
    begun = time.perf_counter()
    chosen = as_filter(filter)
    if why := not_examined(model, chosen):
        raise InputError(why)
    chosen = judging(chosen)
    times = times_of(t, t0)
    ready = prepare(chosen, model, prior, z, steps_given(dt, t, times), inputs, "float64", update_first, R=R)
    if ready.batch is not None:
        raise InputError(f"the doctor examines one record; this is a batch of {ready.batch}: give one of them")
    record, setup = _laid_out(ready, update_first)
    values = sum(int(np.isfinite(v).sum()) for v in record.z.values())
    first = setup.runner([Variant(np.zeros(len(setup.climber.steps)), record)])
    rounds = ForwardSelection(setup, record, first, progress or (lambda said: None))
    findings: tuple[Finding, ...] = ()
    undetermined: tuple[str, ...] = ()
    if values < _FEWEST + record.mean.size:
        refused = f"{values} values are too few; from {_FEWEST + record.mean.size} on there is something to say"
    else:
        findings, undetermined, refused = rounds.examine()
    return Examination(
        findings, refused, undetermined, rounds.tested, rounds.nis0, len(record.dt), chosen.name,
        time.perf_counter() - begun, rounds.evidence,
    )  # fmt: skip


def not_examined(model: Any, filter: Filter) -> str:
    """Why the doctor does not know a model or filter, in words; empty where it does."""
    if isinstance(model, SwitchingModel):
        return (
            "the doctor examines one motion, and this model has modes that take turns: give one of its models, "
            f"and the rows in which it holds; they are {', '.join(model.names)}"
        )
    if not isinstance(model, Model):
        return f"the doctor examines a sigmax.Model; this is {type(model).__name__}"
    if isinstance(filter, Bank):
        return "the doctor judges by one filter, and a bank has several: give one of its members"
    if adapts(filter, model):
        return f"the doctor looks for noises that are wrong, and {filter.name} hides them: give the filter without that"
    return ""


def _laid_out(ready: Prepared, update_first: bool) -> tuple[RecordData, Setup]:
    """The record as arrays, and the filter on the envelope of the model."""
    model = ready.model
    sizes = {s: model.measured_space(s, v.shape[-1]).dim for s, v in ready.z.items()}
    T, M = len(ready.dt), sum(sizes.values())
    u = np.zeros((T, 0)) if ready.u is None else np.asarray(ready.u)
    driven = 0 if ready.inputs is None else ready.inputs.shape[-1]
    record = RecordData(
        z={s: np.asarray(v) for s, v in ready.z.items()},
        dt=np.asarray(ready.dt),
        u=u,
        mean=np.asarray(ready.mean),
        cov=np.asarray(ready.cov),
        extra=np.zeros(M),
        out=np.zeros((T, M), bool),
        huge=np.zeros(M),
        q_factor=np.ones(T),
    )
    dt = record.interval
    Q, R = noise_at(model, record, dt)
    moves = model.space.difference(moved(model, record, 0.0), record.mean)
    at_rest = np.allclose(moves, 0.0, atol=1e-9 * max(1.0, float(np.abs(record.mean).max())))
    back = bool(at_rest and np.isfinite(moved(model, record, -dt)).all())
    parameters = parameters_of(model, sizes, driven, groups_of(Q), axes_of(model, record, dt, driven), back)
    family = envelope(model, parameters, u.shape[1], driven, tuple(sizes.items()))
    width = {s: 1.0 if curved(model, s) else np.nanvar(v, axis=0) + 1e-12 for s, v in ready.z.items()}
    spread = {s: np.where(v > 0, v, width[s]) for s, v in R.items()}
    record = replace(record, huge=1e8 * np.concatenate([spread[s] for s in sizes]))
    setup = Setup(
        climber=Climber(
            Runner(ready.filter, family, update_first),
            natural_steps(family, record, Q, R, dt),
            {s: tuple(model.measured_angular(s, v.shape[-1])) for s, v in ready.z.items()},
        ),
        hypotheses=hypotheses(family),
        R=R,
        names={s: component_names(model, s, m) for s, m in sizes.items()},
        burn=max(5, 2 * model.size),
        timed=not np.array_equal(moved(model, record, dt), moved(model, record, 2 * dt)),
    )
    return record, setup

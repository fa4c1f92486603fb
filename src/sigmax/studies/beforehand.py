"""What is checked and found out before a study runs."""

import os
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from sigmax.engine.backend import BACKENDS
from sigmax.errors import InputError
from sigmax.filters import Bank, Filter, ModeFilters, get
from sigmax.modelling.model import check_flat
from sigmax.modelling.switching import SwitchingModel
from sigmax.models import Gaussian
from sigmax.native.fingerprint import fingerprint
from sigmax.preparation.folding import folding
from sigmax.running.run import run
from sigmax.studies.simulate import sizes
from sigmax.studies.study import Study
from sigmax.studies.sums import Sums, Yardsticks
from sigmax.studies.work import OPTIMUM

# Deviations of a prediction without any measurement beyond which a run counts as diverged.
_BEYOND = 4.0


def chosen_filters(study: Study, filters: Mapping[str, Filter] | Sequence[str] | None) -> dict[str, Filter]:
    """Filters by name; a name that the study knows means the filter as the study sets it."""
    if filters is None:
        chosen = dict(study.filters)
    elif isinstance(filters, Mapping):
        chosen = dict(filters)
    else:
        known = {name.casefold(): (name, f) for name, f in study.filters.items()}
        chosen = {}
        for name in filters:
            found, f = known.get(name.casefold(), (None, None))
            made = get(name) if f is None else f
            chosen[found or made.name] = made
    if not chosen:
        raise InputError(f"{study.name} names no filters; say which, for example filters=['EKF', 'SRCKFB']")
    for name in chosen:
        if name.startswith(OPTIMUM):
            raise InputError(f"a filter cannot be called {name!r}")
    return chosen


def check(
    study: Study,
    count: int,
    N: int,
    workers: int | None,
    chunk: int,
    backend: str | None,
    show: Sequence[int] = (),
) -> None:
    """Refuse numbers that make no sense.

    Raises:
        InputError: with what was given and what is meant.
    """
    for what, value, least in (("runs", count, 2), ("particles", N, 0), ("chunk", chunk, 1), ("workers", workers, 1)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < least):
            raise InputError(f"{what} must be a whole number of at least {least}; it is {value!r}")
    if show:
        check_flat(study.model, "runs that are shown whole")
    for one in show:
        if isinstance(one, bool) or not isinstance(one, int) or not 1 <= one <= count:
            raise InputError(f"show names runs from 1 to {count}, the number of runs; {one!r} is none of them")
    if N and not study.fair:
        raise InputError(
            f"{study.name}: an optimum needs truth that is drawn from the filters' model and prior; "
            "this study draws it otherwise, so no filter is optimal: give particles=0"
        )
    if backend is not None and backend not in BACKENDS:
        raise InputError(f"unknown backend {backend!r}; known: {', '.join(BACKENDS)}")


def yardsticks(study: Study, backend: str | None) -> Yardsticks:
    """Errors are held against what a prediction would know that never sees a measurement."""
    T = study.steps
    z = {s: np.full((T, m), np.nan) for s, m in sizes(study).items()}
    blind = run(
        "SRCKFB",
        study.model,
        Gaussian(study.prior.mean, study.prior.cov),
        z if study.model.several else z[""],
        dt=study.dt,
        inputs=study.inputs,
        keep=("factor",),
        backend=backend,
    ).std
    look = np.array(study.looked) - 1
    smallest = np.where(blind.max(0) > 0, blind.max(0), 1.0)
    scale = np.where(blind[look] > 0, blind[look], smallest)
    limit = _BEYOND * scale[-1] if study.limit is None else np.asarray(study.limit, float)
    # Of an angle more than a right angle is lost in any case.
    turning = np.array(study.model.angular)
    for p, _, to in study.model.space.parts():
        turning[to.start : to.start + p.turns] = True
    limit = np.where(turning, np.minimum(limit, np.pi / 2), limit)
    return Yardsticks(look, limit, scale, study.model.space)


def folding_notes(study: Study, filters: Mapping[str, Filter]) -> list[str]:
    """What is to be said of filters whose points fold at the start, a sentence each."""
    k = None if study.inputs is None else np.shape(study.inputs)[-1]
    return [
        f"{name}: {said}"
        for name, filter in filters.items()
        if not isinstance(filter, Bank | ModeFilters) and not isinstance(study.model, SwitchingModel)
        for said in folding(filter.on(0), study.model, study.prior, k)
    ]


def settings_of(study: Study, filters: Mapping[str, Filter], seed: int, N: int, backend: str | None) -> Any:
    """What the sums depend on; None where that cannot be told, so that they must not be used again."""
    about = {k: v for k, v in vars(study).items() if k not in ("runs", "title", "about", "units", "filters", "groups")}
    name = fingerprint("study", Sums._fields, about, dict(filters), os.environ.get("SIGMAX_BACKEND"))
    if name is None:
        return None
    return {"sigmax": version("sigmax"), "fingerprint": name, "seed": seed, "particles": N, "backend": backend}

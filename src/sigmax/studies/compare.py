"""Many runs of a study with all its filters, and what they say."""

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import joblib
import numpy as np

import sigmax
from sigmax.errors import InputError
from sigmax.filters import Filter, get
from sigmax.models import Gaussian
from sigmax.native.fingerprint import fingerprint
from sigmax.running.backend import BACKENDS
from sigmax.running.run import run
from sigmax.studies.bound import absent, bound
from sigmax.studies.cost import Cost, costs
from sigmax.studies.measures import Measures, measures
from sigmax.studies.progress import FILE, NOTHING, Totals, add, restore, store
from sigmax.studies.simulate import draw, sizes
from sigmax.studies.study import Study
from sigmax.studies.sums import Sums, Yardsticks
from sigmax.studies.work import CHECK, OPTIMUM, Done, Work, block, estimate

# Deviations of a prediction without any measurement beyond which a run counts as diverged.
_BEYOND = 4.0
_STORED_EVERY = 5.0  # seconds
Report = Callable[[str, int, int], None]


class Optimum(NamedTuple):
    """The optimum by particles over the runs in which it was computed.

    Attributes:
        particles: N.
        measures: of the optimum.
        check: of the same with 2N particles.
        filters: of the filters over the same runs.
    """

    particles: int
    measures: Measures
    check: Measures
    filters: dict[str, Measures]


class Comparison(NamedTuple):
    """What a study says.

    Attributes:
        study: the study.
        seed: of all its draws.
        runs: how many were made.
        filters: by name, those that could not be run included.
        escaped: runs of which the truth escaped; the measures are of the others.
        measures: by filter.
        failures: why a filter could not be run, by filter.
        sums: by filter, for the histograms.
        by: what errors were held against.
        costs: by filter.
        optimum: the optimum, or None.
        bound: the least RMSE (T, n) by the posterior Cramér–Rao bound, or None.
        no_bound: why there is none.
        prepared: seconds that the first run took longer than the others, by filter: tracing and compiling.
        seconds: how long it all took.
    """

    study: Study
    seed: int
    runs: int
    filters: dict[str, Filter]
    escaped: int
    measures: dict[str, Measures]
    failures: dict[str, str]
    sums: dict[str, Sums]
    by: Yardsticks
    costs: dict[str, Cost]
    optimum: Optimum | None
    bound: np.ndarray | None
    no_bound: str
    prepared: dict[str, float]
    seconds: float


def compare(
    study: Study,
    filters: Mapping[str, Filter] | Sequence[str] | None = None,
    *,
    runs: int | None = None,
    seed: int = 1,
    particles: int | None = None,
    workers: int | None = None,
    chunk: int = 1,
    folder: Path | str | None = None,
    backend: str | None = None,
    report: Report = lambda what, done, of: None,
) -> Comparison:
    """Run a study.

    The numbers depend on the study, the filters, the seed and the number of runs alone: not on workers or chunk.
    Work is dealt out by joblib, within whatever `joblib.parallel_config` says (threads without it), so that
    the same call uses a Dask or Ray cluster.

    Args:
        study: what is to be drawn and compared.
        filters: names of the catalogue, or filters by name; without it those of the study.
        runs: how many; without it as the study says.
        seed: fixes all draws.
        particles: of the optimum; without it as the study says, 0 for none.
        workers: how many blocks of runs are worked on at once; without it one for each core.
        chunk: blocks that a worker is given at a time.
        folder: where sums are kept, so that a study that was stopped goes on, and one that is repeated
            with more runs only makes those that are new.
        backend: as in `run`.
        report: called with what is being done, how much is done, and of how much.

    Raises:
        InputError: before anything is computed, for whatever does not fit. A filter that fails is data:
            `Comparison.failures`, and the lost runs of its measures.
    """
    begun = time.perf_counter()
    chosen = _chosen(study, filters)
    count = study.runs if runs is None else runs
    N = study.particles if particles is None else particles
    _check(study, count, N, workers, chunk, backend)
    size = study.block
    by = _yardsticks(study, backend)
    no_bound = absent(study)
    work = Work(study, chosen, by, seed, not no_bound, backend)
    settings = _settings(study, chosen, seed, N, backend)
    path = None if folder is None or settings is None else Path(folder) / FILE
    totals = NOTHING if path is None else restore(path, settings or {})
    whole, rest = divmod(count, size)
    if totals.blocks > whole:
        totals = NOTHING
    sizes_ = [size] * whole + ([rest] if rest else [])
    with_optimum = -(-min(study.optimum_runs, count) // size) if N else 0

    def todo(number: int) -> tuple[int, int, int]:
        return number, sizes_[number], N if number < with_optimum else 0

    failures, prepared = _tried(work, report)
    work = work.without(list(failures))
    if not work.filters:
        totals = NOTHING
        sizes_ = []
    stored = time.perf_counter()
    kept = totals
    jobs = joblib.effective_n_jobs(workers or -1) if workers != 1 else 1
    at = totals.blocks
    while at < len(sizes_):
        report("runs", min(at * size, count), count)
        group = [todo(k) for k in range(at, min(at + chunk * jobs * 2, len(sizes_)))]
        for done, (number, made, _) in zip(_dealt(work, group, jobs, chunk), group, strict=True):
            totals = add(totals, done)
            if made == size:
                kept = totals
            at = number + 1
        if path is not None and (time.perf_counter() - stored > _STORED_EVERY or at == len(sizes_)):
            store(path, kept, settings or {})
            stored = time.perf_counter()
    report("runs", count, count)
    ran = {name: measures(s) for name, s in totals.all.items()}
    return Comparison(
        study,
        seed,
        count,
        chosen,
        totals.escaped,
        ran,
        failures,
        dict(totals.all),
        by,
        _costs(work, report),
        _optimum(totals, N),
        None if totals.told is None else bound(study, totals.told),
        no_bound,
        prepared,
        time.perf_counter() - begun,
    )


def _dealt(work: Work, group: Sequence[tuple[int, int, int]], jobs: int, chunk: int) -> list[Done]:
    """The blocks of a group, in their order."""
    if jobs == 1:
        return [block(work, *one) for one in group]
    parts = [group[k : k + chunk] for k in range(0, len(group), chunk)]
    made = joblib.Parallel(n_jobs=jobs, prefer="threads")(joblib.delayed(_blocks)(work, part) for part in parts)
    return [done for part in made for done in part]


def _blocks(work: Work, group: Sequence[tuple[int, int, int]]) -> list[Done]:
    return [block(work, *one) for one in group]


def _chosen(study: Study, filters: Mapping[str, Filter] | Sequence[str] | None) -> dict[str, Filter]:
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


def _check(study: Study, count: int, N: int, workers: int | None, chunk: int, backend: str | None) -> None:
    for what, value, least in (("runs", count, 2), ("particles", N, 0), ("chunk", chunk, 1), ("workers", workers, 1)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < least):
            raise InputError(f"{what} must be a whole number of at least {least}; it is {value!r}")
    if N and not study.fair:
        raise InputError(
            f"{study.name}: an optimum needs truth that is drawn from the filters' model and prior; "
            "this study draws it otherwise, so no filter is optimal: give particles=0"
        )
    if backend is not None and backend not in BACKENDS:
        raise InputError(f"unknown backend {backend!r}; known: {', '.join(BACKENDS)}")


def _yardsticks(study: Study, backend: str | None) -> Yardsticks:
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
    return Yardsticks(look, limit, scale, np.array(study.model.angular))


def _settings(study: Study, filters: Mapping[str, Filter], seed: int, N: int, backend: str | None) -> Any:
    """What the sums depend on; None where that cannot be told, so that they must not be used again."""
    about = {k: v for k, v in vars(study).items() if k not in ("runs", "title", "about", "units", "filters")}
    name = fingerprint("study", about, dict(filters), os.environ.get("SIGMAX_BACKEND"))
    if name is None:
        return None
    return {"sigmax": sigmax.__version__, "fingerprint": name, "seed": seed, "particles": N, "backend": backend}


def _tried(work: Work, report: Report) -> tuple[dict[str, str], dict[str, float]]:
    """Why each filter that cannot be run cannot, and how long each took to compile."""
    drawn = draw(work.study, work.seed, 0, work.backend)
    failures, prepared = {}, {}
    for k, name in enumerate(work.filters):
        report("compiling", k, len(work.filters))
        try:
            taken = []
            for _ in range(2):
                begun = time.perf_counter()
                estimate(work, name, drawn)
                taken.append(time.perf_counter() - begun)
            prepared[name] = max(taken[0] - taken[1], 0.0)
        except Exception as error:  # whatever a filter or a user's function raises, the others go on
            failures[name] = str(error) or type(error).__name__
    report("compiling", len(work.filters), len(work.filters))
    return failures, prepared


def _costs(work: Work, report: Report) -> dict[str, Cost]:
    if not work.filters:
        return {}
    report("cost", 0, 1)
    made = costs(work.study, work.filters, get("EKF"), work.seed, work.backend)
    report("cost", 1, 1)
    return made


def _optimum(totals: Totals, N: int) -> Optimum | None:
    if OPTIMUM not in totals.paired:
        return None
    filters = {name: measures(s) for name, s in totals.paired.items() if not name.startswith(OPTIMUM)}
    return Optimum(N, measures(totals.paired[OPTIMUM]), measures(totals.paired[CHECK]), filters)

"""Many runs of a study with all its filters, and what they say."""

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import joblib
from joblib.parallel import get_active_backend

from sigmax.errors import BendingWarning, FoldingWarning
from sigmax.filters import Filter, get
from sigmax.modelling.model import check_flat
from sigmax.modelling.switching import check_one_mode
from sigmax.studies.beforehand import check, chosen_filters, folding_notes, settings_of, yardsticks
from sigmax.studies.bound import absent, bound
from sigmax.studies.comparison import Comparison, Optimum
from sigmax.studies.cost import Cost, costs
from sigmax.studies.measures import measures, tends_to
from sigmax.studies.progress import FILE, NOTHING, Totals, add, add_paired, restore, store
from sigmax.studies.single_run import single_run
from sigmax.studies.study import Study
from sigmax.studies.sums import Sums
from sigmax.studies.work import CHECK, OPTIMUM, Rows, Runs, Work, beside_the_optimum, block, estimate

# Seconds between two times at which sums are stored, and that a group of blocks may take.
_STORED_EVERY, _GROUP = 2.0, 2.0
# Seconds: whether so much was spent on compiling is worth a second look.
_WORTH_TELLING = 0.3
Report = Callable[[str, int, int], None]


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
    show: Sequence[int] = (),
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
        workers: how many blocks of runs are worked on at once; without it one for each core, of threads two.
        chunk: blocks that a worker is given at a time.
        folder: where sums are kept every few seconds, so that a study that was stopped goes on, and one that is
            repeated with more runs only makes those that are new.
        backend: as in `run`.
        show: numbers of runs, from 1, that are kept whole, with every filter's estimates: `Comparison.shown`.
        report: called with what is being done, how much is done, and of how much.

    Raises:
        InputError: before anything is computed, for whatever does not fit. A filter that fails is data:
            `Comparison.failures`, and the lost runs of its measures.
    """
    begun = time.perf_counter()
    with warnings.catch_warnings():
        # Said once for each filter, in the notes, not for each block of runs.
        warnings.simplefilter("ignore", FoldingWarning)
        warnings.simplefilter("ignore", BendingWarning)
        return _compared(study, filters, runs, seed, particles, workers, chunk, folder, backend, show, report, begun)


def _compared(
    study: Study,
    filters: Mapping[str, Filter] | Sequence[str] | None,
    runs: int | None,
    seed: int,
    particles: int | None,
    workers: int | None,
    chunk: int,
    folder: Path | str | None,
    backend: str | None,
    show: Sequence[int],
    report: Report,
    begun: float,
) -> Comparison:
    chosen = chosen_filters(study, filters)
    count = study.runs if runs is None else runs
    N = study.particles if particles is None else particles
    if N:
        check_flat(study.model, "the optimum, which particles= asks for,")
        check_one_mode(study.model, "the optimum, which particles= asks for,")
    check(study, count, N, workers, chunk, backend, show)
    by = yardsticks(study, backend)
    no_bound = absent(study)
    work = Work(study, chosen, by, seed, not no_bound, backend)
    settings = settings_of(study, chosen, seed, N, backend)
    path = None if folder is None or settings is None else Path(folder) / FILE
    blocks = _parts(count, study.block, study.block)
    pieces = _parts(min(study.optimum_runs, count), study.block, study.piece(N)) if N else []
    first = Runs(work, blocks[0])
    sums, failures, prepared = _tried(first, report)
    work = work.without(list(failures))
    totals, note = NOTHING, ""
    if work.filters:
        if path is not None:
            totals, note = restore(path, settings or {}, sums, study.block)
            totals = _within(totals, blocks, pieces, study, N)
        # Only whole blocks and pieces are kept, so that more runs can be added to them.
        kept, stored = totals, 0.0
        steps: list[tuple[str, int, Callable[..., Totals], Iterator[tuple[Rows, Any]]]] = []
        made = [(blocks[0], first.done(sums))] if not totals.blocks else []
        jobs = _jobs(workers)
        left = blocks[max(totals.blocks, 1) :]
        beside = partial(beside_the_optimum, work, count=N)
        steps.append(("runs", study.block, add, chain(made, _dealt(partial(block, work), left, jobs, chunk))))
        steps.append(("optimum", study.piece(N), add_paired, _dealt(beside, pieces[totals.pieces :], jobs, chunk)))
        for what, size, adding, found in steps:
            of = {"runs": count, "optimum": min(study.optimum_runs, count)}[what]
            for rows, one in found:
                totals = adding(totals, one)
                if rows.end - rows.first == size:
                    kept = adding(kept, one)
                if path is not None and time.perf_counter() - stored > _STORED_EVERY:
                    store(path, kept, settings or {})
                    stored = time.perf_counter()
                report(what, min(rows.block * study.block + rows.end, of), of)
            if path is not None:
                store(path, kept, settings or {})
    report("runs", count, count)
    return Comparison(
        study,
        seed,
        count,
        chosen,
        totals.escaped,
        {name: measures(s) for name, s in totals.all.items()},
        failures,
        dict(totals.all),
        by,
        _costs(work, report),
        _optimum(totals, N),
        None if totals.told is None else bound(study, totals.told),
        no_bound,
        prepared,
        {} if study.extra is None else study.extra(),
        tuple(single_run(work, run) for run in show),
        time.perf_counter() - begun,
        (*((note,) if note else ()), *folding_notes(study, chosen)),
    )


def _parts(count: int, block: int, size: int) -> list[Rows]:
    """The first `count` runs in parts of `size`, none of which reaches over the end of a block."""
    return [
        Rows(first // block, first % block, first % block + min(size, count - first)) for first in range(0, count, size)
    ]


def _within(totals: Totals, blocks: Sequence[Rows], pieces: Sequence[Rows], study: Study, particles: int) -> Totals:
    """What of former sums belongs to so many runs: all of it, all but the optimum, or nothing."""
    if totals.blocks > sum(rows.end == study.block for rows in blocks):
        return NOTHING
    if totals.pieces > sum(rows.end - rows.first == study.piece(particles) for rows in pieces):
        return totals._replace(pieces=0, paired={})
    return totals


def _jobs(workers: int | None) -> int:
    """How many blocks are worked on at once."""
    if workers == 1:
        return 1
    backend, _ = get_active_backend(prefer="threads")
    jobs = joblib.effective_n_jobs(workers or -1)
    # While the engine, which has threads of its own, works for one, another draws and sums.
    return 2 * jobs if workers is None and getattr(backend, "uses_threads", False) else jobs


def _dealt(make: Callable[[Rows], Any], parts: Sequence[Rows], jobs: int, chunk: int) -> Iterator[tuple[Rows, Any]]:
    """What is made of each of the parts, in their order, in groups that take about `_GROUP` seconds."""
    # The first alone, so that there is something to be stored early.
    at, many = 0, chunk
    while at < len(parts):
        group = parts[at : at + many]
        begun = time.perf_counter()
        if jobs == 1:
            yield from ((rows, make(rows)) for rows in group)
        else:
            calls = (joblib.delayed(_made)(make, group[k : k + chunk]) for k in range(0, len(group), chunk))
            found = joblib.Parallel(n_jobs=jobs, prefer="threads")(calls)
            yield from zip(group, (one for some in found for one in some), strict=True)
        taken = time.perf_counter() - begun
        at += len(group)
        many = 2 * many if taken < _GROUP / 2 else many // 2 if taken > _GROUP else many
        many = max(many, jobs * chunk)


def _made(make: Callable[[Rows], Any], parts: Sequence[Rows]) -> list[Any]:
    return [make(rows) for rows in parts]


def _tried(first: Runs, report: Report) -> tuple[dict[str, Sums], dict[str, str], dict[str, float]]:
    """The sums of the first block, why each filter that cannot be run cannot, and how long each took to compile."""
    work, sums, failures, prepared = first.work, {}, {}, {}
    for k, name in enumerate(work.filters):
        report("compiling", k, len(work.filters))
        try:
            begun = time.perf_counter()
            found = estimate(work, name, first.drawn)
            taken = time.perf_counter() - begun
            if taken > _WORTH_TELLING:
                begun = time.perf_counter()
                found = estimate(work, name, first.drawn)
                taken -= time.perf_counter() - begun
                prepared[name] = max(taken, 0.0)
            if len(first.kept):
                sums[name] = first.added(found)
        except Exception as error:  # whatever a filter or a user's function raises, the others go on
            failures[name] = str(error) or type(error).__name__
    report("compiling", len(work.filters), len(work.filters))
    return sums, failures, prepared


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
    half, whole = (measures(totals.paired[name]) for name in (OPTIMUM, CHECK))
    return Optimum(N, half, whole, tends_to(half, whole), filters)

"""Many runs of a study with all its filters, and what they say."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import joblib
from joblib.parallel import get_active_backend

from sigmax.filters import Filter, get
from sigmax.studies.beforehand import check, chosen_filters, settings_of, yardsticks
from sigmax.studies.bound import absent, bound
from sigmax.studies.comparison import Comparison, Optimum
from sigmax.studies.cost import Cost, costs
from sigmax.studies.measures import measures
from sigmax.studies.progress import FILE, NOTHING, Totals, add, restore, store
from sigmax.studies.study import Study
from sigmax.studies.sums import Sums
from sigmax.studies.work import CHECK, OPTIMUM, Block, Done, Work, block, estimate

_STORED_EVERY = 5.0  # seconds
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
        folder: where sums are kept, so that a study that was stopped goes on, and one that is repeated
            with more runs only makes those that are new.
        backend: as in `run`.
        report: called with what is being done, how much is done, and of how much.

    Raises:
        InputError: before anything is computed, for whatever does not fit. A filter that fails is data:
            `Comparison.failures`, and the lost runs of its measures.
    """
    begun = time.perf_counter()
    chosen = chosen_filters(study, filters)
    count = study.runs if runs is None else runs
    N = study.particles if particles is None else particles
    check(study, count, N, workers, chunk, backend)
    size = study.block
    by = yardsticks(study, backend)
    no_bound = absent(study)
    work = Work(study, chosen, by, seed, not no_bound, backend)
    settings = settings_of(study, chosen, seed, N, backend)
    path = None if folder is None or settings is None else Path(folder) / FILE
    totals = NOTHING if path is None else restore(path, settings or {})
    whole, rest = divmod(count, size)
    if totals.blocks > whole:
        totals = NOTHING
    sizes_ = [size] * whole + ([rest] if rest else [])
    with_optimum = -(-min(study.optimum_runs, count) // size) if N else 0

    def todo(number: int) -> tuple[int, int, int]:
        return number, sizes_[number], N if number < with_optimum else 0

    first = Block(work, 0, sizes_[0])
    sums, failures, prepared = _tried(first, report)
    work = work.without(list(failures))
    if not work.filters:
        totals = NOTHING
        sizes_ = []
    if sizes_ and not totals.blocks:
        report("runs", 0, count)
        totals = add(totals, first.done(sums, todo(0)[2]))
    del first, sums
    stored = time.perf_counter()
    kept = totals if totals.blocks <= whole else NOTHING
    jobs = _jobs(workers)
    at = totals.blocks
    while at < len(sizes_):
        report("runs", min(at * size, count), count)
        group = [todo(k) for k in range(at, min(at + chunk * jobs * 2, len(sizes_)))]
        for done, (number, made, _) in zip(_dealt(work, group, jobs, chunk), group, strict=True):
            totals = add(totals, done)
            if made == size:
                kept = totals
            at = number + 1
        if path is not None and time.perf_counter() - stored > _STORED_EVERY:
            store(path, kept, settings or {})
            stored = time.perf_counter()
    if path is not None:
        store(path, kept, settings or {})
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


def _jobs(workers: int | None) -> int:
    """How many blocks are worked on at once."""
    if workers == 1:
        return 1
    backend, _ = get_active_backend(prefer="threads")
    jobs = joblib.effective_n_jobs(workers or -1)
    # While the engine, which has threads of its own, works for one, another draws and sums.
    return 2 * jobs if workers is None and getattr(backend, "uses_threads", False) else jobs


def _dealt(work: Work, group: Sequence[tuple[int, int, int]], jobs: int, chunk: int) -> list[Done]:
    """The blocks of a group, in their order."""
    if jobs == 1:
        return [block(work, *one) for one in group]
    parts = [group[k : k + chunk] for k in range(0, len(group), chunk)]
    made = joblib.Parallel(n_jobs=jobs, prefer="threads")(joblib.delayed(_blocks)(work, part) for part in parts)
    return [done for part in made for done in part]


def _blocks(work: Work, group: Sequence[tuple[int, int, int]]) -> list[Done]:
    return [block(work, *one) for one in group]


def _tried(first: Block, report: Report) -> tuple[dict[str, Sums], dict[str, str], dict[str, float]]:
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
    return Optimum(N, measures(totals.paired[OPTIMUM]), measures(totals.paired[CHECK]), filters)

"""What is done for one block of runs, by whatever process or machine has time for it."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import cloudpickle
import jax
import numpy as np

from sigmax.filters import Filter
from sigmax.running.run import run
from sigmax.studies.bank import bank
from sigmax.studies.bound import Information, information
from sigmax.studies.particles import particles
from sigmax.studies.simulate import Drawn, cut, draw
from sigmax.studies.study import Study
from sigmax.studies.sums import Estimated, Sums, Yardsticks, summed

# The optimum and the same with twice the particles, which shows its own error.
OPTIMUM, CHECK = "optimum", "optimum, twice the particles"


class Rows(NamedTuple):
    """Runs of a block: its number, the first of them, and one after the last."""

    block: int
    first: int
    end: int


class Done(NamedTuple):
    """What became of some runs: sums by filter, runs that escaped, and what their truth tells for the bound."""

    sums: dict[str, Sums]
    escaped: int
    told: Information | None


class Work:
    """All that a worker needs to know; pickled once and read once in each process.

    Attributes:
        study: the study.
        filters: by name.
        by: what errors are held against.
        seed: of the whole study.
        bounded: whether the bound is wanted.
        backend: as in `run`.
    """

    def __init__(
        self,
        study: Study,
        filters: Mapping[str, Filter],
        by: Yardsticks,
        seed: int,
        bounded: bool,
        backend: str | None,
    ) -> None:
        self.study, self.filters, self.by = study, dict(filters), by
        self.seed, self.bounded, self.backend = seed, bounded, backend
        self._pickled: bytes | None = None

    def without(self, names: Sequence[str]) -> "Work":
        """The same without some filters."""
        kept = {name: f for name, f in self.filters.items() if name not in names}
        return Work(self.study, kept, self.by, self.seed, self.bounded, self.backend)

    def __reduce__(self) -> tuple[Any, ...]:
        if self._pickled is None:
            state = (self.study, self.filters, self.by, self.seed, self.bounded, self.backend)
            self._pickled = cloudpickle.dumps(state)
        return _work, (self._pickled,)


@lru_cache(maxsize=4)
def _work(pickled: bytes) -> Work:
    """The same object for the same bytes, so that a process compiles its filters once."""
    return Work(*cloudpickle.loads(pickled))


def estimate(work: Work, name: str, drawn: Drawn) -> Estimated:
    """What one filter makes of a block."""
    study = work.study
    model, prior = study.model_and_prior(drawn.mean)
    z: Any = drawn.z if study.model.several else drawn.z[""]
    keep = ("mean", "factor", "fault", "nis", "dof")
    found = run(work.filters[name], model, prior, z, dt=study.dt, inputs=study.inputs, keep=keep, backend=work.backend)
    mean, factor = found.joint()
    return Estimated(mean, factor, found.fault, found.nis, found.dof)


def _optimum(work: Work, drawn: Drawn, count: int, seed: tuple[int, ...]) -> Estimated:
    study = work.study
    if study.optimum == "bank":
        return bank(study, drawn, count, seed, work.backend)
    return particles(study, drawn, count, seed, study.optimum, work.backend)


class Runs:
    """Some runs of one block, and what is added up of estimates of them.

    Args:
        work: the work.
        rows: which runs.
    """

    def __init__(self, work: Work, rows: Rows) -> None:
        self.work, self.rows = work, rows
        self.drawn = cut(draw(work.study, work.seed, rows.block, work.backend), rows.first, rows.end)
        self.kept = np.flatnonzero(self.drawn.kept)
        self.truth, self.last = self.drawn.truth[self.kept], None
        if work.study.mirror is not None:
            self.last = np.asarray(jax.vmap(work.study.mirror)(self.truth[:, -1]))

    def added(self, found: Estimated) -> Sums:
        """The sums of an estimate."""
        kept = found if len(self.kept) == len(found.mean) else Estimated(*(a[self.kept] for a in found))
        return summed(kept, self.truth, self.last, self.work.by, self.work.backend)

    def filtered(self) -> dict[str, Sums]:
        """The sums of all filters; none where every run escaped."""
        names = self.work.filters if len(self.kept) else {}
        return {name: self.added(estimate(self.work, name, self.drawn)) for name in names}

    def done(self, sums: Mapping[str, Sums]) -> Done:
        """The runs with the sums of their filters."""
        work, told = self.work, None
        if work.bounded and len(self.kept):
            told = information(work.study, self.drawn, self.kept, work.backend)
        return Done(dict(sums), len(self.drawn.kept) - len(self.kept), told)


def block(work: Work, rows: Rows) -> Done:
    """The sums of all filters over some runs."""
    runs = Runs(work, rows)
    return runs.done(runs.filtered())


def beside_the_optimum(work: Work, rows: Rows, count: int) -> dict[str, Sums]:
    """The sums of the optimum with `count` particles, with twice as many, and of all filters over the same runs."""
    runs = Runs(work, rows)
    every = runs.filtered()
    if len(runs.kept):
        for k, name in enumerate((OPTIMUM, CHECK), start=1):
            seed = work.seed, rows.block, rows.first, k
            every[name] = runs.added(_optimum(work, runs.drawn, k * count, seed))
    return every

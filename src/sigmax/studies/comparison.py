"""What a study says."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from sigmax.filters import Filter
from sigmax.studies.cost import Cost
from sigmax.studies.measures import Measures
from sigmax.studies.single_run import SingleRun
from sigmax.studies.study import Study
from sigmax.studies.sums import Sums, Yardsticks
from sigmax.views import words


class Optimum(NamedTuple):
    """The optimum by particles over the runs in which it was computed.

    Attributes:
        particles: N.
        measures: of the optimum.
        check: of the same with 2N particles.
        limit: what both tend to with ever more of them, see `measures.tends_to`.
        filters: of the filters over the same runs.
    """

    particles: int
    measures: Measures
    check: Measures
    limit: Measures
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
        extra: what the study finds at its end besides, for the summary.
        shown: the runs that were to be kept whole.
        seconds: how long it all took.
        notes: what else is to be known, as that former sums could not be used.
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
    extra: Mapping[str, Any]
    shown: tuple[SingleRun, ...]
    seconds: float
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        names, units = self.study.model.state, self.study.units
        named = [f"{n} [{u}]" if u else str(n) for n, u in zip(names, (*units, *[""] * len(names)), strict=False)]
        rows = [("RMSE, last", f"{', '.join(named)}; NEES of {self.study.model.dim} expected")]
        for name in self.filters:
            found = self.measures.get(name)
            if found is None:
                rows.append((name, f"could not be run: {self.failures.get(name, '')}"))
                continue
            rmse = ", ".join(f"{v:.4g}" for v in found.rmse.value[-1])
            rows.append((name, f"{rmse}; NEES {found.nees.value[-1]:.3g}, lost {float(found.lost['all'].value):.2%}"))
        title = f"Comparison of {words.counted(len(self.filters), 'filter')} on {self.study.name}"
        return words.text(f"{title}: {words.counted(self.runs, 'run')}", rows)

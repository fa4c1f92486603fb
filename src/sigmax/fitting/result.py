"""What a fit found."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sigmax.fitting.search import Parameters
from sigmax.views import words
from sigmax.views.draw import draw
from sigmax.views.panels import Line, Panel

# What the log-likelihood has lost where a 95 % interval ends.
INTERVAL = 1.92
# Correlations from here on are said.
_CORRELATED = 0.5


class HeldOut(NamedTuple):
    """The later steps of a record, whose likelihood judges what the earlier ones gave.

    Attributes:
        steps: how many, of all tracks and records.
        before: their log-likelihood with the numbers at the start.
        after: with those of greatest likelihood of the steps before.
    """

    steps: int
    before: float
    after: float


class Along(NamedTuple):
    """The log-likelihood along one number, the others going with it as their correlation has it.

    Attributes:
        name: of the number.
        values: (K,).
        lost: log-likelihood less than at the maximum (K,).
    """

    name: str
    values: np.ndarray
    lost: np.ndarray


@dataclass(frozen=True, repr=False)
class Fit:
    """What `fit` found.

    Attributes:
        parameters: the values of greatest likelihood, by name.
        std: their standard errors from the curvature of the log-likelihood; NaN where it has none.
        log_likelihood: at these values.
        converged: whether the search ended at a maximum.
        message: how it ended.
        evaluations: how often the filter was run over the record.
        undetermined: what the record does not tell, in words; empty where it tells all.
        labels: what each of the p numbers is called, those of arrays one by one.
        covariance: of the p numbers (p, p), NaN for those that are not determined.
        start: the parameters at the start.
        start_log_likelihood: there.
        held_out: how steps that were left out judge the fit of the others; None where none were.
        along: the log-likelihood along each number.
        filter: whose likelihood it is.
    """

    parameters: Parameters
    std: Parameters
    log_likelihood: float
    converged: bool
    message: str
    evaluations: int
    undetermined: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    covariance: np.ndarray | None = None
    start: Parameters | None = None
    start_log_likelihood: float = float("nan")
    held_out: HeldOut | None = None
    along: tuple[Along, ...] = ()
    filter: str = ""

    @property
    def correlation(self) -> np.ndarray | None:
        """Of the p numbers (p, p)."""
        if self.covariance is None:
            return None
        deviation = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(deviation, deviation))

    @property
    def status(self) -> int:
        """0 where all is told, 1 where something is not determined or no maximum was found."""
        return 0 if self.converged and not self.undetermined else 1

    def __repr__(self) -> str:
        rows = []
        for name, value in self.parameters.items():
            best, std = np.ravel(value), np.ravel(self.std[name])
            said = [words.measured(float(v), float(s)) for v, s in zip(best, std, strict=True)]
            rows.append((name, ", ".join(said)))
        rows += [("correlated", said) for said in self.correlated()]
        gain = self.log_likelihood - self.start_log_likelihood
        gained = f", {gain:+,.4g} from the start" if np.isfinite(gain) else ""
        rows.append(("log-likelihood", f"{self.log_likelihood:,.6g}{gained}"))
        if self.held_out is not None:
            change = self.held_out.after - self.held_out.before
            rows.append(("held out", f"{self.held_out.steps:,} steps, {change:+,.4g} from the start"))
        rows += [("not determined", said) for said in self.undetermined]
        return words.text("Fit" if self.converged else f"Fit that did not converge: {self.message}", rows)

    def correlated(self) -> list[str]:
        """Pairs of numbers whose errors go together, in words."""
        C = self.correlation
        if C is None:
            return []
        pairs = [(i, j) for i in range(len(C)) for j in range(i) if abs(C[i, j]) > _CORRELATED]
        return [f"{self.labels[j]} and {self.labels[i]}, {C[i, j]:.2f}" for i, j in pairs]

    def plot(self, library: str = "plotly") -> Any:
        """The log-likelihood along each number, a figure of "plotly" or "matplotlib".

        Raises:
            InputError: for another library, or one that is not installed.
        """
        return draw(self.panels(), "Log-likelihood along each number", library)

    def panels(self) -> list[Panel]:
        """What the picture shows: a number to the right, upwards the log-likelihood less its maximum."""
        found = []
        for one in self.along:
            edge = Line("95 % interval", one.values, np.full(len(one.values), -INTERVAL), style="limit")
            found.append(
                Panel(one.name, "log-likelihood", (Line("likelihood", one.values, -one.lost), edge), (-6.0, 0.3))
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """As data that JSON can hold; NaN is None."""
        held = None if self.held_out is None else self.held_out._asdict()
        return {
            "parameters": {k: _plain(v) for k, v in self.parameters.items()},
            "std": {k: _plain(v) for k, v in self.std.items()},
            "start": None if self.start is None else {k: _plain(v) for k, v in self.start.items()},
            "labels": list(self.labels),
            "correlation": _plain(self.correlation),
            "log_likelihood": self.log_likelihood,
            "start_log_likelihood": _plain(self.start_log_likelihood),
            "held_out": held,
            "undetermined": list(self.undetermined),
            "converged": self.converged,
            "message": self.message,
            "evaluations": self.evaluations,
            "filter": self.filter,
            "along": {one.name: {"values": _plain(one.values), "lost": _plain(one.lost)} for one in self.along},
        }


def _plain(value: Any) -> Any:
    if value is None:
        return None
    array = np.asarray(value, float)
    if array.ndim:
        return [_plain(v) for v in array]
    return float(array) if np.isfinite(array) else None

"""Running filters: a record or a batch in one call, live step by step, backwards, and for a fit."""

from sigmax.live.contributions import absorb, contribution
from sigmax.live.live import Live
from sigmax.live.message import Contribution
from sigmax.results.result import Result
from sigmax.results.smoothed import Smoothed
from sigmax.results.weighing import weights
from sigmax.running.blocks import run_in_blocks
from sigmax.running.constrained import constrained
from sigmax.running.filter_fit import FilterFit, fit_filter
from sigmax.running.run import run
from sigmax.running.smooth import smooth
from sigmax.running.smoothing_in_windows import smooth_in_windows
from sigmax.running.start import start
from sigmax.running.tails import fit_tails
from sigmax.steps.step import Fault

__all__ = [
    "Contribution",
    "Fault",
    "FilterFit",
    "Live",
    "Result",
    "Smoothed",
    "absorb",
    "constrained",
    "contribution",
    "fit_filter",
    "fit_tails",
    "run",
    "run_in_blocks",
    "smooth",
    "smooth_in_windows",
    "start",
    "weights",
]

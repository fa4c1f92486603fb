"""Running filters: a record or a batch in one call, live step by step, backwards, and for a fit."""

from sigmax.running.blocks import run_in_blocks
from sigmax.running.constrained import constrained
from sigmax.running.contributions import absorb, contribution
from sigmax.running.filter_fit import FilterFit, fit_filter
from sigmax.running.live import Live
from sigmax.running.message import Contribution
from sigmax.running.result import Result
from sigmax.running.run import run
from sigmax.running.smooth import smooth
from sigmax.running.smoothed import Smoothed
from sigmax.running.smoothing_in_windows import smooth_in_windows
from sigmax.running.start import start
from sigmax.running.step import Fault
from sigmax.running.tails import fit_tails
from sigmax.running.weighing import weights

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

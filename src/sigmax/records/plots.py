"""A record of plots: nobody says which plot belongs to which target."""

from collections.abc import Callable
from dataclasses import dataclass

import pandas as pd

from sigmax.files.frame import Placed
from sigmax.files.units import Dimension
from sigmax.filters import Filter
from sigmax.tracking import Cycle, Scan, Truth


@dataclass(frozen=True)
class PlotRecord:
    """Scans and how to make tracks of them.

    Attributes:
        name: short, for folders and tables.
        title: in words.
        scans: as they came; their order need not be that of time.
        cycle: gives the cycle with a filter.
        filter: the filter if nothing else is said.
        window: seconds by which scans may be late.
        truth: where targets really were, as far as it is known.
        cutoff: m; a track farther from a target than this does not follow it.
        dimensions: of the components of the state.
        epoch: the instant of time 0, where the source tells.
        skipped: rows of the data that could not be read, quoted.
        source: where the data come from.
        licence: the terms they are under.
        notes: what a reader of the results should know.
        placed: where the state lies on the Earth, or None.
    """

    name: str
    title: str
    scans: tuple[Scan, ...]
    cycle: Callable[[Filter], Cycle]
    filter: str
    window: float
    truth: tuple[Truth, ...]
    cutoff: float
    dimensions: tuple[Dimension, ...]
    epoch: pd.Timestamp | None = None
    skipped: tuple[str, ...] = ()
    source: str = ""
    licence: str = ""
    notes: tuple[str, ...] = ()
    placed: Placed | None = None

"""What is to be said before a run, because nothing fails in it."""

import warnings

from sigmax.errors import BendingWarning, FoldingWarning
from sigmax.filters import Filter
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.preparation.bending import bending
from sigmax.preparation.folding import folding


def warn_before(filter: Filter, model: Model, prior: Gaussian, inputs: int | None) -> None:
    """Warn of what `folding` and `bending` find; the arguments are those of `folding`."""
    for said in folding(filter, model, prior, inputs):
        warnings.warn(said, FoldingWarning, stacklevel=4)
    for said in bending(filter, model, prior):
        warnings.warn(said, BendingWarning, stacklevel=4)

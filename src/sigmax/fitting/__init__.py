"""Numbers of models, of their noises and priors, by the likelihood of records."""

from sigmax.fitting.em import Em, em
from sigmax.fitting.fit import fit
from sigmax.fitting.parametric_model import Build
from sigmax.fitting.result import Along, Fit, HeldOut

__all__ = ["Along", "Build", "Em", "Fit", "HeldOut", "em", "fit"]

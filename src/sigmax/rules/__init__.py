"""Rules: a nonlinear function of a Gaussian replaced by its statistical linear regression."""

from sigmax.rules.linearization import Linearization, Rule
from sigmax.rules.marginal import Marginal
from sigmax.rules.sets import (
    cubature,
    gauss_hermite,
    projected,
    scaled,
    simplex,
    unscented,
)
from sigmax.rules.sigma import SigmaPoints
from sigmax.rules.sigma_set import SigmaSet, sigma_set
from sigmax.rules.taylor import Taylor, Taylor1, Taylor2

__all__ = [
    "Linearization",
    "Marginal",
    "Rule",
    "SigmaPoints",
    "SigmaSet",
    "Taylor",
    "Taylor1",
    "Taylor2",
    "cubature",
    "gauss_hermite",
    "projected",
    "scaled",
    "sigma_set",
    "simplex",
    "unscented",
]

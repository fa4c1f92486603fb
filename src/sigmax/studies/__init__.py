"""Monte Carlo studies: what each filter is worth on a scenario, what it costs, and how far it is from the optimum."""

from sigmax.studies.comparing import compare
from sigmax.studies.comparison import Comparison, Optimum
from sigmax.studies.load import load_studies
from sigmax.studies.measures import Bounded, Figure, Measures
from sigmax.studies.study import Study, undisturbed

__all__ = [
    "Bounded",
    "Comparison",
    "Figure",
    "Measures",
    "Optimum",
    "Study",
    "compare",
    "load_studies",
    "undisturbed",
]

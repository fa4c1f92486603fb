"""What a function reads, what that costs, and in which order its arguments are best drawn (Belov et al.)."""

from sigmax.dependence.line import Line, straightened
from sigmax.dependence.order import best_order, total_cost
from sigmax.dependence.plan import Plan, planned
from sigmax.dependence.reads import Part, Reading, reading
from sigmax.dependence.weights import complexity, permutation, weight_matrix

__all__ = [
    "Line",
    "Part",
    "Plan",
    "Reading",
    "best_order",
    "complexity",
    "permutation",
    "planned",
    "reading",
    "straightened",
    "total_cost",
    "weight_matrix",
]

"""Pure functions of small arrays lowered to scalar operations, printed as C over vector lanes, and called.

Nothing here knows what a filter is.
"""

from sigmax.native.build import Unavailable
from sigmax.native.graph import Graph
from sigmax.native.machine import compiler
from sigmax.native.pieces import Program
from sigmax.native.primitives.interpret import evaluate
from sigmax.native.refusal import Defect, Refused

__all__ = [
    "Defect",
    "Graph",
    "Program",
    "Refused",
    "Unavailable",
    "compiler",
    "evaluate",
]

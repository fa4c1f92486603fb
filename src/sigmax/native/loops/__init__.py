"""Functions of large arrays as C with loops over their elements, where a straight line would be too long."""

from sigmax.native.loops.flat import flat, operations
from sigmax.native.loops.program import Loops, loops_in, written

__all__ = ["Loops", "flat", "loops_in", "operations", "written"]

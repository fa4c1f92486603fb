"""The functions of the algebra that stay one operation in a trace, by the names that `sigmax.algebra.kernel` gives."""

from collections.abc import Callable
from math import prod
from typing import Any, NamedTuple

Shape = tuple[int, ...]


class Kernel(NamedTuple):
    """A function of the algebra.

    Attributes:
        axes: the axes of its arguments for which kernels.h has a loop; for others its body is written out.
        operations: about how many scalar operations it takes, from the shapes of its arguments.
    """

    axes: tuple[tuple[int, ...], ...]
    operations: Callable[..., int]

    def fits(self, equation: Any) -> bool:
        """Whether there is a loop for an equation."""
        return tuple(len(v.aval.shape) for v in equation.invars) in self.axes


def _product(a: Shape, b: Shape) -> int:
    return 2 * prod(a) * prod(b) // max(a[1], 1)


def _inner(a: Shape, b: Shape) -> int:
    return 2 * prod(a) * prod(b) // max(a[0], 1)


def _third_of_cube(a: Shape) -> int:
    return a[0] ** 3 // 3


KERNELS = {
    "sigmax_times": Kernel(((2, 1),), _product),
    "sigmax_product": Kernel(((2, 2),), _product),
    "sigmax_outer": Kernel(((2, 2),), _product),
    "sigmax_inner": Kernel(((2, 2),), _inner),
    "sigmax_cholesky": Kernel(((2,),), _third_of_cube),
    "sigmax_tria": Kernel(((2,),), lambda a: 2 * a[0] ** 2 * a[1] - 2 * a[0] ** 3 // 3),
    "sigmax_absorb": Kernel(((2, 2, 2), (1, 2, 2)), lambda _, a, b: 2 * a[0] * (a[0] + 2 * b[0]) * a[1]),
    "sigmax_release": Kernel(((2, 2, 2),), lambda a, v, b: 2 * a[0] * (a[0] + 2 * b[0]) * v[1]),
    "sigmax_solve_lower": Kernel(((2, 1), (2, 2)), lambda a, b: a[0] * prod(b)),
    "sigmax_inverse_lower": Kernel(((2,),), _third_of_cube),
}

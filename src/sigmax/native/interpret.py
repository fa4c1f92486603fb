"""A traced function evaluated over scalars: its jaxpr interpreted with arrays of nodes."""

from collections.abc import Callable, Sequence
from typing import Any

from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from sigmax.native.graph import Array, Graph, boxed
from sigmax.native.refusal import Refused, line_of

# A rule takes the graph, the equation and its arguments, and gives an array or a list of them.
Rule = Callable[..., Any]
RULES: dict[str, Rule] = {}
# Primitives whose rules take a table as it is.
_TABLES: set[str] = set()

# Beyond this a straight line takes compilers too long.
_LARGEST = 1_500_000


def rule(*names: str, tables: bool = False) -> Callable[[Rule], Rule]:
    """Let a function be the rule of these primitives; with `tables` it takes tables unopened."""

    def register(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        _TABLES.update(names if tables else ())
        return function

    return register


def evaluate(g: Graph, closed: ClosedJaxpr, arguments: Sequence[Array]) -> list[Array]:
    """The outputs of a closed jaxpr as arrays of nodes.

    Raises:
        Refused: for a primitive that no rule covers, or whose rule refuses it.
    """
    made = evaluate_open(g, closed.jaxpr, [g.constants(c) for c in closed.consts], arguments)
    return [g.opened(array) for array in made]


def evaluate_open(g: Graph, jaxpr: Jaxpr, constants: Sequence[Array], arguments: Sequence[Array]) -> list[Array]:
    """The outputs of a jaxpr with its constants given."""
    known: dict[Any, Array] = dict(zip(jaxpr.constvars, constants, strict=True))
    known |= zip(jaxpr.invars, arguments, strict=True)

    def read(variable: Any) -> Array:
        return g.constants(variable.val) if isinstance(variable, Literal) else known[variable]

    outer = g.label
    for equation in jaxpr.eqns:
        g.label = outer or str(equation.source_info.name_stack).partition("/")[0]
        try:
            results = apply_rule(g, equation, [read(v) for v in equation.invars])
        except Refused as error:
            # The outermost line wins: the body of a function that JAX has traced before remembers another caller.
            raise Refused(error.what, line_of(equation) or error.where) from None
        if len(g.nodes) > _LARGEST:
            raise Refused(f"the step has more than {_LARGEST} scalar operations")
        known |= zip(equation.outvars, results, strict=True)
    g.label = outer
    return [read(v) for v in jaxpr.outvars]


def apply_rule(g: Graph, equation: Any, arguments: Sequence[Array]) -> list[Array]:
    """The results of one equation.

    Raises:
        Refused: for a primitive that no rule covers, or whose rule refuses it.
    """
    name = equation.primitive.name
    found: Rule = RULES.get(name, _unknown)
    made: Any = found(g, equation, *(arguments if name in _TABLES else map(g.opened, arguments)))
    return [boxed(value) for value in (made if equation.primitive.multiple_results else [made])]


def _unknown(g: Graph, equation: Any, *arrays: Array) -> Array:
    raise Refused(f"the operation {equation.primitive.name!r} cannot be lowered to C")

"""A traced function evaluated over scalars: its jaxpr interpreted with arrays of nodes."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from sigmax.native.graph import Array, Graph, boxed, numbers_of
from sigmax.native.primitives.folding import folded
from sigmax.native.refusal import Defect, Refused, defects_raised, line_of

# A rule takes the graph, the equation and its arguments, and gives an array or a list of them.
Function = Callable[..., Any]


class LoweringRule(NamedTuple):
    """How a primitive is lowered.

    Attributes:
        function: of the graph, the equation and arrays of nodes.
        parameters: those of the equation that it takes into account, or that change no number.
        moves: whether it only moves elements about, so that arrays of known numbers may stay as they are.
        any_width: whether floats of another width than the graph's pass it unchanged.
        tables: whether it takes arrays of known numbers beside arrays of nodes.
        calls: whether it evaluates other functions.
    """

    function: Function
    parameters: frozenset[str]
    moves: bool = False
    any_width: bool = False
    tables: bool = False
    calls: bool = False


# Of what means the same for numbers and integers, or takes no integers; and of what computes integers from integers.
RULES: dict[str, LoweringRule] = {}
INTEGER_RULES: dict[str, LoweringRule] = {}

# Beyond this nothing comes out that is small enough for a compiler: see `pieces`.
_LARGEST = 300_000
# Loops of known numbers alone are run, not written out.
_RUN = ("while", "scan")


def rule(
    *names: str,
    parameters: str = "",
    moves: bool = False,
    any_width: bool = False,
    tables: bool = False,
    calls: bool = False,
    integers: bool | None = None,
) -> Callable[[Function], Function]:
    """Let a function be the rule of these primitives: see `LoweringRule`.

    Args:
        names: of the primitives.
        parameters: what it takes into account; any other that is set is refused.
        moves: see `LoweringRule`.
        any_width: see `LoweringRule`.
        tables: see `LoweringRule`.
        calls: see `LoweringRule`.
        integers: whether the rule is for operations with integers; None is for operations with and without.
    """

    def register(function: Function) -> Function:
        known = frozenset(parameters.split())
        new = LoweringRule(function, known, moves, any_width or moves, tables or moves or calls, calls)
        if not integers:
            RULES.update(dict.fromkeys(names, new))
        if integers is not False:
            INTEGER_RULES.update(dict.fromkeys(names, new))
        return function

    return register


def evaluate(g: Graph, closed: ClosedJaxpr, arguments: Sequence[Array]) -> list[Array]:
    """The outputs of a closed jaxpr as arrays of nodes.

    Raises:
        Refused: for a primitive that no rule covers, or whose rule refuses it.
    """
    return [g.opened(array) for array in evaluate_closed(g, closed, arguments)]


def evaluate_closed(g: Graph, closed: ClosedJaxpr, arguments: Sequence[Array]) -> list[Array]:
    """The same, where what is known may stay an array of numbers."""
    jaxpr = closed.jaxpr
    constants = [numbers_of(c, dtype_of(v)) for c, v in zip(closed.consts, jaxpr.constvars, strict=True)]
    return evaluate_open(g, jaxpr, constants, arguments)


def evaluate_open(g: Graph, jaxpr: Jaxpr, constants: Sequence[Array], arguments: Sequence[Array]) -> list[Array]:
    """The outputs of a jaxpr with its constants given."""
    known: dict[Any, Array] = dict(zip(jaxpr.constvars, constants, strict=True))
    known |= zip(jaxpr.invars, arguments, strict=True)

    def read(variable: Any) -> Array:
        return numbers_of(variable.val, dtype_of(variable)) if isinstance(variable, Literal) else known[variable]

    outer = g.label
    for equation in jaxpr.eqns:
        g.label = outer or str(equation.source_info.name_stack).partition("/")[0]
        results = apply_rule(g, equation, [read(v) for v in equation.invars])
        if len(g.nodes) > _LARGEST:
            raise Refused(
                f"a step of more than {_LARGEST:,} scalar operations cannot be lowered to C", line_of(equation)
            )
        known |= zip(equation.outvars, results, strict=True)
    g.label = outer
    return [read(v) for v in jaxpr.outvars]


def apply_rule(g: Graph, equation: Any, arguments: Sequence[Array]) -> list[Array]:
    """The results of one equation.

    Raises:
        Refused: for a primitive that no rule covers, or whose rule refuses it, with the line it came from; a `Defect`
            where the rule fails.
    """
    try:
        return _applied(g, equation, arguments)
    except Refused as error:
        # The outermost line wins: the body of a function that JAX has traced before remembers another caller.
        raise type(error)(error.what, line_of(equation) or error.where) from error.__cause__
    except Exception as error:
        if defects_raised():
            raise
        raise Defect.of(f"the operation {equation.primitive.name!r}", error, line_of(equation)) from error


def _applied(g: Graph, equation: Any, arguments: Sequence[Array]) -> list[Array]:
    name = equation.primitive.name
    if not all(hasattr(v.aval, "dtype") for v in (*equation.invars, *equation.outvars)):
        raise Refused(f"the operation {name!r}, which orders others, cannot be lowered to C")
    types = [dtype_of(v) for v in equation.invars]
    all_types = [*types, *(dtype_of(v) for v in equation.outvars)]
    integers = any(_kind(t) in "iu" for t in all_types)
    found = (INTEGER_RULES if integers else RULES).get(name)
    arguments = [g.known(a, t) for a, t in zip(arguments, types, strict=True)]
    if all(a.dtype != object for a in arguments) and not (found and found.calls and name not in _RUN):
        # Keys are moved by JAX, which would trace what is done to them here.
        moves = found is not None and found.moves and all(isinstance(a, np.ndarray) for a in arguments)
        made = (
            found.function(g, equation, *arguments)
            if found and moves
            else folded(g, equation, arguments, found is None)
        )
        if made is not None:
            return _listed(equation, made)
    if found is None:
        of = " on integers" if integers and name in RULES else ""
        raise Refused(f"the operation {name!r}{of} cannot be lowered to C")
    for parameter, value in equation.params.items():
        if parameter not in found.parameters and not _unset(value):
            raise Refused(f"the operation {name!r} with {parameter}={value} cannot be lowered to C")
    for dtype in () if found.calls else all_types:
        g.check_type(dtype, any_width=found.any_width)
    if not found.tables:
        arguments = [g.opened(a) for a in arguments]
    return _listed(equation, found.function(g, equation, *arguments))


def _listed(equation: Any, made: Any) -> list[Array]:
    return [boxed(value) for value in (made if equation.primitive.multiple_results else [made])]


def _kind(dtype: Any) -> str:
    """As NumPy has it; of what NumPy has no type for "V"."""
    return str(getattr(dtype, "kind", "V"))


def dtype_of(variable: Any) -> Any:
    """The type of a variable of a trace."""
    return variable.aval.dtype


def _unset(value: Any) -> bool:
    return value is None or value is False or (isinstance(value, tuple | list | dict) and not value)

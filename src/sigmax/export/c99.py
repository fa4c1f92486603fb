"""A program as C99 for one number at a time: nothing but the language and its mathematical library."""

import re
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from sigmax.native.node import Node
from sigmax.native.operations import OPERATIONS
from sigmax.native.pieces import Dialect, Program, function, needed

_WHOLE = ("fabs", "sqrt", "rint", "floor", "ceil", "trunc", "round")
_CALLED = sorted({*_WHOLE, *(o.calls for o in OPERATIONS.values() if o.calls)}, key=len, reverse=True)
_FUNCTIONS = re.compile(rf"\b({'|'.join(_CALLED)})\(")


def literal(value: float, single: bool) -> str:
    """A number in C99."""
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    text = repr(float(np.float32(value)) if single else float(value))
    text = text if any(c in text for c in ".en") else f"{text}.0"
    return f"{text}f" if single else text


def c_function(program: Program, name: str, single: bool, names: Callable[[str, int], str]) -> list[str]:
    """A program as `static void name(inputs…, outputs…)`; `names` says what an input is called inside."""

    def constant(node: Node) -> str:
        if node.truth:
            return "1" if node.value else "0"
        text = literal(node.value, single)
        return f"({text})" if text.startswith("-") else text

    def spelled(node: Node, arguments: Sequence[str]) -> str:
        if node.operation == "table":
            return f"{name}_table_{node.arguments[0]}[(int){arguments[0]}]"
        text = OPERATIONS[node.operation].scalar.format(*arguments)
        return _FUNCTIONS.sub(r"\1f(", text) if single else text

    number = "float" if single else "double"
    dialect = Dialect(
        number=number,
        truth="int",
        linkage="static",
        entry="static ",
        before=("", ""),
        spell=spelled,
        constant=constant,
        fixed=lambda node: None,
        input=names,
        stored="{}",
        loaded="{} != 0",
        told="{}",
        somewhere=("{} != 0", "{} == 0"),
        unwritten=" = {0}",
        comment=lambda text: f"\n    /* {text} */" if text else "",
    )
    tables = [
        f"static const {number} {name}_table_{i}[{len(table)}] = {{{', '.join(literal(x, single) for x in table)}}};"
        for i, table in enumerate(program.graph.tables)
    ]
    return [*tables, *function(program, name, dialect)]


def count(program: Program) -> str:
    """The operations of a program in words."""
    found = Counter(n.operation for n in needed(program.results) if n.operation in OPERATIONS)
    groups = {"additions": ("+", "-"), "multiplications": ("*",), "divisions": ("/",), "square roots": ("sqrt",)}
    parts = [f"{sum(found.pop(k, 0) for k in keys)} {words}" for words, keys in groups.items()]
    calls = {k: v for k, v in found.items() if OPERATIONS[k].calls}
    parts += [f"{v} {k}" for k, v in sorted(calls.items())]
    others = sum(v for k, v in found.items() if k not in calls)
    return ", ".join([*parts, f"{others} comparisons, choices and roundings"])

"""The scalar operations that a step is lowered to: how each is computed, folded and written in C."""

import math
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np


class Operation(NamedTuple):
    """One scalar operation.

    Attributes:
        fold: its value for known numbers.
        lanes: in C over vector lanes, a format of its arguments.
        scalar: in C99, the same.
        truth: whether it gives a truth value.
        commutes: whether the order of its arguments does not matter.
        calls: the function of the mathematical library that it calls, if any.
    """

    fold: Callable[..., Any]
    lanes: str
    scalar: str
    truth: bool = False
    commutes: bool = False
    calls: str = ""

    @property
    def arity(self) -> int:
        """The number of its arguments."""
        return sum(f"{{{i}}}" in self.lanes for i in range(3))


def _arithmetic(symbol: str, fold: Callable[..., Any], commutes: bool = False) -> Operation:
    text = f"{{0}} {symbol} {{1}}"
    return Operation(fold, text, text, commutes=commutes)


def _comparison(symbol: str, lanes: str, fold: Callable[..., Any]) -> Operation:
    return Operation(fold, lanes, f"{{0}} {symbol} {{1}}", truth=True, commutes=symbol in ("==", "!="))


def _function(name: str, fold: Callable[..., Any], arity: int = 1) -> Operation:
    arguments = ", ".join(f"{{{i}}}" for i in range(arity))
    return Operation(fold, f"v_{name}({arguments})", f"{name}({arguments})", calls=name)


def _inlined(name: str, fold: Callable[..., Any], scalar: str = "", arity: int = 1) -> Operation:
    arguments = ", ".join(f"{{{i}}}" for i in range(arity))
    return Operation(fold, f"v_{name}({arguments})", scalar or f"{name}({arguments})")


def _special(name: str) -> Callable[..., Any]:
    """A function of SciPy, which takes a fifth of the time of importing this package: only where it is called."""
    return lambda *a: getattr(import_module("scipy.special"), name)(*a)


def _away_from_zero(a: float) -> float:
    if not math.isfinite(a):
        return a
    whole = math.floor(abs(a))
    return math.copysign(whole + (abs(a) - whole >= 0.5), a)


def _integer(a: float) -> float:
    return math.copysign(math.inf, a) if math.isinf(a) else 0.0 if math.isnan(a) else math.trunc(a) + 0.0


def _ordered(a: float, b: float, sign: float) -> float:
    """The larger of two by sign, NaN if there is one; of two zeros by their signs."""
    if math.isnan(a) or math.isnan(b):
        return math.nan
    return a if (sign * a, sign * math.copysign(1, a)) > (sign * b, sign * math.copysign(1, b)) else b


OPERATIONS: dict[str, Operation] = {
    "+": _arithmetic("+", np.add, commutes=True),
    "-": _arithmetic("-", np.subtract),
    "*": _arithmetic("*", np.multiply, commutes=True),
    "/": _arithmetic("/", np.divide),
    "negative": Operation(np.negative, "-{0}", "-{0}"),
    "<": _comparison("<", "v_less({0}, {1})", np.less),
    "<=": _comparison("<=", "v_at_most({0}, {1})", np.less_equal),
    ">": _comparison(">", "v_less({1}, {0})", np.greater),
    ">=": _comparison(">=", "v_at_most({1}, {0})", np.greater_equal),
    "==": _comparison("==", "v_equal({0}, {1})", np.equal),
    "!=": _comparison("!=", "v_unequal({0}, {1})", np.not_equal),
    "and": Operation(np.logical_and, "{0} & {1}", "{0} & {1}", truth=True, commutes=True),
    "or": Operation(np.logical_or, "{0} | {1}", "{0} | {1}", truth=True, commutes=True),
    "xor": Operation(np.logical_xor, "{0} ^ {1}", "{0} ^ {1}", truth=True, commutes=True),
    "not": Operation(np.logical_not, "~{0}", "!{0}", truth=True),
    "finite": Operation(np.isfinite, "v_finite({0})", "isfinite({0})", truth=True),
    "select": Operation(lambda p, a, b: a if p else b, "v_select({0}, {1}, {2})", "{0} ? {1} : {2}"),
    "select truth": Operation(
        lambda p, a, b: a if p else b, "({0} & {1}) | (~{0} & {2})", "{0} ? {1} : {2}", truth=True
    ),
    "max": _inlined(
        "max",
        lambda a, b: _ordered(a, b, 1.0),
        "({0} > {1} || {0} != {0} || ({0} == {1} && !signbit({0}))) ? {0} : {1}",
        2,
    ),
    "min": _inlined(
        "min",
        lambda a, b: _ordered(a, b, -1.0),
        "({0} < {1} || {0} != {0} || ({0} == {1} && signbit({0}))) ? {0} : {1}",
        2,
    ),
    "abs": _inlined("abs", np.abs, "fabs({0})"),
    "sqrt": _inlined("sqrt", np.sqrt),
    "rint": _inlined("rint", np.rint),
    "floor": _inlined("floor", np.floor),
    "ceil": _inlined("ceil", np.ceil),
    "trunc": _inlined("trunc", np.trunc),
    "round": _inlined("round", _away_from_zero),
    # A number as an integer, NaN as 0, no zero with a sign; and two integers divided, the rest dropped.
    "integer": _inlined("integer", _integer, "({0} == {0} ? trunc({0}) : 0) + 0"),
    "quotient": _inlined("quotient", lambda a, b: np.trunc(np.divide(a, b)), "trunc({0} / {1})", 2),
    "unsigned zero": Operation(lambda a: a + 0.0, "{0} + K(0)", "{0} + 0"),
    "sign": _inlined("sign", lambda a: np.sign(a) if a else a, "{0} > 0 ? 1 : {0} < 0 ? -1 : {0}"),
    "fmod": _function("fmod", np.fmod, 2),
    "sin": _function("sin", np.sin),
    "cos": _function("cos", np.cos),
    "tan": _function("tan", np.tan),
    "asin": _function("asin", np.arcsin),
    "acos": _function("acos", np.arccos),
    "atan": _function("atan", np.arctan),
    "sinh": _function("sinh", np.sinh),
    "cosh": _function("cosh", np.cosh),
    "tanh": _function("tanh", np.tanh),
    "asinh": _function("asinh", np.arcsinh),
    "acosh": _function("acosh", np.arccosh),
    "atanh": _function("atanh", np.arctanh),
    "exp": _function("exp", np.exp),
    "exp2": _function("exp2", np.exp2),
    "expm1": _function("expm1", np.expm1),
    "log": _function("log", np.log),
    "log1p": _function("log1p", np.log1p),
    "cbrt": _function("cbrt", np.cbrt),
    "erf": _function("erf", _special("erf")),
    "erfc": _function("erfc", _special("erfc")),
    "lgamma": _function("lgamma", _special("gammaln")),
    "atan2": _function("atan2", np.arctan2, 2),
    "pow": _function("pow", np.power, 2),
}

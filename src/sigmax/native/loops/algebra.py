"""Functions of the algebra as calls of kernels.h."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sigmax.native.loops.products import matrix_product
from sigmax.native.loops.views import View
from sigmax.native.loops.writer import Value, Writer, writes


def _triangle(square: View) -> View:
    """A matrix that is 0 above the diagonal."""
    return square._replace(zero=np.triu(np.ones(square.shape, bool), 1))


def _new_triangle(w: Writer, n: int) -> View:
    return _triangle(w.lines.new((n, n)))


def _call(w: Writer, name: str, *arguments: Any, to: View | None = None) -> None:
    given = ", ".join(w.lines.pointer(a) if isinstance(a, View) else str(a) for a in arguments)
    result = "" if to is None else f"*({w.lines.pointer(to)}) = "
    w.lines.say(f"{result}k_{name}({given});", w.label)


@writes("sigmax_times", "sigmax_product", "sigmax_outer", "sigmax_inner")
def _product(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value]:
    name = equation.primitive.name.removeprefix("sigmax_")
    a, b = (w.lying(v) if isinstance(v, np.ndarray) else w.settled(v) for v in values)
    half = name in ("outer", "inner") and a.buffer is b.buffer and np.array_equal(a.at, b.at)
    if name == "times":
        b = b.moved(lambda at: at[:, None])
    if name == "inner":
        a = a.moved(np.transpose)
    if name == "outer":
        b = b.moved(np.transpose)
    out = w.lines.new((a.shape[0], b.shape[1]))._replace(zero=_zeros_of_product(a, b))
    matrix_product(w, a, b, out, half)
    return [out.moved(lambda at: at.reshape(equation.outvars[0].aval.shape))]


def _zeros_of_product(a: View, b: View) -> np.ndarray | None:
    """Where a product is 0 because one factor of each term is."""
    if a.zero is None and b.zero is None:
        return None
    left, right = (np.ones(v.shape, int) if v.zero is None else (~v.zero).astype(int) for v in (a, b))
    zero: np.ndarray = left @ right == 0
    return zero if zero.any() else None


@writes("sigmax_absorb")
def _absorb(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value]:
    L, A, B = values
    (m, k), n = A.shape, B.shape[0]
    X = w.lines.new((m + n, k))
    w.put(A, X.moved(lambda at: at[:m]))
    w.put(B, X.moved(lambda at: at[m:]))
    X, L = w.settled(X), w.lying(L)
    factor, cross = _new_triangle(w, m), w.lines.new((n, m))
    _call(w, "absorb", m, n, k, L, m if len(L.shape) == 2 else 0, X, factor, cross, w.lines.new((2 * m,)))
    return [factor, cross, X.moved(lambda at: at[m:])]


@writes("sigmax_tria")
def _tria(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value]:
    X = w.lying(values[0], fresh=True)
    factor = _new_triangle(w, X.shape[0])
    _call(w, "tria", *X.shape, X, factor, w.lines.new((2 * X.shape[0],)))
    return [factor]


@writes("sigmax_cholesky")
def _cholesky(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value]:
    P = w.lying(values[0])
    n, epsilon = P.shape[0], float(np.finfo(equation.invars[0].aval.dtype).eps)
    factor, sound = _new_triangle(w, n), w.lines.new((), truth=True)
    _call(w, "cholesky", n, repr(8 * n * epsilon), P, factor, to=sound)
    return [factor, sound]


@writes("sigmax_release")
def _release(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value]:
    L, V, B = values
    (n, q), p = V.shape, B.shape[0]
    whole, X = w.lines.new((n + p, n)), w.lines.new((n + p, q))
    w.put(L, whole.moved(lambda at: at[:n]))
    w.put(B, whole.moved(lambda at: at[n:]))
    w.put(V, X.moved(lambda at: at[:n]))
    w.put(np.zeros((p, q)), X.moved(lambda at: at[n:]))
    whole, X, sound = w.settled(whole), w.settled(X), w.lines.new((), truth=True)
    _call(w, "release", n, p, q, whole, X, to=sound)
    factor, cross = _triangle(whole.moved(lambda at: at[:n])), whole.moved(lambda at: at[n:])
    return [factor, cross, X.moved(lambda at: at[n:]), sound]


@writes("sigmax_solve_lower")
def _solve_lower(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value]:
    L, b = (w.lying(v) for v in values)
    out = w.lines.new(b.shape)
    _call(w, "solve_lower", L.shape[0], b.shape[1] if len(b.shape) == 2 else 1, L, b, out)
    return [out]


@writes("sigmax_inverse_lower")
def _inverse_lower(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value]:
    L = w.lying(values[0])
    out = _new_triangle(w, L.shape[0])
    _call(w, "inverse_lower", L.shape[0], L, out)
    return [out]

"""Whether a traced function gives what the function itself gives, at points where both are known."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from sigmax.native import Graph, Refused, evaluate
from sigmax.native.refusal import Defect, defects_raised

Point = list[np.ndarray]
# Where nobody knows better: several sizes, and more often above zero.
_SCALES = (0.7, 3.1, 40.0)
_NEAR = {np.dtype(np.float64): 1e-8, np.dtype(np.float32): 1e-3}


def points(specs: Sequence[Any]) -> list[Point]:
    """Arguments to try where nobody knows any: of several sizes, numbers (an interval) above zero."""
    rng = np.random.default_rng(3)
    found = []
    for scale in _SCALES:
        found.append(
            [
                np.asarray(
                    scale * (rng.uniform(0.2, 1.2, s.shape) if scale < 1 or not s.shape else rng.normal(size=s.shape)),
                    s.dtype,
                )
                for s in specs
            ]
        )
    return found


def plainly(function: Callable[..., Any], at: Sequence[Point]) -> list[np.ndarray | None] | None:
    """What a function gives at points, None where it raises; None altogether where it computes with JAX.

    Raises:
        ValueError: where it gives something else for the same arguments.
    """
    found: list[np.ndarray | None] = []

    def all_called() -> int:
        for point in (*at, *at[:1]):
            try:
                made = _called(function, point)
                held = jax.tree.leaves(made)
                if any(isinstance(leaf, jax.Array) for leaf in held):
                    found.clear()
                    return 0
                found.append(np.array(_real(made), float))
            except Exception:
                found.append(None)
        return 0

    # What computes with JAX would be run operation by operation: here it is only traced.
    jax.make_jaxpr(all_called)()
    if not found:
        return None
    again, first = found.pop(), found[0]
    if again is not None and first is not None and not (again.shape == first.shape and _near(again, first, 0.0)):
        raise ValueError("it gives another result for the same arguments: random numbers, or something it remembers")
    return found


def _called(function: Callable[..., Any], point: Point) -> Any:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        # A number is one of Python, as an interval mostly is.
        return function(*(a.copy() if a.shape else float(a) for a in point))


def difference(
    function: Callable[..., Any], traced: ClosedJaxpr, at: Sequence[Point], plain: Sequence[np.ndarray | None]
) -> str:
    """What a traced function gives otherwise, in words; nothing where it gives the same.

    What rounding of the arguments alone changes as much is the same.
    """
    for point, want in zip(at, plain, strict=True):
        if want is None or not traced.out_avals:
            continue
        (got,) = numbers(traced, point)
        tolerance = _NEAR.get(point[0].dtype, 1e-8)
        if got.shape != want.shape or not (
            _near(got, want, tolerance) or _near(got, want, tolerance, _unsteadiness(function, point, want))
        ):
            where = ", ".join(np.array2string(a, precision=4) for a in point)
            return (
                f"traced it would give {np.array2string(got, precision=6)} at {where}, and called it gives "
                f"{np.array2string(want, precision=6)}"
            )
    return ""


def numbers(traced: ClosedJaxpr, point: Point) -> list[np.ndarray]:
    """What a traced function gives for known numbers."""
    g = Graph()
    try:
        made = evaluate(g, traced, [g.constants(a) for a in point])
        return [np.array([x.arguments[0] for x in a.flat], float).reshape(a.shape) for a in made]
    except (Refused, AttributeError, TypeError) as error:
        if isinstance(error, Defect) and defects_raised():
            raise
        with jax.ensure_compile_time_eval():
            return [np.asarray(_real(a), float) for a in jax.jit(jaxpr_as_fun(traced))(*point)]


def _real(a: Any) -> Any:
    """Numbers as they are, complex ones without a warning: whoever calls the function refuses them."""
    return np.real(a) if np.iscomplexobj(a) else a


def _near(got: np.ndarray, want: np.ndarray, tolerance: float, beside: Any = 0.0) -> bool:
    # Beyond where a function is defined JAX and NumPy may call the same thing NaN and infinity.
    finite = np.isfinite(want)
    size = np.abs(want[finite]).max(initial=0.0)
    allowed = np.broadcast_to(beside, want.shape)[finite] + tolerance * (np.abs(want[finite]) + size + 1e-4)
    return bool((np.abs(got[finite] - want[finite]) <= allowed).all() and not np.isfinite(got[~finite]).any())


def _unsteadiness(function: Callable[..., Any], point: Point, want: np.ndarray) -> np.ndarray:
    """How far the results move where the arguments are rounded otherwise, with room for a thousand operations."""
    rng, moved = np.random.default_rng(7), np.zeros(want.shape)
    for _ in range(3):
        near = [np.asarray(a * (1 + rng.choice([-1, 1], a.shape) * np.finfo(a.dtype).eps), a.dtype) for a in point]
        try:
            made = np.array(_called(function, near), float)
        except Exception:  # it stands at the edge of where it is defined
            return np.full(want.shape, np.inf)
        moved = np.fmax(moved, np.abs(made - want)) if made.shape == want.shape else np.full(want.shape, np.inf)
    return 1e3 * moved

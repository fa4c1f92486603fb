"""What a user's function gives for arguments of some shapes, found by tracing it."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters.partial_eval import dce_jaxpr

from sigmax.errors import InputError
from sigmax.functions.bounds import check_indices
from sigmax.functions.precision import coarse_constants
from sigmax.modelling.checks import is_traced
from sigmax.native.refusal import user_line

# What is returned in another shape, and what to write.
_SHAPED = {0: ", a number: write np.array([…]) around it", 2: ": write .ravel() behind it"}


class Evaluated(NamedTuple):
    """What a function gives: shape, type, whether it depends on anything.

    And what it holds: constants of too few digits, and whether a number that is being traced.
    """

    shape: tuple[int, ...]
    kind: np.dtype[Any]
    varies: bool
    coarse: list[str]
    captured: bool


@functools.lru_cache(maxsize=512)
def _evaluated(function: Any, arguments: tuple[Any, ...]) -> Evaluated:
    """Found once, because tracing costs more than a short run."""
    traced, made = jax.make_jaxpr(lambda *a: _as_array(function(*a)), return_shape=True)(*arguments)
    check_indices(traced)
    _, used = dce_jaxpr(traced.jaxpr, [True])
    double = arguments[0].dtype == np.float64
    coarse = coarse_constants(function, traced) if double else []
    if double and made.dtype == np.float32:
        coarse.append("what it returns")
    return Evaluated(made.shape, np.dtype(made.dtype), any(used), coarse, is_traced(traced.consts))


def _as_array(result: Any) -> jax.Array:
    if result is None:
        raise InputError("it returns nothing: is a return missing?")
    try:
        return jnp.asarray(result)
    except (TypeError, ValueError) as error:
        if isinstance(error, jax.errors.JAXTypeError):
            raise
        raise InputError(f"it returns {type(result).__name__}, which is no array of numbers; {error}") from error


def shape(what: str, function: Any, arguments: tuple[Any, ...], said: list[str]) -> Evaluated:
    """What a function gives, of real numbers or of whole ones that are the same for all arguments.

    What is to be warned of is added to `said`.
    """
    try:
        found = _evaluated(function, arguments)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    except IndexError as error:
        shapes = [a.shape for a in arguments]
        raise InputError(
            f"{what}, given arrays of the shapes {shapes} (a state is (n,), no column (n, 1)): {error}"
        ) from error
    except (jax.errors.JAXTypeError, jax.errors.ConcretizationTypeError) as error:
        where = user_line(error)
        raise InputError(
            f"{what} needs its numbers to be known while it is compiled{f' ({where})' if where else ''}: write it with "
            "numpy or jax.numpy, where() in the place of if, without float(); or hand it over as "
            "sigmax.models.opaque(…)"
        ) from error
    except Exception as error:
        error.add_note(
            f"sigmax: this happened while evaluating {what} on arrays of shapes {[a.shape for a in arguments]}"
        )
        raise
    if found.coarse:
        said.append(
            f"in {what} {' and '.join(found.coarse)} has the seven digits of float32, and the run is in float64: make "
            "it after `import sigmax`, or from Python's own floats; .astype(float) says that they are all there are"
        )
    if not jnp.issubdtype(found.kind, jnp.floating) and (found.varies or found.kind.kind not in "iu"):
        raise InputError(
            f"{what} must return real numbers of float64; it returns {found.kind}, which has no derivative: leave out "
            "the conversion to whole numbers, complex ones or truth values"
        )
    return found


def shape_of(what: str, function: Any, arguments: tuple[Any, ...], size: int, names: Any, said: list[str]) -> bool:
    """Check that a function gives so many components, named in messages; whether it has captured a traced number."""
    found = shape(what, function, arguments, said)
    if not jnp.issubdtype(found.kind, jnp.floating):
        raise InputError(f"{what} must return real numbers of float64, it returns {found.kind}: write 1.0 for 1")
    if found.shape != (size,):
        named = list(names)
        hint = _SHAPED.get(len(found.shape), "") if np.prod(found.shape) == size else ""
        raise InputError(
            f"{what} must return the {size} components {named}, shape ({size},); it returns {found.shape}{hint}"
        )
    return found.captured

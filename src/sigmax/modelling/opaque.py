"""Functions that JAX cannot trace: a database, a routine of another language."""

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError

# What went wrong in opaque functions while somebody waits to be told: XLA itself would bury it in its own trace.
_failed: list[Exception] = []
_waiting: list[None] = []


@contextmanager
def failures_raised() -> Iterator[None]:
    """Raise what an opaque function raises inside, as it was, at the end; until then its values are NaN."""
    _waiting.append(None)
    try:
        yield
        if _failed:
            raise _failed[0]
    finally:
        _waiting.pop()
        if not _waiting:
            _failed.clear()


def opaque(
    function: Callable[..., Any], size: int | None = None, reads: Sequence[int] | None = None
) -> Callable[..., jax.Array]:
    """A function of NumPy arrays for use inside a motion or a sensor.

    It is called once for each half-step with all distinct points of the whole batch: a number arrives as an
    array (N,), a vector as (N, k), and (N,) or (N, size) must come back. NaN says that there is no value
    at a point; the step of that track is then a fault. Steps with such a function run on XLA.

    Args:
        function: of as many arrays as the model gives it.
        size: components of its result, None for a number.
        reads: where it is given the whole state, the components that it reads; they alone arrive, (N, len(reads)).

    Returns:
        The function of numbers and vectors. It has no derivatives, so that a Taylor rule refuses it; give them
        by `with_derivatives(opaque(f, m), opaque(jacobian, …))`.

    Raises:
        InputError: in a run, where the result has another shape, or derivatives are asked for. What the function
            itself raises ends the run, too.
    """
    shape = () if size is None else (size,)
    name = getattr(function, "__name__", "the opaque function")
    places = None if reads is None else np.array(list(reads), int)

    def called(cores: Sequence[int], dtype: Any, *arrays: Any) -> np.ndarray:
        given = [np.asarray(a) for a in arrays]
        lead = np.broadcast_shapes(*(a.shape[: a.ndim - core] for a, core in zip(given, cores, strict=True)))
        flat = [
            np.broadcast_to(a, (*lead, *a.shape[a.ndim - core :])).reshape(-1, *a.shape[a.ndim - core :])
            for a, core in zip(given, cores, strict=True)
        ]
        if not (_waiting and _failed):
            try:
                return values(flat, dtype).reshape((*lead, *shape))
            except Exception as error:
                if not _waiting:
                    raise
                _failed.append(error)
        return np.full((*lead, *shape), np.nan, dtype)

    def values(flat: Sequence[np.ndarray], dtype: Any) -> np.ndarray:
        made = np.asarray(function(*flat), dtype)
        if made.shape != (len(flat[0]), *shape):
            raise InputError(
                f"{name} was given {len(flat[0])} points and must return an array of shape "
                f"{(len(flat[0]), *shape)}; it returned {made.shape}"
            )
        return made

    @jax.custom_jvp
    def on_host(*arguments: Any) -> jax.Array:
        dtype = jnp.result_type(*arguments)
        host = functools.partial(called, [a.ndim for a in arguments], dtype)
        return jax.pure_callback(host, jax.ShapeDtypeStruct(shape, dtype), *arguments, vmap_method="broadcast_all")

    @on_host.defjvp
    def _(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> Any:
        raise InputError(
            f"{name} is opaque and has no derivatives: take a filter of sigma points (UKF, CKF, SRCKFB, …), or give "
            "them by sigmax.models.with_derivatives(function, jacobian)"
        )

    @functools.wraps(function)
    def wrapped(*arguments: Any) -> jax.Array:
        if not arguments:
            raise InputError(f"{name} is opaque and must be given at least one number or vector")
        floating = [jnp.asarray(a, jnp.result_type(a, jnp.float32)) for a in arguments]
        if places is not None:
            if len(floating) != 1 or floating[0].ndim != 1 or not (places < floating[0].shape[0]).all():
                raise InputError(
                    f"{name} reads components {places.tolist()} and must be given the one vector they are of"
                )
            floating = [floating[0][places]]
        return on_host(*floating)

    return wrapped


def calls_out(function: Callable[..., Any], *arguments: Any) -> bool:
    """Whether a function, traced on arguments of these shapes and types, calls something that is opaque."""
    return "pure_callback" in str(jax.make_jaxpr(function)(*arguments))

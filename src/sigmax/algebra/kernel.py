"""Functions of the algebra that stay one operation in a trace: an engine may have a loop of its own for each."""

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

_named: ContextVar[bool] = ContextVar("named", default=False)


@contextmanager
def kernels(named: bool = True) -> Iterator[None]:
    """Trace functions of the algebra as one operation each, or write them out again inside."""
    before = _named.set(named)
    try:
        yield
    finally:
        _named.reset(before)


def like(*shape: int, of: Sequence[jax.Array], core: Sequence[int], dtype: Any = None) -> jax.ShapeDtypeStruct:
    """What a result looks like: its own axes before the batch of arrays that have `core` axes without one."""
    batches = [a.shape[axes:] for a, axes in zip(of, core, strict=True)]
    return jax.ShapeDtypeStruct((*shape, *jnp.broadcast_shapes(*batches)), dtype or jnp.result_type(*of))


def kernel(looks: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Let a function of arrays be one operation, `sigmax_` and its name, where a trace asks for that.

    It is traced without its body, which takes most of the time of a large model. Whoever knows no better finds the body
    in the parameters of the operation; derivatives, batches and XLA take it.

    Args:
        looks: what the results look like, from what the arguments look like.
    """

    def mark(function: Callable[..., Any]) -> Callable[..., Any]:
        primitive = Primitive(f"sigmax_{function.__name__}")
        primitive.multiple_results = True

        def shapes(*leaves: Any, function: Any, tree: Any) -> list[Any]:
            made = jax.tree.leaves(looks(*jax.tree.unflatten(tree, leaves)))
            return [jax.core.ShapedArray(a.shape, a.dtype) for a in made]

        primitive.def_impl(written_out)
        primitive.def_abstract_eval(shapes)
        mlir.register_lowering(primitive, mlir.lower_fun(written_out, multiple_results=True))
        ad.primitive_jvps[primitive] = _derivative
        batching.primitive_batchers[primitive] = _over_batch

        @functools.wraps(function)
        def named(*arguments: Any) -> Any:
            if not _named.get():
                return function(*arguments)
            leaves, tree = jax.tree.flatten(arguments)
            made = primitive.bind(*leaves, function=function, tree=tree)
            return jax.tree.unflatten(jax.tree.structure(looks(*arguments)), made)

        return named

    return mark


def written_out(*leaves: Any, function: Callable[..., Any], tree: Any) -> list[Any]:
    """The body of an operation on its arguments."""
    with kernels(False):
        return jax.tree.leaves(function(*jax.tree.unflatten(tree, leaves)))


def _derivative(primals: Sequence[Any], tangents: Sequence[Any], **about: Any) -> Any:
    whole = tuple(ad.instantiate_zeros(t) for t in tangents)
    return jax.jvp(lambda *leaves: written_out(*leaves, **about), tuple(primals), whole)


def _over_batch(leaves: Sequence[Any], axes: Sequence[Any], **about: Any) -> Any:
    made = jax.vmap(lambda *each: written_out(*each, **about), in_axes=tuple(axes))(*leaves)
    return made, [0] * len(made)

"""Between which numbers an operation is said to lie: every number that it gives does, and each bound is a float."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sigmax.native import Graph, evaluate
from sigmax.native.primitives.intervals import interval

jax.config.update("jax_enable_x64", True)
N = 3
UNARY = {
    "floor": jnp.floor,
    "ceil": jnp.ceil,
    "trunc": jnp.trunc,
    "sign": jnp.sign,
    "abs": jnp.abs,
    "negative": jnp.negative,
}
BINARY = {
    "add": jnp.add,
    "subtract": jnp.subtract,
    "multiply": jnp.multiply,
    "maximum": jnp.maximum,
    "minimum": jnp.minimum,
}


@st.composite
def rounded(draw):
    """The names of some operations on clipped numbers, each on what was there before."""
    limits = [sorted(draw(st.lists(st.floats(-5, 5, width=32), min_size=2, max_size=2))) for _ in range(N)]
    calls = []
    for k in range(draw(st.integers(2, 8))):
        name = draw(st.sampled_from([*UNARY, *BINARY]))
        calls.append((name, [draw(st.integers(0, N + k - 1)) for _ in range(1 if name in UNARY else 2)]))
    return limits, calls


def written(limits, calls):
    def f(x):
        values = [jnp.clip(x[i], low, high) for i, (low, high) in enumerate(limits)]
        for name, places in calls:
            values.append({**UNARY, **BINARY}[name](*(values[i] for i in places)))
        return jnp.stack(values)

    return f


@settings(max_examples=60, deadline=None)
@given(rounded(), st.integers(0, 1000))
def test_every_number_lies_between_the_bounds_of_its_operation(made, seed):
    f, g = written(*made), Graph()
    (nodes,) = evaluate(g, jax.make_jaxpr(f)(jax.ShapeDtypeStruct((N,), jnp.float64)), [g.inputs("x", (N,))])
    with jax.disable_jit():
        values = np.stack([np.asarray(f(row)) for row in 4 * np.random.default_rng(seed).standard_normal((6, N))])
    for node, column in zip(np.ravel(nodes), values.T, strict=True):
        low, high = interval(g, node)
        assert isinstance(low, float)
        assert isinstance(high, float)
        assert (low <= column).all()
        assert (column <= high).all()

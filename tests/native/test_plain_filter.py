"""Filters of random functions are those of a textbook: what both engines share is judged from outside too.

Which components a function reads, and where it is straight, is found by one analysis for both engines.
"""

from itertools import islice
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.native.comparison import FILTERS, NAMES, apart, measurements
from tests.native.compositions import composition, function

jax.config.update("jax_enable_x64", True)
SIZES = dict(f=2, g=2, h=2)


def values(text: str, size: int, offset: int) -> Any:
    """The last numbers that a composition gives, bounded so that filters stay in reach."""
    f = function(text)

    def g(x: Any, u: Any) -> Any:
        flat = jnp.concatenate([jnp.ravel(jnp.asarray(v)).astype(x.dtype) for v in f(x, u)])[::-1]
        y = flat[(offset + np.arange(size)) % flat.shape[0]]
        return y / jnp.sqrt(1 + y**2 / 9)

    return g


def texts(seed: int) -> list[str]:
    """Four functions whose numbers are not rounded to fewer bits on their way."""
    made = (composition(100 * seed + k, most=4) for k in range(100))
    return list(islice((text for text in made if "float32" not in text and "reduce_precision" not in text), 4))


def functions(seed: int) -> tuple[Any, dict[str, Any]]:
    """A motion and three sensors of random functions."""
    first, *others = texts(seed)
    moved = values(first, 4, seed)
    matrix = np.eye(4) * 0.9 + np.diag([0.1, -0.2, 0.3], 1)

    def motion(x: Any, dt: Any, u: Any) -> Any:
        return jnp.asarray(matrix, x.dtype) @ x + 0.4 * dt * moved(x, u * dt)

    sensors = {s: values(text, 2, seed) for s, text in zip(SIZES, others, strict=True)}
    return motion, sensors


def compared(cases: list[tuple[int, str]]) -> None:
    results = [apart(kind, *functions(seed), measurements(SIZES, seed)) for seed, kind in cases]
    wrong = [
        f"seed {seed}: {text}\n" + "\n".join(texts(seed))
        for (seed, _), found in zip(cases, results, strict=True)
        for text in found or ()
    ]
    assert not wrong, f"{len(wrong)} of {2 * len(cases)} differ\n" + "\n".join(wrong[:5])
    # Functions with jumps, roots of negative numbers and the like cannot be compared; most can.
    assert sum(found is not None for found in results) > 0.6 * len(cases)


@pytest.mark.filterwarnings("ignore")
def test_filters_of_random_functions_are_those_of_a_textbook():
    compared([(seed, FILTERS[seed % 4]) for seed in range(2)])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("part", range(4))
def test_filters_of_many_random_functions_are_those_of_a_textbook(part):
    compared([(100 + 25 * part + k, FILTERS[k % 4]) for k in range(25)])


ORDERS = {
    "columns first": lambda x, u: jnp.array([[x[0], x[1] ** 2], [x[2], x[3]]]).ravel(order="F")[1:3],
    "a product of columns": lambda x, u: jnp.prod(x.reshape(2, 2, order="F"), axis=1),
    "a permutation of axes": lambda x, u: jnp.stack([x, x**2]).reshape(2, 2, 2).transpose(2, 0, 1)[1, 0],
    "turned by a lax reshape": lambda x, u: jnp.sin(x).reshape(2, 2).T.ravel()[1:3],
    "rolled": lambda x, u: jnp.roll(jnp.stack([x[0], x[1] * x[2], x[3]]), 1)[:2],
    "written behind": lambda x, u: jnp.zeros(3).at[jnp.array([2, 0])].set(x[:2] * x[2:])[::-2],
    "taken from": lambda x, u: jnp.concatenate([x, x * u[0]])[jnp.array([6, 1])] * x[:2],
    "a batch of products": lambda x, u: jnp.einsum("bij,bj->bi", jnp.outer(x[:2], x).reshape(2, 2, 2), x.reshape(2, 2))[
        1
    ],
    "one chosen": lambda x, u: jnp.stack([x[0] * x[1], x[2]])[::-1] + jnp.where(u[0] > 0, x[3], x[3] ** 2),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", FILTERS)
def test_what_moves_numbers_about_moves_their_uncertainty(kind):
    for first, second in zip(ORDERS, [*list(ORDERS)[1:], "columns first"], strict=True):
        sensors = {"f": ORDERS[first], "g": ORDERS[second]}
        found = apart(kind, functions(0)[0], sensors, measurements(dict(f=2, g=2), 3))
        assert found == [], f"{first}, {second}: {found}"


def written(x: Any, u: Any) -> Any:
    """What is written to a reference does not enter it when it is made."""
    cell = jax.new_ref(jnp.zeros(2))
    cell[0] = x[0] * x[1]
    return cell[...] + x[2:] ** 2


SEEN: list[float] = []
# Besides what they give, they do something: show it, order it, keep it, write it down.
EFFECTS = {
    "shown": lambda x, u: (jax.debug.callback(lambda a: SEEN.append(float(a)), x[0]), jnp.sin(x[:2]))[1],
    "shown where": lambda x, u: (
        jax.lax.cond(u[0] > 0, lambda: jax.debug.callback(lambda a: None, x), lambda: None),
        jnp.sin(x[:2]),
    )[1],
    "ordered": lambda x, u: (jax.lax.create_token(), jnp.sin(x[1:3]))[1],
    "drawn": lambda x, u: x[:2] ** 2 + jax.random.normal(jax.random.split(jax.random.key(0))[1], 2),
    # Not in every version of JAX.
    **({"kept": lambda x, u: (jax.lax.dce_sink(x**2), jnp.sin(x[:2]))[1]} if hasattr(jax.lax, "dce_sink") else {}),
    **({"written": written, "written by a call": jax.jit(written)} if hasattr(jax, "new_ref") else {}),
}


QUICK = {name: EFFECTS[name] for name in ("shown", "written by a call") if name in EFFECTS}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("sensors", [QUICK, pytest.param(EFFECTS, marks=pytest.mark.slow)], ids=["some", "all"])
def test_what_gives_nothing_orders_or_holds_numbers_leaves_a_filter_right(sensors):
    SEEN.clear()
    z = measurements(dict.fromkeys(sensors, 2), 1)
    assert apart("CKF", lambda x, dt, u: 0.9 * x, sensors, z, backends=("xla",)) == []
    jax.effects_barrier()
    # At each point, not at one of them.
    assert len(set(SEEN)) > 2 * len(NAMES)


def test_a_sensor_that_reads_nothing_leaves_a_filter_right():
    sensors = {"known": lambda x, u: jnp.array([0.5, 0.25]), "input": lambda x, u: 2 * u}
    assert apart("CKF", lambda x, dt, u: 0.9 * x, sensors, measurements(dict(known=2, input=2), 1)) == []

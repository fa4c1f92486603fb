"""Every public function of JAX that takes floats gives in C what it gives in JAX, or is refused."""

import importlib
import re
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.native.comparison import apart, measurements
from tests.native.compositions import whole
from tests.native.judge import points, traced, verdicts

jax.config.update("jax_enable_x64", True)
MODULES = ("jax.numpy", "jax.numpy.linalg", "jax.scipy.special", "jax.scipy.linalg", "jax.lax")
SIZES = (4, 2)
TOGETHER = 40
C = np.array([0.5, -1.25, 2.0, 0.75])


class Entry(NamedTuple):
    """A function with arguments to call it with."""

    module: str
    name: str
    expression: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}: {self.expression}"


def table() -> tuple[list[Entry], set[str]]:
    """The entries of functions.txt, and the functions that take no traced numbers."""
    entries, none, module = [], set(), ""
    for line in (Path(__file__).parent / "functions.txt").read_text().splitlines():
        names, _, rest = line.partition(": ")
        if line.startswith("["):
            module = line.strip("[]")
        elif line.startswith("! "):
            none |= {f"{module}.{name}" for name in names[2:].split()}
        elif line and not line.startswith("#"):
            entries += [Entry(module, name, rest) for name in names.split()]
    return entries, none


ENTRIES, NONE = table()
# Versions of JAX differ in what they have.
CALLED = [e for e in ENTRIES if hasattr(importlib.import_module(e.module), e.name)]


def letters(x: Any, u: Any, way: str, wanted: set[str]) -> dict[str, Any]:
    """What the wanted letters of an expression stand for.

    a, b: numbers of shapes that fit; c between 0.1 and 0.9, d above 1, k whole, as a; s: a number; l: four of 0 and 1;
    v (4,), w (2, 3), m (2, 2), t (2, 2, 2), p positive definite (2, 2); C: known numbers.
    """
    if way == "constants":
        x = jnp.concatenate([x[:2], jnp.asarray(C[:2], x.dtype)])
    a, b = {
        "vectors": (x, 0.7 * x[::-1] + 0.2),
        "inputs": (x * u[0], u[1]),
        "scalars": (x[0], x[1]),
        "constants": (x, jnp.asarray(C, x.dtype)),
    }[way]
    made = {
        **dict(a=lambda: a, b=lambda: b, c=lambda: 0.5 + 0.4 * jnp.tanh(a), d=lambda: 1.1 + a * a),
        **dict(k=lambda: jnp.floor(3 * jnp.clip(a, -9, 9)).astype(int), l=lambda: (x > 0.5).astype(int)),
        **dict(s=lambda: a if way == "scalars" else x[0], v=lambda: x * (b if jnp.ndim(b) == 0 else 1.0)),
        **dict(m=lambda: x.reshape(2, 2), p=lambda: x.reshape(2, 2) @ x.reshape(2, 2).T + 2 * jnp.eye(2)),
        **dict(w=lambda: jnp.stack([x[:3], 0.5 * x[1:]]), t=lambda: jnp.stack([x, x + 1]).reshape(2, 2, 2)),
    }
    return {name: make() for name, make in made.items() if name in wanted}


def called(entry: Entry, ways: tuple[str, ...]) -> Any:
    """A function of x and u that calls the entry's with arguments of these ways."""
    function = getattr(importlib.import_module(entry.module), entry.name)
    known = {"_": function, "C": C, "jnp": jnp, "jax": jax, "np": np}
    wanted = set(re.findall(r"\b[a-z]\b", entry.expression))

    def f(x: Any, u: Any) -> list[Any]:
        return [eval(entry.expression, known | letters(x, u, way, wanted)) for way in ways]

    return f


def groups() -> list[list[Entry]]:
    return [CALLED[i : i + TOGETHER] for i in range(0, len(CALLED), TOGETHER)]


def wrong(entries: list[Entry], ways: tuple[str, ...], use: int, rows: np.ndarray, dtype: Any) -> list[str]:
    """What is wrong among these functions, used as values, slopes or at points."""
    functions, kept = [], []
    for entry in entries:
        try:
            functions.append(traced(whole(called(entry, ways), use), SIZES, dtype))
            kept.append(entry)
        except Exception:
            # Raised by JAX while tracing: not every function has a derivative, takes single numbers or float32.
            if use == 0 and "vectors" in ways and dtype == np.float64:
                raise
    found = verdicts(functions, rows)
    return [f"{entry}: {verdict.wrong}" for entry, verdict in zip(kept, found, strict=True) if verdict.wrong]


@pytest.mark.parametrize("module", MODULES)
def test_every_public_function_is_in_the_table_or_takes_no_traced_numbers(module):
    found = importlib.import_module(module)
    public = {name for name in dir(found) if not name.startswith("_") and callable(getattr(found, name))}
    known = {f"{e.module}.{e.name}" for e in ENTRIES} | NONE
    assert not [name for name in sorted(public) if f"{module}.{name}" not in known]


@pytest.mark.parametrize("k", range(len(groups())))
@pytest.mark.filterwarnings("ignore")
def test_every_function_gives_in_c_what_it_gives_in_jax(k):
    found = wrong(groups()[k], ("vectors", "constants"), 0, points(6)[:7], np.float64)
    assert not found, "\n".join(found)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("use", range(3), ids=["values", "slopes", "points"])
@pytest.mark.parametrize("ways", [("vectors", "inputs"), ("scalars", "constants")], ids=" and ".join)
def test_every_function_is_right_in_every_use(ways, use, dtype):
    found = [text for group in groups() for way in ways for text in wrong(group, (way,), use, points(6), dtype)]
    assert not found, "\n".join(found)


def lowerable(entry: Entry) -> bool:
    closed = traced(whole(called(entry, ("inputs", "constants")), 0), SIZES, np.float64)
    return not verdicts([closed], points(6)[:1])[0].refused


def bounded(entries: list[Entry], way: str) -> Any:
    """One number of each function, in reach of a filter."""

    def f(x: Any, u: Any) -> Any:
        made = (jnp.concatenate([jnp.ravel(v).astype(x.dtype) for v in called(e, (way,))(x, u)]) for e in entries)
        y = jnp.stack([jnp.nan_to_num(v).sum() for v in made])
        return y / jnp.sqrt(1 + y**2 / 9)

    return f


def in_filters(kind: str, entries: list[Entry], tally: Counter[str]) -> list[str]:
    """What filters with these functions in motion and sensor say otherwise than plain ones, by function."""
    inside, h = bounded(entries, "inputs"), bounded(entries, "constants")

    def motion(x: Any, dt: Any, u: Any) -> Any:
        y = inside(x, u * dt)
        return 0.9 * x + 0.2 * dt * y[np.arange(4) % len(entries)] + 0.1 * dt * y.mean()

    try:
        found = apart(kind, motion, {"h": h}, measurements(dict(h=len(entries)), 0), backends=(None,))
    except Exception as error:
        # The plain filter could be computed, so nothing may be raised.
        found = [f"{type(error).__name__}: {error}"]
    if found == []:
        tally["right"] += len(entries)
    elif len(entries) > 1:
        half = len(entries) // 2
        return in_filters(kind, entries[:half], tally) + in_filters(kind, entries[half:], tally)
    else:
        tally["not comparable" if found is None else "wrong"] += 1
    return [f"{entries[0]}: {text}" for text in found or ()]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["EKF", "CKF"])
@pytest.mark.parametrize("module", MODULES)
def test_every_function_serves_in_motion_and_sensor(module, kind):
    """What is left to XLA stands beside its like, so that it takes nothing else with it."""
    entries, tally = [e for e in CALLED if e.module == module], Counter[str]()
    apart_from = {True: [], False: []}
    for entry in entries:
        apart_from[lowerable(entry)].append(entry)
    found = [
        text
        for alike in apart_from.values()
        for i in range(0, len(alike), 16)
        for text in in_filters(kind, alike[i : i + 16], tally)
    ]
    print(dict(tally))
    assert not found, "\n".join(found)
    assert tally["right"] > 0.7 * len(entries)

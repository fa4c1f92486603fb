"""Random functions of x (4,) and u (2,), as source text: statements of every kind that a model may hold.

A statement is drawn as text, tried on tracers, and kept if JAX accepts it, so that shapes need not be known here.
The same seed gives the same text.
"""

import linecache
import re
import warnings
import zlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

SIZES = (4, 2)
_LARGEST = 30


@jax.custom_jvp
def softly(a: Any) -> Any:
    """A function with a derivative of its own."""
    return jnp.where(a > 0, a, 0.1 * a)


softly.defjvp(lambda primals, tangents: (softly(*primals), tangents[0] * (0.1 + 0.9 * (primals[0] > 0))))


@jax.custom_vjp
def backwards(a: Any) -> Any:
    """A function with a reverse derivative of its own; JAX cannot take its forward one."""
    return jnp.sin(a)


backwards.defvjp(lambda a: (jnp.sin(a), a), lambda a, t: (t * jnp.cos(a),))


def shaped(a: Any, shape: tuple[int, ...]) -> Any:
    """The numbers of an array, again from the first where they do not suffice."""
    return jnp.ravel(a)[np.arange(np.prod(shape)) % jnp.size(a)].reshape(shape)


NAMES = {
    "jax": jax,
    "jnp": jnp,
    "np": np,
    "lax": jax.lax,
    "linalg": jnp.linalg,
    "scipy": jax.scipy,
    "shaped": shaped,
    "softly": softly,
    "backwards": backwards,
    "C": np.array([0.5, -1.25, 2.0, 0.75]),
    "J": jnp.array([[0.3, -0.8], [1.5, 0.25]]),
    "TABLE": np.sin(np.arange(12.0)),
    "PLACES": np.array([2, 0, 1]),
}

# {a} {b}: arrays; {v}: a vector; {m} {w} {t}: 2 x 2, 2 x 3, 2 x 2 x 2; {s}: a number; {p}: a positive definite 2 x 2;
# {k}: an integer; {i} {j}: 0 or 1, computed; {q}: truth values of 2 x 3; {e} {g}: expressions of y; {x} {c}: 0 or 1.
_STATEMENTS = (Path(__file__).parent / "statements.txt").read_text()


def _kinds() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in _STATEMENTS.splitlines():
        if line.startswith("["):
            found[line.strip("[]")] = []
        elif line and not line.startswith("#"):
            list(found.values())[-1].append(line)
    return found


KINDS = _kinds()
# What the native engine refuses ends the comparison of all that stands beside it: seldom.
_LEFT, _SELDOM = KINDS.pop("left to XLA"), 0.02
_OF_ONE, _OF_TWO = KINDS["elementwise, of one"], KINDS["elementwise, of two"]


class _Writer:
    """Draws statements; `values` are what the names stand for while it is traced."""

    def __init__(self, rng: np.random.Generator, values: dict[str, Any]) -> None:
        self.rng, self.values = rng, values

    def one(self, of: Any) -> Any:
        return of[int(self.rng.integers(len(of)))]

    def statement(self, template: str) -> str:
        """A template with its letters replaced, each time anew."""
        return re.sub(r"\{([a-z])\}", lambda found: getattr(self, f"_{found[1]}")(), template)

    def _of(self, kinds: str, fits: Any = lambda value: True) -> list[str]:
        return [n for n, value in self.values.items() if jnp.result_type(value).kind in kinds and fits(value)]

    def _shaped(self, *shape: int) -> str:
        """A value of this shape: one there is, or another one's numbers repeated."""
        found = self._of("f", lambda value: jnp.shape(value) == shape)
        if found and self.rng.random() < 0.7:
            return self.one(found)
        return f"shaped({self._a()}, {shape})"

    def _a(self) -> str:
        found = self._of("f", jnp.size)
        return self.one(found[-3:] if self.rng.random() < 0.6 else found)

    _b = _a

    def _v(self) -> str:
        return self.one(self._of("f", lambda value: jnp.ndim(value) == 1 and 4 <= jnp.size(value) <= 8))

    def _m(self) -> str:
        return self._shaped(2, 2)

    def _w(self) -> str:
        return self._shaped(2, 3)

    def _t(self) -> str:
        return self._shaped(2, 2, 2)

    def _p(self) -> str:
        m = self._m()
        return f"({m} @ {m}.T / (1 + jnp.sum({m}**2)) + jnp.eye(2))"

    def _s(self) -> str:
        if self.rng.random() < 0.4:
            return f"x[{int(self.rng.integers(-4, 4))}]"
        return self.one([*self._of("f", lambda value: jnp.ndim(value) == 0), "u[1]", f"jnp.sum({self._a()})"])

    def _k(self) -> str:
        found = self._of("i", lambda value: jnp.ndim(value) == 0)
        made = [f"jnp.floor({self._s()}).astype(int)", f"jnp.argmax({self._v()})", f"jnp.sum({self._v()} > 0)"]
        return self.one(found) if found and self.rng.random() < 0.6 else self.one(made)

    def _i(self) -> str:
        k = self._k()
        return self.one(
            [f"jnp.clip({k}, 0, 1)", f"({k} % 2)", f"({self._s()} > 0).astype(int)", f"jnp.argmin({self._v()}[:2])"]
        )

    _j = _i

    def _q(self) -> str:
        found = self._of("b", lambda value: jnp.shape(value) == (2, 3))
        return self.one(found) if found else f"({self._w()} > 0)"

    def _e(self) -> str:
        return self._expression("y", 2)

    _g = _e

    def _x(self) -> str:
        return self.one(["0", "1", "-1"])

    def _c(self) -> str:
        return self.one(["0", "1"])

    def _expression(self, name: str, depth: int) -> str:
        """An expression of a name that keeps its shape, and of numbers from outside."""
        if depth == 0:
            return name
        outer = self._of("f", lambda value: jnp.ndim(value) == 0)
        inner = self._expression(name, depth - 1)
        if self.rng.random() < 0.6:
            return f"({self.one(_OF_ONE).replace('{a}', inner)})"
        other = self.one([*outer, "u[0]", "C[2]", name, name])
        return f"({self.one(_OF_TWO).replace('{a}', inner).replace('{b}', other)})"


def composition(seed: int, most: int = 6, least: int = 2) -> str:
    """The text of a random function f(x, u) -> what its statements give, `most` of them at most."""
    rng = np.random.default_rng(seed)
    wanted, lines = int(rng.integers(least, most + 1)), []

    def writing(x: Any, u: Any) -> Any:
        values = {"x": x, "u": u}
        for _ in range(8 * wanted):
            if len(lines) == wanted:
                break
            writer = _Writer(rng, values)
            text = writer.statement(writer.one(_LEFT if rng.random() < _SELDOM else KINDS[writer.one(list(KINDS))]))
            try:
                value = eval(text, NAMES | values)
            except (TypeError, ValueError, IndexError, NotImplementedError, AttributeError, ZeroDivisionError):
                continue
            if jnp.size(value) <= _LARGEST and jnp.result_type(value).kind in "fiub":
                name = f"v{len(lines)}"
                values[name] = value
                lines.append(f"{name} = {text}")
        return x

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        jax.eval_shape(writing, *(jax.ShapeDtypeStruct((k,), jnp.float64) for k in SIZES))
    return source(lines)


def source(lines: list[str]) -> str:
    """Statements as the text of a function that returns what each gives."""
    names = "".join(f"{line.partition(' = ')[0]}, " for line in lines)
    return "def f(x, u):\n" + "".join(f"    {line}\n" for line in lines) + f"    return ({names})\n"


def function(text: str) -> Any:
    """The function of a text, whose lines are known to tracebacks."""
    name = f"composition-{zlib.crc32(text.encode()):x}"
    linecache.cache[name] = len(text), None, text.splitlines(True), name
    names = dict(NAMES)
    exec(compile(text, name, "exec"), names)
    return names["f"]


def whole(f: Any, way: int) -> Any:
    """A function of x and u as rules use it: its values, its slope along columns of a factor, or values at points."""

    def numbers(x: Any, u: Any) -> Any:
        made = [jnp.ravel(jnp.asarray(v)).astype(x.dtype) for v in f(x, u)]
        return jnp.concatenate(made)

    def columns(u: Any) -> Any:
        return jnp.eye(SIZES[0], 2, dtype=u.dtype) * u[0] + jnp.asarray(0.25, u.dtype)

    def slope(x: Any, u: Any) -> Any:
        y, along = jax.linearize(lambda at: numbers(at, u), x)
        return y, jax.vmap(along, in_axes=1, out_axes=1)(columns(u))

    def at_points(x: Any, u: Any) -> Any:
        return jax.vmap(lambda at: numbers(at, u), in_axes=1, out_axes=-1)(x[:, None] + columns(u))

    return (numbers, slope, at_points)[way % 3]

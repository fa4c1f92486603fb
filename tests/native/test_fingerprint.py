"""A fingerprint changes with everything that a function's result depends on, and is refused where that is hidden."""

import collections
import enum
import functools
import math
import types
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.models import radio_altimeter
from sigmax.models.builtin import BUILTIN, builtin
from sigmax.native.fingerprint import fingerprint
from tests import own_records
from tests.native.test_build import filtered

SCALE = 2.0
TABLE = np.arange(3.0)


def helper(x):
    return x * SCALE


def of(source, **names):
    """The function f of a piece of source."""
    space = {"jnp": jnp, "jax": jax, "math": math, **names}
    exec(source, space)
    return space["f"]


SAME = "def f(x):\n    return jnp.sin(x) * 2.0"


def test_the_same_function_has_the_same_fingerprint():
    assert fingerprint(of(SAME)) == fingerprint(of(SAME)) is not None
    assert fingerprint(of(SAME), 1) != fingerprint(of(SAME), 2)
    assert fingerprint(1) != fingerprint(1.0) != fingerprint(True)
    assert fingerprint((1, 2), 3) != fingerprint((1,), 2, 3)
    assert fingerprint(sigmax.angle("x")) != fingerprint("x")


def test_what_is_looked_at_in_passing_never_passes_for_something_else():
    """Values made for the moment share addresses with later ones: each has to be looked at all the same."""

    def of_density(density):
        motion = sigmax.motions.constant_velocity()
        sensor = {"a": sigmax.sensors.range_only(origin=(0.0, 0.0)), "b": sigmax.sensors.range_only(origin=(3.0, 1.0))}
        model = sigmax.Model(motion=motion, sensor=sensor, Q=motion.noise(density), R={"a": [0.1], "b": [0.1]})
        return fingerprint(("predict",), vars(model))

    assert len({of_density(d) for d in (0.05, 0.1, 1.0, 2.0)}) == 4
    one, other = (
        sigmax.motions.join(sigmax.motions.unicycle(), sigmax.motions.random_walk(("a",))).noise(
            sigmax.motions.unicycle().noise(position=p, heading=0.1), sigmax.motions.random_walk(("a",)).noise(0.0)
        )
        for p in (0.1, 0.2)
    )
    assert fingerprint(one) != fingerprint(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (of(SAME), of("def f(x):\n    return jnp.sin(x) * 3.0")),
        (of(SAME), of("def f(x):\n    return jnp.cos(x) * 2.0")),
        (of(SAME), of("def f(x):\n    return 2.0 * jnp.sin(x)")),
        (of("def f(x, a=1.0):\n    return x * a"), of("def f(x, a=2.0):\n    return x * a")),
        (of("def f(x):\n    return x * g", g=1.0), of("def f(x):\n    return x * g", g=2.0)),
        (of("def f(x):\n    return g(x)", g=helper), of("def f(x):\n    return g(x)", g=of(SAME))),
        (of("def f(x):\n    return x @ g", g=TABLE), of("def f(x):\n    return x @ g", g=TABLE + 1e-12)),
        (of("def f(x):\n    return x * g['a']", g={"a": 1.0}), of("def f(x):\n    return x * g['a']", g={"a": 2.0})),
        (of("def f(x):\n    return (lambda y: y + 1)(x)"), of("def f(x):\n    return (lambda y: y + 2)(x)")),
        (partial(helper, 1.0), partial(helper, 2.0)),
        (jax.jit(helper), jax.jit(of(SAME))),
        (sigmax.get("SRUKF", alpha=0.4), sigmax.get("SRUKF", alpha=0.5)),
        (sigmax.get("EKF"), sigmax.get("SREKF")),
        (sigmax.motions.singer(tau=1.0).function, sigmax.motions.singer(tau=2.0).function),
    ],
)
def test_what_matters_changes_it(one, other):
    assert fingerprint(one) != fingerprint(other)
    assert fingerprint(one) is not None
    assert fingerprint(other) is not None


def wrapping(source, other, **names):
    return functools.wraps(other)(of(source, **names))


def with_attribute(value):
    made = of("def f(x):\n    return x * f.scale")
    made.scale = value
    return made


def with_rule(factor):
    @jax.custom_jvp
    def made(x):
        return jnp.sin(x)

    rule = of("def f(p, t):\n    return p[0], t[0] * k", k=factor)
    made.defjvp(rule)
    return made


def captured(value):
    return of("def f(x):\n    return x * g", g=value)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (
            wrapping("def f(x):\n    return x * g", jnp.sin, g=1.0),
            wrapping("def f(x):\n    return x * g", jnp.sin, g=2.0),
        ),
        (
            wrapping("def f(x):\n    return x * g", np.mean, g=1.0),
            wrapping("def f(x):\n    return x * g", np.mean, g=2.0),
        ),
        (wrapping("def f(x):\n    return x", jnp.sin), jnp.sin),
        (with_attribute(1.0), with_attribute(2.0)),
        (with_rule(1.0), with_rule(2.0)),
        (captured(jnp.asarray(2.0)), captured(jnp.asarray(np.float64(2.0)))),
        (captured(jnp.ones(2, np.float32)), captured(jnp.ones(2))),
        (captured(np.float64(2.0)), captured(2.0)),
        (captured(np.float32(2.0)), captured(np.float64(2.0))),
        (captured(2), captured(2.0)),
        (captured(0.0), captured(-0.0)),
        (captured(np.ones((2, 2))), captured(np.asfortranarray(np.ones((2, 2))))),
        (captured({"a": 1, "b": 2}), captured({"b": 2, "a": 1})),
        (captured(partial(helper, k=1)), captured(partial(helper, k=2))),
        (captured(math.sin), captured(math.cos)),
        (captured(jnp.sin), captured(jnp.cos)),
    ],
)
def test_what_matters_changes_it_however_it_is_dressed(one, other):
    """Or nothing is remembered."""
    assert fingerprint(one) is None or fingerprint(one) != fingerprint(other)


def test_what_was_put_in_the_place_of_a_librarys_function_matters(monkeypatch):
    user = of(SAME)
    before = fingerprint(user), fingerprint(sigmax.motions.singer(tau=1.0).function)
    monkeypatch.setattr(jnp, "sin", of("def f(x):\n    return x"))
    assert fingerprint(user) != before[0]
    monkeypatch.setattr("sigmax.motions.jnp.sin", of("def f(x):\n    return x * 2"), raising=False)
    assert fingerprint(user) != before[0]


def test_a_default_that_is_changed_matters():
    def f(x, table=[1.0]):  # noqa: B006
        return x * table[0]

    before = fingerprint(f)
    f.__defaults__[0][0] = 2.0
    assert fingerprint(f) != before is not None


def test_a_function_deep_below_matters(monkeypatch):
    def outer(x):
        return helper(x)

    before = fingerprint(outer)
    monkeypatch.setattr(f"{__name__}.SCALE", 3.0)
    assert fingerprint(outer) != before


class Thing:
    def method(self, x):
        return x

    def __call__(self, x):
        return x


def uses_module(x):
    return own_records.RADAR, x


def reads(x):
    return np.load("grid.npy") @ x


class Chosen(enum.IntEnum):
    ONE = 1


class Defaults(dict):
    def __missing__(self, key):
        return 2.0


class Disguised(float):
    def __repr__(self):
        return "1.0"


def impostor():
    made = type("attrgetter", (), {})
    made.__module__ = "operator"
    return made


@pytest.mark.parametrize(
    "hidden",
    [
        *(Thing().method, Thing(), uses_module, reads, types.ModuleType("m"), object(), {1, 2}),
        *(
            types.ModuleType("operator"),
            types.ModuleType("sigmax_models"),
            types.ModuleType("jax"),
            impostor(),
            impostor()(),
        ),
        *(
            Thing,
            Chosen.ONE,
            Defaults(),
            Disguised(3.0),
            collections.defaultdict(float),
            np.ma.masked_equal([1.0], 1.0),
        ),
        *(jax.random.key(0), np.array([None]), np.random.default_rng(0), iter([1])),
    ],
)
def test_what_cannot_be_seen_through_has_none(hidden):
    assert fingerprint(hidden) is None


def test_every_filter_and_built_in_model_has_one():
    found = {fingerprint(sigmax.get(name)) for name in sigmax.names()}
    assert None not in found
    assert len(found) == len(sigmax.names())
    assert None not in {fingerprint(vars(builtin(name).model)) for name in BUILTIN}


def test_models_that_differ_only_deep_down_have_two():
    flat = sigmax.models.Elevation(np.full((4, 4), 300.0), (5e3, 5e3))
    steep = sigmax.models.Elevation(np.arange(16.0).reshape(4, 4), (5e3, 5e3))
    made = builtin("terrain").model
    found = set()
    for ground in (flat, steep):
        other = sigmax.Model(motion=made.motion, state=made.state, Q=made.Q, sensor=radio_altimeter(ground), R=[25.0])
        found.add(fingerprint(("correct", "", 1), sigmax.get("EKF"), vars(other), [], 3))
    assert len(found) == 2


def test_a_changed_model_in_another_process_is_not_mistaken_for_the_former(tmp_path):
    first, again, changed = (filtered(tmp_path, scale=scale, backend="native")[0] for scale in ("0.1", "0.1", "0.7"))
    assert first == again
    assert changed == pytest.approx(filtered(tmp_path, scale="0.7", backend="xla")[0], rel=1e-12)
    assert changed != pytest.approx(first, rel=1e-3)


@pytest.mark.slow
def test_a_damaged_source_in_the_cache_is_made_again(tmp_path):
    value, _ = filtered(tmp_path, backend="native")
    for path in (tmp_path / "cache").rglob("*.c"):
        path.write_text(path.read_text().replace("2", "3", 1))
    assert filtered(tmp_path, backend="native") == (value, "")


def test_functions_of_one_name_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a package whose functions are known by their names there may be two of one name."""
    pair = [lambda x: x + 1, lambda x: x - 1]
    for function in pair:
        monkeypatch.setattr(function, "__module__", "sigmax.somewhere")
    assert fingerprint(pair[0]) != fingerprint(pair[1])

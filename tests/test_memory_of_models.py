"""What a model's functions read may change: every answer is that of the values as they are now."""

import itertools
import subprocess
import sys
import types
from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.engine.rows import RowSteps

PRIOR = sigmax.Gaussian([2.0], [1.0])
Z = np.array([[1.0], [0.5], [0.25]])
NAME = itertools.count()


def written(source, **names):
    """The names of a module that is no library's, and that the function f of it reads."""
    space = {"__name__": "written", "jnp": jnp, "jax": jax, **names}
    exec(source, space)
    return space


def of_space(source, **names):
    """A way of reading a global A: the function, and how to change it."""

    def way():
        space = written(source, A=1.0, **names)
        return space["f"], lambda value: space.update(A=value)

    return way


def array_in_place():
    space = written("def f(x): return x * jnp.asarray(A)", A=np.ones(1))
    return space["f"], lambda value: space["A"].fill(value)


def large_array_in_place():
    space = written("def f(x): return x * jnp.asarray(A)[900]", A=np.ones(1000))
    return space["f"], lambda value: space["A"].fill(value)


def entry():
    space = written("def f(x): return x * A['gain']", A={"gain": 1.0})
    return space["f"], lambda value: space["A"].update(gain=value)


def item():
    space = written("def f(x): return x * A[0][0]", A=[[1.0]])
    return space["f"], lambda value: space["A"][0].__setitem__(0, value)


def nonlocal_variable():
    a = 1.0

    def f(x):
        return x * a

    def change(value):
        nonlocal a
        a = value

    return f, change


def of_module():
    module = types.ModuleType("settings_by_hand")
    module.A = 1.0
    return written("def f(x): return x * settings.A", settings=module)["f"], partial(setattr, module, "A")


def imported_inside():
    name = f"imported_inside_{next(NAME)}"
    module = sys.modules[name] = types.ModuleType(name)
    module.A = 1.0
    return written(f"def f(x):\n    from {name} import A\n    return x * A")["f"], partial(setattr, module, "A")


def of_class():
    class Gain:
        A = 1.0

    return (lambda x: x * Gain.A), partial(setattr, Gain, "A")


def default():
    def f(x, *, a=1.0):
        return x * a

    return f, lambda value: f.__kwdefaults__.update(a=value)


@dataclass
class Plain:
    a: float

    def __call__(self, x):
        return x * self.a

    def of(self, x):
        return x * self.a


@dataclass(slots=True)
class Slotted:
    a: float

    def __call__(self, x):
        return x * self.a


class Hostile:
    """Nobody may ask it whether it equals something."""

    def __init__(self, a):
        self.a = a

    def __eq__(self, other):
        raise AssertionError("compared")

    def __hash__(self):
        raise AssertionError("hashed")

    def __bool__(self):
        raise AssertionError("asked for its truth")

    def __call__(self, x):
        return x * self.a


class Inheriting(Plain):
    @property
    def gain(self):
        return self.a * self.scale

    scale = 1.0

    def __call__(self, x):
        return x * self.gain


def of_object(kind):
    def way():
        made = kind(1.0)
        return made, partial(setattr, made, "a")

    return way


def method():
    made = Plain(1.0)
    return made.of, partial(setattr, made, "a")


def held():
    made = Plain(1.0)
    return (lambda x: made.of(x)), partial(setattr, made, "a")


def partly():
    numbers = {"a": 1.0}
    return partial(lambda numbers, x: x * numbers["a"], numbers), lambda value: numbers.update(a=value)


def helper():
    space = written("def g(x): return x * 1.0\ndef f(x): return g(x)")
    return space["f"], lambda value: exec(f"def g(x): return x * {value}", space)


def code():
    def f(x):
        return x * 1.0

    def change(value):
        f.__code__ = written(f"def f(x): return x * {value}")["f"].__code__

    return f, change


WAYS = {
    "a global": of_space("def f(x): return x * A"),
    "a global in an inner function": of_space("def f(x): return (lambda: x * A)()"),
    "a global of a function of a function": of_space(
        "def h(): return A\ndef g(x): return x * h()\ndef f(x): return g(x)"
    ),
    "a compiled helper": of_space("@jax.jit\ndef g(x): return x * A\ndef f(x): return g(x)"),
    "the body of a loop": of_space("def g(i, x): return x * A\ndef f(x): return jax.lax.fori_loop(0, 1, g, x)"),
    "a compiled helper of a lambda": of_space("@jax.jit\ndef g(x): return x * A\nf = jax.vmap(g)"),
    "a function with derivatives": of_space(
        "def g(x): return x * A\ndef J(x): return jnp.ones((1, 1)) * A\nf = join(g, J)",
        join=sigmax.models.with_derivatives,
    ),
    "a class without a module": of_space("class G:\n    def __call__(self, x): return x * A\nf = G()"),
    "an array in place": array_in_place,
    "a large array in place": large_array_in_place,
    "an entry": entry,
    "an item of a list in a list": item,
    "a nonlocal variable": nonlocal_variable,
    "an attribute of a module": of_module,
    "a module imported inside": imported_inside,
    "an attribute of a class": of_class,
    "a default": default,
    "a dataclass": of_object(Plain),
    "slots": of_object(Slotted),
    "an object that cannot be compared": of_object(Hostile),
    "a property": of_object(Inheriting),
    "a method": method,
    "an object that is closed over": held,
    "a partial function": partly,
    "a helper defined anew": helper,
    "its code": code,
}
PLACES = {
    "motion": lambda f: dict(motion=lambda x, dt: f(x)),
    "sensor": lambda f: dict(sensor=f),
    "domain": lambda f: dict(domain=f),
    "Q": lambda f: dict(Q=lambda x, dt: f(jnp.ones(1))),
    "R": lambda f: dict(R=lambda x: f(jnp.ones(1))),
    "F": lambda f: dict(bias=sigmax.Bias(sensor=lambda x: f(jnp.ones((1, 1))), prior=sigmax.Gaussian([1.0], [1.0]))),
}


def model(**changes):
    given = dict(motion=lambda x, dt: x, sensor=lambda x: x, Q=[0.1], R=[0.5], state=("x",), measurement=("z",))
    return sigmax.Model(**given | changes)


def recorded(made, backend):
    return sigmax.run("EKF", made, PRIOR, Z, backend=backend).mean


def stepped(made, backend):
    live = sigmax.Live("EKF", made, PRIOR, backend=backend)
    return np.array([(live.step(z, 1.0), live.mean)[1] for z in Z])


def smoothed(made, backend):
    return sigmax.smooth("EKF", made, sigmax.run("EKF", made, PRIOR, Z, backend=backend), backend=backend).mean


def of_rows(made, backend):
    # Rows hold states alone: a bias is a part of them.
    steps = RowSteps("EKF", sigmax.models.augment(made), backend=backend)
    mean = np.array([[2.0, 1.0][: made.size + made.biases]])
    rows, _ = steps.predict(steps.start(mean, np.eye(mean.size)[None]), 1.0)
    return steps.mean(steps.correct(rows, "", Z[:1])[0])


DRIVERS = {"run": recorded, "Live": stepped, "smooth": smoothed, "rows": of_rows}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.one_in(7)
def test_a_changed_value_gives_the_answer_of_a_fresh_model(way):
    """Of motion x ↦ a x in every way of reading a, natively and on XLA; the judge is a constant in new functions."""
    engines = ("native", "xla") if list(WAYS).index(way) % 8 == 0 or "comp" in way or "loop" in way else ("native",)
    for engine in engines:
        f, change = WAYS[way]()
        made = model(sensor=f)
        for value in (1.0, 0.5, 2.0, 1.0):
            change(value)
            wanted = kalman(value)
            for once in (made, model(sensor=f)):
                np.testing.assert_allclose(recorded(once, engine), wanted, rtol=1e-9)


def kalman(a, q=0.1, r=0.5):
    """Of x⁺ = x, z = a x by hand."""
    x, P, found = 2.0, 1.0, []
    for z in Z[:, 0]:
        P += q
        K = P * a / (a * a * P + r)
        x, P = x + K * (z - a * x), (1 - K * a) * P
        found.append([x])
    return np.array(found)


@pytest.mark.parametrize(
    ("place", "engine", "driver"),
    list(itertools.product(PLACES, ["native", "xla"], DRIVERS)),
)
@pytest.mark.one_in(10)
def test_a_changed_value_counts_in_every_function_and_driver(place, engine, driver):
    space = written("def f(x): return x * A", A=0.9)
    made = model(**PLACES[place](space["f"]))
    found = []
    for value in (0.9, 0.4):
        space["A"] = value
        found.append(DRIVERS[driver](made, engine))
    fresh = model(**PLACES[place](lambda x: x * 0.4))
    np.testing.assert_allclose(found[1], DRIVERS[driver](fresh, engine), rtol=1e-12)
    if place != "domain" or driver != "run":
        assert not np.allclose(found[0], found[1])


def test_objects_that_are_equal_are_two_functions():
    @dataclass(frozen=True)
    class Gain:
        a: np.ndarray = field(compare=False)

        def __call__(self, x):
            return x * self.a

    for engine in ("native", "xla"):
        for value in (1.0, 0.5):
            made = model(sensor=Gain(np.array(value)))
            np.testing.assert_allclose(recorded(made, engine), kalman(value), rtol=1e-9)


def test_a_frozen_dataclass_may_hold_an_array():
    @dataclass(frozen=True)
    class Gain:
        a: np.ndarray

        def __call__(self, x):
            return x * self.a

    np.testing.assert_allclose(recorded(model(sensor=Gain(np.array([0.5]))), None), kalman(0.5), rtol=1e-9)


def test_a_function_that_counts_its_calls_is_traced_once():
    calls = []

    def f(x):
        calls.append(x)
        return x * 0.5

    made = model(sensor=f)
    recorded(made, "xla")
    count = len(calls)
    recorded(made, "xla")
    assert len(calls) == count


def test_a_fit_reads_what_build_reads_now():
    space = written("A = 1.0\ndef g(x): return x * A", A=1.0)

    def build(p):
        return model(sensor=space["g"], R=p["r"] * jnp.ones(1)), PRIOR

    found = []
    for value in (1.0, 0.5):
        space["A"] = value
        found.append(sigmax.fit("EKF", build, {"r": 0.5}, Z, positive=("r",)).log_likelihood)

    def fresh(p):
        return model(sensor=lambda x: x * 0.5, R=p["r"] * jnp.ones(1)), PRIOR

    wanted = sigmax.fit("EKF", fresh, {"r": 0.5}, Z, positive=("r",)).log_likelihood
    assert abs(found[1] - wanted) < 1e-6 < abs(found[0] - wanted)


def writable(array):
    array.flags.writeable = True
    return array


def in_place(array, value):
    array[...] = value


# How a model is changed itself: what Q, R or the sensor's gain become.
CHANGES = {
    "Q": lambda made, value: setattr(made, "Q", sigmax.Model(**PLAIN | dict(Q=[value])).Q),
    "R": lambda made, value: made.R.update({"": sigmax.Model(**PLAIN | dict(R=[value])).R[""]}),
    "Q in place": lambda made, value: in_place(writable(made.Q.entries), value),
    "R in place": lambda made, value: in_place(writable(made.R[""].entries), value),
    "gain": lambda made, value: made.sensors.update({"": lambda x: x * value}),
}
PLAIN = dict(motion=lambda x, dt: x, sensor=lambda x: x, Q=[0.1], R=[0.5], state=("x",), measurement=("z",))


@pytest.mark.parametrize("filter", ["EKF", "KF"])
@pytest.mark.parametrize("what", CHANGES)
@pytest.mark.one_in(2)
def test_a_model_that_is_changed_itself_gives_the_answer_of_a_fresh_one(what, filter):
    made = model()
    for value in (0.3, 0.7, 0.3):
        for engine in ("native", "xla"):
            CHANGES[what](made, value)
            given = dict(Q=0.1, R=0.5, gain=1.0) | {what.split()[0]: value}
            found = sigmax.run(filter, made, PRIOR, Z, backend=engine).mean
            np.testing.assert_allclose(found, kalman(given["gain"], given["Q"], given["R"]), rtol=1e-9)


def test_a_bias_and_modes_that_are_changed_themselves():
    bias = dict(sensor=np.ones((1, 1)), prior=sigmax.Gaussian([1.0], [1.0]))
    made, one = model(bias=sigmax.Bias(**bias)), np.eye(2)
    modes = {"slow": model(), "fast": model(Q=[3.0])}
    switching = sigmax.imm(modes, transition=one)
    for mean, stay in ((1.0, 0.9), (-2.0, 0.6), (1.0, 0.9)):
        made.bias.prior = prior = sigmax.Gaussian([mean], [1.0])
        in_place(one, [[stay, 1 - stay], [1 - stay, stay]])
        for changed, fresh in (
            (made, model(bias=sigmax.Bias(**bias | dict(prior=prior)))),
            (switching, sigmax.imm(modes, transition=one.copy(), initial=switching.initial)),
        ):
            found = [sigmax.run("EKF", m, PRIOR, Z).mean for m in (changed, changed, fresh)]
            np.testing.assert_array_equal(found[0], found[2])
            np.testing.assert_array_equal(found[1], found[2])


@pytest.mark.parametrize("engine", ["native", "xla"])
def test_functions_that_share_a_compiled_helper_each_see_what_it_reads_now(engine):
    space = written("@jax.jit\ndef g(x): return x * A\ndef f(x): return g(x)\ndef h(x): return g(x)", A=1.0)
    first, second = model(sensor=space["f"]), model(sensor=space["h"])
    for value, made in ((1.0, first), (0.5, second), (1.0, first), (0.5, first), (1.0, second)):
        space["A"] = value
        for once in (made, model(sensor=made.sensors[""])):
            np.testing.assert_allclose(recorded(once, engine), kalman(value), rtol=1e-9)


def test_a_warning_of_float32_comes_with_every_run():
    made = model(sensor=lambda x: x * jnp.float32(0.1))
    for _ in range(3):
        with pytest.warns(UserWarning, match="seven digits"):
            recorded(made, None)


def test_another_process_sees_what_a_function_imports(tmp_path):
    """An import in the body of a function: what was compiled before the module was edited is not found again."""
    (tmp_path / "program.py").write_text(
        "import numpy as np, sigmax\n"
        "def f(x):\n    from own_settings import GAIN\n    return x * GAIN\n"
        "def g(x):\n    import own_settings\n    return x * own_settings.GAIN\n"
        "for h in (f, g):\n"
        "    m = sigmax.Model(motion=lambda x, dt: x, sensor=h, Q=[0.1], R=[0.5])\n"
        "    r = sigmax.run('EKF', m, sigmax.Gaussian([2.0], [1.0]), np.array([[1.0], [0.5], [0.25]]))\n"
        "    print(r.mean[-1, 0])\n"
    )
    for value in (1.0, 0.25):
        (tmp_path / "own_settings.py").write_text(f"GAIN = {value}\n")
        command = [sys.executable, "-B", "program.py"]
        told = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
        np.testing.assert_allclose([float(line) for line in told.stdout.split()], kalman(value)[-1, 0], rtol=1e-9)

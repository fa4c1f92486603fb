"""Functions written in plain NumPy are what they are when they are called: on both engines, in values and in effect."""

import math
import pickle
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.engine.vectorized import vectorized
from sigmax.tracing import traceable
from tests.numpy_compositions import drawn
from tests.numpy_table import FUNCTIONS, XLA_ALONE, A

POINTS = np.array([[0.3, -1.2, 2.1], [1.3, 0.2, 0.7], [-2.2, -0.4, -1.1], [0.51, 0.52, 0.53], [3.7, 1.6, -4.4]])
PRIOR = sigmax.Gaussian([0.5, 0.3], [0.1, 0.1])


def plain(functions, points):
    with np.errstate(all="ignore"):
        return np.array([np.concatenate([np.ravel(np.asarray(f(x.copy()), float)) for f in functions]) for x in points])


def compared(names, functions, points, backend):
    """All functions together, so that one compilation does."""
    together = [traceable(f) for f in functions]

    def all_of_them(x):
        return jnp.concatenate([jnp.ravel(jnp.asarray(f(x))) for f in together])

    (got,) = vectorized(all_of_them, points, backend=backend)
    sizes = [np.size(plain([f], points[:1])) for f in functions]
    bounds = np.cumsum(sizes)[:-1]
    for name, one, want in zip(
        names, np.split(got, bounds, 1), np.split(plain(functions, points), bounds, 1), strict=True
    ):
        np.testing.assert_allclose(one, want, rtol=1e-9, atol=1e-11, err_msg=f"{name} on {backend}")


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_functions_of_numpy_are_themselves(backend):
    names = [name for name in FUNCTIONS if backend == "xla" or name not in XLA_ALONE]
    compared(names, [FUNCTIONS[name] for name in names], POINTS, backend)


def compositions(seeds, backend):
    functions = [drawn(seed) for seed in seeds]
    points = np.random.default_rng(11).normal(size=(6, 4)) * 1.7
    names = [f"seed {seed}: {steps}" for seed, (_, steps) in zip(seeds, functions, strict=True)]
    compared(names, [f for f, _ in functions], points, backend)


@pytest.mark.parametrize("part", range(3))
@pytest.mark.one_in(3)
def test_random_functions_of_numpy_are_themselves(part):
    compositions(range(50 * part, 50 * part + 50), "native")


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "xla"])
@pytest.mark.parametrize("part", range(3, 63))
def test_thousands_of_random_functions_of_numpy_are_themselves(part, backend):
    compositions(range(50 * part, 50 * part + 50), backend)


@pytest.mark.slow
@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_of_numpy_in_motion_and_sensor(name):
    """The first step of a filter without noise to speak of is the function itself."""
    f = FUNCTIONS[name]
    m = np.size(plain([f], POINTS[:1]))
    for x in POINTS[:2] + 0.013:  # no multiple of anything
        model = sigmax.Model(
            motion=lambda x, dt: x + dt * np.resize(np.ravel(np.asarray(f(x.copy()))), 3) * 0.1,
            sensor=lambda x: np.ravel(np.asarray(f(x))),
            state=("a", "b", "c"),
            Q=np.full(3, 1e-18),
            R=np.full(m, 1e9),
        )
        moved = x + 0.1 * np.resize(plain([f], x[None])[0], 3)
        for backend in ("xla",) if name in XLA_ALONE else ("native", "xla"):
            prior = sigmax.Gaussian(x, np.full(3, 1e-18))
            result = sigmax.run("CKF", model, prior, np.zeros((1, m)), dt=1.0, backend=backend)
            np.testing.assert_allclose(result.mean[0], moved, rtol=1e-6, atol=1e-7)
            np.testing.assert_allclose(-result.innovation[0], plain([f], moved[None])[0], rtol=1e-5, atol=1e-6)


def moved(x, dt):
    F = np.eye(2)
    F[0, 1] = dt
    return F @ x


def seen(x):
    return np.array([math.sin(x[0]), np.hypot(x[0], x[1])])


def moved_by_jax(x, dt):
    return jnp.stack([x[0] + dt * x[1], x[1]])


def seen_by_jax(x):
    return jnp.stack([jnp.sin(x[0]), jnp.hypot(x[0], x[1])])


def model(motion=moved, sensor=seen, **changes):
    return sigmax.Model(**(dict(motion=motion, sensor=sensor, Q=[0.1, 0.1], R=[0.1, 0.2]) | changes))


Z = np.random.default_rng(0).normal(size=(12, 2)) * 0.3 + [0.4, 0.7]


@pytest.mark.parametrize(("name", "backend"), [("UKF", "native"), ("EKF", "native"), ("SRECKFB", "xla")])
def test_a_model_in_numpy_is_the_model_in_jax(name, backend):
    own, theirs = (
        sigmax.run(name, m, PRIOR, Z, dt=0.1, backend=backend) for m in (model(), model(moved_by_jax, seen_by_jax))
    )
    np.testing.assert_allclose(own.mean, theirs.mean, rtol=1e-10)
    np.testing.assert_allclose(own.cov, theirs.cov, rtol=1e-9, atol=1e-14)


def test_noises_domain_bias_and_derivatives_in_numpy():
    def written_with(array, *functions):
        return model(
            *functions,
            state=("a", "b"),
            measurement=("c", "d"),
            Q=lambda x, dt: array.diag(array.array([0.1 + x[0] ** 2, 0.1])) * dt,
            R=lambda x: array.array([0.1, 0.2 + array.abs(x[1])]),
            domain=lambda x: array.array([x[0], array.maximum(x[1], -5.0)]),
            bias=sigmax.Bias(
                sensor=lambda x: array.array([[x[0]], [1.0]]), prior=sigmax.Gaussian([0.0], [0.01]), names=("offset",)
            ),
        )

    ours, theirs = written_with(np, moved, seen), written_with(jnp, moved_by_jax, seen_by_jax)
    a, b = (sigmax.run("EKF", m, PRIOR, Z, dt=0.1) for m in (ours, theirs))
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-9)
    by_hand = sigmax.models.with_derivatives(seen, lambda x: np.array([[math.cos(x[0]), 0.0], x / np.hypot(*x)]))
    np.testing.assert_allclose(
        sigmax.run("EKF", model(sensor=by_hand), PRIOR, Z, dt=0.1).mean,
        sigmax.run("EKF", model(), PRIOR, Z, dt=0.1).mean,
        rtol=1e-9,
    )


def test_live_pickle_and_fit_take_models_in_numpy():
    live = sigmax.Live("UKF", model(), PRIOR)
    again = pickle.loads(pickle.dumps(live))
    for z in Z[:3]:
        live.step(z, dt=0.1)
        again.step(z, dt=0.1)
    np.testing.assert_array_equal(live.mean, again.mean)
    np.testing.assert_allclose(live.mean, sigmax.run("UKF", model(), PRIOR, Z[:3], dt=0.1).mean[-1], rtol=1e-12)

    def build(given, array):
        def drag(x, dt):
            return array.array([x[0] + dt * x[1], x[1] * (1 - given["drag"] * dt)])

        return model(drag, seen if array is np else seen_by_jax), PRIOR

    ours, theirs = (sigmax.fit("EKF", lambda p, a=a: build(p, a), {"drag": 0.5}, Z, dt=0.1) for a in (np, jnp))
    assert ours.parameters["drag"] == pytest.approx(theirs.parameters["drag"], rel=1e-5)


def test_functions_in_jax_are_traced_as_they_are():
    for f, given in ((moved_by_jax, (np.ones(2), 1.0)), (seen_by_jax, (np.ones(2),))):
        one, other = (str(jax.make_jaxpr(g)(*given)) for g in (f, lambda *a, f=f: traceable(f)(*a)))
        assert one == other
        assert traceable(f) is traceable(f)


class Car:
    def __init__(self):
        self.F, self.scale = np.eye(2), 0.5

    def scaled(self, x):
        y = np.zeros(2)
        y[0], y[1] = self.scale * x[0], math.cos(x[1])
        return y

    @property
    def gain(self):
        return np.diag([self.scale, 1.0])

    def fx(self, x, dt):
        F = self.F.copy()
        F[0, 1] = dt
        return F @ x + 0.01 * self.scaled(x)

    def hx(self, x):
        return self.gain @ x


def test_methods_see_their_object_as_it_is_now_and_leave_it_so():
    car = Car()
    before = sigmax.run("UKF", model(car.fx, car.hx), PRIOR, Z, dt=0.1).mean
    assert type(car.F) is np.ndarray
    np.testing.assert_array_equal(car.F, np.eye(2))
    car.scale = 0.7
    car.F[1, 1] = 0.9
    after = sigmax.run("UKF", model(car.fx, car.hx), PRIOR, Z, dt=0.1).mean
    other = Car()
    other.scale, other.F[1, 1] = 0.7, 0.9
    np.testing.assert_array_equal(after, sigmax.run("UKF", model(other.fx, other.hx), PRIOR, Z, dt=0.1).mean)
    assert not np.allclose(before, after)


def test_nothing_of_numpy_is_changed_while_a_function_is_traced():
    real = np.zeros, np.array, math.cos
    found = []

    def motion(x, dt):
        numpy = sys.modules["numpy"]
        found.append((numpy.zeros, numpy.array, sys.modules["math"].cos))
        y = np.zeros(2)
        y[:] = x
        return y

    traceable(motion)(jnp.ones(2), jnp.asarray(1.0))
    assert set(found) == {real}


def decides(x, dt):
    if x[0] > 0:
        return x
    return -x


def loops(x):
    a = x[0]
    while a > np.pi:
        a -= 2 * np.pi
    return np.array([a, x[1]])


def truncates(x, dt):
    y = np.array([0, 0])
    y[0] = x[0]
    return y


RNG = np.random.default_rng(0)
CALLS = []


def remembers(x, dt):
    CALLS.append(1)
    return x + len(CALLS)


class Foreign:
    """As a spline of SciPy: what is computed is computed elsewhere, with known numbers."""

    def __call__(self, x):
        return memoryview(np.ascontiguousarray(x, float))


@pytest.mark.parametrize(
    ("functions", "words"),
    [
        (dict(motion=decides), r"decides by the value.*\(test_numpy_functions.py, line \d+, in decides\).*np.where"),
        (dict(sensor=loops), r"decides by the value.*\(test_numpy_functions.py, line \d+, in loops\).*np.where"),
        (dict(motion=truncates), r"whole number.*\(test_numpy_functions.py, line \d+, in truncates\)"),
        (dict(motion=lambda x, dt: x + RNG.normal(size=2)), "another result for the same arguments"),
        (dict(motion=remembers), "another result for the same arguments"),
        (dict(sensor=lambda x: x[x > 0]), r"for which a condition holds \(test_numpy.*np.where"),
        (dict(sensor=lambda x: A[int(x[0]), :2]), r"whole number.*\(test_numpy.*np.interp"),
        (dict(sensor=lambda x: np.asarray(Foreign()(x))), r"\(test_numpy.*opaque"),
        (dict(sensor=lambda x: x.reshape(-1, 1)), r"returns \(2, 1\): write .ravel\(\)"),
        (dict(sensor=lambda x: np.hypot(x[0], x[1]), R=[1.0]), r"returns \(\), a number: write np.array"),
        (dict(motion=lambda x, dt: np.array([x[0, 0], x[1, 0]])), r"no column \(n, 1\)"),
    ],
)
def test_what_cannot_be_traced_is_told_in_words(functions, words):
    with pytest.raises(sigmax.InputError, match=words):
        sigmax.run("UKF", model(**functions), PRIOR, Z[:, : 1 if "R" in functions else 2], dt=0.1)


def test_a_silent_difference_is_found():
    """JAX makes another array where NumPy changes the one that has two names: the function is right."""

    def motion(x, dt):
        y = x
        y += dt
        return np.stack([x[0], y[1]]) if isinstance(x, np.ndarray) else jnp.stack([x[0], y[1]])

    (got,) = vectorized(lambda x: traceable(motion)(x, jnp.asarray(0.5)), np.ones((1, 2)))
    np.testing.assert_array_equal(got, [[1.5, 1.5]])


def test_a_motion_by_its_equation_and_parts_put_together_take_functions_in_numpy():
    def swing(x):
        return np.array([x[1], -9.81 * math.sin(x[0])])

    def swing_by_jax(x):
        return jnp.stack([x[1], -9.81 * jnp.sin(x[0])])

    results = []
    for drift, sensor in ((swing, seen), (swing_by_jax, seen_by_jax)):
        exact = sigmax.sde(drift, [[0.0], [1.0]], state=("a", "b"))
        own = sigmax.models.Motion(lambda x, dt, f=drift: x + dt * f(x), ("a", "b"), lambda: [0.1, 0.1])
        walk = sigmax.motions.random_walk(("bias",))
        joined = sigmax.motions.join(own, walk)
        for motion, Q in ((exact, exact.noise(0.1)), (joined, [0.1, 0.1, 0.01])):
            made = sigmax.Model(motion=motion, sensor=sensor, Q=Q, R=[0.1, 0.2])
            prior = sigmax.Gaussian(np.full(made.size, 0.3), np.full(made.size, 0.1))
            results.append(sigmax.run("EKF", made, prior, Z[:3], dt=0.1).mean)
    for ours, theirs in zip(results[:2], results[2:], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)


def test_exported_c_holds_functions_in_numpy(tmp_path):
    sources = []
    for k, m in enumerate((model(), model(moved_by_jax, seen_by_jax))):
        made = sigmax.export_c("EKF", m, PRIOR, tmp_path / str(k), name="swing", dt=0.1)
        assert made.operations["predict"] > 0
        sources.append(made.operations)
    assert sources[0] == sources[1]


def test_a_file_of_functions_in_numpy_runs_from_a_description(tmp_path):
    (tmp_path / "own.py").write_text(
        "import numpy as np\nfrom math import sin\n\n\ndef motion(x, dt):\n    F = np.eye(2)\n    F[0, 1] = dt\n"
        "    return F @ x\n\n\ndef sensor(x):\n    return [sin(x[0])]\n"
    )
    from sigmax.files.userfile import Functions

    functions = Functions(tmp_path)
    made = sigmax.Model(
        motion=functions("own.py:motion", "motion"), sensor=functions("own.py:sensor", "sensor"), Q=[0.1, 0.1], R=[0.1]
    )
    want = sigmax.Model(motion=moved_by_jax, sensor=lambda x: jnp.sin(x[:1]), Q=[0.1, 0.1], R=[0.1])
    got, want = (sigmax.run("UKF", m, PRIOR, Z[:, :1], dt=0.1).mean for m in (made, want))
    np.testing.assert_allclose(got, want, rtol=1e-10)


def test_what_rounding_alone_changes_is_no_difference():
    """A chaotic motion: a last digit is worth everything after so many turns."""

    def folded(x, dt):
        a = x[0]
        for _ in range(60):
            a = 3.99 * np.mod(a, 1.0) * (1 - np.mod(a, 1.0)) + 0 * np.hypot(a, dt)
        return np.array([a, x[1]])

    def wrong(x, dt):
        return x + (0.0 if isinstance(x, np.ndarray) and x[0].__class__ is np.float64 else 1e-6)

    assert np.isfinite(np.asarray(traceable(folded)(jnp.ones(2) / 3, jnp.asarray(1.0)))).all()
    with pytest.raises(sigmax.InputError, match=r"traced it would give .* and called it gives"):
        traceable(wrong)(jnp.ones(2), jnp.asarray(1.0))

"""Fits: members of a family are models, slopes are those of the exact likelihood, and what is not told is said."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.engine.lowered import Lowered
from sigmax.fitting import em
from sigmax.fitting.likelihood import Data, Likelihood, Likelihoods
from sigmax.fitting.maximum import climb, derivatives
from sigmax.fitting.search import search_of


def walk(parameters):
    noise = parameters["sensor"] ** 2
    model = sigmax.Model(
        motion=lambda x, dt: x,
        sensor=lambda x: x + parameters["bias"] * jnp.array([0.0, 1.0]),
        Q=[0.01, 0.01],
        R=jnp.stack([noise, noise]),
        state=("a", "b"),
    )
    return model, sigmax.Gaussian([0.0, 0.0], np.eye(2) * 1e-4)


def test_fitting_finds_what_made_the_record():
    rng = np.random.default_rng(5)
    x = np.cumsum(rng.standard_normal((4, 60, 2)) * 0.1, axis=1)
    z = x + rng.standard_normal(x.shape) * 0.3 + [0.0, 1.5]
    got = sigmax.fit("EKF", walk, {"sensor": 1.0, "bias": 0.0}, z, positive=["sensor"])
    assert got.converged
    assert abs(got.parameters["sensor"] - 0.3) < 4 * got.std["sensor"]
    assert abs(got.parameters["bias"] - 1.5) < 4 * got.std["bias"]
    assert 0.005 < got.std["sensor"] < 0.05
    with pytest.raises(sigmax.InputError, match="sensor"):
        sigmax.fit("EKF", walk, {"sensor": 1.0, "bias": 0.0}, z, positive=["sensors"])
    with pytest.raises(sigmax.InputError, match="positive"):
        sigmax.fit("EKF", walk, {"sensor": -1.0, "bias": 0.0}, z, positive=["sensor"])


def level(parameters):
    noise = LEVEL.noise(parameters["q"])
    return sigmax.Model(motion=LEVEL, sensor=seen, Q=noise, R=[parameters["r"]]), sigmax.Gaussian([0.0, 0.0], [1, 1])


LEVEL = sigmax.motions.constant_velocity(("a",))


def seen(x):
    return x[:1]


def test_a_problem_is_compiled_once(monkeypatch):
    """Another record of the size, another start: the filter is not traced again."""
    rng, traced, found, program = np.random.default_rng(0), [], [], Lowered._program
    monkeypatch.setattr(Lowered, "_program", lambda self, *about: traced.append(1) or program(self, *about))
    for start in (0.5, 2.0, 1.0):
        z = rng.standard_normal((20, 1)) * start
        found.append(sigmax.fit("EKF", level, {"q": 1.0, "r": start}, z, positive=("q", "r")))
        if start == 0.5:
            first = len(traced)
    assert len(traced) == first <= 3
    assert len({float(f.parameters["r"]) for f in found}) == 3


def test_what_the_build_reads_is_not_remembered_when_it_changes():
    """The sensor's offset is a global of this file: the fit of the same function is that of the new value."""
    z = np.random.default_rng(0).standard_normal((20, 1))
    before = sigmax.fit("EKF", shifted, {"r": 1.0}, z, positive="r")
    SHIFT[0] = 5.0
    after = sigmax.fit("EKF", shifted, {"r": 1.0}, z, positive="r")
    assert before.parameters["r"] < 2 < after.parameters["r"]


SHIFT = [0.0]


def shifted(parameters):
    offset = SHIFT[0]
    prior = sigmax.Gaussian([0.0], [1e-6])
    return sigmax.Model(motion=lambda x, dt: x, sensor=lambda x: x + offset, Q=[1e-9], R=[parameters["r"]]), prior


def drawn(T, q=0.3, r=2.0, seed=0):
    """A record of `level` (T, 1)."""
    rng, x, z = np.random.default_rng(seed), np.zeros(2), []
    Q = np.asarray(LEVEL.noise(q)(1.0))
    for _ in range(T):
        x = np.array([x[0] + x[1], x[1]]) + rng.multivariate_normal(np.zeros(2), Q)
        z.append([x[0] + rng.normal() * np.sqrt(r)])
    return np.array(z)


def exact(theta, z):
    """The log-likelihood of `level` by the textbook, for complex parameters too."""
    q, r = theta
    F, Q = np.array([[1, 1], [0, 1]]), q * np.array([[1 / 3, 1 / 2], [1 / 2, 1]])
    x, P, total = np.zeros(2, complex), np.eye(2) + 0j, 0
    for (value,) in z:
        x, P = F @ x, F @ P @ F.T + Q
        S, nu = P[0, 0] + r, value - x[0]
        total += -0.5 * (nu * nu / S + np.log(2 * np.pi * S))
        K = P[:, 0] / S
        x, P = x + K * nu, P - np.outer(K, P[0])
    return total


def test_slopes_are_those_of_the_exact_likelihood():
    """Of a linear model, by complex steps through the textbook's filter: exact to rounding."""
    z, theta = drawn(50), np.array([0.2, 1.5])
    search, start = search_of({"q": 0.2, "r": 1.5}, ("q", "r"), {})
    L = Likelihoods(sigmax.get("EKF"), [Data(level, z)], search, start)
    value, slope, curved = derivatives(L.inside(), search.inside(theta), np.full(2, 1e-2))
    assert value == pytest.approx(exact(theta, z).real, rel=1e-12)
    wanted = np.array([exact(theta + 1e-30j * e, z).imag / 1e-30 * t for e, t in zip(np.eye(2), theta, strict=True)])
    np.testing.assert_allclose(slope, wanted, rtol=1e-3)
    # Differences are wrong by the square of their step.
    near = derivatives(L.inside(), search.inside(theta), np.full(2, 1e-3))[1]
    np.testing.assert_allclose(near - wanted, (slope - wanted) / 100, atol=2e-4 * np.abs(slope - wanted).max() + 1e-7)

    def by_logarithm(y):
        return np.array([exact(np.exp(y) * np.exp(1e-30j * e), z).imag / 1e-30 for e in np.eye(2)])

    y, h = np.log(theta), 1e-5
    rows = [(by_logarithm(y + h * e) - by_logarithm(y - h * e)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(curved, rows, rtol=2e-3)


def test_the_maximum_is_that_of_the_exact_likelihood():
    from scipy.optimize import minimize

    def slope(y, z):
        return np.array([-exact(np.exp(y + 1e-30j * e), z).imag / 1e-30 for e in np.eye(2)])

    z = drawn(80)
    found = sigmax.fit("EKF", level, {"q": 1.0, "r": 1.0}, z, positive=("q", "r"), hold_out=0.25)
    best, first = (
        minimize(lambda y, z: -exact(np.exp(y), z).real, [0.0, 0.0], (part,), jac=slope) for part in (z, z[:60])
    )
    np.testing.assert_allclose([found.parameters["q"], found.parameters["r"]], np.exp(best.x), rtol=1e-4)
    assert found.log_likelihood == pytest.approx(-best.fun, rel=1e-9)
    assert found.start_log_likelihood == pytest.approx(exact([1.0, 1.0], z).real, rel=1e-12)
    # What is held out: the likelihood of the later steps, with the maximum of the first ones.
    later = [(exact(t, z) - exact(t, z[:60])).real for t in ([1.0, 1.0], np.exp(first.x))]
    assert found.held_out.steps == 20
    assert found.held_out.before == pytest.approx(later[0], rel=1e-10)
    assert found.held_out.after == pytest.approx(later[1], rel=1e-5)
    # Along a number the log-likelihood is that of its values, and of a parabola of its standard error near the top.
    q = found.along[0]
    assert q.name == "q"
    assert np.interp(found.parameters["q"] + found.std["q"], q.values, q.lost) == pytest.approx(0.5, abs=0.25)
    assert found.status == 0
    json.dumps(found.to_dict(), allow_nan=False)
    assert len(found.plot("matplotlib").axes) == 2


TURN = sigmax.motions.constant_velocity(("x", "y"))


def rich(p):
    """A bias, inputs, two sensors, a noise of state and one that is a function: everything reads a parameter."""
    bias = sigmax.Bias(
        prior=sigmax.Gaussian([p["m"]], [p["q"]]), sensor={"place": jnp.ones((2, 1)) * p["k"], "way": None}, Q=[p["q"]]
    )
    model = sigmax.Model(
        motion=lambda x, dt, u: TURN.function(x, dt) + p["k"] * u[0] * jnp.array([0, 0, 1.0, 0]),
        sensor={"place": lambda x: x[:2], "way": lambda x, u: jnp.hypot(x[0] - u[1], x[1])[None]},
        Q=TURN.noise(p["q"]),
        R={"place": jnp.stack([p["r"], 2 * p["r"]]), "way": lambda x: (p["r"] + 0.01 * jnp.abs(x[0]))[None]},
        state=TURN.state,
        bias=bias,
    )
    return model, sigmax.Gaussian(jnp.stack([p["m"], 0.0, 1.0, 1.0]), jnp.ones(4) * p["r"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["EKF", "TSCKF"])
def test_a_member_of_the_family_is_the_model_of_its_parameters(name):
    """Two tracks, R of one sensor by row: the batch of parameters gives what `run` gives of each."""
    one, theta = of_rich(name)
    data = one.data
    got = one(theta)
    for value, t in zip(got, theta, strict=True):
        model, prior = rich(one.search.named(t))
        done = sigmax.run(name, model, prior, data.z, dt=0.5, inputs=data.inputs, R=data.R, update_first=True)
        assert value == pytest.approx(float(done.log_likelihood.sum()), rel=1e-9)


@pytest.mark.slow
def test_both_engines_give_the_same():
    one, theta = of_rich("EKF")
    np.testing.assert_allclose(one._by_xla(theta, one.steps), one(theta), rtol=1e-9)
    np.testing.assert_allclose(one._by_xla(theta[:1], 7), one(theta[:1], 7), rtol=1e-9)


def of_rich(name):
    rng, T = np.random.default_rng(3), 12
    z = {"place": rng.normal(size=(2, T, 2)).cumsum(1), "way": np.abs(rng.normal(size=(2, T, 1))) + 3}
    z["way"][:, ::3] = np.nan
    data = Data(rich, z, 0.5, rng.normal(size=(T, 2)), {"place": rng.uniform(0.5, 2, (T, 2))}, True)
    search, start = search_of({"q": 1.0, "r": 1.0, "m": 0.0, "k": 1.0}, ("q", "r"), {})
    theta = np.array([[0.7, 0.5, 2.0, 0.3], start, [-0.4, -0.2, 0.5, 3.0]])
    return Likelihood(sigmax.get(name), data, search, start), theta


def test_several_records_share_their_parameters():
    a, b = drawn(30, seed=1), drawn(18, seed=2)
    search, start = search_of({"q": 1.0, "r": 1.0}, ("q", "r"), {})
    both = Likelihoods(sigmax.get("EKF"), [Data(level, a), Data(level, b)], search, start)
    theta = np.array([[0.3, 1.0], [1.0, 2.0]])
    np.testing.assert_allclose(both(theta), [exact(t, a).real + exact(t, b).real for t in theta], rtol=1e-12)
    found = sigmax.fit("EKF", level, {"q": 1.0, "r": 1.0}, a, positive=("q", "r"), more=[{"z": b}])
    assert found.log_likelihood == pytest.approx(climb(both.inside(), np.zeros(2), np.ones(2)).value, rel=1e-12)
    for given, said in (({"z": b, "x": 1}, "unknown part of a record 'x'"), ({"dt": 1.0}, "must be a dict with z")):
        with pytest.raises(sigmax.InputError, match=said):
            sigmax.fit("EKF", level, {"q": 1.0, "r": 1.0}, a, positive=("q", "r"), more=[given])


def mixed(p):
    return level({"q": jnp.asarray(p["a"] * p["b"]), "r": jnp.asarray(p["r"] + 0 * p["idle"])})


def test_what_a_record_does_not_tell_is_said():
    """Factors of one product, a number that nothing reads, and a noise of which the record shows nothing."""
    start = {"a": 1.0, "b": 0.5, "r": 1.0, "idle": 2.0}
    found = sigmax.fit("EKF", mixed, start, drawn(80), positive=("a", "b", "r"))
    assert found.status == 1
    assert any("a and b only together" in said for said in found.undetermined)
    assert any("says nothing of idle" in said for said in found.undetermined)
    assert np.isnan([found.std["a"], found.std["b"], found.std["idle"]]).all()
    assert np.isfinite(found.std["r"])
    assert "not determined" in repr(found)
    json.dumps(found.to_dict(), allow_nan=False)
    still = np.random.default_rng(0).normal(size=(200, 1))
    found = sigmax.fit("EKF", level, {"q": 1.0, "r": 1.0}, still, positive=("q", "r"))
    assert any("of q the record tells only that it is below" in said for said in found.undetermined)
    assert abs(found.parameters["r"] - 1) < 3 * found.std["r"]


def test_bounds_are_kept():
    z = drawn(80)
    found = sigmax.fit("EKF", level, {"q": 1.0, "r": 1.0}, z, bounds={"q": (0.1, 5.0), "r": (0.1, 5.0)})
    free = sigmax.fit("EKF", level, {"q": 1.0, "r": 1.0}, z, positive=("q", "r"))
    for name in ("q", "r"):
        assert found.parameters[name] == pytest.approx(free.parameters[name], rel=1e-4)
        assert found.std[name] == pytest.approx(free.std[name], rel=0.05)
    held = sigmax.fit("EKF", level, {"q": 1.0, "r": 0.4}, z, positive="q", bounds={"r": (0.1, 0.5)})
    assert any("r runs into its bound 0.5" in said for said in held.undetermined)
    for bounds, said in (({"q": 3}, "two numbers"), ({"q": (2, 3)}, "between 2 and 3"), ({"x": (0, 1)}, "'x'")):
        with pytest.raises(sigmax.InputError, match=said):
            sigmax.fit("EKF", level, {"q": 1.0, "r": 1.0}, z, bounds=bounds)


def test_a_robust_update_has_a_robust_likelihood():
    z = drawn(200)
    z[::17] += 60
    plain, robust = (
        sigmax.fit(sigmax.get("EKF", update=u), level, {"q": 0.3, "r": 2.0}, z, positive=("q", "r"))
        for u in ("once", "student")
    )
    assert plain.parameters["r"] > 50
    assert 0.5 < robust.parameters["r"] < 5


@pytest.mark.parametrize("seeds", [8, pytest.param(200, marks=pytest.mark.slow)])
def test_the_truth_is_within_two_standard_errors(seeds):
    """As often as it should be, 95 %, less what chance leaves of so many records; by the logarithm of each."""
    near = []
    for seed in range(seeds):
        found = sigmax.fit("EKF", level, {"q": 1.0, "r": 1.0}, drawn(200, seed=seed), positive=("q", "r"))
        for name, true in (("q", 0.3), ("r", 2.0)):
            value = float(found.parameters[name])
            near.append(abs(np.log(value / true)) < 2 * found.std[name] / value)
    assert np.mean(near) > (0.75 if seeds < 20 else 0.92)


@pytest.mark.slow
def test_numbers_of_the_filter_are_fitted_with_the_others():
    """The top of the profile over degrees of freedom, each place by a fit of its own."""
    z = drawn(120)
    z[::11] += 30

    def made(p):
        return sigmax.get("EKF", update=sigmax.robust("student", dof=p["nu"]))

    start = {"q": 1.0, "r": 1.0, "nu": 4.0}
    found = sigmax.fit(made, level, start, z, positive=("q", "r"), bounds={"nu": (0.5, 50)}, hold_out=0.3)
    assert found.status == 0

    def profile(nu):
        return sigmax.fit(made({"nu": nu}), level, {"q": 1.0, "r": 1.0}, z, positive=("q", "r")).log_likelihood

    nu, std = float(found.parameters["nu"]), float(found.std["nu"])
    # A weight that is at most 1 bends the likelihood: its top is found to a thousandth.
    assert profile(nu) == pytest.approx(found.log_likelihood, abs=1e-3)
    assert found.log_likelihood > max(profile(nu * 0.8), profile(nu * 1.25)) - 0.05
    lost = [found.log_likelihood - profile(nu + s * std) for s in (-1, 1)]
    assert 0.2 < np.mean(lost) < 1.0
    assert found.start["nu"] == 4.0
    json.dumps(found.to_dict(), allow_nan=False)
    with pytest.raises(sigmax.InputError, match="give bounds"):
        sigmax.fit(made, level, start, z, positive=("q", "r"))
    with pytest.raises(sigmax.InputError, match="must give a filter"):
        sigmax.fit(lambda p: p["nu"], level, start, z, positive=("q", "r"), bounds={"nu": (0.5, 50)})


def test_em_is_that_of_the_textbook():
    """Shumway and Stoffer's steps for a factor of Q and one of R, written out in NumPy, step by step the same."""
    z, steps = drawn(60), 6
    model = sigmax.Model(motion=LEVEL, sensor=seen, Q=LEVEL.noise(1.0), R=[1.0], measurement=("level",))
    found = em("EKF", model, sigmax.Gaussian([0.0, 0.0], [1, 1]), z, steps=steps)
    F, Q, q, r = np.array([[1, 1], [0, 1.0]]), np.array([[1 / 3, 1 / 2], [1 / 2, 1]]), 1.0, 1.0
    for k in range(steps):
        assert found.log_likelihood[k] == pytest.approx(exact([q, r], z).real, rel=1e-9)
        mean, cov, ahead, x, P = [], [], [], np.zeros(2), np.eye(2)
        for (value,) in z:
            x, P = F @ x, F @ P @ F.T + q * Q
            ahead.append((x, P))
            K = P[:, 0] / (P[0, 0] + r)
            x, P = x + K * (value - x[0]), P - np.outer(K, P[0])
            mean.append(x)
            cov.append(P)
        later, spread = mean[-1], cov[-1]
        noise, misses = 0.0, [(z[-1, 0] - later[0]) ** 2 + spread[0, 0]]
        for t in range(len(z) - 2, -1, -1):
            G = cov[t] @ F.T @ np.linalg.inv(ahead[t + 1][1])
            x, P = mean[t] + G @ (later - ahead[t + 1][0]), cov[t] + G @ (spread - ahead[t + 1][1]) @ G.T
            w, both = later - F @ x, spread @ G.T @ F.T
            noise += np.trace(np.linalg.solve(Q, np.outer(w, w) + spread - both - both.T + F @ P @ F.T))
            later, spread = x, P
            misses.append((z[t, 0] - x[0]) ** 2 + P[0, 0])
        q, r = noise / (2 * (len(z) - 1)), np.mean(misses)
    assert [found.Q, found.R[""][0]] == pytest.approx([q, r], rel=1e-8)
    assert (np.diff(found.log_likelihood) > 0).all()
    best = sigmax.fit("EKF", level, {"q": found.Q, "r": found.R[""][0]}, z, positive=("q", "r"))
    assert best.log_likelihood >= found.log_likelihood[-1]
    nameless = sigmax.Model(motion=LEVEL, sensor=seen, Q=LEVEL.noise(1.0), R=lambda x: jnp.ones(1))
    with pytest.raises(sigmax.InputError, match="give the model measurement"):
        em("EKF", nameless, sigmax.Gaussian([0.0, 0.0], [1, 1]), z)


@pytest.mark.slow
def test_em_of_a_bent_model_comes_near_the_maximum():
    """Two tracks of a radar, an azimuth that turns, a value missing: the likelihood climbs to near its top."""
    s = sigmax.builtin("radar-ct")
    rng, T = np.random.default_rng(1), 80
    x = np.array([-2000.0, 5000.0, 50.0, 3.0, 0.02])
    z = []
    for _ in range(2):
        y, rows = x.copy(), []
        for _ in range(T):
            y = np.asarray(s.model.motion(y, 1.0)) + np.sqrt(np.asarray(s.model.Q.entries)) * rng.normal(size=5)
            seen_now = np.asarray(s.model.sensors[""](y))
            rows.append(seen_now + np.sqrt(np.asarray(s.model.R[""].entries)) * rng.normal(size=len(seen_now)))
        z.append(rows)
    z = np.array(z)
    z[0, 7] = np.nan
    prior = sigmax.Gaussian(x, np.array([1e2, 1e2, 10.0, 0.01, 1e-4]))
    found = em("EKF", s.model, prior, z, steps=30)
    assert found.log_likelihood[-1] > found.log_likelihood[0]
    # The third is a speed, which Q hides.
    assert np.abs(np.log(found.R[""][:2])).max() < 0.3


def in_turns(p):
    """A target that drives straight or turns hard; its initial probabilities do not hang on the parameters."""
    cruise = sigmax.Model(motion=TURN, sensor=lambda x: x[:2], Q=TURN.noise(p["q"]), R=jnp.stack([p["r"], p["r"]]))
    swerve = sigmax.Model(motion=TURN, sensor=lambda x: x[:2], Q=TURN.noise(30 * p["q"]), R=jnp.stack([p["r"], p["r"]]))
    return sigmax.imm({"cruise": cruise, "swerve": swerve}, sojourn={"cruise": 30.0, "swerve": 5.0}), sigmax.Gaussian(
        jnp.zeros(4), jnp.eye(4)
    )


@pytest.mark.slow
def test_modes_have_parameters_too():
    z = np.random.default_rng(0).normal(size=(30, 2)).cumsum(0)
    search, start = search_of({"q": 0.1, "r": 1.0}, ("q", "r"), {})
    one = Likelihood(sigmax.get("EKF"), Data(in_turns, z), search, start)
    theta = np.array([[0.1, 1.0], [0.5, 0.3]])
    for value, t in zip(one._natively(theta, 30), theta, strict=True):
        assert value == pytest.approx(
            float(sigmax.run("EKF", *in_turns(search.numbers(t)), z).log_likelihood), rel=1e-9
        )

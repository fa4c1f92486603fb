"""Covariances that are singular, tiny or huge, and exact measurements."""

from functools import cache

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import sigmax

EPS = np.finfo(float).eps
ONE_OF_EACH_FORM = ["EKF", "SREKF", "SREKFB", "EIF", "SREIF"]


def system_of(u):
    return u[:9].reshape(3, 3), u[9:15].reshape(2, 3)


MODEL = sigmax.Model(
    motion=lambda x, dt, u: system_of(u)[0] @ x,
    sensor=lambda x, u: system_of(u)[1] @ x,
    Q=lambda x, dt, u: u[15:24].reshape(3, 3),
    R=lambda x, u: u[24:28].reshape(2, 2),
    state=("a", "b", "c"),
    measurement=("u", "v"),
)


class Problem:
    """A linear problem (3 states, 2 measured) whose matrices are inputs, so that all of them share what is compiled."""

    def __init__(self, F=None, H=None, Q=0.0, R=1.0, P0=1.0, x0=(0.0, 0, 0), z=None, steps=5):
        self.F = np.eye(3) if F is None else np.asarray(F, float)
        self.H = np.array([[1.0, 0, 0], [0, 1, 0]]) if H is None else np.asarray(H, float)
        self.Q, self.R, self.P0 = (a * np.eye(n) if np.ndim(a) == 0 else np.asarray(a, float)
                                   for a, n in ((Q, 3), (R, 2), (P0, 3)))  # fmt: skip
        self.x0 = np.asarray(x0, float)
        self.z = np.ones((steps, 2)) if z is None else np.asarray(z, float)

    def run(self, name, **given):
        u = np.tile(np.concatenate([a.ravel() for a in (self.F, self.H, self.Q, self.R)]), (len(self.z), 1))
        return sigmax.run(name, MODEL, sigmax.Gaussian(self.x0, self.P0), self.z, inputs=u, **given), u

    def smooth(self, name):
        got, u = self.run(name)
        return got, sigmax.smooth(name, MODEL, got, inputs=u)

    def exact(self):
        """Filtered and smoothed means and deviations in 80 digits, with the pseudo-inverse where P is singular."""
        with mpmath.workdps(80):
            x, P, kept = _matrix(self.x0), _matrix(self.P0), []
            F, H, Q, R = map(_matrix, (self.F, self.H, self.Q, self.R))
            for z in self.z:
                before, ahead = (x, P), (F * x, F * P * F.T + Q)
                x, P = ahead
                seen = [i for i, v in enumerate(z) if not np.isnan(v)]
                if seen:
                    Hs = mpmath.matrix([[H[i, j] for j in range(3)] for i in seen])
                    Rs = mpmath.matrix([[R[i, j] for j in seen] for i in seen])
                    K = P * Hs.T * _pseudo_inverse(Hs * P * Hs.T + Rs)
                    x, P = x + K * (_matrix([float(z[i]) for i in seen]) - Hs * x), P - K * Hs * P
                kept.append((before, ahead, (x, P)))
            smoothed = [kept[-1][2]]
            for (x, P), (ahead, Pa), _ in kept[:0:-1]:
                G = P * F.T * _pseudo_inverse(Pa)
                late, Pl = smoothed[-1]
                smoothed.append((x + G * (late - ahead), P + G * (Pl - Pa) * G.T))
            return _told([k[2] for k in kept]), _told(smoothed[::-1])


def _matrix(a):
    return mpmath.matrix(np.asarray(a, float).tolist())


def _pseudo_inverse(P):
    """Of a covariance, by its eigenvalues; those below 60 of 80 digits are zero."""
    values, vectors = mpmath.eigsy(P)
    most = max(abs(v) for v in values)
    inverse = mpmath.diag([1 / v if abs(v) > most * mpmath.mpf(10) ** -50 else 0 for v in values])
    return vectors * inverse * vectors.T


def _told(track):
    means = np.array([[float(v) for v in x] for x, _ in track])
    return means, np.array([[float(mpmath.sqrt(max(P[i, i], 0))) for i in range(len(x))] for x, P in track])


ONES, SHARES = np.ones((3, 3)), np.eye(3) - np.ones((3, 3)) / 3
TURN = np.array([[1.0, 2, 0], [-1, 1, 1], [0, 1, -1]])
SINGULAR = {
    "copies": Problem(P0=ONES, Q=0.125 * ONES, R=0.01),
    "copies that stand still": Problem(P0=ONES, Q=0.0, R=0.01),
    "shares that sum to one": Problem(P0=np.array([[2.0, -1, -1], [-1, 2, -1], [-1, -1, 2]]) / 64,
                                      Q=np.array([[2.0, -1, -1], [-1, 2, -1], [-1, -1, 2]]) / 2048, R=0.01,
                                      x0=(1 / 4, 1 / 4, 1 / 2)),
    "rank one, turned": Problem(F=TURN, P0=np.outer([1, 2, -1], [1, 2, -1]), Q=np.outer([1, 0, 1], [1, 0, 1]) / 8),
    "one component known": Problem(F=[[1, 0.5, 0], [0, 1, 0], [0, 0, 1]], P0=np.diag([4.0, 1, 0]),
                                   Q=np.diag([0.25, 0, 0])),
    "no noise, a huge prior": Problem(F=TURN, P0=2.0**40, R=0.01),
    "a huge prior of one rank": Problem(P0=2.0**46 * ONES, Q=np.diag([2.0**-40, 0, 0]), R=0.01),
}  # fmt: skip


@pytest.mark.parametrize("name", ["EKF", "SREKFB", "SRUKFB"])
@pytest.mark.parametrize("case", SINGULAR)
def test_smoothing_with_singular_covariances_is_the_smoother_of_the_pseudo_inverse(case, name):
    p = SINGULAR[case]
    exact = p.exact()
    for got, (mean, std) in zip(p.smooth(name), exact, strict=True):
        assert got.ok.all()
        unit = std + 256 * EPS * (np.abs(mean).max() + np.sqrt(np.diagonal(p.P0)).max())
        assert (np.abs(got.mean - mean) / unit).max() < 1e-3
        assert (np.abs(got.std - std) / unit).max() < 1e-3


def test_a_copy_of_a_component_changes_no_other():
    """The third component is the first again: the first two answer as they do without it."""
    F = np.array([[1.0, 0.5, 0], [-0.25, 1, 0], [0, 0, 1]])
    P0, Q = np.diag([4.0, 1, 0]), np.diag([0.25, 0.5, 0])
    z = np.random.default_rng(3).normal(size=(6, 2))
    copy = np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 0]])
    alone = Problem(F=F, P0=P0, Q=Q, z=z)
    beside = Problem(F=copy @ F[:, :3] @ np.diag([1.0, 1, 0]), P0=copy @ P0 @ copy.T, Q=copy @ Q @ copy.T, z=z)
    for name in ONE_OF_EACH_FORM:
        for one, other in zip(alone.smooth(name), beside.smooth(name), strict=True):
            assert other.ok.all()
            # Rounding is 1 / 64 of what it is counted as, and enters a gain by the square of that.
            assert (np.abs(one.mean - other.mean)[:, :2] / one.std[:, :2]).max() < 1e-3
            assert np.abs(other.std[:, :2] / one.std[:, :2] - 1).max() < 1e-3
            assert np.abs(other.mean[:, 2] - other.mean[:, 0]).max() < 1e-11


@pytest.mark.parametrize("name", ONE_OF_EACH_FORM)
def test_a_prior_of_any_size_leaves_the_deviation_of_the_sensor(name):
    for k in range(0, 61, 6):
        got, _ = Problem(P0=2.0**k, R=9e-6).run(name)
        assert got.ok.all()
        assert np.allclose(
            got.std[:, :2], np.sqrt(9e-6 / (np.arange(5) + 1 + 9e-6 / 2.0**k))[:, None], rtol=1e-4 if k > 40 else 1e-6
        )


@pytest.mark.parametrize("name", ONE_OF_EACH_FORM)
def test_sixty_steps_from_a_huge_prior_by_a_sensor_of_a_sum(name):
    rng = np.random.default_rng(6)
    p = Problem(F=[[1, 0.1, 0], [0, 1, 0], [0, 0, 1]], H=[[1, 1, 0], [0, 0, 1]], Q=1e-9, R=1e-6, P0=1e12)
    x, p.z = np.array([4e5, -3e5, 1e6]), np.zeros((60, 2))
    for k in range(60):
        x = p.F @ x + np.sqrt(1e-9) * rng.normal(size=3)
        p.z[k] = p.H @ x + 1e-3 * rng.normal(size=2)
    for got, (mean, std) in zip(p.smooth(name), p.exact(), strict=True):
        assert got.ok.all()
        assert (np.abs(got.mean - mean) / std).max() < 1e-4
        assert np.abs(got.std / std - 1).max() < 1e-6


@pytest.mark.parametrize("name", ONE_OF_EACH_FORM)
def test_units_of_the_components_are_of_no_account(name):
    """Powers of two in each component: the same bits."""
    rng = np.random.default_rng(5)
    A, B = rng.normal(size=(2, 3, 3))
    p = Problem(
        F=np.eye(3) + 0.2 * A, H=rng.normal(size=(2, 3)), P0=B @ B.T, Q=0.1 * A @ A.T, z=rng.normal(size=(5, 2))
    )
    units = 2.0 ** np.array([20, -13, 4])
    other = Problem(
        F=units[:, None] * p.F / units,
        H=p.H / units,
        P0=units[:, None] * p.P0 * units,
        Q=units[:, None] * p.Q * units,
        z=p.z,
    )
    for one, scaled in zip(p.smooth(name), other.smooth(name), strict=True):
        assert np.array_equal(one.mean * units, scaled.mean)
        assert np.array_equal(one.std * units, scaled.std)


@pytest.mark.parametrize("name", ONE_OF_EACH_FORM)
def test_an_exact_measurement_repeated_changes_nothing_and_a_contradiction_shows(name):
    z = np.tile([1.25, -3.0], (6, 1))
    z[5, 0] = 1.26
    got, _ = Problem(P0=np.array([[2.0, 1, 0.5], [1, 2, 1], [0.5, 1, 2]]), H=[[1, 1, 0], [0, 1, 1]], R=0.0, z=z).run(
        name
    )
    assert got.ok.all()
    assert (np.diff(got.std[:5], axis=0) <= 4096 * EPS).all()
    assert (np.abs(np.diff(got.mean[:5], axis=0)) < 1e-3 * got.std[:4] + 4096 * EPS * 3).all()
    assert np.abs(got.mean[:5] @ [[1, 0], [1, 1], [0, 1]] - z[:5]).max() < 4096 * EPS * 3
    assert got.nis[5] > 1e6


@pytest.mark.parametrize("name", ONE_OF_EACH_FORM)
def test_constant_velocity_with_an_exact_sensor_in_three_axes(name):
    flight = sigmax.motions.constant_velocity(("x", "y", "z"))
    model = sigmax.Model(
        motion=flight, Q=flight.noise(0.1), sensor=lambda x: x[:3], R=np.zeros(3), measurement=("x", "y", "z")
    )
    z = np.cumsum(np.random.default_rng(2).normal(size=(30, 3)), axis=0)
    got = sigmax.run(name, model, sigmax.Gaussian(np.zeros(6), np.full(6, 100.0)), z)
    assert got.ok.all()
    assert np.abs(got.mean[:, :3] - z).max() < 1e-11
    assert got.std[:, :3].max() < 1e-11
    assert np.isfinite(got.nis).all()


def test_a_smoothed_deviation_is_not_above_the_filtered_one():
    for p in SINGULAR.values():
        got, smoothed = p.smooth("SREKFB")
        assert (smoothed.std <= got.std * (1 + 1e-9) + 64 * EPS * np.sqrt(np.diagonal(p.P0)).max()).all()


@cache
def slope_of_the_likelihood(name):
    def value(P0, R, u):
        model = sigmax.Model(
            motion=lambda x, dt: x,
            sensor=lambda x: x[:2],
            Q=jnp.zeros((3, 3)),
            R=R,
            state=("a", "b", "c"),
            measurement=("u", "v"),
        )
        return sigmax.run(
            name, model, sigmax.Gaussian(jnp.zeros(3), P0), jnp.asarray(u), keep=("fault",)
        ).log_likelihood

    return jax.jit(jax.grad(value, argnums=(0, 1)))


@pytest.mark.parametrize(
    "name", [pytest.param(f, marks=[pytest.mark.slow] * (f not in ("SREKFB", "EIF"))) for f in ONE_OF_EACH_FORM]
)
@pytest.mark.one_in(2)
def test_gradients_are_finite_at_zero_pivots_and_at_the_floors(name):
    z = np.random.default_rng(1).normal(size=(4, 2))
    for P0 in (np.ones((3, 3)), np.diag([1.0, 0, 2]), 1e12 * np.eye(3), np.eye(3)):
        for R in (np.ones(2), np.array([1.0, 1e-30])):
            for part in slope_of_the_likelihood(name)(P0, R, z):
                assert np.isfinite(part).all(), (P0, R)


def test_a_fault_says_what_caused_it_and_what_helps():
    nothing = Problem(H=np.zeros((2, 3)), R=0.0)
    got, _ = nothing.run("EKF")
    assert "R is 0 where nothing uncertain is measured: give it" in got.faults()[0]
    growing = Problem(F=np.diag([1.0, 1, 1e80]), steps=6)
    got, _ = growing.run("SREKF")
    assert int(sigmax.running.Fault.PREDICTION_INDEFINITE) in got.fault
    assert "a direction that no sensor observes" in got.faults()[-1]
    for fault in sigmax.running.Fault:
        if fault.name.endswith(("INDEFINITE", "WIDENED")):
            assert "; " in fault.message, fault


def test_contributions_to_the_state_with_a_component_known_exactly():
    model = sigmax.Model(
        motion=lambda x, dt: x, sensor={"s": lambda x: x[:1] + x[1:]}, Q=[0.1, 0.0], R={"s": [0.5]}, state=("a", "b"),
        measurement={"s": ["z"]},
    )  # fmt: skip
    prior = sigmax.Gaussian([1.0, 2.0], [4.0, 0.0])
    whole, parts = (sigmax.Live("SREIF", model, prior) for _ in range(2))
    for z in (2.5, 3.5, 3.0):
        whole.predict(1.0)
        whole.update([z], "s")
        parts.predict(1.0)
        sigmax.running.absorb(parts, [sigmax.running.contribution(parts, [z], "s", space="state")])
        assert np.allclose(parts.mean, whole.mean, rtol=1e-12)
        assert np.allclose(parts.cov, whole.cov, rtol=1e-12, atol=1e-13)
    with pytest.raises(sigmax.InputError, match="R of 's' has no inverse"):
        sigmax.running.contribution(parts, [1.0], "s", space="state", R=[0.0])

"""Laws of filters on curved spaces: turned with its world, an answer turns with it and is the same otherwise."""

import warnings
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.filters import Update
from sigmax.spaces import SPACES, Direction, Product, Rotation, conjugate, exponential, multiply, rotate
from tests.laws.problems import textbook

CURVED = {name: space for name, space in SPACES.items() if not space.flat}
# Compilers take some ten seconds for each: two in the quick suite, all in the slow one.
QUICK = {"rotation", "direction"}
EACH = [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in CURVED]
STEPS = 5


def parts_first(a):
    return jnp.moveaxis(jnp.asarray(a), -1, 0)


def parts_last(a):
    return np.moveaxis(np.asarray(a), 0, -1)


def add(space, x, d):
    """Points (..., size) and differences (..., dim), the components last."""
    return parts_last(space.add(parts_first(x), parts_first(d)))


def minus(space, a, b):
    return parts_last(space.difference(parts_first(a), parts_first(b)))


def identity(space):
    """The neutral element of a group, some direction."""
    return np.concatenate([_identity(p) for p, _, _ in space.parts()])


def _identity(p):
    return {3: np.array([0.0, 0.0, 1.0]), 4: np.array([1.0, 0, 0, 0])}.get(
        p.size if isinstance(p, Direction | Rotation) else 0,
        np.concatenate([[1.0], np.zeros(p.size - 1)]) if "qw" in p.numbers else np.zeros(p.size),
    )


def acted(space, g, x):
    """g · x of every part; directions are turned, by the attitude that is as long as the element."""
    if isinstance(space, Product):
        return np.concatenate([acted(p, g[to], x[..., at]) for p, at, to in space.parts()], axis=-1)
    if isinstance(space, Direction):
        turn = np.asarray(exponential(jnp.asarray(np.append(g, 0.4))))
        return parts_last(rotate(parts_first(np.broadcast_to(turn, (*x.shape[:-1], 4))), parts_first(x)))
    far = minus(space, x, np.broadcast_to(identity(space), x.shape))
    return add(space, np.broadcast_to(add(space, identity(space), g), x.shape), far)


@cache
def on(name):
    """A walk in a space that is measured as it is, with noise of the same size in all axes."""
    space = CURVED[name]
    part = sigmax.models.part("p", space)
    return sigmax.Model(
        motion=lambda x, dt: x,
        sensor=lambda x: x,
        Q=np.full(space.dim, 0.01),
        R=np.full(space.dim, 0.09),
        state=[part],
        measurement=[sigmax.models.part("z", space)],
    )


@cache
def drawn(name, tracks=3, seed=0):
    """Starts, truths and measurements."""
    space, rng = CURVED[name], np.random.default_rng(seed)
    start = add(space, np.tile(identity(space), (tracks, 1)), 0.6 * rng.standard_normal((tracks, space.dim)))
    x, truth, z = start, [], []
    x = add(space, x, 0.4 * rng.standard_normal((tracks, space.dim)))
    for _ in range(STEPS):
        x = add(space, x, 0.1 * rng.standard_normal((tracks, space.dim)))
        truth.append(x)
        z.append(add(space, x, 0.3 * rng.standard_normal((tracks, space.dim))))
    return start, np.stack(truth, 1), np.stack(z, 1)


def prior(name, start):
    return sigmax.Gaussian(start, np.full(CURVED[name].dim, 0.16))


@pytest.mark.parametrize("filter", ["EKF", "SRCKFB"])
@pytest.mark.parametrize("name", EACH)
@pytest.mark.one_in(2)
def test_what_is_turned_with_its_world_gives_the_same_turned(name, filter):
    space = CURVED[name]
    start, _, z = drawn(name)
    g = np.random.default_rng(5).uniform(-2, 2, space.dim)
    here = sigmax.run(filter, on(name), prior(name, start), z)
    there = sigmax.run(filter, on(name), prior(name, acted(space, g, start)), acted(space, g, z))
    assert here.ok.all()
    gap = minus(space, there.mean, acted(space, g, here.mean))
    size = np.sqrt((gap**2).sum(-1))
    assert (size / here.std.max(-1)).max() < 1e-9
    assert np.allclose(there.log_likelihood, here.log_likelihood, rtol=1e-9)
    assert np.allclose(there.nis, here.nis, rtol=1e-9)
    # The axes of a direction are chosen by where it points; those of a body turn with it.
    assert np.allclose(*(np.linalg.eigvalsh(r.cov) for r in (there, here)), rtol=1e-9)
    if not any(isinstance(p, Direction) for p, _, _ in space.parts()):
        assert np.allclose(there.cov, here.cov, rtol=1e-8, atol=1e-12)
    back, forth = (sigmax.smooth(filter, on(name), r) for r in (there, here))
    assert np.abs(minus(space, back.mean, acted(space, g, forth.mean))).max() < 1e-9


@pytest.mark.parametrize("name", ["rotation", pytest.param("product", marks=pytest.mark.slow)])
def test_the_other_sign_of_a_quaternion_is_the_same_attitude(name):
    space = CURVED[name]
    start, _, z = drawn(name)
    at = [i for i, n in enumerate(space.numbers) if n in ("w", "x", "y", "z", "qw", "qx", "qy", "qz")]
    quaternion = [p_at.start for p, p_at, _ in space.parts() if isinstance(p, Rotation)]
    rows = slice(quaternion[0], quaternion[0] + 4) if quaternion else slice(at[0], at[0] + 4)
    turned_start, turned_z = start.copy(), z.copy()
    turned_start[1, rows] *= -1
    turned_z[0, ::2, rows] *= -1
    same = sigmax.run("SRCKFB", on(name), prior(name, turned_start), turned_z)
    want = sigmax.run("SRCKFB", on(name), prior(name, start), z)
    assert np.abs(minus(space, same.mean, want.mean)).max() < 1e-12
    assert np.allclose(same.cov, want.cov, rtol=1e-11, atol=1e-15)


UPDATES = {"by itself": None, "once": sigmax.once, "iterated": sigmax.iterated(2), "student": sigmax.robust("student")}


FORMS = [
    (name, filter, update)
    for name in ("rotation", "product")
    for filter in ("SREKFB", "CIF", "SRPF")
    for update in UPDATES
]
ALWAYS = {("rotation", "SREKFB", "student")}


@pytest.mark.parametrize(
    ("name", "filter", "update"), [pytest.param(*c, marks=[pytest.mark.slow] * (c not in ALWAYS)) for c in FORMS]
)
def test_every_form_is_the_covariance_form_on_curved_spaces(name, filter, update):
    """The textbook's equations on XLA, every form on the native engine: both engines and all forms agree."""
    start, _, z = drawn(name)
    z = z.copy()
    z[0, 1, 0] = np.nan
    chosen = sigmax.get(filter, update=UPDATES[update])
    got = sigmax.run(chosen, on(name), prior(name, start), z, backend="native")
    want = sigmax.run(replace(chosen, form=textbook(False)), on(name), prior(name, start), z, backend="xla")
    assert got.ok.all()
    gap = minus(CURVED[name], got.mean, want.mean)
    assert np.abs(gap / want.std).max() < 1e-9
    assert np.allclose(got.cov, want.cov, rtol=1e-8, atol=1e-12)
    assert np.allclose(got.step_log_likelihood, want.step_log_likelihood, rtol=1e-9)
    assert np.array_equal(got.dof, want.dof)


@pytest.mark.parametrize("name", EACH)
@pytest.mark.one_in(2)
def test_live_is_the_record_and_single_precision_is_near(name):
    space = CURVED[name]
    start, _, z = drawn(name)
    record = sigmax.run("SRCKFB", on(name), prior(name, start), z)
    single = sigmax.run("SRCKFB", on(name), prior(name, start), z, dtype="float32")
    assert np.abs(minus(space, single.mean.astype(float), record.mean)).max() < 1e-4
    live = sigmax.Live("SRCKFB", on(name), prior(name, start[0]))
    for value in z[0]:
        told = live.step(value, 1.0)
    assert np.abs(live.mean - record.mean[0, -1]).max() < 1e-13
    assert np.allclose(live.cov, record.cov[0, -1], rtol=1e-12, atol=1e-16)
    assert told.residual.shape == (space.dim,)
    assert (record.mean.shape, record.cov.shape) == (z.shape, (*z.shape[:-1], space.dim, space.dim))
    again = sigmax.Live("SRCKFB", on(name), prior(name, start[1]))
    again.restore(live.save())
    assert np.array_equal(again.mean, live.mean)


@pytest.mark.slow
def test_a_part_that_is_missing_in_one_number_is_missing():
    start, _, z = drawn("product")
    one, all_of_it = z.copy(), z.copy()
    at = next(at for p, at, _ in CURVED["product"].parts() if isinstance(p, Rotation))
    one[0, 2, at.start + 1] = np.nan
    all_of_it[0, 2, at] = np.nan
    got, want = (sigmax.run("SRCKFB", on("product"), prior("product", start), seen) for seen in (one, all_of_it))
    assert np.array_equal(got.mean, want.mean)
    assert got.dof[0, 2] == CURVED["product"].dim - 3
    assert np.isnan(got.innovation[0, 2]).sum() == 3


# An attitude with gyroscopes of unknown drift, and two directions seen from the body.
SEEN = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
GYRO, DRIFT, SIGHT = 0.01, 1e-4, 0.1


def gyroscopes(x, dt, u):
    return jnp.concatenate([multiply(x[:4], exponential((u - x[4:]) * dt)), x[4:]])


def sights(x):
    return jnp.concatenate([rotate(conjugate(x[:4]), jnp.asarray(v)) for v in SEEN])


ATTITUDE = sigmax.Model(
    motion=gyroscopes,
    sensor=sights,
    Q=np.repeat(np.square([GYRO, DRIFT]), 3),
    R=np.full(6, SIGHT**2),
    state=(sigmax.rotation("attitude"), "bx", "by", "bz"),
)


def matrix(q):
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def across(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def right_jacobian(d):
    a = np.linalg.norm(d)
    K = across(d)
    if a < 1e-8:
        return np.eye(3) - K / 2
    return np.eye(3) - (1 - np.cos(a)) / a**2 * K + (a - np.sin(a)) / a**3 * K @ K


def product(p, q):
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def turn(d):
    a = np.linalg.norm(d)
    return np.concatenate([[np.cos(a / 2)], np.sinc(a / 2 / np.pi) / 2 * d])


def error_state(q, b, P, u, z, reset):
    """The multiplicative extended Kalman filter by its textbook equations (Markley 2003; Solà 2017, section 6)."""
    means, covs = [], []
    for rate, seen in zip(u, z, strict=True):
        w = rate - b
        F = np.block([[matrix(turn(w)).T, -right_jacobian(w)], [np.zeros((3, 3)), np.eye(3)]])
        q = product(q, turn(w))
        P = F @ P @ F.T + np.diag(np.repeat(np.square([GYRO, DRIFT]), 3))
        body = [matrix(q).T @ v for v in SEEN]
        H = np.block([[across(v), np.zeros((3, 3))] for v in body])
        S = H @ P @ H.T + SIGHT**2 * np.eye(6)
        K = P @ H.T @ np.linalg.inv(S)
        d = K @ (seen - np.concatenate(body))
        P = (np.eye(6) - K @ H) @ P @ (np.eye(6) - K @ H).T + SIGHT**2 * K @ K.T
        q, b = product(q, turn(d[:3])), b + d[3:]
        if reset:
            G = np.eye(6)
            G[:3, :3] = right_jacobian(d[:3])
            P = G @ P @ G.T
        means.append(np.concatenate([q, b]))
        covs.append(P)
    return np.array(means), np.array(covs)


def flown(tracks, steps, deviation, seed):
    """Gyroscopes, sights and true states from a start that is off by a deviation."""
    rng = np.random.default_rng(seed)
    space = ATTITUDE.space
    x = add(space, np.tile([1.0, 0, 0, 0, 0, 0, 0], (tracks, 1)), rng.standard_normal((tracks, 6)) * deviation)
    truth, u, z = [], [], []
    for _ in range(steps):
        rate = 0.2 * rng.standard_normal((tracks, 3))
        x = np.asarray(jax.vmap(gyroscopes, (0, None, 0))(x, 1.0, rate))
        x = add(space, x, rng.standard_normal((tracks, 6)) * np.repeat([GYRO, DRIFT], 3))
        truth.append(x)
        u.append(rate)
        z.append(np.asarray(jax.vmap(sights)(x)) + SIGHT * rng.standard_normal((tracks, 6)))
    return np.stack(truth, 1), np.stack(u, 1), np.stack(z, 1)


DEVIATION = np.repeat([0.5, 0.02], 3)
START = sigmax.Gaussian([1.0, 0, 0, 0, 0, 0, 0], DEVIATION**2)


@pytest.mark.parametrize(
    ("filter", "reset"),
    [
        pytest.param(f, reset, marks=[pytest.mark.slow] * ((f, reset) != ("SREKFB", True)))
        for f in ("EKF", "SREKFB", "EIF")
        for reset in (True, False)
    ],
)
def test_corrected_once_it_is_the_multiplicative_filter_of_the_textbook(filter, reset):
    _, u, z = flown(2, 200, DEVIATION, 1)
    chosen = sigmax.get(filter, update=Update(reset=reset))
    got = sigmax.run(chosen, ATTITUDE, START, z, inputs=u, dt=1.0)
    for track in range(2):
        means, covs = error_state(
            np.array([1.0, 0, 0, 0]), np.zeros(3), np.diag(DEVIATION**2), u[track], z[track], reset
        )
        gap = minus(ATTITUDE.space, got.mean[track], means)
        assert np.abs(gap / got.std[track]).max() < 1e-8
        scale = got.std[track][:, :, None] * got.std[track][:, None]
        assert np.abs((got.cov[track] - covs) / scale).max() < 1e-8


def nees(result, truth):
    e = result.errors(truth)
    return np.einsum("...i,...i", e, np.linalg.solve(result.cov, e[..., None])[..., 0]) / e.shape[-1]


@pytest.mark.parametrize("filter", ["SREKFB", pytest.param("SRCKFB", marks=pytest.mark.slow)])
def test_a_filter_on_attitudes_is_honest(filter):
    """From 30° off: one line about the prediction is not, a line about the posterior is, and so is the smoother."""
    truth, u, z = flown(400, 8, DEVIATION, 2)
    once, itself = (
        sigmax.run(sigmax.get(filter, update=up), ATTITUDE, START, z, inputs=u, dt=1.0) for up in ("once", None)
    )
    assert nees(once, truth)[:, 0].mean() > 1.2
    assert 0.85 < nees(itself, truth)[:, 0].mean() < 1.15
    assert 0.85 < nees(itself, truth)[:, -1].mean() < 1.15
    smoothed = sigmax.smooth(filter, ATTITUDE, itself)
    assert 0.85 < nees(smoothed, truth)[:, 0].mean() < 1.15
    size = [np.sqrt((r.errors(truth)[:, 0, :3] ** 2).sum(-1).mean()) for r in (once, itself, smoothed)]
    assert size[2] < size[1] < size[0]


def by_bias():
    """The attitude without its drift in the state: the drift and an offset of one sight are a bias."""
    return sigmax.Model(
        motion=lambda x, dt, u: multiply(x, exponential(u * dt)),
        sensor=sights,
        Q=np.full(3, GYRO**2),
        R=np.full(6, SIGHT**2),
        state=(sigmax.rotation("attitude"),),
        bias=sigmax.Bias(
            motion=lambda dt: jnp.eye(3, 4) * -dt,
            sensor=np.eye(6)[:, [3, 3, 3, 3]] * [0, 0, 0, 1],
            prior=sigmax.Gaussian(np.zeros(4), [0.02**2] * 3 + [0.1**2]),
            Q=[DRIFT**2] * 3 + [0.0],
            names=("bx", "by", "bz", "offset"),
        ),
    )


def by_hand():
    """The same with both in the state."""

    def motion(x, dt, u):
        return jnp.concatenate([multiply(multiply(x[:4], exponential(u * dt)), exponential(-x[4:7] * dt)), x[4:]])

    return sigmax.Model(
        motion=motion,
        sensor=lambda x: sights(x).at[3].add(x[7]),
        Q=np.array([GYRO**2] * 3 + [DRIFT**2] * 3 + [0.0]),
        R=np.full(6, SIGHT**2),
        state=(sigmax.rotation("attitude"), "bx", "by", "bz", "offset"),
    )


@pytest.mark.parametrize("filter", ["TSEKF", pytest.param("SREKFB", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_bias_of_curved_parts_is_the_state_with_it(filter):
    _, u, z = flown(3, 30, DEVIATION, 4)
    own = sigmax.Gaussian([1.0, 0, 0, 0], DEVIATION[:3] ** 2)
    whole = sigmax.Gaussian([1.0, *np.zeros(7)], [*DEVIATION[:3] ** 2, *[0.02**2] * 3, 0.1**2])
    got = sigmax.run(filter, by_bias(), own, z, inputs=u, dt=1.0)
    want = sigmax.run("SREKFB", by_hand(), whole, z, inputs=u, dt=1.0)
    gap = minus(ATTITUDE.space, np.concatenate([got.mean, got.bias_mean[..., :3]], -1), want.mean[..., :7])
    assert np.abs(gap / want.std[..., :6]).max() < 1e-9
    assert np.abs(got.bias_std / want.std[..., 3:] - 1).max() < 1e-9
    scale = want.std[..., :3, None] * want.std[..., None, :3]
    assert np.abs((got.cov - want.cov[..., :3, :3]) / scale).max() < 1e-9
    live = sigmax.Live(filter, by_bias(), own)
    for k in range(3):
        live.predict(1.0, u[0, k])
        live.update(z[0, k])
    assert np.allclose(live.mean, got.mean[0, 2], rtol=0, atol=1e-12)
    assert np.allclose(live.bias_std, got.bias_std[0, 2], rtol=1e-12)
    back, wanted = sigmax.smooth(filter, by_bias(), got), sigmax.smooth("SREKFB", by_hand(), want)
    assert np.abs((back.bias_mean - wanted.mean[..., 4:]) / want.std[..., 3:]).max() < 1e-9


@pytest.mark.slow
def test_a_domain_acts_on_points_and_deviations():
    """A domain that turns the whole state turns mean and covariance with it."""
    quarter = turn(np.array([0.0, 0.0, np.pi / 2]))

    def turned(x):
        return jnp.concatenate([multiply(jnp.asarray(quarter), x[:4]), x[4:]])

    _, u, z = flown(1, 1, DEVIATION, 3)
    plain = with_domain(None)
    made = with_domain(turned)
    want, got = (sigmax.run("SREKFB", m, START, np.full_like(z, np.nan), inputs=u) for m in (plain, made))
    assert np.abs(minus(ATTITUDE.space, got.mean[0], np.asarray(jax.vmap(turned)(want.mean[0])))).max() < 1e-12
    # From the left the world turns, and the axes of the body stay what they are.
    assert np.allclose(got.cov, want.cov, rtol=1e-10, atol=1e-14)


def with_domain(domain):
    return sigmax.Model(
        motion=gyroscopes,
        sensor=sights,
        Q=np.full(6, 1e-4),
        R=np.full(6, 0.01),
        domain=domain,
        state=(sigmax.rotation("attitude"), "bx", "by", "bz"),
    )


def test_sigma_points_beyond_half_a_turn_are_told():
    wide = sigmax.Gaussian([1.0, 0, 0, 0], np.full(3, 2.0**2))
    z = np.tile([1.0, 0, 0, 0], (2, 1))
    with pytest.warns(UserWarning, match="198° from the mean of p.roll"):
        sigmax.run("SRCKFB", on("rotation"), wide, z)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sigmax.run("EKF", on("rotation"), wide, z)
        sigmax.run("SRCKFB", on("rotation"), sigmax.Gaussian([1.0, 0, 0, 0], np.full(3, 1.8**2)), z)


def refused(model, cov, mean=(1.0, 0.0, 0.0, 0.0), filter="EKF"):
    sigmax.run(filter, model, sigmax.Gaussian(mean, cov), np.tile([1.0, 0, 0, 0], (2, 1)))


THREE = sigmax.Gaussian([1.0, 0, 0, 0], np.ones(3))


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (lambda m: refused(m, np.full(4, 0.1)), "4 deviations, the model has 3"),
        (lambda m: refused(m, np.full(3, 0.1), mean=[1.0, 1.0, 0, 0]), "unit length"),
        (lambda m: refused(m, np.full(3, 0.1), filter="KF"), "curved"),
        (lambda m: sigmax.models.part("a", "rotation"), "space"),
        (lambda m: sigmax.models.fused(m), "numbers and angles"),
        (lambda m: sigmax.explain("SRCKF", m, THREE), "numbers and angles"),
        (lambda m: sigmax.tracking.Modes([("EKF", m)]), "a tracker knows"),
    ],
)
def test_what_does_not_know_curved_parts_says_so(given, says):
    with pytest.raises(sigmax.InputError, match=says):
        given(on("rotation"))

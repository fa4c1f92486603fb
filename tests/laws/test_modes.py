"""Laws of models that take turns: against a textbook's IMM in covariances, and exact sums over all histories."""

import itertools
import pickle
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import block_diag, expm

import sigmax
from sigmax.running import Fault

SEEN = ("px", "py")
# What XLA compiles for half a minute is seen by the slow suite; the textbook's filter by both at once.
ENGINES = ["native", pytest.param("xla", marks=pytest.mark.slow)]
PRIOR = sigmax.Gaussian([0.0, 1.0, 0.0, 1.0], [4.0, 1.0, 4.0, 1.0])
H = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]])
R = np.array([[1.0, 0.2], [0.2, 0.5]])


def F(dt):
    return np.kron(np.eye(2), [[1, dt], [0, 1]])


def Q(q, dt):
    return q * np.kron(np.eye(2), [[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])


def moving(q, sensor=lambda x: x[jnp.array([0, 2])]):
    def motion(x, dt):
        return jnp.stack([x[0] + dt * x[1], x[1], x[2] + dt * x[3], x[3]])

    def noise(dt):
        block = jnp.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) * q
        return jnp.block([[block, jnp.zeros((2, 2))], [jnp.zeros((2, 2)), block]])

    return sigmax.Model(motion=motion, sensor=sensor, Q=noise, R=R, state=("x", "vx", "y", "vy"), measurement=SEEN)


CALM, WILD = moving(0.01), moving(5.0)


def walk(tracks, steps, seed=0):
    return np.random.default_rng(seed).normal(size=(tracks, steps, 2)).cumsum(1) * 2


def moments(weights, means, covs):
    mean = sum(w * m for w, m in zip(weights, means, strict=True))
    return mean, sum(w * (P + np.outer(m - mean, m - mean)) for w, m, P in zip(weights, means, covs, strict=True))


def textbook(z, dt, change, initial, noises):
    """The filter of Blom and Bar-Shalom as a textbook has it, with covariances and likelihoods."""
    M = len(noises)
    means, covs, mu, total, told = [PRIOR.mean] * M, [PRIOR.cov] * M, np.array(initial), 0.0, []
    for now, elapsed in zip(z, dt, strict=True):
        P = change(elapsed)
        later = mu @ P
        mixed = [moments(mu * P[:, j] / later[j], means, covs) for j in range(M)]
        means = [F(elapsed) @ m for m, _ in mixed]
        covs = [F(elapsed) @ C @ F(elapsed).T + Q(q, elapsed) for (_, C), q in zip(mixed, noises, strict=True)]
        there, likelihood = ~np.isnan(now), np.ones(M)
        for j in range(M) if there.any() else ():
            h = H[there]
            S, nu = h @ covs[j] @ h.T + R[there][:, there], now[there] - h @ means[j]
            K = covs[j] @ h.T @ np.linalg.inv(S)
            likelihood[j] = np.exp(-nu @ np.linalg.solve(S, nu) / 2) / np.sqrt(np.linalg.det(2 * np.pi * S))
            means[j], covs[j] = means[j] + K @ nu, covs[j] - K @ S @ K.T
        total += np.log(later @ likelihood)
        mu = later * likelihood / (later @ likelihood)
        told.append((*moments(mu, means, covs), mu))
    return [np.array(a) for a in zip(*told, strict=True)], total


MATRIX = np.array([[0.95, 0.05], [0.2, 0.8]])


def leaving(dt, sojourn=(30.0, 4.0)):
    rates = 1 / np.array(sojourn)[:, None] * (np.ones((2, 2)) - 2 * np.eye(2))
    return expm(rates * dt)


CHANGES = {
    "a matrix": ({"transition": MATRIX, "initial": [0.7, 0.3]}, lambda dt: MATRIX),
    "a function": (
        {"transition": lambda dt: jnp.eye(2) + (1 - jnp.exp(-dt)) * jnp.array([[-0.1, 0.1], [0.3, -0.3]])},
        lambda dt: np.eye(2) + (1 - np.exp(-dt)) * np.array([[-0.1, 0.1], [0.3, -0.3]]),
    ),
    "sojourn": ({"sojourn": {"calm": 30.0, "wild": 4.0}}, leaving),
}


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize(("change", "filter"), list(zip(CHANGES, ("SRCKFB", "KF", "EIF"), strict=True)))
def test_it_is_the_filter_of_the_textbook(change, filter, backend):
    given, P = CHANGES[change]
    model = sigmax.imm({"calm": CALM, "wild": WILD}, **given)
    z, dt = walk(1, 40)[0], np.random.default_rng(1).uniform(0.3, 2, 40)
    z[5], z[9, 0] = np.nan, np.nan
    wanted, total = textbook(z, dt, P, model.initial, (0.01, 5.0))
    got = sigmax.run(filter, model, PRIOR, z, dt=dt, backend=backend)
    assert got.ok.all()
    assert got.modes == ("calm", "wild")
    for ours, theirs in zip((got.mean, got.cov, got.probability), wanted, strict=True):
        assert np.allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    assert np.isclose(got.log_likelihood, total, rtol=1e-10)


def test_the_shares_of_time_are_those_of_the_chain():
    shares = sigmax.imm({"calm": CALM, "wild": WILD}, sojourn=[30.0, 10.0]).initial
    assert np.allclose(shares, [0.75, 0.25])
    P = np.array([[0.9, 0.1], [0.3, 0.7]])
    assert np.allclose(sigmax.imm({"calm": CALM, "wild": WILD}, transition=P).initial, [0.75, 0.25])
    assert np.allclose(sigmax.imm({"calm": CALM, "wild": WILD}).initial, 0.5)


def radar(q):
    def motion(x, dt):
        return jnp.stack([x[0] + dt * x[2] * jnp.cos(x[3]), x[1] + dt * x[2] * jnp.sin(x[3]), x[2], x[3]])

    def sensor(x):
        return jnp.stack([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])

    return sigmax.Model(
        motion=motion,
        sensor=sensor,
        Q=[0.1, 0.1, 0.1, q],
        R=[25.0, 1e-4],
        state=("x", "y", "speed", sigmax.angle("course")),
        measurement=("range", sigmax.angle("azimuth")),
    )


FROM = sigmax.Gaussian([-900.0, 20.0, 10.0, 3.0], [100.0, 100.0, 4.0, 0.04])


def plots(tracks=2, steps=25):
    rng, t = np.random.default_rng(2), np.arange(1, steps + 1)
    x, y = -900 - 10 * t, 20 - 1.5 * t
    z = np.stack([np.hypot(x, y), np.arctan2(y, x)], -1) + rng.normal(size=(tracks, steps, 2)) * [5, 0.01]
    z[..., 1] = (z[..., 1] + np.pi) % (2 * np.pi) - np.pi
    return z


@pytest.mark.parametrize(
    "filter", ["EKF", "SRCKFB", "UIF", *(pytest.param(f, marks=pytest.mark.slow) for f in ("SRPFB", "TSHCIF", "IEKF"))]
)
@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.one_in(3)
def test_modes_alike_are_the_one_filter(filter, backend):
    """Across the line of ±180°, smoothed too."""
    model = sigmax.imm({"a": radar(1e-3), "b": radar(1e-3)}, transition=MATRIX)
    z = plots()
    one = sigmax.run(filter, radar(1e-3), FROM, z, backend=backend)
    got = sigmax.run(filter, model, FROM, z, backend=backend)
    pairs = [(one, got), (sigmax.smooth(filter, radar(1e-3), one), sigmax.smooth(filter, model, got, backend=backend))]
    for theirs, ours in pairs:
        gap = ours.mean - theirs.mean
        gap[..., 3] = np.sin(gap[..., 3])
        assert np.allclose(gap, 0, atol=1e-6)
        assert np.allclose(ours.cov, theirs.cov, rtol=1e-6, atol=1e-9)
    assert np.allclose(got.nis, one.nis, rtol=1e-7)
    assert np.allclose(got.log_likelihood, one.log_likelihood, rtol=1e-9)
    assert np.allclose(got.probability, [0.8, 0.2], atol=1e-9)


def test_each_mode_runs_its_own_filter():
    """Where a target never changes, each mode is its filter alone, weighed by its likelihood."""
    model = sigmax.imm({"a": (radar(1e-3), "EKF"), "b": radar(0.1)}, initial=[0.3, 0.7])
    z = plots()
    each = [sigmax.run("EKF", radar(1e-3), FROM, z), sigmax.run("SRCKFB", radar(0.1), FROM, z)]
    logs = np.log([0.3, 0.7]) + np.stack([r.step_log_likelihood.cumsum(1) for r in each], -1)
    total = np.logaddexp(*np.moveaxis(logs, -1, 0))
    got = sigmax.run("SRCKFB", model, FROM, z)
    assert np.allclose(got.probability, np.exp(logs - total[..., None]), atol=1e-9)
    assert np.allclose(got.log_likelihood, total[:, -1], rtol=1e-9)
    named = sigmax.imm({"a": (radar(1e-3), "EKF"), "b": (radar(0.1), sigmax.get("SRCKFB"))}, initial=[0.3, 0.7])
    assert np.array_equal(sigmax.run(None, named, FROM, z).mean, got.mean)
    with pytest.raises(sigmax.InputError, match="give None in the place of EKF"):
        sigmax.run("EKF", named, FROM, z)


@pytest.mark.parametrize("backend", ENGINES)
def test_live_and_alone_it_is_the_run(backend):
    model = sigmax.imm({"calm": CALM, "wild": WILD}, sojourn=[30.0, 4.0])
    z = walk(3, 12)
    z[1, 4] = z[2, 5, 0] = np.nan
    whole = sigmax.run("SRCKFB", model, PRIOR, z, backend=backend)
    alone = sigmax.run("SRCKFB", model, PRIOR, z[1], backend=backend)
    near = {"rtol": 0, "atol": 0 if backend == "native" else 1e-12}
    assert np.allclose(alone.mean, whole.mean[1], **near)
    assert np.allclose(alone.probability, whole.probability[1], **near)
    live = sigmax.Live("SRCKFB", model, PRIOR, backend=backend)
    for k in range(12):
        told = live.step(z[1, k], 1.0)
        assert np.allclose(live.mean, whole.mean[1, k], **near)
        assert np.allclose(live.cov, whole.cov[1, k], **near)
        assert np.allclose(live.probability, whole.probability[1, k], **near)
        assert np.allclose(told.nis, whole.nis[1, k], equal_nan=True, **near)
        if k == 6:
            kept = live.save()
            other = sigmax.Live("SRCKFB", model, PRIOR, backend=backend)
            other.restore(kept)
            live = other
    wild = sigmax.imm({"calm": CALM, "wild": moving(6.0)}, sojourn=[30.0, 4.0])
    with pytest.raises(sigmax.InputError, match="another model"):
        sigmax.Live("SRCKFB", wild, PRIOR, backend=backend).restore(kept)


def all_histories(z, steps, change, initial, noises):
    """Exact smoothing of one record: the sum over all sequences of modes, each a Kalman smoother."""
    found = []
    for modes in itertools.product(range(len(noises)), repeat=steps):
        log = np.log((initial @ change)[modes[0]]) + sum(np.log(change[a, b]) for a, b in itertools.pairwise(modes))
        x, P, seen, expected = PRIOR.mean, PRIOR.cov, [], []
        for now, mode in zip(z, modes, strict=True):
            x, P = F(1) @ x, F(1) @ P @ F(1).T + Q(noises[mode], 1)
            expected.append((x, P))
            S, nu = H @ P @ H.T + R, now - H @ x
            K = P @ H.T @ np.linalg.inv(S)
            log -= nu @ np.linalg.solve(S, nu) / 2 + np.log(np.linalg.det(2 * np.pi * S)) / 2
            x, P = x + K @ nu, P - K @ S @ K.T
            seen.append((x, P))
        for k in range(steps - 2, -1, -1):
            G = seen[k][1] @ F(1).T @ np.linalg.inv(expected[k + 1][1])
            x = seen[k][0] + G @ (seen[k + 1][0] - expected[k + 1][0])
            seen[k] = x, seen[k][1] + G @ (seen[k + 1][1] - expected[k + 1][1]) @ G.T
        found.append((log, modes, seen))
    logs = np.array([log for log, _, _ in found])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    each = [moments(weights, *zip(*(seen[k] for _, _, seen in found), strict=True)) for k in range(steps)]
    shares = sum(w * np.eye(len(noises))[list(modes)] for w, (_, modes, _) in zip(weights, found, strict=True))
    return np.array([m for m, _ in each]), np.array([P for _, P in each]), shares


@pytest.mark.slow
def test_smoothed_it_is_near_the_sum_over_all_histories():
    """Nearer by far than the filter, and than smoothing all modes before from one belief."""
    rng, steps, initial = np.random.default_rng(4), 6, np.array([0.6, 0.4])
    tracks = 30
    z = np.empty((tracks, steps, 2))
    for track in z:
        mode, x = rng.choice(2, p=initial), rng.multivariate_normal(PRIOR.mean, PRIOR.cov)
        for now in track:
            mode = rng.choice(2, p=MATRIX[mode])
            x = rng.multivariate_normal(F(1) @ x, Q((0.01, 5.0)[mode], 1))
            now[:] = rng.multivariate_normal(H @ x, R)
    model = sigmax.imm({"calm": CALM, "wild": WILD}, transition=MATRIX, initial=initial)
    filtered = sigmax.run("KF", model, PRIOR, z)
    smoothed = sigmax.smooth("KF", model, filtered)
    exact = [np.array(a) for a in zip(*(all_histories(t, steps, MATRIX, initial, (0.01, 5.0)) for t in z), strict=True)]

    def away(result):
        return np.sqrt(((result.mean - exact[0]) ** 2).mean()), np.abs(result.probability - exact[2]).mean()

    assert (np.array(away(smoothed)) < 0.35 * np.array(away(filtered))).all()
    ours, theirs = (np.einsum("btii->bt", P) for P in (smoothed.cov, exact[1]))
    assert np.allclose(np.median(ours / theirs), 1, atol=0.02)
    assert np.allclose((ours / theirs).mean(), 1, atol=0.1)


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.slow
def test_smoothed_without_changes_it_is_the_mixture_of_smoothers(backend):
    model = sigmax.imm({"calm": CALM, "wild": WILD}, initial=[0.5, 0.5])
    z = walk(2, 10) / 2
    filtered = sigmax.run("KF", model, PRIOR, z)
    last = filtered.probability[:, -1]
    each = [sigmax.smooth("KF", m, sigmax.run("KF", m, PRIOR, z)) for m in (CALM, WILD)]
    mean = sum(last[:, None, None, i] * s.mean for i, s in enumerate(each))
    smoothed = sigmax.smooth("KF", model, filtered, backend=backend)
    assert np.allclose(smoothed.probability, last[:, None], atol=1e-9)
    assert np.allclose(smoothed.mean, mean, atol=1e-8)


def accelerated(q):
    def motion(x, dt):
        return jnp.stack([x[0] + dt * x[1] + dt**2 / 2 * x[2], x[1] + dt * x[2], 0.9 * x[2]])

    return sigmax.Model(
        motion=motion, sensor=lambda x: x[:1], Q=[0.01, 0.01, q], R=[1.0], state=("p", "v", "a"), measurement=("p",)
    )


def coasting():
    def motion(x, dt):
        return jnp.stack([x[0] + dt * x[1], x[1]])

    return sigmax.Model(
        motion=motion, sensor=lambda x: x[:1], Q=[0.01, 0.01], R=[1.0], state=("p", "v"), measurement=("p",)
    )


ENTRY = {"a": (0.3, 4.0)}
START = sigmax.Gaussian([0.0, 1.0, 0.3], [1.0, 1.0, 4.0])


@pytest.mark.parametrize("backend", ENGINES)
def test_what_a_mode_has_not_comes_in_by_its_entry(backend):
    """As a textbook's filter whose states are filled up by a component that is drawn anew on each entry."""
    P = np.array([[0.9, 0.1], [0.3, 0.7]])
    model = sigmax.imm({"coast": coasting(), "push": accelerated(0.1)}, transition=P, initial=[0.5, 0.5], entry=ENTRY)
    assert model.state == ("p", "v", "a")
    z = np.random.default_rng(5).normal(size=(30, 1)).cumsum(0) * 3
    A = [np.array([[1.0, 1], [0, 1]]), np.array([[1, 1, 0.5], [0, 1, 1], [0, 0, 0.9]])]
    noise = [np.diag([0.01, 0.01]), np.diag([0.01, 0.01, 0.1])]
    x, C, mu = [START.mean[:2], START.mean], [START.cov[:2, :2], START.cov], np.array([0.5, 0.5])

    def wide(m, S):
        return (m, S) if len(m) == 3 else (np.append(m, ENTRY["a"][0]), block_diag(S, ENTRY["a"][1]))

    got = sigmax.run("SRCKFB", model, START, z, backend=backend)
    for k, now in enumerate(z):
        later = mu @ P
        both = [wide(*pair) for pair in zip(x, C, strict=True)]
        likelihood = np.ones(2)
        for j, size in enumerate((2, 3)):
            mean, cov = moments(mu * P[:, j] / later[j], *zip(*both, strict=True))
            m, S = A[j] @ mean[:size], A[j] @ cov[:size, :size] @ A[j].T + noise[j]
            s, nu = S[0, 0] + 1, now[0] - m[0]
            likelihood[j] = np.exp(-nu * nu / s / 2) / np.sqrt(2 * np.pi * s)
            x[j], C[j] = m + S[:, 0] / s * nu, S - np.outer(S[:, 0], S[:, 0]) / s
        mu = later * likelihood / (later @ likelihood)
        mean, cov = moments(mu, *zip(*(wide(*pair) for pair in zip(x, C, strict=True)), strict=True))
        assert np.allclose(got.mean[k], mean, atol=1e-9)
        assert np.allclose(got.cov[k], cov, atol=1e-9)
        assert np.allclose(got.probability[k], mu, atol=1e-10)
    back = sigmax.smooth("SRCKFB", model, got, backend=backend)
    assert back.ok.all()
    assert np.allclose(back.mean[-1], got.mean[-1])
    still = sigmax.imm({"coast": coasting(), "push": accelerated(0.1)}, entry=ENTRY)
    kept = sigmax.run("SRCKFB", still, START, z)
    alone = [sigmax.smooth("SRCKFB", m, sigmax.run("SRCKFB", m, sigmax.Gaussian(START.mean[:n], START.cov[:n, :n]), z))
             for m, n in ((coasting(), 2), (accelerated(0.1), 3))]  # fmt: skip
    share = kept.probability[-1]
    speed = sum(p * s.mean[:, 1] for p, s in zip(share, alone, strict=True))
    assert np.allclose(sigmax.smooth("SRCKFB", still, kept, backend=backend).mean[:, 1], speed, atol=1e-8)


@pytest.mark.parametrize("backend", ENGINES)
def test_a_mode_that_fails_leaves_the_others(backend):
    def breaking(x):
        return jnp.where(x[0] > 5, jnp.nan, x[jnp.array([0, 2])])

    model = sigmax.imm({"calm": CALM, "broken": moving(5.0, breaking)}, transition=MATRIX)
    z = np.column_stack([np.linspace(0, 20, 21)] * 2)
    got = sigmax.run("EKF", model, PRIOR, z, backend=backend)
    late = got.mean[:, 0] > 6
    assert late.sum() > 10
    assert (got.fault[late] == Fault.MEMBER_FAILED).all()
    assert "one of several modes or members failed" in got.faults()[0]
    assert (got.probability[late, 1] == 0).all()
    assert np.abs(got.mean[late, 0] - z[late, 0]).max() < 1.5
    both = sigmax.imm({"a": moving(1.0, breaking), "b": moving(5.0, breaking)}, transition=MATRIX)
    lost = sigmax.run("EKF", both, PRIOR, z, backend=backend)
    assert lost.fault.max() == Fault.SENSOR_NOT_FINITE
    assert np.isfinite(lost.mean).all()


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.slow
def test_attitudes_are_mixed_where_they_live(backend):
    """Modes that turn at two speeds; the other sign of the quaternions is the same attitude."""

    def turning(rate):
        def motion(x, dt):
            half = jnp.stack([jnp.cos(rate * dt / 2), 0 * dt, 0 * dt, jnp.sin(rate * dt / 2)])
            return sigmax.spaces.multiply(x, half)

        def sensor(x):
            return sigmax.spaces.rotate(sigmax.spaces.conjugate(x), jnp.array([1.0, 0.0, 0.0]))

        return sigmax.Model(
            motion=motion,
            sensor=sensor,
            Q=[1e-4] * 3,
            R=[1e-2] * 3,
            state=[sigmax.rotation("attitude")],
            measurement=("a", "b", "c"),
        )

    model = sigmax.imm({"slow": turning(0.05), "fast": turning(0.3)}, sojourn=[20.0, 20.0])
    angles = np.cumsum([0.3] * 15 + [0.05] * 25)
    z = np.column_stack([np.cos(angles), -np.sin(angles), 0 * angles])
    z += np.random.default_rng(6).normal(size=z.shape) * 0.1
    prior = [sigmax.Gaussian([s, 0, 0, 0], [0.3] * 3) for s in (1.0, -1.0)]
    got, other = (sigmax.run("SRCKFB", model, p, z, backend=backend) for p in prior)
    assert got.ok.all()
    assert np.allclose(got.probability, other.probability, atol=1e-9)
    assert np.allclose(got.cov, other.cov, atol=1e-9)
    assert np.allclose(np.linalg.norm(got.mean, axis=1), 1)
    assert got.probability[10:14, 1].min() > 0.7
    assert got.probability[30:, 0].min() > 0.7
    back = sigmax.smooth("SRCKFB", model, got, backend=backend)
    assert back.ok.all()
    heading = 2 * np.arctan2(back.mean[:, 3], back.mean[:, 0])
    assert np.abs((heading - angles + np.pi) % (2 * np.pi) - np.pi).max() < 0.15


@pytest.mark.slow
def test_the_likelihood_differentiates_in_what_the_chain_is_made_of():
    z = walk(1, 10)[0]

    def likelihood(sojourn):
        model = sigmax.imm({"calm": CALM, "wild": WILD}, sojourn=jnp.stack([sojourn, 5.0]))
        return sigmax.run("SRCKFB", model, PRIOR, z).log_likelihood

    slope = jax.grad(likelihood)(jnp.asarray(20.0))
    wanted = (likelihood(jnp.asarray(20.1)) - likelihood(jnp.asarray(19.9))) / 0.2
    assert np.isclose(slope, wanted, rtol=1e-4)


def test_single_precision_is_near():
    model = sigmax.imm({"calm": CALM, "wild": WILD}, sojourn=[30.0, 4.0])
    z = walk(2, 20)
    single, double = (sigmax.run("SRCKFB", model, PRIOR, z, dtype=kind) for kind in ("float32", "float64"))
    assert np.allclose(single.mean, double.mean, atol=2e-3)
    assert np.allclose(single.probability, double.probability, atol=2e-3)


@pytest.mark.parametrize(
    ("modes", "given", "words"),
    [
        ({}, {}, "models by name"),
        ([CALM, WILD], {}, "models by name"),
        ({"a": CALM, "b": 3}, {}, "'b' is int"),
        ({"a": (CALM, "XKF")}, {}, "XKF"),
        ({"a": (CALM, 3)}, {}, "must be a name or a filter, not int"),
        ({"a": CALM, "b": radar(1.0)}, {}, "must measure the same"),
        ({"a": coasting(), "b": accelerated(1.0)}, {}, r"\['a'\] are not in every mode"),
        ({"a": coasting(), "b": accelerated(1.0)}, {"entry": {"a": 3.0}}, "a mean and a variance"),
        ({"a": coasting(), "b": accelerated(1.0)}, {"entry": {"a": (0, -1)}}, "a variance of at least 0"),
        ({"a": CALM, "b": WILD}, {"entry": {"x": (0, 1)}}, "what is not in every mode"),
        ({"a": CALM, "b": WILD}, {"transition": MATRIX, "sojourn": [1, 2]}, "give one of them"),
        ({"a": CALM, "b": WILD}, {"transition": MATRIX.T}, "probabilities that sum to 1"),
        ({"a": CALM, "b": WILD}, {"transition": [0.9, 0.1]}, r"the shape \(2, 2\)"),
        ({"a": CALM, "b": WILD}, {"transition": lambda dt: jnp.ones((2, 2))}, "probabilities that sum to 1"),
        ({"a": CALM, "b": WILD}, {"sojourn": [1, 0]}, "positive seconds"),
        ({"a": CALM, "b": WILD}, {"sojourn": {"a": 1}}, r"no entry for the modes \['b'\]"),
        ({"a": CALM, "b": WILD}, {"sojourn": {"a": 1, "c": 2}}, "'c'"),
        ({"a": CALM, "b": WILD}, {"initial": [0.5, 0.6]}, "sum to 1"),
    ],
)
def test_what_does_not_fit_is_a_message(modes, given, words):
    with pytest.raises(sigmax.InputError, match=words):
        sigmax.imm(modes, **given)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_exported_it_is_the_same_filter(dtype, tmp_path):
    modes = {"coast": (coasting(), "SREKFB"), "push": (accelerated(0.1), "CKF")}
    sigmax.export_c(None, sigmax.imm(modes, sojourn=[20, 5], entry=ENTRY), START, tmp_path, dt=0.5, dtype=dtype)
    done = subprocess.run(["make", "-C", str(tmp_path), "test"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the last 2: log probabilities of coast, push" in (tmp_path / "filter.h").read_text()


def test_results_of_other_modes_are_refused():
    model = sigmax.imm({"calm": CALM, "wild": WILD}, transition=MATRIX)
    got = sigmax.run("KF", model, PRIOR, walk(1, 5)[0])
    with pytest.raises(sigmax.InputError, match="its modes are"):
        sigmax.smooth("KF", CALM, got)
    with pytest.raises(sigmax.InputError, match="modes was not kept"):
        sigmax.smooth("KF", model, sigmax.run("KF", model, PRIOR, walk(1, 5)[0], keep=("mean", "factor", "fault")))
    with pytest.raises(sigmax.InputError, match="has no modes"):
        _ = sigmax.run("KF", CALM, PRIOR, walk(1, 5)[0]).probability
    with pytest.raises(sigmax.InputError, match="linear"):
        sigmax.run("KF", sigmax.imm({"a": radar(1.0), "b": radar(2.0)}), FROM, plots())
    assert np.array_equal(pickle.loads(pickle.dumps(model.initial)), model.initial)


def test_explained_it_is_each_mode_explained():
    narrow = sigmax.Model(
        motion=lambda x, dt: jnp.stack([x[0] * x[1], x[1]]), sensor=lambda x: x[:1], Q=[1.0, 1.0], R=[1.0],
        state=("x", "vx"), measurement=("x",),
    )  # fmt: skip
    wide = sigmax.Model(
        motion=lambda x, dt: jnp.stack([x[0], jnp.sin(x[2]), x[2]]), sensor=lambda x: x[:1], Q=[1.0, 1.0, 1.0],
        R=[1.0], state=("x", "vx", "w"), measurement=("x",),
    )  # fmt: skip
    model = sigmax.imm({"narrow": (narrow, "EKF"), "wide": wide}, sojourn=[5.0, 5.0], entry={"w": (0.0, 1.0)})
    prior = sigmax.Gaussian([0.0, 1.0, 0.0], [1.0, 2.0, 3.0])
    found = sigmax.explain("SRCKF", model, prior, measure=False)
    alone = [
        one._replace(function=f"{mode}: {one.function}")
        for mode, filter, part in (("narrow", "EKF", narrow), ("wide", "SRCKF", wide))
        for one in sigmax.explain(filter, part, sigmax.Gaussian(np.zeros(part.size), np.ones(part.size)), measure=False)
    ]
    assert found == alone
    assert [one.function for one in found] == ["narrow: motion", "narrow: sensor", "wide: motion", "wide: sensor"]


def test_it_has_whatever_a_model_has():
    """Anything that takes a Model may ask for what every Model has, before it finds that this one has modes."""
    model = sigmax.imm({"calm": CALM, "wild": WILD}, transition=MATRIX)
    again = jax.tree.unflatten(jax.tree.structure(model), jax.tree.leaves(model))
    for one in (model, again, model.with_models(model.models)):
        assert not set(vars(CALM)) - set(vars(one))


@pytest.mark.parametrize(
    "use",
    [
        lambda m, folder: sigmax.start(m, walk(1, 3)[0], at=np.zeros(4)),
        lambda m, folder: sigmax.tracking.Modes([("KF", m)]),
        lambda m, folder: sigmax.running.contribution(sigmax.Live("EIF", m, PRIOR), [0.0, 0.0], ""),
        lambda m, folder: m.motion(np.zeros(4), 1.0),
    ],
)
def test_what_knows_one_mode_alone_says_so(use, tmp_path):
    with pytest.raises(sigmax.InputError, match=r"model\.modes\[NAME\]"):
        use(sigmax.imm({"calm": CALM, "wild": WILD}, transition=MATRIX), tmp_path)

"""The problems that laws are tested on, and the exact Kalman filter in fifty digits."""

from functools import cache

import jax.numpy as jnp
import mpmath
import numpy as np

import sigmax
from sigmax.forms import Corrected, Form, Predicted

mpmath.mp.dps = 50
DT = 0.7


def covariance(rng, n, size=1.0):
    A = rng.standard_normal((n, n + 2))
    return size * A @ A.T / n


class Linear:
    """x ← A x + c dt, z = H x + d: constants checked by an offset, all matrices full."""

    def __init__(self, n=3, m=2, seed=0):
        rng = np.random.default_rng(seed)
        self.n, self.m = n, m
        self.A = np.eye(n) + 0.2 * rng.standard_normal((n, n)) / np.sqrt(n)
        self.H = rng.standard_normal((m, n))
        self.Q, self.R, self.P0 = (covariance(rng, k, s) for k, s in ((n, 0.3), (m, 0.5), (n, 1.0)))
        self.x0 = rng.standard_normal(n)
        self.z = rng.standard_normal((6, m))

    def model(self, Q=None, R=None):
        return sigmax.Model(
            motion=self.motion,
            sensor=self.sensor,
            Q=self.Q if Q is None else Q,
            R=self.R if R is None else R,
            state=[f"x{i}" for i in range(self.n)],
        )

    def motion(self, x, dt):
        return jnp.asarray(self.A) @ x

    def sensor(self, x):
        return jnp.asarray(self.H) @ x

    def exact(self, z, x0=None, Q=None, R=None):
        """Means and covariances of the Kalman filter by its textbook equations in fifty digits."""

        def matrix(a):
            return mpmath.matrix(np.asarray(a, float).tolist())

        A, H = matrix(self.A), matrix(self.H)
        Q = matrix(self.Q if Q is None else Q) * mpmath.mpf(DT)
        R = np.broadcast_to(self.R if R is None else R, (len(z), self.m, self.m))
        x, P = matrix(self.x0 if x0 is None else x0), matrix(self.P0)
        means, covs = [], []
        for row, noise in zip(z, R, strict=True):
            x, P = A * x, A * P * A.T + Q
            seen = [i for i, v in enumerate(row) if not np.isnan(v)]
            if seen:
                Hs = mpmath.matrix([[H[i, j] for j in range(self.n)] for i in seen])
                Rs = matrix(noise[np.ix_(seen, seen)])
                K = P * Hs.T * mpmath.inverse(Hs * P * Hs.T + Rs)
                x = x + K * (matrix([row[i] for i in seen]) - Hs * x)
                P = P - K * Hs * P
            means.append([float(v) for v in x])
            covs.append(np.array(P.tolist(), float))
        return np.array(means), np.array(covs)


@cache
def linear(n=3, m=2):
    return Linear(n, m, seed=n)


def turning_motion(x, dt, u):
    """An antenna's azimuth with rate and range, pulled by something fixed in direction u."""
    azimuth, rate, distance = x
    pull = 0.3 * jnp.sin(azimuth - u[0])
    return jnp.stack([azimuth + rate * dt + 0.1 * pull, rate - pull * dt, distance + 0.2 * jnp.cos(azimuth - u[0])])


def turning_sensor(x, u):
    return jnp.stack([x[0] + 0.05 * x[1] ** 2, x[2] * jnp.cos(0.3 * x[1]) + 0.2 * jnp.sin(x[0] - u[0])])


TURNING = sigmax.Model(
    motion=turning_motion,
    sensor=turning_sensor,
    Q=np.array([[0.01, 0.002, 0], [0.002, 0.01, 0], [0, 0, 0.02]]),
    R=np.array([[0.02, 0.005], [0.005, 0.05]]),
    state=(sigmax.angle("azimuth"), "rate", "distance"),
    measurement=(sigmax.angle("azimuth"), "distance"),
)
TURNING_PRIOR = np.array([0.3, 0.2, 5.0]), np.array([[0.05, 0.01, 0], [0.01, 0.04, 0], [0, 0, 0.3]])


def turning_record(steps=6, seed=1):
    rng = np.random.default_rng(seed)
    x, z = np.array([0.5, 0.1, 5.3]), []
    for _ in range(steps):
        x = np.asarray(turning_motion(jnp.asarray(x), DT, jnp.zeros(1)))
        z.append(np.asarray(turning_sensor(jnp.asarray(x), jnp.zeros(1))) + rng.standard_normal(2) * [0.14, 0.22])
    return np.array(z)


APART = sigmax.Model(
    motion=turning_motion,
    sensor={"antenna": lambda x, u: turning_sensor(x, u)[:1], "ruler": lambda x, u: turning_sensor(x, u)[1:]},
    Q=TURNING.Q,
    R={"antenna": [0.02], "ruler": [0.05]},
    state=TURNING.state,
    measurement={"antenna": [sigmax.angle("azimuth")], "ruler": ["distance"]},
    bias=sigmax.Bias(
        prior=sigmax.Gaussian([0.1, -0.05], np.array([[0.04, 0.01], [0.01, 0.02]])),
        motion=np.array([[0.3, -0.1], [0.0, 0.2], [0.1, 0.0]]),
        sensor={"antenna": np.array([[1.0, 0.0]]), "ruler": np.array([[0.2, 1.0]])},
        Q=[2e-3, 1e-3],
    ),
)


def textbook(bias_first):
    """The covariance form by its textbook equations, in products, an inverse and a difference of matrices."""

    def laid(a):
        return jnp.moveaxis(a, (0, 1), (-2, -1))

    def noise(L):
        return jnp.eye(len(L.entries)) * L.entries.T[..., None, :] if hasattr(L, "entries") else laid(L)

    def spread(line, L):
        columns = [(laid(line.slope), 1), (laid(line.residual), 1), (laid(line.deficit), -1), (noise(L), 1)]
        return sum(sign * a @ a.swapaxes(-1, -2) for a, sign in columns if a.shape[-1])

    def factor(P):
        return jnp.moveaxis(jnp.linalg.cholesky(P), (-2, -1), (0, 1))

    def predict(line, Lq):
        return Predicted(factor(spread(line, Lq)), jnp.ones(line.mean.shape[1:], bool))

    def correct(S, line, Lr, nu):
        Pyy, S, nu = spread(line, Lr), laid(S), jnp.moveaxis(nu, 0, -1)[..., None]
        K = S @ laid(line.slope).swapaxes(-1, -2) @ jnp.linalg.inv(Pyy)
        root = jnp.linalg.cholesky(Pyy)
        P = S @ S.swapaxes(-1, -2) - K @ Pyy @ K.swapaxes(-1, -2)
        shift, white = (jnp.moveaxis(a[..., 0], -1, 0) for a in (K @ nu, jnp.linalg.inv(root) @ nu))
        return Corrected(shift, factor(P), white, factor(Pyy), jnp.ones(line.mean.shape[1:], bool))

    return Form("textbook", predict, correct, bias_first=bias_first)


def scaled_gap(a, b):
    """Largest differences of means and covariances in units of b's standard deviations."""
    sd = np.asarray(b.std)
    difference = a.errors(b.mean)
    return (
        np.abs(difference / sd).max(),
        (np.abs(a.cov - b.cov) / (sd[..., :, None] * sd[..., None, :])).max(),
    )


# The unscented filters with a centre weight below zero, everything else as it comes.
NEGATIVE = {"alpha": 0.9, "beta": 0.0, "kappa": -0.5}


def made(name):
    entry = sigmax.catalogue()[name]
    return sigmax.get(name, **NEGATIVE) if "alpha" in entry.parameters else sigmax.get(name)

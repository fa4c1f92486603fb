"""Small studies for the tests."""

import jax.numpy as jnp
import numpy as np

import sigmax

F = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = np.array([[0.05, 0.04], [0.04, 0.06]])
P0 = np.array([[2.0, 0.3], [0.3, 0.5]])
R = 0.4


def linear_motion(x, dt):
    return jnp.asarray(F) @ x


def first(x):
    return x[:1]


def bent(x):
    return x + 0.3 * x**2


def kept(x, dt):
    return 0.9 * x


LINEAR = sigmax.Model(motion=linear_motion, sensor=first, Q=Q, R=[R], state=("place", "speed"))
BENT = sigmax.Model(motion=kept, sensor=bent, Q=[0.05], R=[0.1])


def linear(**changes):
    prior = sigmax.Gaussian([0.5, 0.1], P0)
    names = {name: sigmax.get(name) for name in ("EKF", "SRCKFB")}
    return sigmax.studies.Study(
        **{"name": "linear", "model": LINEAR, "prior": prior, "steps": 12, "filters": names, **changes}
    )


def scalar(**changes):
    prior = sigmax.Gaussian([1.0], [[0.5]])
    names = {name: sigmax.get(name) for name in ("EKF", "PF")}
    return sigmax.studies.Study(
        **{"name": "bent", "model": BENT, "prior": prior, "steps": 6, "filters": names, **changes}
    )

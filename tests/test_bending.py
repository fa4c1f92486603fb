"""A bank with too few members says so before a run, and those that it has are enough where it is silent."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.errors import BendingWarning
from sigmax.preparation.bending import bending


def model(r, inputs=False):
    return sigmax.Model(
        motion=lambda x, dt: x,
        sensor=(lambda x, u: x + 0.5 * x**2) if inputs else (lambda x: x + 0.5 * x**2),
        Q=[0.0],
        R=[r * r],
    )


PRIOR = sigmax.Gaussian([1.0], [1.0])


@pytest.mark.parametrize(("r", "members", "silent"), [(0.3, 5, True), (0.03, 9, False), (0.1, 13, True)])
@pytest.mark.one_in(3)
def test_it_is_silent_where_the_mean_is_the_integral(r, members, silent):
    """The mean after one measurement against a sum over a grid, in deviations of the posterior."""
    assert (not list(bending(sigmax.bank("SRCKFB", members), model(r), PRIOR))) == silent
    rng = np.random.default_rng(0)
    x = 1 + rng.standard_normal(200)
    z = x + 0.5 * x**2 + r * rng.standard_normal(200)
    grid = np.linspace(-8, 10, 40001)
    weight = np.exp(-0.5 * (grid - 1) ** 2 - 0.5 * ((z[:, None] - grid - 0.5 * grid**2) / r) ** 2)
    weight /= weight.sum(1, keepdims=True)
    mean = weight @ grid
    variance = weight @ grid**2 - mean**2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BendingWarning)
        found = sigmax.run(sigmax.bank("SRCKFB", members), model(r), PRIOR, z[:, None, None]).mean[:, 0, 0]
    off = np.sqrt(np.mean((found - mean) ** 2) / variance.mean())
    assert (off < 0.17) == silent, off


def test_a_run_warns_with_the_number_that_it_wants():
    with pytest.warns(BendingWarning, match="bends by 7.07 .* about 13 members; .* take members=13"):
        sigmax.run(sigmax.bank("SRCKFB"), model(0.1), PRIOR, np.zeros((1, 1)))


def test_what_it_bends_by_is_the_second_derivative_along_the_worst_direction():
    def seen(x):
        return jnp.stack([x[0] * x[1], x[2] + 0.25 * x[0] ** 2])

    three = sigmax.Model(motion=lambda x, dt: x, sensor=seen, Q=np.zeros(3), R=[0.01**2, 0.02**2])
    P = np.diag([4.0, 1.0, 9.0])
    (said,) = bending(sigmax.bank("EKF"), three, sigmax.Gaussian(np.zeros(3), P))
    S = np.sqrt(np.diag(P))
    H = np.zeros((2, 3, 3))
    H[0, 0, 1] = H[0, 1, 0] = S[0] * S[1] / 0.01
    H[1, 0, 0] = 0.5 * S[0] ** 2 / 0.02
    d = np.linalg.eigh(H[0] @ H[0] + H[1] @ H[1])[1][:, -1]
    wanted = np.sqrt(((d @ H[0] @ d) ** 2 + (d @ H[1] @ d) ** 2) / 2)
    assert f"bends by {wanted:.3g} " in said


def test_one_filter_and_a_sensor_with_inputs_say_nothing():
    assert not list(bending(sigmax.get("SRCKFB"), model(0.01), PRIOR))
    assert not list(bending(sigmax.bank("SRCKFB"), model(0.01, inputs=True), PRIOR))

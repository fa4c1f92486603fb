"""What is no covariance by its own scale is refused where it is given, and a fault where a function gives it."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.filterpy import KalmanFilter
from sigmax.modelling.evaluate import noise_root

NOT_ONE = np.array([[0.0, 0.5], [0.5, 1.0]])


def test_a_covariance_with_a_component_of_no_variance_is_refused_wherever_it_is_given():
    two = {"motion": lambda x, dt: x, "sensor": lambda x: x, "state": ("a", "b"), "measurement": ("u", "v")}
    says = r"entry \[0, 1\] is 0.5 although the variance \[0, 0\] is 0"
    prior = sigmax.Gaussian([0.0, 0], np.eye(2))
    for make in (
        lambda: sigmax.Gaussian([0.0, 0], NOT_ONE),
        lambda: sigmax.Gaussian(np.zeros((2, 2)), np.array([np.eye(2), NOT_ONE])),
        lambda: sigmax.Model(**two, Q=NOT_ONE, R=np.eye(2)),
        lambda: sigmax.Model(**two, Q=np.eye(2), R=NOT_ONE),
        lambda: sigmax.Live("EKF", sigmax.Model(**two, Q=np.eye(2), R=np.eye(2)), prior).update([0.0, 0], R=NOT_ONE),
        lambda: sigmax.run(
            "EKF", sigmax.Model(**two, Q=lambda x, dt: jnp.asarray(NOT_ONE), R=np.eye(2)), prior, np.zeros((2, 2))
        ),
    ):
        with pytest.raises(sigmax.InputError, match=says):
            make()


def test_a_noise_that_becomes_none_on_the_way_is_a_fault():
    noise = {"Q": lambda x, dt: jnp.array([[jnp.where(x[0] > 2.5, 0.0, 1.0), 0.5], [0.5, 1.0]]), "R": [1.0]}
    model = sigmax.Model(
        motion=lambda x, dt: x + dt, sensor=lambda x: x[:1], state=("a", "b"), measurement=("u",), **noise
    )
    z = np.arange(1.0, 7)[:, None]
    got = sigmax.run("EKF", model, sigmax.Gaussian([0.0, 0], 1e-6 * np.eye(2)), z)
    assert got.fault[:2].tolist() == [0, 0]
    assert int(sigmax.running.Fault.MOTION_NOISE_INDEFINITE) in got.fault


def test_filterpys_names_refuse_it_too():
    f = KalmanFilter(2, 1)
    f.F, f.H, f.P = np.eye(2), np.array([[1.0, 0]]), NOT_ONE.copy()
    with pytest.raises(np.linalg.LinAlgError, match="semidefinite"):
        f.predict()


@pytest.mark.slow
def test_the_root_of_a_deficient_covariance_is_exact():
    """What is checked at a pivot of zero is what rounding cannot have left there."""
    rng = np.random.default_rng(8)
    for _ in range(50):
        n, k = rng.integers(2, 8, 2)
        A = rng.normal(size=(n, min(n, k))) * 10 ** rng.uniform(-6, 6, (n, 1))
        S = np.asarray(noise_root(A @ A.T))
        d = np.sqrt(np.diagonal(A @ A.T))
        assert np.abs((S @ S.T - A @ A.T) / np.outer(d, d)).max() < 1e-7

"""Long studies, run by `make slow`: honest covariances and endurance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

import sigmax
from tests.laws.test_hard import PRIOR, RADAR, TURN, radar

pytestmark = pytest.mark.slow


def driven(runs, steps, seed):
    """Truth drawn from the prior and driven by Q, and what the radar saw of it."""
    rng = np.random.default_rng(seed)
    model = radar()
    move = jax.jit(jax.vmap(TURN.function, in_axes=(0, None)))
    see = jax.jit(jax.vmap(RADAR.function))
    x = rng.multivariate_normal(PRIOR.mean, PRIOR.cov, runs)
    truth, seen = [], []
    for _ in range(steps):
        x = np.asarray(move(jnp.asarray(x), 1.0)) + rng.standard_normal(x.shape) * np.sqrt(model.Q.entries)
        truth.append(x)
        seen.append(np.asarray(see(jnp.asarray(x))) + rng.standard_normal((runs, 3)) * np.sqrt(model.R[""].entries))
    return np.stack(truth, 1), np.stack(seen, 1)


@pytest.mark.parametrize("name", ["SRCKFB", "SRECKFB", "SRUKFB"])
def test_the_covariance_is_honest(name):
    """NEES and NIS of 1000 runs lie near their expectation once the start is forgotten; failures none."""
    truth, z = driven(1000, 60, seed=4)
    got = sigmax.run(name, radar(), PRIOR, z)
    assert got.ok.all()
    errors = got.errors(truth)[:, 40:]
    nees = np.einsum("rti,rtij,rtj->rt", errors, np.linalg.inv(got.cov[:, 40:]), errors)
    # A run in a thousand may end with speed and course mirrored; the median does not see it. A nonlinear
    # filter is a few per cent too sure of itself, and the median of 1000 runs is known to 3 %.
    assert abs(np.median(nees) / chi2(5).median() - 1) < 0.12
    assert abs(np.median(got.nis[:, 40:]) / chi2(3).median() - 1) < 0.05


@pytest.mark.parametrize("name", ["SRCKFB", "EKF"])
def test_a_hundred_thousand_steps(name):
    """More than a day at one step a second: every step sound, NIS as at the start."""
    _, z = driven(1, 100_000, seed=1)
    got = sigmax.run(name, radar(), PRIOR, z[0])
    assert got.ok.all()
    assert abs(np.median(got.nis[-50_000:]) / chi2(3).median() - 1) < 0.05

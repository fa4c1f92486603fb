"""On a linear model every filter is the Kalman filter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sigmax
from tests.laws.problems import DT, Linear, linear, made

OFFSET = 1e7
SQUARE_ROOT = [name for name in sigmax.names() if sigmax.get(name).form.name.startswith("square")]


def gap(mean, cov, exact):
    means, covs = exact
    sd = np.sqrt(np.einsum("...ii->...i", covs))
    return np.abs((mean - means) / sd).max(), (np.abs(cov - covs) / (sd[:, :, None] * sd[:, None, :])).max()


@pytest.mark.parametrize("name", sigmax.names())
@pytest.mark.one_in(2)
def test_every_filter_is_the_kalman_filter(name):
    """Plain, far from the origin and with holes, in one batch; then a stiff R with what is compiled."""
    p = linear()
    shift = np.full(p.n, OFFSET)
    moved = np.linalg.matrix_power
    far = np.array([p.z[k] + p.H @ moved(p.A, k + 1) @ shift for k in range(len(p.z))])
    holes = p.z.copy()
    holes[1] = np.nan
    holes[3, 0] = holes[4, 1] = np.nan
    starts = np.array([p.x0, p.x0 + shift, p.x0])
    records = np.array([p.z, far, holes])
    got = sigmax.run(made(name), p.model(), sigmax.Gaussian(starts, p.P0), records, dt=DT)
    assert got.ok.all()
    for i, (allowed_mean, allowed_cov) in enumerate([(1e-11, 1e-11), (2e-6, 2e-6), (1e-11, 1e-11)]):
        off_mean, off_cov = gap(got.mean[i], got.cov[i], p.exact(records[i], starts[i]))
        assert off_mean < allowed_mean
        assert off_cov < allowed_cov
    if sigmax.get(name).form.name.startswith("information"):
        return  # a stiff R is what the information form is not for; see test_hard.py
    stiff = p.R * 1e-12
    got = sigmax.run(made(name), p.model(R=stiff), sigmax.Gaussian(starts, p.P0), records, dt=DT)
    if name in SQUARE_ROOT:
        assert got.ok.all()
        for i in (0, 2):
            off_mean, off_cov = gap(got.mean[i], got.cov[i], p.exact(records[i], starts[i], R=stiff))
            assert off_mean < 1e-3
            assert off_cov < 1e-3


@pytest.mark.parametrize(
    ("n", "name"),
    [
        (1, "EKF"), (1, "SRUKFB"), (1, "GHKF"), (2, "SRSKFB"), (4, "HCKF"), (7, "SREKF"), (9, "CIF"),
        *(
            pytest.param(n, name, marks=pytest.mark.slow)
            for n, name in [
                (1, "SRHCKFB"), (1, "PF"), (2, "SRCKF"), (5, "SRHCKF"), (6, "UKF"), (8, "SRUKFB"), (10, "SRCKFB"),
                (11, "SKF"), (12, "ECKF"),
            ]
        ),
    ],
)  # fmt: skip
def test_from_one_to_twelve_components(n, name):
    p = linear(n, max(1, n // 2))
    got = sigmax.run(made(name), p.model(), sigmax.Gaussian(p.x0, p.P0), p.z, dt=DT)
    assert got.ok.all()
    off_mean, off_cov = gap(got.mean, got.cov, p.exact(p.z))
    assert off_mean < 1e-9
    assert off_cov < 1e-9


def test_log_likelihood_and_nis_are_those_of_the_innovations():
    p = linear()
    holes = p.z.copy()
    holes[2] = np.nan
    holes[3, 0] = np.nan
    got = sigmax.run("KF", p.model(), sigmax.Gaussian(p.x0, p.P0), holes, dt=DT)
    want = 0.0
    for k in range(len(holes)):
        seen = ~np.isnan(holes[k])
        if not seen.any():
            assert np.isnan(got.nis[k])
            assert got.dof[k] == 0
            continue
        nu, S = got.innovation[k][seen], got.innovation_cov[k][np.ix_(seen, seen)]
        nis = nu @ np.linalg.solve(S, nu)
        assert got.nis[k] == pytest.approx(nis, rel=1e-10)
        assert got.dof[k] == seen.sum()
        want -= 0.5 * (nis + np.linalg.slogdet(2 * np.pi * S)[1])
    assert got.log_likelihood == pytest.approx(want, rel=1e-12)


def test_the_kalman_filter_refuses_what_is_not_linear():
    model = sigmax.Model(motion=lambda x, dt: x, sensor=lambda x: x**2, Q=[1.0], R=[1.0], state=["x"])
    with pytest.raises(sigmax.InputError, match="sensor is not linear"):
        sigmax.run("KF", model, sigmax.Gaussian([0.0], [1.0]), np.zeros((3, 1)))


@pytest.mark.parametrize("name", ["EKF", "SRCKFB", "SREKF"])
def test_no_noise_of_the_motion(name):
    p = linear()
    none = np.zeros((p.n, p.n))
    got = sigmax.run(name, p.model(Q=none), sigmax.Gaussian(p.x0, p.P0), p.z, dt=DT)
    off_mean, off_cov = gap(got.mean, got.cov, p.exact(p.z, Q=none))
    assert got.ok.all()
    assert off_mean < 1e-10
    assert off_cov < 1e-10


def system_of(u):
    return u[:9].reshape(3, 3), u[9:15].reshape(2, 3)


RANDOM = sigmax.Model(
    motion=lambda x, dt, u: system_of(u)[0] @ x,
    sensor=lambda x, u: system_of(u)[1] @ x,
    Q=lambda x, dt, u: u[15:24].reshape(3, 3) * dt,
    R=lambda x, u: u[24:28].reshape(2, 2),
    state=("a", "b", "c"),
    measurement=("u", "v"),
)


@pytest.mark.parametrize("name", ["SREKFB", "SRUKF", "SRHCKFB"])
@given(seed=st.integers(0, 2**32 - 1), stiffness=st.floats(-9, 2), drive=st.floats(-9, 2))
def test_any_linear_system_in_square_root_form(name, seed, stiffness, drive):
    """Random systems with R and Q over eleven powers of ten: the matrices are inputs, so nothing is compiled twice."""
    p = Linear(seed=seed)
    p.R, p.Q = p.R * 10**stiffness, p.Q * 10**drive
    inputs = np.tile(np.concatenate([p.A.ravel(), p.H.ravel(), p.Q.ravel(), p.R.ravel()]), (len(p.z), 1))
    # Measurements that the system could have made: exactness is counted in standard deviations.
    z = np.cumsum(p.z, axis=0) * 10 ** (max(stiffness, drive) / 2)
    got = sigmax.run(made(name), RANDOM, sigmax.Gaussian(p.x0, p.P0), z, dt=DT, inputs=inputs)
    off_mean, off_cov = gap(got.mean, got.cov, p.exact(z))
    assert got.ok.all()
    assert off_mean < 1e-4
    assert off_cov < 1e-4

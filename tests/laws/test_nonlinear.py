"""Laws of nonlinear filtering, over the whole catalogue on one model with an angle in state and sensor."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.forms import information, without_omega
from tests.laws.problems import APART, DT, TURNING, TURNING_PRIOR, made, scaled_gap, textbook, turning_record

TURNS = np.array([0.0, 2.9, -40.0])
MEAN, COV = TURNING_PRIOR


@cache
def turned(filter, backend=None):
    """Four tracks in one run: as it is, turned by two angles, and with measurements missing."""
    z = turning_record()
    holes = z.copy()
    holes[2] = np.nan
    holes[3, 0] = holes[4, 1] = np.nan
    records = np.array([z + np.array([t, 0]) for t in TURNS] + [holes])
    starts = np.array([MEAN + np.array([t, 0, 0]) for t in TURNS] + [MEAN])
    inputs = np.array([np.full((len(z), 1), t) for t in (*TURNS, 0.0)])
    return sigmax.run(filter, TURNING, sigmax.Gaussian(starts, COV), records, dt=DT, inputs=inputs, backend=backend)


def track(result, i):
    return {"mean": result.mean[i], "cov": result.cov[i], "std": result.std[i], "nis": result.nis[i]}


@pytest.mark.parametrize("name", sigmax.names()[1:])
@pytest.mark.one_in(4)
def test_turning_every_angle_turns_the_answer(name):
    got = turned(made(name))
    assert got.ok.all()
    assert (np.abs(got.mean[..., 0]) <= np.pi + 1e-12).all()
    for i, angle in enumerate(TURNS):
        back = got.mean[i] - [angle, 0, 0] - got.mean[0]
        back[:, 0] -= 2 * np.pi * np.round(back[:, 0] / (2 * np.pi))
        assert np.abs(back / got.std[0]).max() < 1e-11
        assert np.abs(got.std[i] / got.std[0] - 1).max() < 1e-11
        assert np.allclose(got.nis[i], got.nis[0], rtol=1e-9)


@cache
def by_the_book(predict, correct, update):
    """The same four tracks by the textbook's equations."""
    return turned(sigmax.Filter(predict, correct, textbook(False), update=update), "xla")


@pytest.mark.parametrize("name", sigmax.names()[1:])
@pytest.mark.one_in(8)
def test_every_form_is_the_covariance_form(name):
    """Whatever is turned, taken in two or added as information: P = E Eᵀ + Q, K = P_xy P_yy⁻¹ and P − K P_yy Kᵀ."""
    filter = made(name)
    off_mean, off_cov = scaled_gap(turned(filter), by_the_book(filter.predict, filter.correct, filter.update))
    assert off_mean < 1e-10
    assert off_cov < 1e-10


@pytest.mark.parametrize(
    "name",
    ["UKF", "SRCKF", "TSCIF", "CIF", "SRHCIF", "TSCKF", "TSEKF", "SRUKFB", "TSHCIF", "MTSCKF", "MTSCIF"],
)
@pytest.mark.one_in(6)
def test_every_form_is_the_covariance_form_with_a_bias_and_two_sensors(name):
    filter = made(name)
    z = turning_record()
    z[2, 0] = z[3, 1] = np.nan
    record = {"antenna": z[:, :1], "ruler": z[:, 1:]}
    same = sigmax.Filter(filter.predict, filter.correct, textbook(filter.form.bias_first))
    got, want = (
        sigmax.run(f, APART, sigmax.Gaussian(MEAN, COV), record, dt=DT, inputs=np.zeros((6, 1)), backend=backend)
        for f, backend in ((filter, None), (same, "xla"))
    )
    assert got.ok.all()
    off_mean, off_cov = scaled_gap(got, want)
    assert off_mean < 1e-10
    assert off_cov < 1e-10
    assert np.abs((got.bias_mean - want.bias_mean) / want.bias_std).max() < 1e-10
    assert np.allclose(got.bias_cov, want.bias_cov, rtol=1e-8, atol=0)
    assert np.allclose(got.nis, want.nis, rtol=1e-9)


@pytest.mark.parametrize("name", ["EKF", "UKF", "SRUKFB", "SRHCKF", "CIF"])
@pytest.mark.one_in(2)
def test_the_smoother_is_that_of_rauch_tung_and_striebel_on_the_rule(name):
    """G = S Eᵀ P⁻⁻¹ and P + G (P_s − P⁻) Gᵀ in products and inverses; some of these rules have negative weights."""
    filter = made(name)
    got, u = turned(filter), jnp.zeros(1)
    smoothed = sigmax.smooth(filter, TURNING, got, dt=DT, inputs=np.array([np.full((6, 1), t) for t in (*TURNS, 0.0)]))
    assert smoothed.ok.all()
    late, P_late = got.mean[0, -1], got.cov[0, -1]
    for k in range(4, -1, -1):
        line = filter.predict(lambda x: TURNING.motion(x, DT, u), got.mean[0, k], got.factor[0, k], TURNING.angular)
        E, N, D = line.slope, line.residual, line.deficit
        ahead = E @ E.T + N @ N.T - D @ D.T + TURNING.Q * DT
        G = got.factor[0, k] @ E.T @ np.linalg.inv(ahead)
        late = got.mean[0, k] + G @ (late - line.mean)
        P_late = got.cov[0, k] + G @ (P_late - ahead) @ G.T
        sd = np.sqrt(np.diagonal(P_late))
        assert np.abs((smoothed.mean[0, k] - late) / sd).max() < 1e-9
        assert np.abs((smoothed.cov[0, k] - P_late) / np.outer(sd, sd)).max() < 1e-9


def test_the_information_form_as_printed_is_overconfident():
    """Without Ω the information counts what the straight line misses as if it were known."""
    printed, exact = (turned(sigmax.get("CIF", information=kind)) for kind in ("paper", "exact"))
    assert sigmax.get("CIF", information="paper").form == without_omega(information)
    assert (printed.std[0, -1] < exact.std[0, -1]).any()
    assert scaled_gap(printed, exact)[0] > 1e-6


@pytest.mark.parametrize(("one", "other"), [("CKF", {"alpha": 1, "beta": 0, "kappa": 0}), ("CKF", {"w0": 0})])
def test_cubature_is_a_special_unscented_transform(one, other):
    off_mean, off_cov = scaled_gap(turned(sigmax.get(one)), turned(sigmax.get("UKF", **other)))
    assert off_mean < 1e-12
    assert off_cov < 1e-12


def test_the_general_transform_is_a_scaled_one():
    """beta = alpha² − 1 and alpha²(n + kappa) = n / (1 − w0)."""
    w0, alpha = 0.4, 0.8
    kappa = 3 / (1 - w0) / alpha**2 - 3
    scaled = sigmax.get("UKF", alpha=alpha, beta=alpha**2 - 1, kappa=kappa)
    assert scaled_gap(turned(scaled), turned(sigmax.get("UKF", w0=w0)))[0] < 1e-12


@pytest.mark.parametrize("name", ["EKF", "SRCKFB", "SRSKF", "UIF"])
def test_missing_means_skipped(name):
    """A component that is NaN adds nothing: the same filter on a sensor without it gives the same."""
    got = turned(made(name))
    z = turning_record()
    model = sigmax.Model(
        motion=TURNING.motion,
        sensor={
            "first": lambda x, u: TURNING.sensors[""](x, u)[:1],
            "second": lambda x, u: TURNING.sensors[""](x, u)[1:],
        },
        Q=TURNING.Q,
        R={"first": TURNING.R[""][:1, :1], "second": TURNING.R[""][1:, 1:]},
        state=TURNING.state,
        measurement={"first": TURNING.measurement[""][:1], "second": TURNING.measurement[""][1:]},
    )
    first, second = z[:, :1].copy(), z[:, 1:].copy()
    whole = z.copy()
    whole[[0, 1, 5]] = np.nan  # where both components are seen, R couples them
    first[[0, 1, 2, 3, 5]] = second[[0, 1, 2, 4, 5]] = np.nan
    whole[2] = np.nan
    whole[3, 0] = whole[4, 1] = np.nan
    inputs = np.zeros((len(z), 1))
    prior = sigmax.Gaussian(MEAN, COV)
    apart = sigmax.run(made(name), model, prior, {"first": first, "second": second}, dt=DT, inputs=inputs)
    together = sigmax.run(made(name), TURNING, prior, whole, dt=DT, inputs=inputs)
    off_mean, off_cov = scaled_gap(apart, together)
    assert off_mean < 1e-11
    assert off_cov < 1e-11
    assert np.isnan(apart.nis[0])
    assert got.dof[3].tolist() == [2, 2, 0, 1, 1, 2]


@pytest.mark.parametrize("name", ["EKF", "SRUKFB", "HCIF"])
def test_a_batch_is_a_loop(name):
    """A track alone gives what it gives in a batch, to rounding of the compiler's own sums."""
    batch, z = turned(made(name)), turning_record()
    alone = sigmax.run(made(name), TURNING, sigmax.Gaussian(MEAN, COV), z, dt=DT, inputs=np.zeros((len(z), 1)))
    assert alone.mean.shape == (6, 3)
    assert np.abs((alone.mean - batch.mean[0]) / alone.std).max() < 1e-12
    assert alone.log_likelihood == pytest.approx(batch.log_likelihood[0], rel=1e-12)

"""Hard numbers: negative weights, stiff noise, single precision, failures that stay where they are."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from tests.laws.problems import DT, linear, scaled_gap

TURN = sigmax.motions.coordinated_turn()
RADAR = sigmax.sensors.range_azimuth(polar_velocity=(2, 3))


def radar(**changes):
    parts = {
        "motion": TURN.function,
        "sensor": RADAR.function,
        "Q": TURN.noise(1.0, 0.1, np.deg2rad(0.3), np.deg2rad(0.04)),
        "R": np.square([50, np.deg2rad(0.008), 0.016]),
        "state": TURN.state,
        "measurement": RADAR.measurement,
    }
    return sigmax.Model(**{**parts, **changes})


START = np.array([200e3, 100e3, 100.0, np.deg2rad(45), 0.0])
PRIOR = sigmax.Gaussian(
    [199_953, 100_032, 165.001, np.deg2rad(26.577), 0],
    np.square([86.6, 86.6, 29.6, np.deg2rad(20.6), np.deg2rad(0.04)]),
)


def radar_record(steps=8, seed=0):
    x, rows = jnp.asarray(START), []
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        x = TURN.function(x, 1.0)
        rows.append(np.asarray(RADAR.function(x)) + rng.standard_normal(3) * [50, np.deg2rad(0.008), 0.016])
    return np.array(rows)


@pytest.mark.parametrize(("full", "root"), [("UKF", "SRUKFB"), ("EUKF", "SREUKF")])
def test_a_negative_centre_weight_agrees_with_the_covariance_form(full, root):
    """alpha 0.45, beta 2, kappa −2: W0c = −4.4, one hyperbolic downdate a step."""
    z = radar_record()
    weights = {"alpha": 0.45, "beta": 2, "kappa": -2}
    one, other = (sigmax.run(sigmax.get(name, **weights), radar(), PRIOR, z) for name in (full, root))
    assert one.ok.all()
    assert other.ok.all()
    off_mean, off_cov = scaled_gap(other, one)
    assert off_mean < 1e-8
    assert off_cov < 1e-8


@pytest.mark.parametrize("name", ["EKF", "SREKF", "SREKFB", "EIF", "SREIF"])
def test_single_precision_lives_in_every_form(name):
    """Measurements far more exact than the start: P in float32 loses definiteness, its factor does not."""
    p = linear(4, 2)
    stiff = p.R * 1e-9
    prior = sigmax.Gaussian(p.x0, p.P0)
    kept = sigmax.run(name, p.model(Q=p.Q * 1e-7, R=stiff), prior, p.z, dt=DT, dtype="float32")
    _, covs = p.exact(p.z, Q=p.Q * 1e-7, R=stiff)
    sd = np.sqrt(np.einsum("tii->ti", covs))
    assert kept.mean.dtype == np.float32
    assert kept.ok.all()
    assert np.abs(kept.std / sd - 1).max() < 0.05


def hits_a_wall(x, dt):
    return jnp.where(x[0] > 5, jnp.inf, x + dt * jnp.array([1.0, 0.0]))


WALL = sigmax.Model(motion=hits_a_wall, sensor=lambda x: x[:1], Q=[0.01, 0.01], R=[0.1], state=("x", "y"))


def test_one_bad_track_spoils_no_other():
    z = np.zeros((3, 6, 1)) + np.arange(1, 7)[:, None]
    z[2, 3] = np.inf
    starts = np.array([[-10.0, 0], [3.0, 0], [-10.0, 0]])
    got = sigmax.run("SRCKFB", WALL, sigmax.Gaussian(starts, np.eye(2)), z + starts[:, :1, None])
    alone = sigmax.run("SRCKFB", WALL, sigmax.Gaussian(starts[:1], np.eye(2)), z[:1] + starts[0, 0])
    assert np.array_equal(got.mean[0], alone.mean[0])
    assert got.ok[0].all()
    assert np.isfinite(got.mean).all()
    assert np.isfinite(got.cov).all()
    first = int(np.argmin(got.ok[1]))
    assert not got.ok[1].all()
    assert np.array_equal(got.mean[1, first], got.mean[1, first - 1])
    assert any(line.startswith(f"track 1, step {first}: the motion gave") for line in got.faults())
    assert got.fault[2].tolist() == [0, 0, 0, int(sigmax.running.Fault.SENSOR_NOT_FINITE), 0, 0]


def test_an_indefinite_correction_is_a_defined_event():
    """A centre weight so negative that R + Ω has no real factor: flagged, and done without it."""
    model = sigmax.Model(motion=lambda x, dt: x, sensor=lambda x: x**2, Q=[0.0], R=[1e-6], state=["x"])
    filter = sigmax.Filter(
        sigmax.rules.Taylor1(),
        sigmax.rules.SigmaPoints(sigmax.rules.scaled, alpha=1.0, beta=-4.0, kappa=1.0),
        sigmax.forms.block,
    )
    given = model, sigmax.Gaussian([0.0], [1.0]), np.ones((2, 1))
    got = sigmax.run(filter, *given)
    assert got.fault.tolist() == [int(sigmax.running.Fault.CORRECTION_WIDENED)] * 2
    assert not got.ok.any()
    assert "without them" in got.faults()[0]
    # Without the weight of the centre in covariances the rule is this one.
    points = np.sqrt(2.0) * np.array([[1.0], [-1.0], [0.0]])
    positive = sigmax.rules.sigma_set(points, [0.25, 0.25, 0.5], centre_covariance=0.0)
    without = sigmax.rules.SigmaPoints(lambda n: positive)
    same = sigmax.run(sigmax.Filter(sigmax.rules.Taylor1(), without, sigmax.forms.block), *given)
    assert same.ok.all()
    assert np.allclose(got.mean, same.mean, rtol=1e-12, atol=0)
    assert np.allclose(got.nis, same.nis, rtol=1e-12, atol=0)
    for backend in ("native", "xla"):
        for form in (sigmax.forms.covariance, sigmax.forms.information):
            other = sigmax.run(sigmax.Filter(sigmax.rules.Taylor1(), filter.correct, form), *given, backend=backend)
            assert np.array_equal(other.fault, got.fault)
            assert np.allclose(other.cov, got.cov, rtol=1e-9)


def test_a_component_known_exactly_stays_known():
    p = linear()
    prior = sigmax.Gaussian([1.0, 2.0], np.diag([4.0, 0.0]))
    model = sigmax.Model(
        motion=lambda x, dt: x, sensor=lambda x: x[:1] * x[1:], Q=np.zeros(2), R=[0.5], state=("x", "scale")
    )
    for name in ("EKF", "SREKFB", "SRCKF", "CKF", "EIF", "SREIF", "CIF"):
        got = sigmax.run(name, model, prior, p.z[:, :1])
        assert got.ok.all(), name
        assert np.array_equal(got.mean[:, 1], np.full(6, 2.0))
        assert not got.std[:, 1].any()


def test_a_negative_speed_is_the_mirrored_course():
    domain = sigmax.motions.mirrored_speed(2, 3)
    z = radar_record()
    mirrored = PRIOR.mean * np.array([1, 1, -1, 1, 1]) + np.array([0, 0, 0, np.pi, 0])
    sign = np.array([1, 1, -1, 1, 1])
    prior = sigmax.Gaussian(mirrored, PRIOR.cov * sign[:, None] * sign)
    plain = sigmax.run("SREKF", radar(), PRIOR, z)
    back = sigmax.run("SREKF", radar(domain=domain), prior, z)
    assert (back.mean[:, 2] > 0).all()
    off_mean, off_cov = scaled_gap(back, plain)
    assert off_mean < 1e-8
    assert off_cov < 1e-8

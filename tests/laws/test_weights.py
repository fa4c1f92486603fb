"""Laws of what a robust update says of measurements: weights, the distribution it expects, tails of a record."""

import numpy as np
import pytest
from scipy import stats

import sigmax
from sigmax.filters import WEIGHTS, BySensor, Huber, Student
from sigmax.reports.weight_counts import judged_nis
from sigmax.running import fit_tails, weights
from tests.laws.test_updates import PRIOR, RADAR, RADAR_R, drawn


def outliers(tracks=3, steps=25):
    _, z = drawn(RADAR, RADAR_R, tracks, steps, seed=5, outliers=0.15)
    z[0, 3] = z[1, 4, 0] = np.nan
    return z


@pytest.mark.parametrize("backend", ["native", pytest.param("xla", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", WEIGHTS)
@pytest.mark.one_in(2)
def test_a_weight_divides_the_variance(kind, backend):
    """Each step again, without weights, with R divided by those of the result: the same means and covariances."""
    z = outliers()
    robust = sigmax.get("EKF", update=kind)
    got = sigmax.run(robust, RADAR, PRIOR, z, dt=1.0, backend=backend)
    assert (np.nanmin(got.weight, (1, 2)) < 0.9).all()
    assert (np.isnan(got.weight) == np.isnan(z)).all()
    for track in range(len(z)):
        live, plain = sigmax.Live(robust, RADAR, PRIOR), sigmax.Live("EKF", RADAR, PRIOR)
        for step in range(z.shape[1]):
            w = got.weight[track, step]
            live.predict(1.0)
            plain.put(live.belief, 0)
            told = live.update(z[track, step])
            assert np.allclose(weights(robust.update.weight, told), w, rtol=1e-9, equal_nan=True)
            if (w == 0).any():
                assert told.dof == got.dof[track, step] == 0
                continue
            plain.update(z[track, step], R=RADAR_R / np.where(np.isnan(w), 1, w))
            assert np.allclose(got.mean[track, step], plain.mean, rtol=0, atol=1e-9)
            assert np.allclose(got.cov[track, step], plain.cov, rtol=1e-7, atol=1e-13)


def test_without_a_weight_every_measurement_counts_in_full():
    z = outliers()
    got = sigmax.run("SRCKFB", RADAR, PRIOR, z, dt=1.0)
    assert np.array_equal(got.weight, np.where(np.isnan(z), np.nan, 1.0), equal_nan=True)


def test_weights_of_innovations_that_were_not_kept_are_a_message():
    with pytest.raises(sigmax.InputError, match="innovation was not kept"):
        _ = sigmax.run("EKF", RADAR, PRIOR, outliers(), keep=("mean",)).weight


def huber_sample(rng, c, shape):
    """Draws of Huber's density by rejection from a double exponential of rate c."""
    found = []
    while sum(map(len, found)) < np.prod(shape):
        e = rng.laplace(scale=1 / c, size=100_000)
        size = np.abs(e)
        loss = np.where(size > c, c * size - c * c / 2, e * e / 2)
        # −loss + c |e| is largest, c²/2, beyond c.
        found.append(e[rng.random(len(e)) < np.exp(-loss + c * size - c * c / 2)])
    return np.concatenate(found)[: np.prod(shape)].reshape(shape)


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("weight", [Student(0.5), Student(4), Huber(1.345), Huber(0.5)], ids=str)
def test_what_an_update_expects_is_judged_as_chi_square(weight, m):
    rng = np.random.default_rng(m)
    if isinstance(weight, Student):
        e = rng.standard_normal((m, 4000)) / np.sqrt(rng.chisquare(weight.dof, 4000) / weight.dof)
    else:
        e = huber_sample(rng, weight.threshold, (m, 4000))
    assert stats.kstest(weight.chi_square(e), stats.chi2(m).cdf).pvalue > 1e-3
    missing = np.concatenate([e, np.full((1, 4000), np.nan)])
    assert np.allclose(weight.chi_square(missing), weight.chi_square(e))
    near = rng.standard_normal((m, 50))
    assert np.allclose(type(weight)(1e7).chi_square(near), (near**2).sum(0), rtol=1e-4)


def line(sensor_names):
    return sigmax.Model(
        motion=lambda x, dt: np.array([[1.0, 0.0], [0.0, 1.0]]) @ x + dt * x[1] * np.array([1.0, 0.0]),
        Q=np.array([[1e-4, 0.0], [0.0, 1e-4]]),
        sensor={name: lambda x: x[:1] for name in sensor_names},
        R={name: [0.25] for name in sensor_names},
        state=("s", "v"),
    )


def measured(seed, names, bad):
    rng = np.random.default_rng(seed)
    walk = np.cumsum(np.cumsum(rng.normal(scale=1e-2, size=400)))
    return {
        n: (walk + rng.normal(scale=0.5, size=400) * np.where(rng.random(400) < (n in bad) * 0.1, 20, 1))[:, None]
        for n in names
    }


def test_tails_are_found_by_sensor():
    names, prior = ("gps", "radio"), sigmax.Gaussian([0.0, 0.0], [1.0, 1e-3])
    found = fit_tails("SRCKFB", line(names), prior, measured(1, names, bad=("gps",)))
    assert isinstance(found.update, BySensor)
    gps, radio = found.update.of("gps"), found.update.of("radio")
    assert isinstance(gps.weight, Student)
    assert gps.weight.dof <= 4
    assert radio == sigmax.once
    assert "student" in str(found)


@pytest.mark.parametrize("seed", range(3))
def test_a_record_without_outliers_keeps_its_filter(seed):
    names, prior = ("gps", "radio"), sigmax.Gaussian([0.0, 0.0], [1.0, 1e-3])
    chosen = sigmax.get("SRCKFB")
    assert fit_tails(chosen, line(names), prior, measured(seed, names, bad=())) == chosen


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"degrees": ()}, "at least one"),
        ({"degrees": (4, -1)}, "above 0"),
        ({"degrees": "four"}, "degrees"),
        ({"degrees": [[1.0, 2.0]]}, "at least one"),
        ({"keep": ("mean",)}, "belongs to run"),
    ],
)
def test_tails_of_nothing_are_a_message(options, message):
    names, prior = ("gps",), sigmax.Gaussian([0.0, 0.0], [1.0, 1e-3])
    with pytest.raises(sigmax.InputError, match=message):
        fit_tails("EKF", line(names), prior, measured(0, names, bad=()), **options)


@pytest.mark.parametrize("seed", range(4))
def test_what_a_gate_refused_is_not_judged(seed):
    """Beside a sensor judged by Student's t, a gate's refusals count as little as in the NIS."""
    names, prior = ("gps", "radio"), sigmax.Gaussian([0.0, 0.0], [1.0, 1e-3])
    chosen = sigmax.get("SRCKFB", update={"gps": "gate", "radio": "student(2)"})
    got = sigmax.run(chosen, line(names), prior, measured(seed, names, bad=("gps",)))
    e2 = {n: (got.innovation[n] ** 2 / got.innovation_cov[n][..., 0])[..., 0] for n in names}
    refused = got.dof == 1
    assert 20 < refused.sum() < 80
    as_rare = stats.chi2(1).isf(2 * stats.t(2).sf(np.sqrt(e2["radio"])))
    assert np.allclose(judged_nis(got), as_rare + np.where(refused, 0, e2["gps"]), rtol=1e-9)

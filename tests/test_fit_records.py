"""`sigmax fit`: numbers of records by name, descriptions that come back with them, and what is refused."""

import json

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import sigmax
from sigmax.cli.app import app
from sigmax.corrections.fit_numbers import fit_numbers
from sigmax.corrections.fit_toml import fitted
from sigmax.corrections.free_model import build_of
from sigmax.corrections.free_numbers import find
from sigmax.errors import InputError
from sigmax.records import load

TOML = """data = "{data}"
time = "t"
filters = ["EKF"]

[motion]
kind = "constant_velocity"
axes = ["x"]
noise = {{ density = "0.1 m^2/s^3" }}  # a guess

[sensors.gauge]
kind = "position"
columns = {{ x = "x" }}
noise = {{ x = "{noise}" }}

[sensors.scaled]
kind = "position"
columns = {{ x = "y" }}
noise = {{ x = "5 m" }}

[prior]
x = {{ mean = 0, std = "10 m" }}
vx = {{ mean = 0, std = "5 m/s" }}

[bias.factor]
std = 0.2
scale = {{ scaled = "x" }}
"""


def write(folder, name="level", seed=0, T=200, noise="100 cm"):
    """A record with a density of 0.5, deviations of 3 and 5 m, a scale of 1.04."""
    rng, x, rows = np.random.default_rng(seed), np.array([0.0, 3.0]), []
    Q = 0.5 * np.array([[1 / 3, 1 / 2], [1 / 2, 1]])
    for k in range(T):
        x = np.array([x[0] + x[1], x[1]]) + rng.multivariate_normal(np.zeros(2), Q)
        rows.append([k, x[0] + 3 * rng.normal(), 1.04 * x[0] + 5 * rng.normal()])
    pd.DataFrame(rows, columns=["t", "x", "y"]).to_csv(folder / f"{name}.csv", index=False)
    path = folder / f"{name}.toml"
    path.write_text(TOML.format(data=f"{name}.csv", noise=noise))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("fit")
    write(made)
    write(made, "other", 1, 120)
    return made


def run(*args):
    return CliRunner().invoke(app, ["fit", *map(str, args)])


def test_a_description_comes_back_with_its_numbers(folder):
    """Deviations in their units, the density, a factor: within three standard errors, and again the same as 1."""
    path = folder / "level.toml"
    asked = ["--free", "density,gauge.noise.x", "--free", "factor", "--write", "--json", "--out", folder / "page"]
    found = run(path, *asked)
    assert found.exit_code == 0, found.output
    told = json.loads(found.stdout)
    for name, true in (("density", 0.5), ("gauge.noise.x", 300), ("factor", 0.04)):
        assert abs(told["parameters"][name] - true) < 3 * told["std"][name]
    assert told["units"]["gauge.noise.x"] == "cm"
    assert told["held_out"]["after"] > told["held_out"]["before"]
    assert "Likelihood along each number" in (folder / "page" / "report.html").read_text()
    assert json.loads((folder / "page" / "summary.json").read_text())["parameters"] == told["parameters"]
    written = folder / "level-fitted.toml"
    text = written.read_text()
    assert text.startswith("# Fitted by sigmax fit from level.toml")
    assert "# a guess; density fitted: " in text
    record = load(str(written))
    value = float(np.sqrt(record.model.R["gauge"].entries[0]))
    assert value == pytest.approx(told["parameters"]["gauge.noise.x"] / 100, rel=1e-3)
    assert record.model.bias.prior.mean[0] == pytest.approx(told["parameters"]["factor"], rel=1e-2)
    again = fit_numbers([str(written)], ["Q,R.gauge"])
    np.testing.assert_allclose([again.fit.parameters[n] for n in ("Q", "R.gauge")], 1, rtol=0.02)


def test_the_likelihood_of_a_number_is_that_of_its_description(folder):
    """A file in which the number stands, loaded and run, against the model that `fit` makes of the first."""
    path = folder / "level.toml"
    record = load(str(path))
    names = ("scaled.noise.x", "prior.vx.std", "bias.factor.std", "prior.x.mean", "R.gauge")
    numbers = find(record, path, record.trials[0], dict.fromkeys(names))
    assert [n.unit for n in numbers] == ["m", "m/s", "", "", ""]
    values = {"scaled.noise.x": 2.0, "prior.vx.std": 1.0, "bias.factor.std": 0.5, "prior.x.mean": 4.0, "R.gauge": 9.0}
    model, prior = build_of(record, path, numbers, lambda m: (m, record.prior))(values)
    text = path.read_text().replace('x = "5 m" }', 'x = "2 m" }').replace('std = "5 m/s"', 'std = "1 m/s"')
    text = text.replace("std = 0.2", "std = 0.5").replace('mean = 0, std = "10 m"', 'mean = 4, std = "10 m"')
    other = folder / "by_hand.toml"
    other.write_text(text.replace('x = "100 cm" }', 'x = "300 cm" }'))
    wanted = load(str(other))
    for got, want in (
        (model.R["scaled"].entries, wanted.model.R["scaled"].entries),
        (prior.cov, wanted.prior.cov),
        (model.bias.prior.cov, wanted.model.bias.prior.cov),
        (prior.mean, wanted.prior.mean),
        (model.R["gauge"].entries, wanted.model.R["gauge"].entries),
    ):
        np.testing.assert_allclose(got, want, rtol=1e-12)


@pytest.mark.slow
def test_records_share_their_numbers(folder):
    each = [str(folder / f"{name}.toml") for name in ("level", "other")]
    both = fit_numbers(each, ["density,R.gauge"])
    assert len(both.records) == 2
    names = ("density", "R.gauge")
    alone = [fit_numbers([name], ["density,R.gauge"]).fit for name in each]
    apart = np.array([[fit.parameters[n] for n in names] for fit in alone])
    found = np.array([both.fit.parameters[n] for n in names])
    assert (apart.min(0) < found).all()
    assert (found < apart.max(0)).all()
    assert all(both.fit.std[n] < min(f.std[n] for f in alone) for n in names)


def test_what_is_not_determined_is_said_and_not_written(folder):
    """A number and the factor of the same noise."""
    found = run(folder / "level.toml", "--free", "scaled.noise.x,R.scaled,density", "--write", "--hold-out", "0")
    assert found.exit_code == 1
    assert "determines R.scaled and scaled.noise.x only together" in found.stdout
    text = (folder / "level-fitted.toml").read_text()
    assert 'x = "5 m" }' in text
    assert "density fitted" in text


@pytest.mark.parametrize(
    ("free", "said"),
    [
        ("densty", "did you mean 'motion.noise.density'|density"),
        ("noise.x", "may be sensors.gauge.noise.x, sensors.scaled.noise.x"),
        ("Q.z", "unknown component 'z'"),
        ("R.radar", "unknown sensor 'radar'"),
        ("R.gauge.y", "unknown component 'y'"),
        ("alpha", "EKF has no parameter 'alpha'"),
        ("nu", "no update has it"),
        ("Q,Q", "twice"),
        ("Q=1..x", "the bounds are numbers"),
        ("Q=3", "NAME=LOW..HIGH"),
        (",", "names no number"),
        ("density=1..3", "between 1 and 3"),
    ],
)
def test_what_cannot_be_freed_is_refused(folder, free, said):
    with pytest.raises(InputError, match=said):
        fit_numbers([str(folder / "level.toml")], [free])


def test_nothing_is_written_over(folder):
    (folder / "mine.toml").write_text((folder / "level.toml").read_text())
    (folder / "mine-fitted.toml").write_text("x = 1")
    found = run(folder / "mine.toml", "--free", "Q", "--write")
    assert "was not written by sigmax fit" in str(found.exception)
    found = run("plaza2", "--free", "Q", "--write")
    assert "is built in and has none" in str(found.exception)


@pytest.mark.slow
def test_numbers_of_the_filter_come_back_in_the_description(folder):
    """Tails of a sensor with outliers, and the spread of points, where they stand."""
    path = folder / "tails.toml"
    table = pd.read_csv(folder / "level.csv")
    table.loc[::9, "x"] += 25 * np.random.default_rng(0).standard_t(1.5, len(table.loc[::9]))
    table.to_csv(folder / "tails.csv", index=False)
    text = (folder / "level.toml").read_text().replace("level.csv", "tails.csv").replace('["EKF"]', '["UKF:kappa=1"]')
    path.write_text(text.replace("[sensors.gauge]", '[sensors.gauge]\nupdate = "student(20)"').replace("100 cm", "3 m"))
    made = fit_numbers([str(path)], ["nu,kappa=0.5..2"])
    assert float(made.fit.parameters["nu"]) < 8
    numbers = {n: (float(made.fit.parameters[n.name]), 0.1) for n in made.numbers}
    new = fitted(path, made.trial, numbers)
    assert not new.left
    (folder / "new.toml").write_text(new.text)
    record = load(str(folder / "new.toml"))
    assert record.updates["gauge"].weight.dof == pytest.approx(made.fit.parameters["nu"])
    assert record.trials[0].name == f"UKF:kappa={made.fit.parameters['kappa']:g}"
    done = sigmax.run(*record.of_trial(record.trials[0]), record.z, dt=record.dt, update_first=True)
    assert float(done.log_likelihood.sum()) == pytest.approx(made.fit.log_likelihood, rel=1e-9)


@pytest.mark.slow
def test_the_radios_of_plaza_measure_seven_percent_too_long():
    """Whatever stands in the prior; the noises are those that a grid had chosen."""
    made = fit_numbers(["plaza2"], ["Q,R,range_scale"], hold_out=0.3).fit
    assert made.parameters["range_scale"] == pytest.approx(1.0695, abs=0.001)
    assert 0.0002 < made.std["range_scale"] < 0.0006
    for name in ("Q", "R"):
        assert abs(made.parameters[name] - 1) < 3 * made.std[name]
    assert made.held_out.after > made.held_out.before

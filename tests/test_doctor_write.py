"""`sigmax doctor --write`: the description that comes out means what was found, and the rest of it stays."""

from dataclasses import replace

import numpy as np
import pytest

import sigmax
from sigmax.cli.app import app
from sigmax.corrections.correct import correct
from sigmax.examination import Finding
from sigmax.records import load
from tests.own_records import RADAR, radar_table, write_csv
from tests.records.test_own import write_rover

MARK = "# the old radar"
TEXT = RADAR.replace('[sensors.radar]', f"[sensors.radar]  {MARK}").replace(
    'noise = { density', "# from a book\nnoise = { density"
)  # fmt: skip
PLAIN = Finding("R", "radar.range", "because", "so much", "do that", 0.0, 0.1, 50.0, 9.0, 1.0)


def written(folder, finding, text=TEXT):
    """The correction of one finding, the record before it and after it."""
    write_csv(folder / "radar.csv", radar_table())
    old, new = folder / "old.toml", folder / "new.toml"
    old.write_text(text)
    correction = correct(old, [finding])
    new.write_text(correction.text)
    return correction, load(str(old)), load(str(new))


def noise(record, sensor="radar"):
    return np.asarray(record.model.R[sensor].entries)


def Q(record):
    return np.asarray(record.model.Q(2.0) if callable(record.model.Q) else record.model.Q)


CASES = {
    "R": (replace(PLAIN, value=np.log(4)), lambda a, b: noise(b) / noise(a), [4, 1]),
    "R of all": (
        replace(PLAIN, where="all components", value=np.log(9)), lambda a, b: noise(b) / noise(a), [9, 9],
    ),
    "coarse": (replace(PLAIN, kind="coarse", value=60.0), lambda a, b: noise(b) - noise(a), [300, 0]),
    "Q": (replace(PLAIN, kind="Q", where="all components", value=np.log(9)), lambda a, b: Q(b) / Q(a) , 9.0),
    "degrees": (
        replace(PLAIN, kind="degrees", where="radar.azimuth", factor=180 / np.pi),
        lambda a, b: b.z["radar"][..., 1] / a.z["radar"][..., 1], 180 / np.pi,
    ),
    "units": (
        replace(PLAIN, kind="units", factor=1e-3), lambda a, b: b.z["radar"][..., 0] / a.z["radar"][..., 0], 1e-3,
    ),
    "time units": (replace(PLAIN, kind="time units", where="dt", factor=60.0), lambda a, b: b.dt / a.dt, 60.0),
    "prior": (replace(PLAIN, kind="prior", where="vnorth", value=2.0), lambda a, b: b.prior.mean[..., 2], 200.0),
    "prior as a whole": (
        replace(PLAIN, kind="prior", where="covariance × 100", factor=100.0),
        lambda a, b: (np.asarray(b.prior.cov) / np.asarray(a.prior.cov))[..., [2, 3], [2, 3]], 100.0,
    ),
    "bias": (replace(PLAIN, kind="bias", value=7.0, std=2.0), lambda a, b: [*b.model.bias.prior.mean,
             *np.diag(b.model.bias.prior.cov)], [7.0, 4.0]),
    "scale": (replace(PLAIN, kind="scale", value=0.07, std=0.01), lambda a, b: b.model.bias.prior.mean, [0.07]),
    "scale with a name": (
        replace(PLAIN, kind="scale", value=1 / 0.3048 - 1, std=0.01, factor=0.3048e-3),
        lambda a, b: b.z["radar"][..., 0] / a.z["radar"][..., 0], 0.3048e-3,
    ),
    "drift": (replace(PLAIN, kind="drift", where="veast", value=0.3), lambda a, b: b.model.bias.prior.mean, [0.3]),
    "outliers": (
        replace(PLAIN, kind="outliers", value=0.1), lambda a, b: "student" in str(b.updates["radar"]).lower(), True,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_is_written_means_what_was_found(case, tmp_path):
    finding, ratio, wanted = CASES[case]
    correction, old, new = written(tmp_path, finding)
    assert correction.changed == ("because, so much",)
    with np.errstate(all="ignore"):  # padding, and covariances of 0
        value = np.asarray(ratio(old, new), float)
    there = np.isfinite(value)
    assert there.any()
    np.testing.assert_allclose(value[there], np.broadcast_to(wanted, value.shape)[there], rtol=1e-3)
    assert MARK in correction.text
    assert "# from a book" in correction.text
    # Every line that is new says why, or stands in a table that does.
    news = [line for line in correction.text.splitlines() if line not in TEXT.splitlines()]
    assert any("because, so much" in line for line in news)


def test_a_second_reason_stands_behind_the_first(tmp_path):
    text = TEXT.replace('azimuth = "0.2 deg" }', 'azimuth = "0.2 deg" } # data sheet')
    correction, _, _ = written(tmp_path, replace(PLAIN, value=1.0), text)
    assert "# data sheet; because, so much" in correction.text


def test_the_unit_of_an_input_of_one_of_several_motions_is_written(tmp_path):
    path = write_rover(tmp_path)
    correction = correct(path, [replace(PLAIN, kind="degrees", where="turn_rate", factor=180 / np.pi)])
    assert correction.changed == ("because, so much",)
    assert 'unit = "rad/s"' in correction.text


REFUSED = {
    "a density of both axes": (replace(PLAIN, kind="Q", where="north, vnorth", value=1.0), TEXT, "alike"),
    "no words": (replace(PLAIN, kind="clock", where="dt", value=0.1), TEXT, "no words"),
    "provisional": (replace(PLAIN, provisional=True, value=1.0), TEXT, "provisional"),
    "no such unit": (replace(PLAIN, kind="units", factor=0.123), TEXT, "no unit"),
    "a start that was measured": (replace(PLAIN, kind="prior", where="north", value=4.0), TEXT, "first measurement"),
    "a column": (
        replace(PLAIN, value=1.0),
        TEXT.replace('range = "30 m"', 'range = { column = "range_km", unit = "km" }'), "column",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_written_stays_and_says_what_to_do(case, tmp_path):
    finding, text, why = REFUSED[case]
    correction, _, _ = written(tmp_path, finding, text)
    assert correction.text == text
    assert not correction.changed
    (left,) = correction.left
    assert why in left
    assert "do that" in left


def test_the_command_refuses_before_it_examines(tmp_path):
    write_csv(tmp_path / "radar.csv", radar_table())
    (tmp_path / "radar.toml").write_text(TEXT)
    (tmp_path / "radar-corrected.toml").write_text("mine")
    with pytest.raises(sigmax.InputError, match="was not written by sigmax doctor"):
        app(["doctor", str(tmp_path / "radar.toml"), "--write"])
    with pytest.raises(sigmax.InputError, match="built in"):
        app(["doctor", "plaza2", "--write"])

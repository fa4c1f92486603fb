"""Noises from columns, and delays of sensors, against the same by hand."""

from pathlib import Path

import numpy as np
import pytest

import sigmax
from sigmax.records import load
from tests.own_records import RADAR, radar_table, write_csv

COLUMN = RADAR.replace('range = "30 m", azimuth', 'range = { column = "off_km", unit = "km", missing = 0 }, azimuth')


def with_deviations() -> dict[str, list]:
    """Ranges whose deviation each row tells, in km; of a row that measured nothing none."""
    table = radar_table()
    deviations = np.random.default_rng(0).uniform(0.01, 0.3, len(table["t"])).round(6)
    table["off_km"] = [d if np.isfinite(r) else np.nan for d, r in zip(deviations, table["range_km"], strict=True)]
    return table


def written(folder: Path, text: str, table: dict[str, list]) -> sigmax.records.Record:
    write_csv(folder / "radar.csv", table)
    (folder / "radar.toml").write_text(text)
    return load(str(folder / "radar.toml"))


def test_a_column_of_deviations_is_the_noise_of_each_row(tmp_path: Path) -> None:
    """The same as `run` with R of every row; the prior from a first measurement has its noise, too."""
    table = with_deviations()
    record = written(tmp_path, COLUMN, table)
    plain = written(tmp_path, RADAR, table)
    for k, name in enumerate(("A1", "B2")):
        mine = [i for i, aircraft in enumerate(table["aircraft"]) if aircraft == name]
        deviation = 1e3 * np.array(table["off_km"])[mine]
        R = np.column_stack([deviation**2, np.full(len(mine), np.radians(0.2) ** 2)])
        T = len(mine)
        assert np.allclose(
            record.prior.cov[k][:2, :2].trace(),
            deviation[0] ** 2 + (np.radians(0.2) * np.hypot(*record.prior.mean[k][:2])) ** 2,
        )
        start = sigmax.Gaussian(record.prior.mean[k], record.prior.cov[k])
        filter, model, _ = record.of_trial(record.trials[0])
        given = {"dt": record.dt[k, :T], "update_first": True}
        z = {"radar": record.z["radar"][k, :T]}
        assert record.inputs is not None
        got = sigmax.run(filter, model, start, z, inputs=record.inputs[k, :T], **given)
        wanted = sigmax.run(filter, plain.model, start, z, R={"radar": R}, **given)
        assert np.allclose(got.mean, wanted.mean, rtol=1e-9)
        assert np.allclose(got.cov, wanted.cov, rtol=1e-9)
        assert not np.allclose(got.mean, sigmax.run(filter, plain.model, start, z, **given).mean, rtol=1e-3)


def test_deviations_that_are_none_are_refused_with_their_row(tmp_path: Path) -> None:
    table = with_deviations()
    bad = np.array(table["off_km"])
    bad[bad > 0.25] = -1.0
    with pytest.raises(sigmax.InputError, match=r"row \d+: sensors.radar.noise.range must be above 0.*missing = -1000"):
        written(tmp_path, COLUMN, table | {"off_km": bad.tolist()})
    with pytest.raises(sigmax.InputError, match="the column 'off_km' is empty"):
        written(tmp_path, COLUMN, table | {"off_km": [np.nan] * len(bad)})
    with pytest.raises(sigmax.InputError, match="the unit 'rad' does not fit"):
        written(tmp_path, COLUMN.replace('unit = "km", missing = 0', 'unit = "rad"'), table)
    with pytest.raises(sigmax.InputError, match=r"noise.range: .*'colum'"):
        written(tmp_path, COLUMN.replace('{ column = "off_km"', '{ colum = "off_km"'), table)


ROVER = """
data = "radar.csv"
time = "t"
position = ["x", "y"]
filters = ["EKF"]

[motion]
kind = "unicycle"
noise = { position = 0.05, heading = "1 deg" }
inputs = { speed = "v", turn_rate = "w" }

[sensors.gps]
kind = "position"
columns = { x = "gx", y = "gy" }
noise = { x = 0.5, y = { column = "off" } }
delay = "250 ms"

[sensors.wall]
kind = "range_only"
origin = [20, 0]
columns = { range = "d" }
noise = { range = 0.1 }

[prior]
x = { mean = 0, std = 1 }
y = { mean = 0, std = 1 }
heading = { mean = 0, std = 0.1 }

[truth]
x = "x"
"""


def rover_table(rng: np.random.Generator) -> dict[str, list]:
    t = np.arange(0, 8, 0.1)
    there = rng.random(len(t)) < 0.3
    gps = np.where(there[:, None], np.column_stack([t, 0 * t]) + rng.normal(size=(len(t), 2)), np.nan)
    wall = np.where(rng.random(len(t)) < 0.5, 20 - t + 0.1 * rng.normal(size=len(t)), np.nan)
    off = np.where(there, rng.uniform(0.2, 1, len(t)), np.nan)
    columns = {
        "t": t,
        "v": rng.normal(1, 0.2, len(t)),
        "w": rng.normal(0, 0.1, len(t)),
        "gx": gps[:, 0],
        "gy": gps[:, 1],
    }
    return {k: v.tolist() for k, v in (columns | {"off": off, "d": wall, "x": t}).items()}


def test_a_delay_is_the_table_put_right_by_hand(tmp_path: Path) -> None:
    """Each delayed measurement in a row of its own, earlier, with the inputs under way then."""
    table = rover_table(np.random.default_rng(1))
    record = written(tmp_path, ROVER, table)
    rows = []
    for k, t in enumerate(table["t"]):
        row = {name: column[k] for name, column in table.items()}
        rows.append(row | {"gx": np.nan, "gy": np.nan, "off": np.nan})
        if np.isfinite(row["gx"]):
            early = t - 0.25
            after = min(i for i, u in enumerate(table["t"]) if u >= max(early, 0))
            rows.append(
                {"t": early, "v": table["v"][after], "w": table["w"][after], "d": np.nan, "x": np.nan}
                | {name: row[name] for name in ("gx", "gy", "off")}
            )
    rows.sort(key=lambda row: row["t"])
    by_hand = {name: [row[name] for row in rows] for name in table}
    same = written(tmp_path, ROVER.replace('delay = "250 ms"', "delay = 0"), by_hand)
    assert np.allclose(record.time, same.time, atol=1e-9)
    for sensor in ("gps", "wall"):
        assert np.allclose(record.z[sensor], same.z[sensor], atol=1e-5, equal_nan=True)
    assert record.inputs is not None
    results = []
    for one in (record, same):
        filter, model, prior = one.of_trial(one.trials[0])
        results.append(sigmax.run(filter, model, prior, one.z, dt=one.dt, inputs=one.inputs, update_first=True))
    assert np.allclose(results[0].mean, results[1].mean, atol=1e-5)
    assert np.allclose(results[0].cov, results[1].cov, atol=1e-5)
    assert "gps 0.25 s" in record.notes[0]


def test_rows_that_a_delay_leaves_empty_are_dropped(tmp_path: Path) -> None:
    """And the prior from a first measurement stands at the time at which that was made."""
    table = radar_table()
    text = RADAR.split("[truth]")[0].replace('azimuth = "0.2 deg" }', 'azimuth = "0.2 deg" }\ndelay = 0.5')
    late, plain = written(tmp_path, text, table), written(tmp_path, text.replace("delay = 0.5", ""), table)
    heard = ~np.isnan(plain.z["radar"]).all(-1)
    heard[:, 0] = True
    for k in range(2):
        assert np.allclose(late.time[k, : late.steps[k]], plain.time[k][heard[k]] - 0.5)
        assert np.array_equal(late.prior.mean[k], plain.prior.mean[k])


@pytest.mark.parametrize(("delay", "words"), [(-1, "delay must not be negative"), ('"3 m"', "is a time")])
def test_a_delay_that_is_none_is_refused(delay: object, words: str, tmp_path: Path) -> None:
    with pytest.raises(sigmax.InputError, match=words):
        written(tmp_path, ROVER.replace('"250 ms"', str(delay)), rover_table(np.random.default_rng(1)))

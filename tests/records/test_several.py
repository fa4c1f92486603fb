"""Several tables with clocks of their own are the one table that somebody joined by hand."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sigmax.errors import InputError
from sigmax.files import read_table
from sigmax.logs import read_log
from sigmax.records import Record, load
from tests.records.logs_written import ulog
from tests.records.test_proposals import world

HEAD = """
data = "odometer.csv"
time = "t"
filters = ["EKF"]

[motion]
kind = "unicycle"
noise = { position = 0.1, heading = 0.1 }
inputs = { speed = "speed", turn_rate = "turn" }
"""
REST = """
[sensors.gps]
kind = "position"
columns = {{ x = "{gps}east", y = {{ column = "{gps}north", unit = "km" }} }}
noise = {{ x = {{ column = "{gps}acc" }}, y = 2 }}

[sensors.beacon]
kind = "range_only"
columns = {{ range = "{uwb}r" }}
noise = {{ range = 1 }}
inputs = {{ beacon_x = "{uwb}bx", beacon_y = "{uwb}by" }}

[prior]
x = {{ mean = 0, std = 1 }}
y = {{ mean = 0, std = 1 }}
heading = {{ mean = 0, std = 1 }}

[truth]
x = "{truth}x"
y = "{truth}y"
"""
TABLES = """
[tables.gps]
data = "gps.csv"
time = { column = "ms", unit = "ms" }
ahead = "2 s"
[tables.uwb]
data = "uwb.csv"
time = "t"
[tables.reference]
data = "truth.csv"
time = "t"
"""


def frames() -> dict[str, pd.DataFrame]:
    rng = np.random.default_rng(1)
    odometer, gps, uwb, truth = (
        np.arange(0, 10, 0.5),
        np.arange(0.3, 10, 1.7),
        np.arange(0.5, 8, 1.0),
        np.arange(-3, 20.0),
    )
    return {
        "odometer": pd.DataFrame({"t": odometer, "speed": rng.random(20), "turn": rng.random(20)}),
        "gps": pd.DataFrame({"t": gps, "east": rng.random(6), "north": rng.random(6), "acc": 1 + rng.random(6)}),
        "uwb": pd.DataFrame({"t": uwb, "r": rng.random(8), "bx": rng.random(8), "by": rng.random(8)}),
        "truth": pd.DataFrame({"t": truth, "x": rng.random(23), "y": rng.random(23)}),
    }


def by_hand(parts: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Row by row: what a table does not have is empty, and the odometer of a row is that of its next row."""
    rows = []
    for rank, (name, part) in enumerate(parts.items()):
        rows += [(row["t"], rank, name, row) for _, row in part.iterrows() if name != "truth" or 0 <= row["t"] <= 9.5]
    rows.sort(key=lambda row: row[:2])
    found = []
    for t, _, _, row in rows:
        later = parts["odometer"][parts["odometer"].t >= t].iloc[0]
        found.append({**row.to_dict(), "speed": later.speed, "turn": later.turn})
    return pd.DataFrame(found)


def same(a: Record, b: Record) -> None:
    for name in ("time", "dt", "truth", "steps"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-12, err_msg=name)
    # Where no time passes inputs of the motion count for nothing.
    passes = a.dt > 0
    np.testing.assert_allclose(a.inputs[passes], b.inputs[passes], atol=1e-12)
    for sensor in a.z:
        np.testing.assert_allclose(a.z[sensor], b.z[sensor], atol=1e-12)


def written(folder: Path, parts: dict[str, pd.DataFrame], dates: bool = False) -> None:
    own = {name: part.copy() for name, part in parts.items()}
    own["gps"]["ms"] = (own["gps"].pop("t") + 2) * 1000
    for name, part in own.items():
        if dates:
            clock = "ms" if name == "gps" else "t"
            part[clock] = pd.Timestamp("2024-05-01T12:00:00Z") + pd.to_timedelta(
                part[clock] / (1e3 if name == "gps" else 1), unit="s"
            )
        part.to_csv(folder / f"{name}.csv", index=False)


@pytest.mark.parametrize("dates", [False, True])
def test_joined_tables_are_one_table_joined_by_hand(dates: bool, tmp_path: Path) -> None:
    parts = frames()
    written(tmp_path, parts, dates)
    tables = TABLES.replace('{ column = "ms", unit = "ms" }', '"ms"') if dates else TABLES
    names = {"gps": "gps.", "uwb": "uwb.", "truth": "reference."}
    (tmp_path / "several.toml").write_text(HEAD + tables + REST.format(**names))
    by_hand(parts).to_csv(tmp_path / "one.csv", index=False)
    one = (HEAD + REST.format(gps="", uwb="", truth="")).replace("odometer.csv", "one.csv")
    (tmp_path / "one.toml").write_text(one)
    several = load(str(tmp_path / "several.toml"))
    same(several, load(str(tmp_path / "one.toml")))
    # Truth beyond the measurements adds no rows.
    assert several.steps[0] == 20 + 6 + 8 + 10
    if dates:
        assert several.epoch == pd.Timestamp("2024-05-01T12:00:00Z")


def test_tracks_and_places_of_several_tables(tmp_path: Path) -> None:
    """Two ships; the second table has other names for their places, and the plane is that of the first."""
    w = world()
    half = w[w.t < 60]
    half[["t", "id", "lat", "lon"]].to_csv(tmp_path / "a.csv", index=False)
    rest = w[w.t >= 60].rename(columns={"lat": "phi", "lon": "lam", "id": "who", "t": "s"})
    rest[["s", "who", "phi", "lam"]].to_csv(tmp_path / "b.csv", index=False)
    w.to_csv(tmp_path / "all.csv", index=False)
    place = '[{local}]\nlatitude = {{ column = "{lat}", unit = "deg" }}\n'
    place += 'longitude = {{ column = "{lon}", unit = "deg" }}\n'
    sensor = '[sensors.{n}]\nkind = "position"\ncolumns = {{ east = "{p}local.east", north = "{p}local.north" }}\n'
    sensor += "noise = {{ east = 1, north = 1 }}\n"
    head = 'data = "{f}.csv"\ntime = "t"\ntrack = "id"\nfilters = ["EKF"]\n[motion]\nkind = "constant_velocity"\n'
    head += 'axes = ["east", "north"]\nnoise = {{ density = 1 }}\n'
    prior = '[prior]\nposition_from = "a"\nveast = { mean = 0, std = 9 }\nvnorth = { mean = 0, std = 9 }\n'
    local = place.format(local="local", lat="lat", lon="lon")
    (tmp_path / "all.toml").write_text(head.format(f="all") + local + sensor.format(n="a", p="") + prior)
    more = '[tables.late]\ndata = "b.csv"\ntime = "s"\ntrack = "who"\n'
    more += place.format(local="tables.late.local", lat="phi", lon="lam")
    both = sensor.format(n="a", p="") + sensor.format(n="b", p="late.")
    (tmp_path / "two.toml").write_text(head.format(f="a") + local + more + both + prior)
    two, one = load(str(tmp_path / "two.toml")), load(str(tmp_path / "all.toml"))
    # In the order in which they appear.
    assert two.tracks == one.tracks[::-1]
    np.testing.assert_allclose(two.time[::-1], one.time)
    merged = np.where(np.isnan(two.z["b"]), two.z["a"], two.z["b"])
    np.testing.assert_allclose(merged[::-1], one.z["a"], atol=1e-9)
    assert two.placed == one.placed
    begins, _, ends = (tmp_path / "two.toml").read_text().partition("[tables.late.local]")
    origin = '[tables.late.local]\norigin = ["52.1 deg", "4.3 deg"]'
    (tmp_path / "other.toml").write_text(f"{begins}{origin}{ends}")
    with pytest.raises(InputError, match=r"tables.late.local: all tables of a record have one frame.*52.1000"):
        load(str(tmp_path / "other.toml"))


def test_two_tables_of_one_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = []
    monkeypatch.setattr(read_table, "read_log", lambda *of: read.append(of) or read_log(*of))
    ulog(tmp_path, world())
    (tmp_path / "d.toml").write_text(
        'data = "flight.ulg"\ntable = "sensor_gps"\ntime = "time"\nfilters = ["EKF"]\n'
        '[tables.ekf]\ntable = "vehicle_thing"\ntime = "time"\n'
        '[local]\nlatitude = { column = "latitude_deg", unit = "deg" }\n'
        'longitude = { column = "longitude_deg", unit = "deg" }\n'
        '[motion]\nkind = "constant_velocity"\naxes = ["east", "north"]\nnoise = { density = 1 }\n'
        '[sensors.gps]\nkind = "position"\ncolumns = { east = "local.east", north = "local.north" }\n'
        "noise = { east = 1, north = 1 }\n"
        '[prior]\nposition_from = "gps"\nveast = { mean = 0, std = 9 }\nvnorth = { mean = 0, std = 9 }\n'
        '[truth]\nnorth = "ekf.x"\neast = "ekf.y"\n'
    )
    record = load(str(tmp_path / "d.toml"))
    assert len(read) == 1
    assert record.epoch is not None
    seen, known = record.z["gps"][0], record.truth[0, :, :2]
    # Both have the times of the device: a row of one, then one of the other.
    moved = seen[2::2] - known[1:-2:2]
    np.testing.assert_allclose(moved, np.tile(moved[0], (len(moved), 1)), atol=0.06)


WRONG = {
    "no such column": (lambda s: s.replace('"gps.east"', '"gps.esat"'), "unknown column 'gps.esat'"),
    "no such table": (lambda s: s.replace('"gps.east"', '"gsp.east"'), "unknown column 'gsp.east'"),
    "a file that is not there": (lambda s: s.replace("uwb.csv", "uwb2.csv"), "there is no file .*uwb2.csv"),
    "a point in a name": (lambda s: s.replace("[tables.gps]", '[tables."g.p"]'), "has no point in it"),
    "no time": (lambda s: s.replace('data = "uwb.csv"\ntime = "t"', 'data = "uwb.csv"'), "needs the key 'time'"),
    "a track": (lambda s: s.replace('data = "uwb.csv"', 'data = "uwb.csv"\ntrack = "r"'), "tables.uwb.track"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_does_not_fit_is_refused(case: str, tmp_path: Path) -> None:
    change, words = WRONG[case]
    written(tmp_path, frames())
    text = HEAD + TABLES + REST.format(gps="gps.", uwb="uwb.", truth="reference.")
    (tmp_path / "d.toml").write_text(change(text))
    with pytest.raises(InputError, match=words):
        load(str(tmp_path / "d.toml"))


def test_a_wrong_number_is_quoted_with_its_file(tmp_path: Path) -> None:
    written(tmp_path, frames())
    lines = (tmp_path / "uwb.csv").read_text().splitlines()
    (tmp_path / "uwb.csv").write_text("\n".join([*lines[:3], "2.5,far,1,1", *lines[4:]]))
    (tmp_path / "d.toml").write_text(HEAD + TABLES + REST.format(gps="gps.", uwb="uwb.", truth="reference."))
    with pytest.raises(InputError, match=r"row 4 of uwb.csv: column 'uwb.r' has 'far'"):
        load(str(tmp_path / "d.toml"))
    (tmp_path / "uwb.csv").write_text("\n".join([lines[0], *lines[:0:-1]]))
    with pytest.raises(InputError, match=r"uwb.csv: time runs backwards"):
        load(str(tmp_path / "d.toml"))

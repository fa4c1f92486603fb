"""What a user gives wrongly is refused in words, before anything runs."""

from pathlib import Path

import pandas as pd
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.files.read_table import read_table
from sigmax.records import check, load, parse_trial
from tests.own_records import RADAR, radar_table, tracked_radar, write_radar


@pytest.fixture
def radar() -> sigmax.records.Record:
    return tracked_radar()[0]


def changed(old: str, new: str, text: str = RADAR) -> str:
    assert old in text
    return text.replace(old, new)


BAD_DESCRIPTIONS = {
    "no toml": ("data = radar", "Invalid value .at line 1"),
    "a missing key": (changed('time = "t"\n', ""), "needs the key 'time'"),
    "a missing table": (changed("[prior]", "[other]"), "unknown key 'other'"),
    "an unknown key": (changed("columns =", "colums ="), "sensors.radar: unknown key 'colums'; did you mean columns"),
    "a key of another kind": (
        changed('track = "aircraft"', "track = 3"),
        "track: this must be text in quotes; it is 3",
    ),
    "no table where one belongs": (changed("[sensors.radar]", "[sensors]"), "sensors.kind: must be a table of keys"),
    "an unknown motion": (
        changed("constant_velocity", "constant_velosity"),
        "motion.kind: unknown motion.*constant_velocity",
    ),
    "an unknown sensor": (
        changed("range_azimuth", "range_azimut"),
        "sensors.radar.kind: unknown sensor.*range_azimuth",
    ),
    "an unknown filter": (changed('["EKF"]', '["SRCKF", "SRCKFX"]'), "unknown filter 'SRCKFX'; did you mean .*SRCKF"),
    "an unknown component": (
        changed("[truth]\nnorth", "[truth]\nnorht"),
        "truth: unknown component 'norht'; did you mean north",
    ),
    "a missing column": (
        changed("range_km", "range_kn"),
        "radar.csv: unknown column 'range_kn'; did you mean range_km",
    ),
    "a unit that does not fit": (
        changed('unit = "deg"', 'unit = "m"'),
        "azimuth: the unit 'm' does not fit; this is an angle",
    ),
    "noise that does not fit": (changed('"0.2 deg"', '"0.2 m"'), "noise.azimuth: the unit 'm' does not fit"),
    "noise that misses": (changed('range = "30 m", ', ""), "sensors.radar.noise needs 'range', a length"),
    "negative noise": (changed('"30 m"', '"-30 m"'), "must not be negative"),
    "an asymmetric covariance": (
        changed('{ range = "30 m", azimuth = "0.2 deg" }', "[[4, 1], [0, 4]]"),
        "radar.*symmetric",
    ),
    "an indefinite covariance": (
        changed('{ range = "30 m", azimuth = "0.2 deg" }', "[[1, 2], [2, 1]]"),
        "semidefinite",
    ),
    "a ragged covariance": (
        changed('{ range = "30 m", azimuth = "0.2 deg" }', "[[1, 2], [2]]"),
        "array of real numbers",
    ),
    "NaN in the prior": (
        changed('mean = 0, std = "360 km/h"', "mean = nan, std = 1"),
        "prior.vnorth.mean: nan is not finite",
    ),
    "half a prior": (changed('mean = 0, std = "360 km/h"', "mean = 0"), "prior.vnorth must be { mean = …, std = … }"),
    "a prior that misses": (
        changed('position_from = "radar"\n', ""),
        "prior needs 'north'.*or position_from = a sensor",
    ),
    "a prior given twice": (changed("[prior]", "[prior]\nnorth = { mean = 0, std = 1 }"), "given twice"),
    "an unknown function": (
        changed('"constant_velocity"\naxes = ["north", "east"]', '"my.py:f"\nstate = { x = "m" }'),
        "no file.*my.py",
    ),
    "an option of another": (
        changed('kind = "constant_velocity"', 'kind = "constant_velocity"\ntau = 3'),
        "takes no 'tau'",
    ),
    "no filter": (changed('["EKF"]', "[]"), "filters: this must not be empty"),
    "inputs that nobody takes": (
        changed("[sensors.radar]", '[motion.inputs]\nv = "t"\n[sensors.radar]'),
        "nothing here takes inputs",
    ),
}


@pytest.mark.parametrize("case", BAD_DESCRIPTIONS)
def test_a_description_that_does_not_fit_is_refused(case: str, tmp_path: Path) -> None:
    description, words = BAD_DESCRIPTIONS[case]
    with pytest.raises(InputError, match=f"(?s)^radar.toml.*{words}") as refused:
        load(str(write_radar(tmp_path, description)))
    assert "Traceback" not in str(refused.value)


def _lines(change: object) -> object:
    def spoil(path: Path) -> None:
        lines = path.read_text().splitlines()
        path.write_text("\n".join(change(lines)) + "\n")

    return spoil


def _field(row: int, column: int, value: str) -> object:
    """Replace a field; rows are counted as a reader does, the header being 1."""

    def change(lines: list[str]) -> list[str]:
        fields = lines[row - 1].split(",")
        fields[column] = value
        return [*lines[: row - 1], ",".join(fields), *lines[row:]]

    return _lines(change)


BAD_TABLES = {
    "missing": (Path.unlink, "there is no file"),
    "empty": (lambda path: path.write_text(""), "radar.csv is empty"),
    "without rows": (_lines(lambda lines: lines[:1]), "no rows of data"),
    "cut off": (lambda path: path.write_text(path.read_text()[:-25]), "cut off: Row #51: Expected 6 columns, got [45]"),
    "ragged": (_lines(lambda lines: [*lines[:5], lines[5] + ",1", *lines[6:]]), "Row #6: Expected 6 columns, got 7"),
    "twice the same column": (_lines(lambda lines: [lines[0].replace("north_km", "t"), *lines[1:]]), "two columns 't'"),
    "no text": (lambda path: path.write_bytes(b"\xff\xfe\x00t"), "UTF-8"),
    "text for a number": (_field(7, 2, "far"), "row 7: column 'range_km' has 'far' where a number belongs"),
    "infinity": (_field(7, 3, "inf"), "row 7: column 'azimuth_deg' has 'inf' which is not finite"),
    "no time": (_field(4, 0, ""), "row 4: column 't' has nothing where a time belongs"),
    "text for a time": (_field(4, 0, "noon"), "row 4: column 't' has 'noon'"),
    "no track": (_field(3, 1, ""), "row 3: the column 'aircraft' does not say which track"),
    "time backwards": (_field(8, 0, "1.0"), "backwards of the track 'A1' from row 6 .4 s. to row 8 .1 s."),
    "no measurement at all": (
        _lines(
            lambda lines: [lines[0], *(",".join([*x.split(",")[:2], "", "", *x.split(",")[4:]]) for x in lines[1:])]
        ),
        "the track 'A1' has no whole measurement",
    ),
}


@pytest.mark.parametrize("case", BAD_TABLES)
def test_a_table_that_does_not_fit_is_refused(case: str, tmp_path: Path) -> None:
    spoil, words = BAD_TABLES[case]
    path = write_radar(tmp_path)
    spoil(tmp_path / "radar.csv")
    with pytest.raises(InputError, match=words):
        load(str(path))


def test_a_parquet_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    pd.DataFrame(radar_table()).to_parquet(tmp_path / "radar.parquet")
    whole = (tmp_path / "radar.parquet").read_bytes()
    for size in (0, 3, len(whole) // 2, len(whole) - 1):
        (tmp_path / "radar.parquet").write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"radar.parquet is not a whole Parquet file"):
            read_table(tmp_path / "radar.parquet")
    pd.DataFrame({"t": ["a", "b"], "ok": [True, False]}).to_parquet(tmp_path / "radar.parquet")
    table = read_table(tmp_path / "radar.parquet")
    with pytest.raises(InputError, match="row 1: column 't' has 'a'"):
        table.numbers("t")
    with pytest.raises(InputError, match="'ok' holds bool"):
        table.numbers("ok")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("def other(x, dt): return x", "unknown function of mine.py 'motion'; known: 'other'"),
        ("def motion(x, dt) return x", "mine.py, line 1"),
        ("import does_not_exist", "mine.py fails at line 1: ModuleNotFoundError"),
        ("raise SystemExit(3)", "mine.py fails at line 1: SystemExit"),
        ("def motion(x): return x", "must take 2 or 3 positional arguments"),
        ("def motion(x, dt, u): return x", "takes inputs u; name their columns"),
        ("def motion(x, dt):\n    return x[:1]", "motion must return the 2 components"),
        ("def motion(x, dt):\n    return x / nonsense", "NameError: name 'nonsense'.*line 2"),
    ],
)
def test_a_function_that_does_not_fit_is_refused(code: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(code)
    description = changed(
        'kind = "constant_velocity"\naxes = ["north", "east"]',
        'kind = "mine.py:motion"\nstate = { north = "m", east = "m" }',
    )
    description = description.replace('{ density = "0.5 m^2/s^3" }', '{ north = "1 m", east = "1 m" }')
    description = description.replace(
        'vnorth = { mean = 0, std = "360 km/h" }\nveast = { mean = 0, std = "100 m/s" }\n', ""
    )
    path = write_radar(tmp_path, description)

    def load_and_check() -> None:
        record = load(str(path))
        check(record, record.trials)

    with pytest.raises(InputError, match=f"(?s){words}"):
        load_and_check()


def test_what_cannot_work_is_refused_before_it_runs(radar: sigmax.records.Record) -> None:
    for trial, words in {
        "KF": "KF: KF is for linear models",
        "UKF:kappa=-9": "alpha²",
        "EKF:fixed=vnort": "unknown component 'vnort'; did you mean .*vnorth",
    }.items():
        with pytest.raises(InputError, match=words):
            check(radar, (parse_trial(trial),))


def test_tracks_of_very_different_length_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sigmax.records.own._ROOM", 0)
    monkeypatch.setattr("sigmax.records.own._PADDING", 1)
    with pytest.raises(InputError, match="put the long tracks into a file of their own"):
        load(str(write_radar(tmp_path)))


@pytest.mark.parametrize("how", ["dataclass", "dataclass(eq=False)"])
def test_an_object_that_can_be_called_need_not_be_hashable(how: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import jax.numpy as jnp\nfrom dataclasses import dataclass\n\n"
        f"@{how}\nclass Straight:\n    rate: float = 1.0\n\n"
        "    def __call__(self, x, dt):\n        return jnp.stack([x[0] + self.rate * dt * x[1], x[1]])\n\n"
        "motion = Straight()\n"
    )
    (tmp_path / "d.csv").write_text("t,x\n0,1\n1,2\n")
    (tmp_path / "d.toml").write_text(
        'data = "d.csv"\ntime = "t"\n[motion]\nkind = "mine.py:motion"\nstate = { x = "m", v = "m/s" }\n'
        "noise = [[0.1, 0.0], [0.0, 0.1]]\n"
        '[sensors.seen]\nkind = "position"\nat = ["x"]\ncolumns = { x = "x" }\nnoise = { x = 1 }\n'
        "[prior]\nx = { mean = 0, std = 10 }\nv = { mean = 0, std = 10 }\n"
    )
    record = load(str(tmp_path / "d.toml"))
    check(record, (parse_trial("EKF"),))

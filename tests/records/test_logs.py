"""Logs of every format become records that say what was written into them; damaged ones are refused in a line."""

import importlib.util
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sigmax.errors import InputError
from sigmax.logs import FORMATS, format_of
from sigmax.models.earth import to_local
from sigmax.proposals.suggest import propose
from sigmax.records import load
from tests.records.logs_written import WRITERS, Written
from tests.records.test_proposals import described, world

MIDNIGHT = {"nmea": pd.Timestamp("2024-05-01T23:59:31Z")}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Written]:
    folder = tmp_path_factory.mktemp("logs")
    found = {}
    for name, write in WRITERS.items():
        (folder / name).mkdir()
        found[name] = write(folder / name, world())
    return found


@pytest.mark.parametrize("name", WRITERS)
def test_a_log_becomes_the_record_that_was_written(name: str, written: dict[str, Written]) -> None:
    """Ids, times, places, velocities, and how accurate each row is, by the proposal alone."""
    log, w = written[name], world()
    record, remarks = described(log.path)
    assert len(record.tracks) == log.tracks
    by_id = [w[w.id == one].reset_index(drop=True) for one in w.id.unique()][: log.tracks]
    for k, truth in enumerate(by_id):
        assert record.steps[k] == len(truth)
        place = np.array(record.z["report"][k])
        # The first position is the prior.
        assert np.isnan(place[0]).all()
        place[0] = np.atleast_2d(record.prior.mean)[k, :2]
        places = np.radians(truth[["lat", "lon"]].to_numpy())
        moved = to_local(places, np.radians(by_id[0][["lat", "lon"]].to_numpy()[0]))
        np.testing.assert_allclose(place, moved, atol=log.tolerance + 0.05)
        since = truth.t - by_id[0].t[0]
        np.testing.assert_allclose(record.time[k] - record.time[0, 0], since, atol=0.01)
        if log.deviation is not None:
            assert record.inputs is not None
            np.testing.assert_allclose(record.inputs[k], np.tile(log.deviation, (len(truth), 1)), rtol=1e-4)
    assert (record.epoch is not None) == log.epoch or name == "hdf5"
    if record.epoch is not None:
        begins = MIDNIGHT.get(name, pd.Timestamp("2024-05-01T12:00:01Z"))
        assert abs((record.epoch + pd.Timedelta(seconds=record.time[0, 0]) - begins).total_seconds()) < 0.01
    assert ("velocity" in record.z) == log.velocity
    if log.velocity:
        first = by_id[0]
        course = np.radians(first.course)
        said = np.column_stack([first.speed * np.sin(course), first.speed * np.cos(course)])
        np.testing.assert_allclose(record.z["velocity"][0], said, atol=0.06)
    assert any("guesses" in remark for remark in remarks)


@pytest.mark.parametrize("name", WRITERS)
def test_a_format_is_known_by_how_it_begins(name: str, written: dict[str, Written], tmp_path: Path) -> None:
    log = written[name].path
    of_name = format_of(log)
    assert of_name is not None
    if log.is_dir() or of_name.module in ("asterix", "states") or log.suffix == ".nc4":
        return
    shutil.copy(log, tmp_path / "download")
    assert format_of(tmp_path / "download") == of_name


# h5netcdf complains of a file that it could not open when that is forgotten.
@pytest.mark.filterwarnings("ignore:Exception ignored in. <function File.close:pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", WRITERS)
def test_a_damaged_log_is_read_in_part_or_refused_in_a_line(
    name: str, written: dict[str, Written], tmp_path: Path
) -> None:
    """Cut off anywhere, with bytes of another value, empty, of something else: never a traceback."""
    log = written[name].path
    inside = next(p for p in log.iterdir() if p.suffix == ".db3") if log.is_dir() else log
    content, rng = inside.read_bytes(), np.random.default_rng(1)
    damaged = [content[: len(content) * k // 3] for k in range(3)] + [content[:-1], bytes(range(256)) * 8]
    for _ in range(2):
        changed = bytearray(content)
        for at in rng.integers(len(content), size=3):
            changed[at] ^= 1 << rng.integers(8)
        damaged.append(bytes(changed))
    refused = []
    for k, bad in enumerate(damaged):
        path = tmp_path / f"{k}{log.suffix}"
        if log.is_dir():
            shutil.copytree(log, path)
        (path / inside.name if log.is_dir() else path).write_bytes(bad)
        try:
            propose(path)
        except InputError as error:
            refused.append(str(error))
    assert refused
    assert "\n" not in "".join(refused)
    assert (tmp_path / "0").is_dir() or "empty" in _refusal(tmp_path / f"0{log.suffix}")


def _refusal(path: Path) -> str:
    with pytest.raises(InputError) as refused:
        propose(path)
    return str(refused.value)


@pytest.mark.parametrize("format", [f for f in FORMATS if f.packages], ids=lambda f: f.module)
def test_a_package_that_is_missing_is_named_with_the_command(
    format: object, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    find = importlib.util.find_spec
    gone = {name for name, _ in format.packages}
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name in gone else find(name))
    path = tmp_path / f"a{format.endings[0]}"
    path.write_bytes(b"x")
    told = _refusal(path)
    assert 'pip install "sigmax[logs]"' in told
    assert all(pip in told for _, pip in format.packages)


def test_a_table_of_a_log_is_chosen_by_name(written: dict[str, Written], tmp_path: Path) -> None:
    log = written["ulog"].path
    shutil.copy(log, tmp_path / "flight.ulg")
    toml, remarks = propose(tmp_path / "flight.ulg")
    assert "'sensor_gps' is taken; 'vehicle_thing' has positions, too" in remarks[0]
    for change, words in (
        ("", r'flight.ulg has several tables; write which one, table = "…": sensor_gps, vehicle_thing'),
        ('table = "sensor_gpss"', "unknown table 'sensor_gpss'; did you mean sensor_gps"),
    ):
        (tmp_path / "a.toml").write_text(toml.replace('table = "sensor_gps"', change))
        with pytest.raises(InputError, match=words):
            load(str(tmp_path / "a.toml"))


def test_what_was_left_out_is_a_note(written: dict[str, Written], tmp_path: Path) -> None:
    lines = written["nmea"].path.read_text().splitlines()
    # The checksum of one sentence is another, and a line is noise.
    lines[3] = re.sub(r"\*..$", "*00", lines[3])
    (tmp_path / "boat.nmea").write_text("\n".join([*lines, "?\x00#"]))
    record, _ = described(tmp_path / "boat.nmea")
    assert any(note.startswith("2 lines are no whole sentences") for note in record.notes)


def test_unknown_values_of_ais_are_no_measurements(tmp_path: Path) -> None:
    from pyais import encode_dict

    from sigmax.logs import read_log

    lines = [
        encode_dict({"type": t, "mmsi": 211000000 + t, "lat": 91.0, "lon": 181.0, "speed": s, "course": 360.0})[0]
        for t, s in ((1, 102.3), (18, 102.3), (9, 1023), (27, 63))
    ]
    # A time of reception before or behind a sentence, in each way that receivers write.
    beside = "2024-05-01T12:00:00Z {}", "{},1714564800", "1714564800.0 {}", "[2024-05-01 12:00:00] {}"
    (tmp_path / "a.ais").write_text("\n".join(b.format(line) for b, line in zip(beside, lines, strict=True)))
    table = read_log(tmp_path / "a.ais", FORMATS[0]).tables["position"]
    assert table[["latitude", "longitude", "speed_kn", "course_deg"]].isna().all(axis=None)
    assert (table.time == pd.Timestamp("2024-05-01T12:00:00Z")).all()
    (tmp_path / "a.ais").write_text("\n".join(lines))
    assert "4 positions and no time" in _refusal(tmp_path / "a.ais")


COMMENTED = {
    "above": "# a receiver\n# of 2024\ntime,x,y\n0,1,2\n10,2,4\n20,3,6\n",
    "named in a comment": "% log\n% time x y\n0 1 2\n10 2 4\n20 3 6\n",
    "between": "time;x;y\n0;1;2\n# paused\n10;2;4\n\n20;3;6\n",
    "blanks": "  time   x y\n0   1 2  \n# paused\n10 2\t4\n20 3 6",
    "an empty line first": "\n\ntime|x|y\n0|1|2\n10|2|4\n20|3|6\n",
}


@pytest.mark.parametrize("case", COMMENTED)
@pytest.mark.parametrize("packed", [False, True])
def test_comments_and_any_separator(case: str, packed: bool, tmp_path: Path) -> None:
    import gzip

    content = COMMENTED[case]
    path = tmp_path / ("d.csv.gz" if packed else "d.csv")
    path.write_bytes(gzip.compress(content.encode()) if packed else content.encode())
    record, _ = described(path)
    np.testing.assert_array_equal(record.z["position"][0, 1:], [[2, 4], [3, 6]])
    # A fault is quoted with the line in which an editor shows it.
    if case != "above":
        mark = re.search("2(.)4", content)[1]
        wrong = content.replace(f"2{mark}4", f"2{mark}x")
        line = next(k for k, text in enumerate(wrong.splitlines(), 1) if text.endswith("x") and "10" in text)
        path.write_bytes(gzip.compress(wrong.encode()) if packed else wrong.encode())
        with pytest.raises(InputError, match=f"row {line}: column 'y' has 'x'"):
            load(str(tmp_path / "proposal.toml"))


def test_a_table_without_a_header_has_one_in_its_description(tmp_path: Path) -> None:
    (tmp_path / "d.txt").write_text("range2 0.1 2.9\nrange2 0.2 1.6\n")
    described_by = (
        'data = "d.txt"\ntime = "t"\nheader = ["kind", "t", "r"]\nfilters = ["EKF"]\n'
        '[motion]\nkind = "constant_velocity"\nnoise = { density = 1 }\n'
        '[sensors.a]\nkind = "range_only"\norigin = [0, 0]\ncolumns = { range = "r" }\nnoise = { range = 1 }\n'
        "[prior]\nx = { mean = 0, std = 1 }\ny = { mean = 0, std = 1 }\n"
        "vx = { mean = 0, std = 1 }\nvy = { mean = 0, std = 1 }\n"
    )
    (tmp_path / "d.toml").write_text(described_by)
    np.testing.assert_array_equal(load(str(tmp_path / "d.toml")).z["a"][0, :, 0], [2.9, 1.6])
    (tmp_path / "d.toml").write_text(described_by.replace('["kind", "t", "r"]', '["t", "r"]'))
    with pytest.raises(InputError, match="Expected 2 columns, got 3"):
        load(str(tmp_path / "d.toml"))

"""`sigmax track` proposes the doctor where nothing can be believed, and its report says what is wrong when asked."""

import gzip
import json
import re
import shlex
from base64 import b64decode

import numpy as np
import pytest

from sigmax.cli.app import app
from tests.own_records import RADAR, write_csv

TEXT = RADAR[: RADAR.index("[truth]")].replace('range = "30 m"', 'range = "3 m"')


def folder_of(tmp_path):
    """A straight flight whose ranges are ten times as noisy as the description says, and one that agrees with it."""
    rng, rows = np.random.default_rng(4), []
    for name, noise in (("sound", 3.0), ("ill", 30.0)):
        for k in range(150):
            x = np.array([-20e3, 5e3]) + np.array([60.0, -80.0]) * 2 * k
            distance, azimuth = (
                np.hypot(*x) + noise * rng.normal(),
                np.degrees(np.arctan2(x[1], x[0])) + 0.2 * rng.normal(),
            )
            rows.append((2.0 * k, name, distance / 1e3, azimuth))
    rows.sort(key=lambda row: row[0])
    names = ("t", "aircraft", "range_km", "azimuth_deg")
    write_csv(tmp_path / "radar.csv", {name: [row[i] for row in rows] for i, name in enumerate(names)})
    path = tmp_path / "the radar.toml"
    path.write_text(TEXT)
    return path


def figures(report):
    """The figures of a page, by name."""
    packed = re.search(r'<script id="figures"[^>]*>([^<]*)</script>', report)
    assert packed is not None
    return json.loads(gzip.decompress(b64decode(packed[1])))


def tracked(*arguments):
    with pytest.raises(SystemExit) as ended:
        app(["track", *map(str, arguments)])
    return ended.value.code


def test_track_proposes_the_doctor_and_shows_what_it_says(tmp_path, capsys):
    path = folder_of(tmp_path)
    assert tracked(path, "--out", tmp_path / "one") == 0
    out = capsys.readouterr().out
    (line,) = [line for line in out.splitlines() if line.startswith("What is wrong with the model: ")]
    assert shlex.split(line.partition(": ")[2]) == ["sigmax", "doctor", str(path), "--filter", "EKF", "--track", "ill"]
    assert "What is wrong" not in (tmp_path / "one" / "report.html").read_text()

    assert tracked(path, "--doctor", "--out", tmp_path / "two") == 0
    out = capsys.readouterr().out
    assert "R of radar.range is too small" in out
    assert "What is wrong with the model: sigmax" not in out
    (finding, *_) = json.loads((tmp_path / "two" / "summary.json").read_text())["examination"]["findings"]
    assert (finding["kind"], finding["where"]) == ("R", "radar.range")
    report = (tmp_path / "two" / "report.html").read_text()
    assert "What is wrong with the model" in report
    drawn = figures(report)
    before, after = (np.array(line["y"], float) for line in drawn["examined/nis"]["data"][:2])
    assert np.median(before) > 10
    assert 0.5 < np.median(after) < 2
    assert "radar.range" in drawn["examined/residual"]["layout"]["yaxis"]["title"]["text"]
    first, second = (np.array(line["y"], float) for line in drawn["examined/residual"]["data"][:2])
    assert np.std(first) > 5 * np.std(second)


def test_a_filter_that_can_be_believed_proposes_nothing(tmp_path, capsys):
    path = folder_of(tmp_path)
    path.write_text(TEXT.replace('range = "3 m"', 'range = "30 m"'))
    assert tracked(path, "--out", tmp_path / "one") == 0
    assert "doctor" not in capsys.readouterr().out

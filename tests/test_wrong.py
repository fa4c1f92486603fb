"""Every command × every wrong thing that may be given: words and status 2, never a trace, nothing left behind."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sigmax.errors import InputError
from sigmax.serving import Feed
from tests.own_records import RADAR, write_csv, write_radar
from tests.records.test_many import PLOTS
from tests.test_cli import cli

# What takes a model, a record, a study, a map or a feed.
TAKERS: dict[str, list[str]] = {
    "track": ["track"],
    "explain": ["explain"],
    "export": ["export", "c"],
    "compare": ["compare", "--runs", "2"],
    "serve": ["serve"],
    "terrain": ["terrain"],
}
NASTY = "a b'c\"d\n<script>alert(1)</script>;$(touch x)&ü"


def folder(path: Path) -> str:
    path.mkdir()
    return path.name


def content(data: bytes) -> Callable[[Path], str]:
    def make(path: Path) -> str:
        path.write_bytes(data)
        return path.name

    return make


def loop(path: Path) -> str:
    path.symlink_to(path)
    return path.name


WRONG: dict[str, tuple[str, Callable[[Path], str]]] = {
    "nothing there": ("{}.toml", lambda path: path.name),
    "no such table": ("{}.csv", lambda path: path.name),
    "no such name": ("nonesuch", lambda path: path.name),
    "no such folder": ("x/y/z.toml", lambda path: "x/y/z.toml"),
    "an empty name": ("e", lambda path: ""),
    "a blank": ("e", lambda path: " "),
    "a zero": ("e", lambda path: "a\\0.toml"),
    "very long": ("e", lambda path: "a" * 5000 + ".toml"),
    "a folder": ("d.toml", folder),
    "a folder for a table": ("d.csv", folder),
    "a folder for a map": ("d.npz", folder),
    "a link to itself": ("l.toml", loop),
    "bytes": ("b.toml", content(bytes(range(256)))),
    "bytes for a table": ("b.csv", content(bytes(range(256)))),
    "bytes for numbers": ("b.parquet", content(bytes(range(256)))),
    "bytes for a map": ("b.npz", content(b"PK\x03\x04" + bytes(range(256)))),
    "bytes for a picture": ("b.tif", content(bytes(range(256)))),
    "empty": ("e.toml", content(b"")),
    "an empty map": ("e.npz", content(b"")),
    "a mark alone": ("e.toml", content(b"\xef\xbb\xbf")),
    "UTF-16": ("u.toml", content('data = "x"'.encode("utf-16"))),
    "of Windows": ("u.toml", content('title = "Länge"'.encode("cp1252"))),
    "no TOML": ("n.toml", content(b"data = radar")),
    "another TOML": ("n.toml", content(b'[package]\nname = "x"\n')),
    "no such function": ("f.py", lambda path: (path.write_text("x = 1"), f"{path.name}:make")[1]),
    "no function": ("f.py", lambda path: (path.write_text("make = 1"), f"{path.name}:make")[1]),
    "no name of a function": ("f.py", lambda path: (path.write_text("x = 1"), f"{path.name}:")[1]),
    "no file of functions": ("f.py", lambda path: f"{path.name}:make"),
    "a function that fails": ("f.py", lambda path: (path.write_text("def make():\n    1 / 0"), f"{path.name}:make")[1]),
    "a function that ends": ("f.py", lambda path: (path.write_text("def make(): exit(0)"), f"{path.name}:make")[1]),
    "a function that wants": ("f.py", lambda path: (path.write_text("def make(a): pass"), f"{path.name}:make")[1]),
    "a function without a model": ("f.py", lambda path: (path.write_text("def make(): pass"), f"{path.name}:make")[1]),
    "a file that fails": ("f.py", lambda path: (path.write_text("1 / 0"), f"{path.name}:make")[1]),
    "bytes for functions": ("f.py", lambda path: (path.write_bytes(bytes(range(256))), f"{path.name}:make")[1]),
    "a program": ("f.py", lambda path: (path.write_text("x = 1"), path.name)[1]),
    "nasty": (f"{NASTY.replace('/', '_')}.toml", lambda path: path.name),
    "nasty and there": (f"{NASTY.replace('/', '_')}.toml", content(b"x = 1")),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
@pytest.mark.parametrize("command", TAKERS)
def test_a_wrong_argument_is_refused_in_words(
    command: str, case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    name, make = WRONG[case]
    given = make(tmp_path / name)
    before = sorted(tmp_path.rglob("*"))
    assert cli(*TAKERS[command], given) == 2
    told = capsys.readouterr()
    assert "Traceback" not in told.err
    assert told.err.startswith(("sigmax: ", "Usage: "))
    assert len(told.err) < 12_000
    left = [p for p in tmp_path.rglob("*") if p not in before and "__pycache__" not in p.parts]
    assert left == []


FILTERS = [
    *("", "x", "EKF:", "EKF:a", "EKF:=1", "EKF:fixed=", "EKF:fixed=nonesuch", ":", "ü", "EKF EKF"),
    *("UKF:alpha=abc", "UKF:alpha=nan", "UKF:alpha=0", "UKF:alpha=1e308", "UKF:alpha=1,alpha=2", "UKF:kappa=-1e999"),
    *("SRUKFB:beta=inf", "GHKF:points=0", "GHKF:points=1000000"),
]


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("command", ["track", "explain", "export"])
def test_a_wrong_filter_is_refused_in_words(
    command: str, filter: str, radar: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli(*TAKERS[command], radar.name, "-f", filter) in (0, 1, 2)
    assert "Traceback" not in capsys.readouterr().err
    (radar.parent / "plots.toml").write_text(PLOTS)
    with contextlib.suppress(InputError):
        Feed(radar.parent / "plots.toml", filter)


@pytest.fixture
def radar(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_radar(tmp_path)


OUTS = ["radar.csv", "radar.csv/below", "/proc/nonesuch", "/dev/null", "full", "a" * 300, "loop", "loop/below"]
RUNS = [
    ["track", "radar.toml", "-f", "EKF"],
    ["export", "c", "radar.toml", "-f", "EKF"],
    ["compare", "growth", "-f", "EKF", "--runs", "2", "--particles", "0"],
]


@pytest.mark.parametrize("out", OUTS)
@pytest.mark.parametrize("command", RUNS, ids=lambda c: c[0])
def test_a_place_for_results_that_will_not_do_is_refused(
    command: list[str], out: str, radar: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (radar.parent / "full").mkdir()
    (radar.parent / "full" / "precious").write_text("mine")
    (radar.parent / "loop").symlink_to(radar.parent / "loop")
    status = cli(*command, "-o", out)
    told = capsys.readouterr()
    assert "Traceback" not in told.err
    # An export lays its files beside others.
    beside = command[0] == "export" and out == "full"
    assert status == (0 if beside else 2), told.out
    assert told.err.startswith("" if beside else "sigmax: ")
    assert (radar.parent / "full" / "precious").read_text() == "mine"
    assert not [p for p in radar.parent.iterdir() if p.suffix == ".part"]


@pytest.mark.parametrize("name", [NASTY.replace("/", "_"), "  ", "-x", "ends with dot.", "🛰"])
def test_names_of_any_kind_go_through(name: str, radar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of the record, its title, its tracks, its columns and its folder; nothing in a report becomes markup."""
    shutil.copy("radar.csv", f"{name}.csv")
    text = Path(f"{name}.csv").read_text().replace("A1", "<script>alert(2)</script>").replace("range_km", "<b>r")
    Path(f"{name}.csv").write_text(text)
    description = RADAR.replace('"radar.csv"', json.dumps(f"{name}.csv", ensure_ascii=False)).replace(
        "range_km", "<b>r"
    )
    description = description.replace("Two aircraft seen by a radar", "</title><script>alert(3)</script>[red]x[/]")
    Path(f"{name}.toml").write_text(description)
    assert cli("track", "--out", f"{name} out", "--", f"{name}.toml") == 0
    told = capsys.readouterr()
    assert "[red]x[/]" in told.out
    page = Path(f"{name} out", "report.html").read_text()
    for number in (1, 2, 3):
        assert f"<script>alert({number})" not in page
    assert "&lt;script&gt;alert(2)" in page


@pytest.mark.skipif(os.geteuid() == 0 and not shutil.which("setpriv"), reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    write_radar(tmp_path)
    for place in (tmp_path, *list(tmp_path.parents)[:2]):
        place.chmod(0o755)
    drop = ["setpriv", "--reuid=54321", "--clear-groups", "--regid=54321"] if os.geteuid() == 0 else []
    if not drop:
        tmp_path.chmod(0o555)
    command = [*drop, sys.executable, "-m", "sigmax.cli", "track", "radar.toml", "-f", "EKF"]
    probe = subprocess.run(
        [*drop, sys.executable, "-c", "import sigmax"], cwd=tmp_path, capture_output=True, check=False
    )
    if probe.returncode:
        pytest.skip("another user cannot read this installation")
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    tmp_path.chmod(0o755)
    assert done.returncode == 2
    assert "give --out another folder" in done.stderr
    assert "Traceback" not in done.stderr


def full_disk(folder: Path, size: int) -> bool:
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.mark.parametrize("command", RUNS[:2], ids=lambda c: c[0])
def test_a_full_disk_is_told_and_nothing_half_written_stays(
    command: list[str], radar: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    disk = radar.parent / "disk"
    if not full_disk(disk, 16384):
        pytest.skip("no small file system can be mounted here")
    try:
        assert cli(*command, "-o", str(disk / "out")) == 2
        assert "No space left" in capsys.readouterr().err
        assert list(disk.iterdir()) == []
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_table_of_nothing_but_holes_is_refused(radar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    n = 20
    columns = {"t": list(np.arange(n)), "aircraft": ["A"] * n} | dict.fromkeys(("north_km", "east_km"), [1.0] * n)
    columns |= dict.fromkeys(("range_km", "azimuth_deg"), [np.nan] * n)
    write_csv(radar.parent / "radar.csv", columns)
    assert cli("track", "radar.toml") == 2
    assert "no whole measurement" in capsys.readouterr().err

"""Nothing is executed or loaded that a description, or another user, could have slipped in."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from sigmax.errors import InputError
from sigmax.ownership import stranger
from sigmax.records import load
from sigmax.serving import Checkpoint
from tests.own_records import RADAR, write_radar
from tests.test_cli import cli

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another user")
CODE = """import pathlib
pathlib.Path(__file__).with_name("ran").touch()
import numpy as np, sigmax

def noise(x):
    return np.array([900.0, 1e-5]) + 0 * x[0]

def motion(x, dt):
    return x

def make():
    model = sigmax.Model(motion=lambda x, dt: x, sensor=lambda x: x, Q=[0.01], R=[0.1])
    return model, sigmax.Gaussian([1.0], [[1.0]])
"""
PLOTS = """
[tracking]
max_speed = "300 m/s"
[tracking.sensors.radar]
detection = 0.9
clutter = 1e-7
"""


def naming(reference: str, folder: Path) -> Path:
    """A record whose noise is a function."""
    prior = 'north = { mean = "6 km", std = "5 km" }\neast = { mean = "2 km", std = "5 km" }'
    text = RADAR.replace('{ range = "30 m", azimuth = "0.2 deg" }', f"{reference!r}")
    folder.mkdir(exist_ok=True)
    return write_radar(folder, text.replace('position_from = "radar"', prior))


def by_link(home: Path, other: Path) -> str:
    (home / "linked.py").symlink_to(other / "mine.py")
    return "linked.py:noise"


def by_linked_folder(home: Path, other: Path) -> str:
    (home / "below").symlink_to(other)
    return "below/mine.py:noise"


WAYS: dict[str, Callable[[Path, Path], str]] = {
    "above": lambda home, other: "../other/mine.py:noise",
    "absolute": lambda home, other: f"{other / 'mine.py'}:noise",
    "a link": by_link,
    "a linked folder": by_linked_folder,
    "there and back": lambda home, other: "../home/../other/mine.py:noise",
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.one_in(2)
def test_a_description_runs_no_file_from_elsewhere(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not by any command that reads it; only where the place is named on the command line."""
    monkeypatch.chdir(tmp_path)
    home, other = tmp_path / "home", tmp_path / "other"
    for folder in (home, other):
        folder.mkdir()
    (other / "mine.py").write_text(CODE)
    path = str(naming(WAYS[way](home, other), home))
    (home / "plots.toml").write_text((home / "radar.toml").read_text().replace('track = "aircraft"\n', "") + PLOTS)
    plots = str(home / "plots.toml")
    (home / "study.toml").write_text(f"model = {WAYS['absolute'](home, other).replace('noise', 'make')!r}\n")
    (tmp_path / "further.toml").write_text('model = "home/radar.toml"\n')
    for arguments in (
        ["track", path], ["explain", path], ["export", "c", path], ["track", plots], ["serve", plots],
        ["compare", str(home / "study.toml"), "--runs", "2"], ["compare", "further.toml", "--runs", "2"],
    ):  # fmt: skip
        assert cli(*arguments) == 2, arguments
        told = capsys.readouterr().err
        assert "lies outside of" in told, told
        assert f"--allow {other}" in told
        assert not list(tmp_path.rglob("ran"))
    assert cli("--allow", str(other), "track", path, "-f", "EKF", "-o", "out") == 0
    assert (other / "ran").exists() or (home / "ran").exists()
    # What was allowed once is not allowed afterwards.
    assert cli("track", path) == 2


def test_a_description_of_a_description_elsewhere_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = naming("mine.py:noise", tmp_path / "other")
    (tmp_path / "other" / "mine.py").write_text(CODE)
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "study.toml").write_text(f'model = "../other/{path.name}"\n')
    assert cli("compare", str(tmp_path / "home" / "study.toml"), "--runs", "2") == 2
    assert "lies outside of" in capsys.readouterr().err


def test_files_beside_and_below_run_and_so_does_one_that_the_user_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    home = tmp_path / "home"
    (home / "below").mkdir(parents=True)
    for place in (home, home / "below", tmp_path):
        (place / "mine.py").write_text(CODE)
    load(str(naming("mine.py:noise", home)))
    load(str(naming("below/mine.py:noise", home)))
    # A description in a folder reached by a link lies where it really lies.
    (tmp_path / "short").symlink_to(home)
    load(str(tmp_path / "short" / "radar.toml"))
    monkeypatch.chdir(home)
    assert cli("export", "c", "../mine.py:make", "-f", "KF", "-o", "c") == 0


OPENED: dict[str, Callable[[Path], None]] = {
    "the file, to all": lambda home: (home / "mine.py").chmod(0o666),
    "the folder, to all": lambda home: home.chmod(0o777),
    "the folder above, to all": lambda home: home.parent.chmod(0o777),
    "the file, to others alone": lambda home: (home / "mine.py").chmod(0o646),
}
GIVEN: dict[str, Callable[[Path], None]] = {
    "the file": lambda home: os.chown(home / "mine.py", 54321, -1),
    "the folder": lambda home: os.chown(home, 54321, -1),
    "the folder above": lambda home: os.chown(home.parent, 54321, -1),
    "a group": lambda home: to_group(home / "mine.py"),
}


def to_group(path: Path) -> None:
    os.chown(path, -1, 54321)
    path.chmod(0o664)


def refused_and_allowed(home: Path, spoil: Callable[[Path], None], capsys: pytest.CaptureFixture[str]) -> None:
    (home / "mine.py").write_text(CODE)
    path = str(naming("mine.py:noise", home))
    spoil(home)
    for arguments in (["track", path], ["explain", f"{home}/mine.py:make"], ["compare", f"{home}/mine.py:make"]):
        assert cli(*arguments) == 2
        told = capsys.readouterr().err
        assert "is not run" in told, told
        assert not (home / "ran").exists()
    assert cli("--allow", str(home), "track", path, "-f", "EKF", "-o", str(home / "out")) == 0
    assert (home / "ran").exists()


@pytest.mark.parametrize("case", OPENED)
def test_a_file_that_others_can_write_is_not_run(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = tmp_path / "above" / "home"
    home.mkdir(parents=True)
    refused_and_allowed(home, OPENED[case], capsys)


@needs_root
@pytest.mark.parametrize("case", GIVEN)
def test_a_file_of_another_user_is_not_run(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = tmp_path / "above" / "home"
    home.mkdir(parents=True)
    refused_and_allowed(home, GIVEN[case], capsys)


def test_what_lies_compiled_beside_a_file_is_not_run(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CODE)
    cached = tmp_path / "__pycache__"
    cached.mkdir(mode=0o777)
    import importlib.util
    import py_compile

    (tmp_path / "evil.py").write_text("raise SystemError('the compiled one ran')\n" + "#" * (len(CODE) - 46))
    os.utime(tmp_path / "evil.py", (1e9, 1e9))
    os.utime(tmp_path / "mine.py", (1e9, 1e9))
    compiled = importlib.util.cache_from_source(str(tmp_path / "mine.py"))
    py_compile.compile(str(tmp_path / "evil.py"), cfile=compiled)
    load(str(naming("mine.py:noise", tmp_path)))


def test_a_sticky_folder_above_is_no_stranger_but_one_to_read_from_is(tmp_path: Path) -> None:
    folder = tmp_path / "open"
    folder.mkdir()
    folder.chmod(0o1777)
    (folder / "mine.py").write_text(CODE)
    assert stranger(folder / "mine.py") == ""
    assert "can be written by every user" in stranger(folder)
    (folder / "link").symlink_to(folder / "mine.py")
    assert stranger(folder / "link") == ""
    (folder / "mine.py").chmod(0o666)
    assert "mine.py can be written" in stranger(folder / "link")
    assert stranger(tmp_path / "not there" / "at all") == ""


def test_a_checkpoint_that_others_can_write_is_not_used(tmp_path: Path) -> None:
    kept = Checkpoint(tmp_path / "kept", "digest")
    kept.close()
    assert (tmp_path / "kept").stat().st_mode & 0o077 == 0
    (tmp_path / "kept" / "state-1").chmod(0o666)
    with pytest.raises(InputError, match="state-1 can be written by every user"):
        Checkpoint(tmp_path / "kept", "digest")
    (tmp_path / "kept" / "state-1").chmod(0o600)
    (tmp_path / "kept").chmod(0o1777)
    with pytest.raises(InputError, match="kept can be written by every user"):
        Checkpoint(tmp_path / "kept", "digest")
    (tmp_path / "kept").chmod(0o700)
    Checkpoint(tmp_path / "kept", "digest").close()

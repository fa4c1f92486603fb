"""However a command ends, it ends with one line and its own status, and nothing half done stays behind."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sigmax.errors import InputError
from sigmax.leftovers import clear_leftovers
from sigmax.reports.folder import check_folder
from sigmax.reports.replaced import replaced
from tests.own_records import RADAR, radar_table, write_csv, write_radar
from tests.test_cli import cli

needs_proc = pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="only Linux tells which signals are caught"
)
COMMANDS = {
    "track": ["track", "radar.toml"],
    "several": ["track", "radar.toml", "-f", "HCKF", "-f", "SRUKFB"],
    "explain": ["explain", "radar-ct"],
    "export": ["export", "c", "radar-ct"],
    "terrain": ["terrain"],
    "compare": ["compare", "growth", "--runs", "100000", "--workers", "2"],
    "filters": ["filters"],
    "models": ["models"],
}


def started(arguments: list[str], folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "sigmax.cli", *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "SIGMAX_CACHE": str(folder / "cache")},
        # A test that runs in the background would hand on that it ignores the signal.
        preexec_fn=lambda: [signal.signal(s, signal.SIG_DFL) for s in (signal.SIGINT, signal.SIGTERM)],
    )


def wait_until_it_listens(process: subprocess.Popen[str]) -> None:
    """Before our first line Python itself answers a signal; that SIGTERM is caught tells that it has been read."""
    while process.poll() is None:
        status = Path(f"/proc/{process.pid}/status").read_text()
        caught = int(re.search(r"SigCgt:\s*(\w+)", status)[1], 16)  # type: ignore[index]
        if caught >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.001)


def ended_by(number: signal.Signals, arguments: list[str], after: float, folder: Path) -> bool:
    """Whether a command was still at work when it was sent a signal after so many seconds; how it ended is checked."""
    process = started(arguments, folder)
    wait_until_it_listens(process)
    time.sleep(after)
    process.send_signal(number)
    _, told = process.communicate(timeout=120)
    if process.returncode == 0:
        return False
    word = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}[number]
    assert process.returncode == 128 + number, told
    assert re.fullmatch(rf"sigmax: {word}(; [^\n]*)?\n", told)
    return True


@needs_proc
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_with_one_line_and_nothing_left(number: signal.Signals, tmp_path: Path) -> None:
    """While packages are imported, while a step is traced and compiled."""
    write_radar(tmp_path)
    before = {p.name for p in tmp_path.iterdir()}
    heard = [ended_by(number, COMMANDS["several"], t, tmp_path) for t in (0.0, 0.6, 1.2, 2.0)]
    assert heard[0]
    assert {p.name for p in tmp_path.iterdir()} - before <= {"cache", "runs"}
    assert not list((tmp_path / "runs").glob(".*"))
    assert not list((tmp_path / "cache").glob("??/tmp*"))


@pytest.mark.slow
@needs_proc
@pytest.mark.parametrize("command", COMMANDS)
def test_a_signal_ends_any_command_at_any_moment(command: str, tmp_path: Path) -> None:
    write_radar(tmp_path)
    heard = 0
    for step in range(16):
        for number in (signal.SIGINT, signal.SIGTERM):
            heard += ended_by(number, COMMANDS[command], 0.2 * step, tmp_path)
    assert heard
    assert not [p for p in tmp_path.rglob(".*") if p.suffix in (".part", ".old")]


def dead() -> int:
    """The number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_what_a_killed_run_left_is_removed_by_the_next_and_nothing_else(tmp_path: Path) -> None:
    gone, alive = dead(), os.getppid()
    names = {
        f".results.{gone}.part": False,
        f".results.{alive}.part": True,
        f".other.{gone}.part": True,
        f".results.{gone}.part.txt": True,
        ".results.part": True,
        f".results.{gone}x.part": True,
    }
    for name in names:
        (tmp_path / name / "inside").mkdir(parents=True)
    (tmp_path / f".results.{gone + 1 if gone + 1 != alive else gone}.part").symlink_to(tmp_path / ".results.part")
    with replaced(tmp_path / "results") as part:
        (part / "file").touch()
    left = {p.name for p in tmp_path.iterdir() if not p.is_symlink()}
    assert left == {name for name, stays in names.items() if stays} | {"results"}
    assert (tmp_path / ".results.part" / "inside").is_dir()


def test_a_result_that_a_killed_run_had_set_aside_comes_back(tmp_path: Path) -> None:
    aside = tmp_path / f".results.{dead()}.old"
    aside.mkdir()
    (aside / "summary.json").write_text("{}")
    clear_leftovers(tmp_path / "results")
    assert (tmp_path / "results" / "summary.json").is_file()
    assert not aside.exists()


def test_a_study_killed_while_it_stored_goes_on(tmp_path: Path) -> None:
    """What it had begun to write in its own folder makes of it no folder of other things."""
    (tmp_path / "sums.npz").touch()
    (tmp_path / f".sums.npz.{dead()}.part").write_text("half")
    check_folder(tmp_path, ["sums.npz", "report.html"], "sums.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["sums.npz"]
    (tmp_path / f".sums.npz.{os.getppid()}.part").write_text("half")
    with pytest.raises(InputError, match="holds other things"):
        check_folder(tmp_path, ["sums.npz", "report.html"], "sums.npz")


def test_a_folder_that_another_process_holds_is_let_alone(tmp_path: Path) -> None:
    """One in a container of its own has a number that means nothing here."""
    part = tmp_path / f".results.{dead()}.part"
    part.mkdir()
    code = f"import fcntl, os, sys; fcntl.flock(os.open({str(part)!r}, 0), 2); print(); sys.stdin.read()"
    holder = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert holder.stdout is not None
    holder.stdout.readline()
    clear_leftovers(tmp_path / "results")
    assert part.is_dir()
    holder.communicate()
    clear_leftovers(tmp_path / "results")
    assert not part.exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_run_that_ends_while_it_writes_leaves_nothing_for_long(number: signal.Signals, tmp_path: Path) -> None:
    code = (
        "from pathlib import Path\n"
        "from sigmax.reports.replaced import replaced\n"
        "from sigmax.signals import ends_by_signal\n"
        "with ends_by_signal(), replaced(Path('results')) as part:\n"
        "    for i in range(10**9):\n"
        "        (part / f'{i % 1000}').write_text('x' * 1000)\n"
        "        if i == 100: print(flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(number)
    process.wait()
    process.stdout.close()
    if number == signal.SIGKILL:
        assert process.returncode == -number
        clear_leftovers(tmp_path / "results")
    else:
        assert process.returncode == 128 + number
    assert list(tmp_path.iterdir()) == []


# Sound where the run begins, or the run would be refused.
BROKEN = "import jax.numpy as jnp\ndef noise(x):\n    return jnp.where(x[0] == 6000.0, 1.0, -1.0) * jnp.ones(2)\n"


def test_a_run_in_which_every_correction_broke_down_is_no_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.py").write_text(BROKEN)
    description = RADAR.replace('{ range = "30 m", azimuth = "0.2 deg" }', '"broken.py:noise"').replace(
        'position_from = "radar"', 'north = { mean = "6 km", std = "5 km" }\neast = { mean = "2 km", std = "5 km" }'
    )
    write_radar(tmp_path, description.replace("vnorth = { mean = 0", "vnorth = { mean = 1"))
    table = radar_table()
    for first in (0, table["aircraft"].index("B2")):
        table["range_km"][first] = table["azimuth_deg"][first] = float("nan")
    write_csv(tmp_path / "radar.csv", table)
    assert cli("track", "radar.toml") == 1
    told = capsys.readouterr()
    assert "no filter gave a result" in told.err
    # What happened at which step can still be read.
    assert (tmp_path / "runs" / "radar" / "report.html").is_file()
    assert "runs/radar/report.html" in told.out.replace("\n", "")


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="could not be written"), replaced(tmp_path / "file" / "results"):
        pass


def test_a_fault_of_ours_is_called_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fails() -> None:
        raise ZeroDivisionError("no luck today")

    def too_large() -> None:
        raise MemoryError("300 GB")

    monkeypatch.setattr("sigmax.cli.lists.print_filters", fails)
    assert cli("filters") == 70
    told = capsys.readouterr().err
    assert "ZeroDivisionError: no luck today" in told
    assert "a fault of sigmax" in told
    monkeypatch.setattr("sigmax.cli.lists.print_filters", too_large)
    assert cli("filters") == 2
    assert capsys.readouterr().err == "sigmax: there is not enough memory (300 GB); split the data into parts\n"

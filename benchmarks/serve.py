"""The service: seconds from a scan sent to its update received, over TCP on loopback, with a checkpoint and without.

python benchmarks/serve.py
python benchmarks/serve.py --tracks 100 1000 10000 --scans 300
"""

import argparse
import json
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

TOML = """
data = "plots.csv"
time = "t"
filters = ["EKF"]

[motion]
kind = "constant_velocity"
axes = ["x", "y"]
noise = { density = "0.1 m^2/s^3" }

[sensors.radar]
kind = "position"
columns = { x = "x", y = "y" }
noise = { x = "10 m", y = "10 m" }

[tracking]
max_speed = "350 m/s"
associate = "jpda"
confirm = [2, 3]

[tracking.sensors.radar]
detection = 0.98
clutter = 1e-12
"""


def scans(n: int, count: int) -> list[bytes]:
    """A line for each scan of n targets on straight lines, 4 s apart."""
    rng = np.random.default_rng(1)
    size = 2000.0 * np.sqrt(n)
    x, v = rng.uniform(-size, size, (n, 2)), rng.uniform(-200, 200, (n, 2))
    lines = []
    for k in range(count):
        z = (x + 4 * k * v + 10 * rng.normal(size=(n, 2)))[rng.random(n) < 0.98].round(2)
        plots = [{"x": a, "y": b} for a, b in z.tolist()]
        lines.append(json.dumps({"t": 4.0 * k, "plots": plots}, separators=(",", ":")).encode() + b"\n")
    return lines


def connected(run: subprocess.Popen[bytes]) -> list[socket.socket]:
    assert run.stderr is not None
    for raw in run.stderr:
        text = raw.decode()
        if "plots from" in text:
            ports = [int(part.split(":")[1].split()[0].rstrip(",")) for part in text.split("tcp:")[1:]]
            return [socket.create_connection(("127.0.0.1", port)) for port in ports]
    raise SystemExit("the service did not start")


def measured(n: int, count: int, folder: Path, kept: bool) -> tuple[np.ndarray, int, int]:
    """Seconds for each scan, one at a time, the tracks in the last update, and the service's greatest memory, kB."""
    path = folder / "radar.toml"
    path.write_text(TOML)
    command = [sys.executable, "-m", "sigmax.cli", "serve", str(path), "--from", "tcp:0", "--to", "tcp:0"]
    command += ["--max-line", str(1 << 24), *(["--checkpoint", str(folder / f"state-{n}")] if kept else [])]
    run = subprocess.Popen(command, stderr=subprocess.PIPE)
    took: list[float] = []
    told: dict[str, Any] = {}
    try:
        plots, updates = connected(run)
        file = updates.makefile("rb")
        file.readline()
        for line in scans(n, count):
            started = time.perf_counter()
            plots.sendall(line)
            raw = file.readline()
            took.append(time.perf_counter() - started)
            told = json.loads(raw)
        status = Path(f"/proc/{run.pid}/status").read_text()
        memory = int(status.split("VmHWM:")[1].split()[0])
        run.send_signal(signal.SIGTERM)
        run.wait(60)
    finally:
        run.kill()
    return np.array(took[5:]), len(told["tracks"]), memory


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tracks", type=int, nargs="+", default=[100, 1000, 10000])
    parser.add_argument("--scans", type=int, default=300)
    given = parser.parse_args()
    print("| targets | checkpoint | confirmed tracks | median, ms | 99.9th percentile, ms | memory, MB | scans |")
    print("|---|---|---|---|---|---|---|")
    for n in given.tracks:
        for kept in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                took, tracks, memory = measured(n, given.scans + 5, Path(folder), kept)
            held = "yes" if kept else "no"
            middle, top = 1e3 * np.median(took), 1e3 * np.quantile(took, 0.999, method="higher")
            print(
                f"| {n} | {held} | {tracks} | {middle:.1f} | {top:.1f} | {memory // 1024} | {len(took)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

"""What the memory cannot take is refused before it is taken."""

import gzip
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from sigmax.errors import InputError
from sigmax.files import memory
from sigmax.files.read_table import read_table
from tests.own_records import write_radar

GIB = 1 << 30


def many_rows(path: Path, rows: int, at_a_time: int = 1_000_000) -> None:
    """A table of positions of which the file is small."""
    schema = pa.schema([("t", pa.float64()), ("x", pa.float64()), ("y", pa.float64()), ("id", pa.int32())])
    still = np.zeros(at_a_time)
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for k in range(rows // at_a_time):
            columns = [pa.array(still + k), pa.array(still), pa.array(still), pa.array(np.zeros(at_a_time, np.int32))]
            writer.write_table(pa.table(columns, schema=schema))


@pytest.mark.parametrize("form", ["parquet", "csv", "csv.gz"])
def test_a_file_too_large_is_refused_before_it_is_read(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"d.{form}"
    if form == "parquet":
        many_rows(path, 20_000, 10_000)
    else:
        text = b"t,x,y\n" + b"1,2,3\n" * 20_000
        path.write_bytes(gzip.compress(text, 0) if form == "csv.gz" else text)
    assert len(read_table(path)) == 20_000
    monkeypatch.setattr(memory, "memory_left", lambda: 100e3)
    monkeypatch.setattr("pyarrow.parquet.read_table", lambda *_: pytest.fail("it was read"))
    monkeypatch.setattr("pyarrow.csv.read_csv", lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(InputError, match=rf"d.{form} has .* GB of memory would be needed, 0.0 GB are left; split it"):
        read_table(path)


def test_the_limit_of_the_process_counts() -> None:
    code = (
        "import resource; from sigmax.files.memory import memory_left\n"
        "resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30)); print(memory_left())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 0 < float(done.stdout) < 6 * GIB
    assert 0 < memory.memory_left() < 1 << 50


@pytest.mark.slow
def test_two_hundred_million_rows_under_twelve_gigabytes_are_words(tmp_path: Path) -> None:
    path = write_radar(tmp_path)
    many_rows(tmp_path / "many.parquet", 200_000_000)
    (tmp_path / "many.toml").write_text(
        'data = "many.parquet"\ntime = "t"\n[motion]\nkind = "constant_velocity"\nnoise = { density = 1 }\n'
        '[sensors.gps]\nkind = "position"\ncolumns = { x = "x", y = "y" }\nnoise = { x = 1, y = 1 }\n'
        '[prior]\nposition_from = "gps"\nvx = { mean = 0, std = 1 }\nvy = { mean = 0, std = 1 }\n'
    )
    for given in ("many.toml", "many.parquet"):
        done = subprocess.run(
            [sys.executable, "-m", "sigmax.cli", "track", given],
            cwd=path.parent,
            capture_output=True,
            text=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (12 * GIB, 12 * GIB)),
            check=False,
        )
        assert done.returncode == 2, done.stderr[-2000:]
        assert "200,000,000 rows" in done.stderr
        assert done.stderr.count("\n") == 1

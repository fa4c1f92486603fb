"""Whatever is written in a description is taken or refused in words; nothing else happens."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sigmax.errors import InputError
from sigmax.records import check, load, load_plots
from sigmax.serving import Feed
from sigmax.studies import load_studies
from tests.own_records import RADAR, radar_table, write_csv
from tests.toml_values import document, neighbours

PLOTS = RADAR.replace('track = "aircraft"\n', "").replace("[prior]\n", "").replace('position_from = "radar"\n', "")
PLOTS = (
    PLOTS.replace('vnorth = { mean = 0, std = "360 km/h" }\nveast = { mean = 0, std = "100 m/s" }\n', "")
    + """
[tracking]
max_speed = "300 m/s"
within = "10 s"
associate = "jpda"
confirm = [3, 5]
coast = "10 s"
late = "1 s"
extent = ["1 m", "2 m"]
cutoff = "500 m"

[tracking.sensors.radar]
detection = 0.9
clutter = 1e-7
scan = "2 s"

[tracking.truth]
data = "radar.csv"
target = "aircraft"
time = { column = "t", unit = "s" }
"""
)
ROVER = """
title = "A rover"
data = "rover.csv"
time = { column = "t", unit = "ms", format = "" }
decimal = "."
sort = true
position = ["x", "y"]
filters = ["EKF", "EKF:fixed=scale"]
source = "a test"
licence = "none"

[[motion]]
kind = "unicycle"
noise = { position = "5 cm", heading = "1 deg" }
inputs = { speed = "v", turn_rate = { column = "w", unit = "deg/s" } }

[[motion]]
kind = "random_walk"
state = { scale = "1" }
noise = { scale = 0 }

[sensors.radio]
kind = "range_only"
scale = "scale"
at = ["x", "y"]
columns = { range = { column = "r", unit = "m", missing = [-1, -2] } }
noise = [[0.09]]
inputs = { beacon_x = "bx", beacon_y = "by" }

[sensors.fixed]
kind = "range_only"
origin = [1, "2 m"]
columns = { range = "r" }
noise = { range = "30 cm" }

[bias.offset]
offset = { radio = "range" }
std = "1 m"
mean = 0
noise = "1 mm"

[bias.current]
drift = "x"
std = 0.1

[prior]
x = { mean = 20, std = "1 m" }
y = { mean = 10, std = "1 m" }
heading = { mean = 0.5, std = "5 deg" }
scale = { mean = 1, std = "10 %" }
"""
SHIPS = """
data = "ships.csv"
time = { column = "time", format = "%d/%m/%Y %H:%M:%S" }
track = "MMSI"
filters = ["EKF"]

[motion]
kind = "singer"
axes = ["east", "north"]
tau = "20 s"
noise = { acceleration = "1 m/s^2" }

[local]
latitude = { column = "lat", unit = "deg", missing = 91 }
longitude = { column = "lon", unit = "deg" }
origin = ["37.8 deg", "-122.4 deg"]
within = "100 km"
speed = { column = "sog", unit = "kn" }
course = { column = "cog", unit = "deg" }

[sensors.report]
kind = "position"
columns = { east = "local.east", north = "local.north" }
noise = { east = "10 m", north = "10 m" }

[sensors.velocity]
kind = "velocity"
columns = { veast = "local.velocity_east", vnorth = "local.velocity_north" }
noise = { veast = "1 m/s", vnorth = "1 m/s" }

[prior]
position_from = "report"
veast = { mean = 0, std = "10 m/s" }
vnorth = { mean = 0, std = "10 m/s" }
aeast = { mean = 0, std = 1 }
anorth = { mean = 0, std = 1 }
"""
STUDY = """
model = "radar-ct"
steps = 20
dt = 1.0
runs = 10
title = "A study"
filters = ["EKF"]
truth = "driven"
start = [200e3, 100e3, 100.0, 0.8, 0.0]
estimate = "prior"
detection = 0.9
look = [1, 5]
particles = 0
"""


def rover_table(folder: Path) -> None:
    t = np.arange(10.0)
    columns = {"t": t * 100, "v": 0 * t + 2, "w": 0 * t + 3, "r": 30 + t, "bx": 0 * t, "by": 0 * t + 5}
    write_csv(folder / "rover.csv", {name: list(values) for name, values in columns.items()})


def ships_table(folder: Path) -> None:
    rows = [f"01/05/2024 12:00:{k:02d},{k % 2},{37.8 + k / 1e4},{-122.4 - k / 1e4},5,90" for k in range(12)]
    (folder / "ships.csv").write_text("time,MMSI,lat,lon,sog,cog\n" + "\n".join(rows) + "\n")


def radar_csv(folder: Path) -> None:
    write_csv(folder / "radar.csv", radar_table())


SOURCES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "radar": (RADAR, radar_csv),
    "rover": (ROVER, rover_table),
    "ships": (SHIPS, ships_table),
    "plots": (PLOTS, radar_csv),
    "feed": (PLOTS, radar_csv),
    "study": (STUDY, lambda folder: None),
}


def taken(kind: str, path: Path) -> None:
    """All that is asked of a description before anything runs."""
    if kind == "study":
        load_studies(str(path), {})
    elif kind == "feed":
        Feed(path)
    elif (plots := load_plots(str(path))) is None:
        record = load(str(path))
        check(record, record.trials)
    else:
        assert plots.scans


@pytest.mark.parametrize("kind", SOURCES)
def test_the_descriptions_that_are_changed_are_taken(kind: str, tmp_path: Path) -> None:
    text, prepare = SOURCES[kind]
    prepare(tmp_path)
    (tmp_path / "d.toml").write_text(text)
    taken(kind, tmp_path / "d.toml")


def check_neighbours(kind: str, folder: Path, most: int | None) -> None:
    text, prepare = SOURCES[kind]
    prepare(folder)
    others = list(neighbours(tomllib.loads(text)))
    rng = np.random.default_rng(len(others))
    for i in range(len(others)) if most is None else rng.choice(len(others), most, replace=False):
        what, other = others[i]
        (folder / "d.toml").write_text(document(other), encoding="utf-8")
        try:
            taken(kind, folder / "d.toml")
        except InputError:
            continue
        except Exception as error:
            raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error


@pytest.mark.parametrize("kind", SOURCES)
@pytest.mark.one_in(2)
def test_a_description_with_one_other_value_is_taken_or_refused_in_words(kind: str, tmp_path: Path) -> None:
    check_neighbours(kind, tmp_path, 150)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SOURCES)
def test_any_description_with_one_other_value_is_taken_or_refused_in_words(kind: str, tmp_path: Path) -> None:
    check_neighbours(kind, tmp_path, None)


@pytest.mark.parametrize("kind", ["radar", "rover", "study"])
def test_a_key_that_is_misspelt_is_refused_with_the_right_one(kind: str, tmp_path: Path) -> None:
    """Two letters exchanged in the keys that stand at the top."""
    text, prepare = SOURCES[kind]
    prepare(tmp_path)
    table = tomllib.loads(text)
    for key in table:
        wrong = key[:-2] + key[-1] + key[-2]
        if wrong == key:
            continue
        (tmp_path / "d.toml").write_text(document({wrong if k == key else k: v for k, v in table.items()}))
        with pytest.raises(InputError, match=f"unknown key '{wrong}'; did you mean {key}|needs the key '{key}'"):
            taken(kind, tmp_path / "d.toml")

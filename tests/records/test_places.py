"""Places on the Earth as metres of a record and back, in every frame, judged by PROJ; results come back in them."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyproj
import pytest

from sigmax.errors import InputError
from sigmax.records import load, parse_trial, track
from sigmax.reports.figures import path_figure
from tests.test_cli import cli

ORIGIN = (47.45, 8.55, 400.0)
T = np.arange(0.0, 60.0, 5.0)


def flight() -> pd.DataFrame:
    """A climb to the north-east, on the ellipsoid by PROJ's geodesics."""
    rows, lat, lon = [], 47.5, 8.6
    for t in T:
        rows.append((t, lat, lon, 1000.0 + 8 * t, 120.0, 40.0 + 0.2 * t))
        lon, lat, _ = pyproj.Geod(ellps="WGS84").fwd(lon, lat, 40.5 + 0.2 * t, 120.0 * 5)
    return pd.DataFrame(rows, columns=["t", "lat", "lon", "h", "gs", "trk"])


def description(axes: list[str], local: str, third: str = "", velocity: bool = False) -> str:
    columns = {"east": "local.east", "north": "local.north", axes[-1]: third} if third else {}
    columns = columns or {"east": "local.east", "north": "local.north"}
    shown = ", ".join(f'{a} = "{c}"' for a, c in columns.items())
    noise = ", ".join(f"{a} = 0.001" for a in columns)
    speeds = "\n".join(f"v{a} = {{ mean = 0, std = 200 }}" for a in axes)
    more = (
        '[sensors.velocity]\nkind = "velocity"\nat = ["veast", "vnorth"]\n'
        'columns = { veast = "local.velocity_east", vnorth = "local.velocity_north" }\n'
        "noise = { veast = 1, vnorth = 1 }\n"
    )
    return (
        'data = "f.csv"\ntime = "t"\nfilters = ["EKF"]\n[motion]\nkind = "constant_velocity"\n'
        f"axes = {json.dumps(axes)}\n"
        f'noise = {{ density = 1000 }}\n[local]\nlatitude = {{ column = "lat", unit = "deg" }}\n'
        f'longitude = {{ column = "lon", unit = "deg" }}\n{local}\n[sensors.gps]\nkind = "position"\n'
        f"columns = {{ {shown} }}\nnoise = {{ {noise} }}\n{more if velocity else ''}"
        f'[prior]\nposition_from = "gps"\n{speeds}\n'
    )


def topocentric(f: pd.DataFrame, height: bool) -> np.ndarray:
    pipeline = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lat_0={ORIGIN[0]} +lon_0={ORIGIN[1]} +h_0={ORIGIN[2] if height else 0}"
    )
    return np.column_stack(pipeline.transform(f.lon, f.lat, f.h if height else 0 * f.h))


def utm(f: pd.DataFrame) -> np.ndarray:
    return np.column_stack([*pyproj.Transformer.from_crs(4326, 32632, always_xy=True).transform(f.lon, f.lat), f.h])


HEIGHT = 'height = "h"\norigin = ["47.45 deg", "8.55 deg", "400 m"]'
FRAMES = {
    "plane": (["east", "north"], 'origin = ["47.45 deg", "8.55 deg"]', "", lambda f: topocentric(f, False)[:, :2]),
    "east, north, up": (["east", "north", "up"], HEIGHT, "local.up", lambda f: topocentric(f, True)),
    "north, east, down": (
        ["north", "east", "down"], HEIGHT, "local.down", lambda f: topocentric(f, True)[:, [1, 0, 2]] * [1, 1, -1]
    ),
    "utm": (["east", "north"], 'frame = "utm"', "", lambda f: utm(f)[:, :2]),
    "utm with heights": (["east", "north", "up"], 'frame = "utm"\nheight = "h"', "local.up", utm),
}  # fmt: skip


@pytest.mark.parametrize("name", FRAMES)
def test_metres_are_those_of_proj_and_back(name: str, tmp_path: Path) -> None:
    axes, local, third, judge = FRAMES[name]
    f = flight()
    f.to_csv(tmp_path / "f.csv", index=False)
    (tmp_path / "d.toml").write_text(description(axes, local, third))
    record = load(str(tmp_path / "d.toml"))
    z = record.z["gps"][0].copy()
    order = [record.model.measurement["gps"].index(a) for a in axes]
    np.testing.assert_allclose(z[1:, order], judge(f)[1:], atol=1e-5)
    np.testing.assert_allclose(record.prior.mean[0, : len(axes)], judge(f)[0], atol=1e-5)
    assert record.placed is not None
    state = np.zeros((len(f) - 1, record.model.dim))
    state[:, [record.model.state.index(a) for a in axes]] = z[1:, order]
    back = record.placed.columns(state)
    for column, degrees in (("latitude", f.lat), ("longitude", f.lon)):
        np.testing.assert_allclose(back[column][0], degrees[1:], atol=1e-9)
    assert ("zone 32N" in record.placed.frame.name) == ("utm" in name)
    assert np.isnan(record.placed.columns(1e9 + state)["latitude"][0]).all() or "utm" in name


def test_results_come_back_in_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the terminal, in the table, in the summary and on the map, which has north above."""
    monkeypatch.chdir(tmp_path)
    f = flight()
    f.to_csv("f.csv", index=False)
    axes, local, third, _ = FRAMES["north, east, down"]
    Path("d.toml").write_text(description(axes, local, third))
    assert cli("track", "d.toml", "--out", "out") == 0
    assert f"of 1: {f.lat.iloc[-1]:.5f}" in capsys.readouterr().out.replace("\n", " ")
    found = pd.read_parquet("out/estimates.parquet")
    np.testing.assert_allclose(found[["latitude", "longitude"]], f[["lat", "lon"]], atol=1e-7)
    np.testing.assert_allclose(found.height, f.h, atol=0.01)
    frame = json.loads(Path("out/summary.json").read_text())["frame"]
    assert frame["origin"] == pytest.approx(ORIGIN)
    figure = path_figure(load("d.toml"), [(0, "EKF", track(load("d.toml"), parse_trial("EKF")))], 0, [])
    assert figure is not None
    drawn = next(d for d in figure["data"] if d["name"] == "EKF")
    assert drawn["text"][-1].startswith(f"{f.lat.iloc[-1]:.5f}")
    assert "east" in figure["layout"]["xaxis"]["title"]["text"]
    assert figure["layout"]["yaxis"]["scaleanchor"] == "x"


def test_a_velocity_on_the_grid_is_the_change_of_positions_there(tmp_path: Path) -> None:
    f = flight()
    f.to_csv(tmp_path / "f.csv", index=False)
    local = 'frame = "utm"\nspeed = "gs"\ncourse = { column = "trk", unit = "deg" }'
    (tmp_path / "d.toml").write_text(description(["east", "north"], local, velocity=True))
    record = load(str(tmp_path / "d.toml"))
    z, v = record.z["gps"][0], record.z["velocity"][0]
    np.testing.assert_allclose((z[3:] - z[1:-2]) / 10, v[2:-1], atol=0.02)
    # North of the grid is not true north there, and a metre not a metre.
    assert abs(pyproj.Proj(proj="utm", zone=32).get_factors(8.6, 47.5).meridian_convergence) > 0.2


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    flight().to_csv(tmp_path / "f.csv", index=False)
    for axes, local, third, words in (
        (["east", "north"], HEIGHT, "", "measures neither local.up nor local.down"),
        (["east", "north"], 'frame = "mercator"', "", '"plane" or "utm"; it is \'mercator\''),
        (["east", "north", "up"], 'origin = ["47.45 deg", "8.55 deg"]', "local.up", "column 'local.up'"),
    ):
        (tmp_path / "d.toml").write_text(description(axes, local, third))
        with pytest.raises(InputError, match=words):
            load(str(tmp_path / "d.toml"))

"""The built-in runs: what is known of them, and the contrast they show."""

import numpy as np
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.records import load, parse_trial, track


@pytest.fixture(scope="session", params=[1, 2])
def plaza(request: pytest.FixtureRequest) -> tuple[int, sigmax.records.Record]:
    pytest.importorskip("scipy")
    try:
        return request.param, load(f"plaza{request.param}")
    except InputError as error:
        pytest.skip(str(error))


def test_plaza_as_it_is_known(plaza: tuple[int, sigmax.records.Record]) -> None:
    """Ranges about 7 % too long at every beacon; odometry that agrees with the heading of the truth."""
    _, record = plaza
    heard = ~np.isnan(record.z[0, :, 0])
    beacons = record.inputs[0, heard, 2:]
    ratio = record.z[0, heard, 0] / np.linalg.norm(record.truth[0, heard, :2] - beacons, axis=1)
    assert len(record.landmarks) == 4
    for place in record.landmarks.values():
        assert np.median(ratio[(beacons == place).all(1)]) == pytest.approx(1.07, abs=0.015)
    x, y, heading = record.truth[0, :, :3].T
    # The way along the heading, over a second or so, is what odometry says it is.
    stride = 20
    along = np.diff(x[::stride]) * np.cos(heading[:-stride:stride]) + np.diff(y[::stride]) * np.sin(
        heading[:-stride:stride]
    )
    driven = np.diff(np.cumsum(record.inputs[0, :, 0] * record.dt[0])[::stride])
    assert np.corrcoef(along, driven[: len(along)])[0, 1] > 0.95
    assert (record.dt >= 0).all()
    assert record.time[0, -1] == pytest.approx(record.dt.sum())


def test_plaza_with_the_scale_as_a_state_and_without(plaza: tuple[int, sigmax.records.Record]) -> None:
    run, record = plaza
    scores = {}
    for name in ("EKF", "EKF:fixed=range_scale"):
        outcome = track(record, parse_trial(name))
        assert outcome.failure == ""
        assert outcome.result.ok.all()
        scores[name] = sigmax.reports.score(record, outcome)
    found, fixed = scores.values()
    assert found.rmse_position_m <= {1: 0.35, 2: 0.45}[run]
    assert found.mean_nis == pytest.approx(1.0, abs=0.1)
    assert found.constants["range_scale"][0] == pytest.approx(1.070, abs=0.002)
    assert fixed.rmse_position_m > 3
    assert fixed.mean_nis > 10
    assert fixed.constants["range_scale"] == (1.0, 0.0)


def test_plaza_without_its_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'sigmax\[plaza\]'"):
        load("plaza1")

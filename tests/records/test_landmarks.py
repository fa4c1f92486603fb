"""Landmarks by their names are those whose places stand in each row."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sigmax.errors import InputError
from sigmax.records import load

TEXT = """
data = "d.csv"
time = "t"
filters = ["EKF"]
[motion]
kind = "unicycle"
noise = { position = 0.1, heading = 0.1 }
inputs = { speed = "v", turn_rate = "w" }
[sensors.radio]
kind = "range_only"
columns = { range = "r" }
noise = { range = 1 }
SEEN
[prior]
x = { mean = 0, std = 1 }
y = { mean = 0, std = 1 }
heading = { mean = 0, std = 1 }
"""
BY_NAME = (
    'landmark = "who"\n[landmarks]\ndata = "anchors.csv"\nid = "name"\nx = "px"\ny = { column = "py", unit = "km" }\n'
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(1)
    anchors = pd.DataFrame({"name": ["7", "A 2", "x"], "px": [1.0, 5.0, -3.0], "py": [0.002, 0.001, 0.0]})
    anchors.to_csv(tmp_path / "anchors.csv", index=False)
    who = ["7", "x", None, "A 2", " 7"]
    data = pd.DataFrame({"t": np.arange(5.0), "v": 1.0, "w": 0.1, "r": rng.random(5), "who": who})
    data.loc[2, "r"] = np.nan
    at = anchors.set_index("name").reindex([None if w is None else w.strip() for w in who])
    data["bx"], data["by"] = at.px.to_numpy(), at.py.to_numpy() * 1e3
    data.to_csv(tmp_path / "d.csv", index=False)
    return tmp_path


def test_landmarks_by_name_are_those_of_the_rows(folder: Path) -> None:
    (folder / "name.toml").write_text(TEXT.replace("SEEN", BY_NAME))
    (folder / "row.toml").write_text(TEXT.replace("SEEN", 'inputs = { beacon_x = "bx", beacon_y = "by" }'))
    by_name, by_row = load(str(folder / "name.toml")), load(str(folder / "row.toml"))
    np.testing.assert_array_equal(by_name.inputs, by_row.inputs)
    assert dict(by_name.landmarks) == {"7": (1.0, 2.0), "A 2": (5.0, 1.0), "x": (-3.0, 0.0)}


WRONG = {
    "unknown": (lambda s: s, lambda d: d.replace("\nx,", "\ny,"), "row 3: unknown landmark 'x'"),
    "twice": (lambda s: s, lambda d: d + "7,1,1\n", "'7' has two rows"),
    "nowhere": (lambda s: s, lambda d: d + "8,,1\n", "'8' has no place"),
    "no table": (lambda s: s[: s.index("[landmarks]")] + s[s.index("[prior]") :], lambda d: d, r"table \[landmarks\]"),
    "of a compass": (lambda s: s.replace('"range_only"', '"bearing"'), lambda d: d, "bearing sees no landmarks"),
    "places twice": (
        lambda s: s.replace('landmark = "who"', 'landmark = "who"\norigin = [0, 0]'), lambda d: d, "drop the inputs"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_does_not_fit_is_refused(case: str, folder: Path) -> None:
    text, data, words = WRONG[case]
    anchors = folder / "anchors.csv"
    anchors.write_text(data(anchors.read_text()))
    (folder / "d.toml").write_text(text(TEXT.replace("SEEN", BY_NAME)))
    with pytest.raises(InputError, match=words):
        load(str(folder / "d.toml"))

"""HDF5, and the files of MATLAB since 7.3, by h5py."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd

from sigmax.logs.read import Log

# A dataset with more columns than that is no table.
_WIDEST = 64


def tables(path: Path) -> Log:
    """A table for each dataset with named fields, and for each group of the datasets in it that are equally long.

    A dataset of several columns becomes `name_0`, `name_1` and so on. Those of another length than most of their group
    are tables of their own.
    """
    found: dict[str, pd.DataFrame] = {}
    with h5py.File(path, "r") as file:
        _group(file, "", found)
    return Log(found)


def _group(group: Any, path: str, found: dict[str, pd.DataFrame]) -> None:
    by_length: dict[int, dict[str, np.ndarray]] = {}
    for name, one in group.items():
        where = f"{path}/{name}" if path else name
        if isinstance(one, h5py.Group):
            if not name.startswith("#"):
                _group(one, where, found)
        elif one.dtype.names:
            fields = one[...].ravel()
            found[where] = pd.DataFrame({f: _plain(fields[f]) for f in one.dtype.names if fields[f].ndim == 1})
        elif one.ndim in (1, 2) and one.dtype.kind in "biufSO":
            values = one[...]
            # MATLAB writes its columns as rows.
            if values.ndim == 2 and values.shape[0] < values.shape[1] and "MATLAB_class" in one.attrs:
                values = values.T
            columns = values[:, None] if values.ndim == 1 else values
            if columns.shape[1] == 1:
                by_length.setdefault(len(columns), {})[name] = _plain(columns[:, 0])
            elif columns.shape[1] <= _WIDEST:
                more = {f"{name}_{k}": _plain(columns[:, k]) for k in range(columns.shape[1])}
                by_length.setdefault(len(columns), {}).update(more)
    for k, length in enumerate(sorted(by_length, key=lambda n: -len(by_length[n]))):
        found[(path or "/") if not k else f"{path}/{length}"] = pd.DataFrame(by_length[length])


def _plain(values: np.ndarray) -> np.ndarray:
    """Texts as texts."""
    if values.dtype.kind in "SO":
        return np.array([v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in values], object)
    return values

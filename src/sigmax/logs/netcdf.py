"""NetCDF, by xarray: version 4 with h5netcdf, the classic one with SciPy."""

from pathlib import Path

import h5py
import pandas as pd
import xarray

from sigmax.logs.read import Log


def tables(path: Path) -> Log:
    """A table for each set of dimensions, named by them, with their coordinates as columns; times are dates."""
    with path.open("rb") as file:
        classic = file.read(3) == b"CDF"
    if not classic:
        # h5netcdf leaves a file that is none half open.
        h5py.File(path, "r").close()
    with xarray.open_dataset(path, engine="scipy" if classic else "h5netcdf") as dataset:
        by_dimensions: dict[tuple[str, ...], list[str]] = {}
        for name, variable in dataset.variables.items():
            if variable.ndim and name not in dataset.dims:
                by_dimensions.setdefault(tuple(map(str, variable.dims)), []).append(str(name))
        found = {}
        for dimensions, names in by_dimensions.items():
            rows = dataset[names].reset_coords().to_dataframe().reset_index()
            found[",".join(dimensions)] = _texts(rows)
    return Log(found)


def _texts(table: pd.DataFrame) -> pd.DataFrame:
    for name in table.columns:
        if table[name].dtype == object:
            table[name] = [v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in table[name]]
    return table

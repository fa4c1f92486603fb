"""Estimates as tables: of pandas, in Parquet, of xarray."""

from pathlib import Path
from typing import Any

import numpy as np

from sigmax.views.series import Series, needed


def frame(series: Series) -> Any:
    """A pandas frame with a row for each step, times as its index, tracks before them where there are tracks.

    Units are in `frame.attrs["units"]`.
    """
    pandas = needed("pandas", "to_frame()")
    columns = series.columns()
    time = pandas.Index(series.time.ravel(), name="time")
    index = time
    if series.batched:
        B, T = series.time.shape
        index = pandas.MultiIndex.from_arrays([np.repeat(np.arange(B), T), time], names=["track", "time"])
    made = pandas.DataFrame({name: values.ravel() for name, (values, _) in columns.items()}, index=index)
    made.attrs["units"] = {name: unit for name, (_, unit) in columns.items() if unit}
    if not series.dated:
        made.attrs["units"]["time"] = "s"
    return made


def parquet(series: Series, path: str | Path, first: int = 0) -> None:
    """The same in a file of Parquet, the unit of each column in the metadata of its field; tracks from `first` on."""
    arrow, writer = needed("pyarrow", "to_parquet()"), needed("pyarrow.parquet", "to_parquet()")
    columns: dict[str, tuple[Any, str]] = {}
    if series.batched:
        B, T = series.time.shape
        columns["track"] = np.repeat(np.arange(first, first + B), T), ""
    time = arrow.array(series.time.ravel())
    columns["time"] = (time.cast(arrow.timestamp("ns", tz="UTC")), "") if series.dated else (time, "s")
    columns |= {name: (values.ravel(), unit) for name, (values, unit) in series.columns().items()}
    arrays = {name: arrow.array(values) for name, (values, _) in columns.items()}
    fields = [arrow.field(name, a.type, metadata={"unit": columns[name][1]}) for name, a in arrays.items()]
    schema = arrow.schema(fields, metadata={"title": series.title})
    writer.write_table(arrow.Table.from_arrays(list(arrays.values()), schema=schema), path)


def dataset(series: Series, cov: np.ndarray | None) -> Any:
    """An xarray dataset: a variable for each column of the frame, and the covariances of the deviations.

    Along `time`; where tracks have times of their own along `step`, and `time` is a coordinate of both.

    Args:
        series: the estimates.
        cov: (…, d, d), or None where factors were not kept.
    """
    xarray = needed("xarray", "to_xarray()")
    same = bool((series.time == series.time[:1]).all())
    along = ("track", "time" if same else "step") if series.batched else ("time",)
    laid = slice(None) if series.batched else 0
    unit = {} if series.dated else {"units": "s"}
    time = xarray.Variable("time", series.time[0], unit) if same else xarray.Variable(along, series.time, unit)
    coordinates: dict[str, Any] = {"time": time}
    if series.batched:
        coordinates["track"] = np.arange(len(series.time))
    variables = {
        name: xarray.Variable(along, values[laid], {"units": unit} if unit else {})
        for name, (values, unit) in series.columns().items()
    }
    if cov is not None:
        names = list(series.deviations)
        coordinates |= {"deviation": names, "deviation2": names}
        variables["cov"] = xarray.Variable(
            (*along, "deviation", "deviation2"), cov.reshape(*series.time.shape, *cov.shape[-2:])[laid]
        )
    return xarray.Dataset(variables, coordinates, {"title": series.title})

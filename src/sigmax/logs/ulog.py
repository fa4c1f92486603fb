"""ULog, the log of PX4, by pyulog."""

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pyulog import ULog

from sigmax.logs.read import Log

# What older versions of PX4 call otherwise, and in other units.
_SCALED = {"lat": ("latitude_deg", 1e-7), "lon": ("longitude_deg", 1e-7), "alt": ("altitude_msl_m", 1e-3)}


def tables(path: Path) -> Log:
    """A table for each message, "sensor_gps", its further instances as "sensor_gps.1".

    `time` is in seconds since the start of the device, or a date where a message of the receiver tells it. Latitude and
    longitude are in degrees whatever the version.
    """
    # It reports what is damaged by printing, and leaves open what it opens itself.
    with contextlib.redirect_stdout(io.StringIO()), path.open("rb") as file:
        log: Any = ULog(file)
    began = _began(log.data_list)
    found = {}
    for data in log.data_list:
        columns = {name: values for name, values in data.data.items() if name != "timestamp"}
        for name, (better, scale) in _SCALED.items():
            if name in columns and np.issubdtype(columns[name].dtype, np.integer):
                columns[better] = columns.pop(name) * scale
        time = pd.Series(data.data["timestamp"].astype(np.int64) * 1000)
        times = pd.to_datetime(time + began, utc=True) if began else time * 1e-9
        of_instance = f".{data.multi_id}" if data.multi_id else ""
        found[data.name + of_instance] = pd.DataFrame({"time": times, **columns})
    lost = sum(dropout.duration for dropout in log.dropouts)
    notes = [f"The log lost {len(log.dropouts)} stretches, {lost} ms in all."] if log.dropouts else []
    notes += ["The log is damaged in places, which were left out."] if log.file_corruption else []
    return Log(found, tuple(notes))


def _began(messages: list[Any]) -> int:
    """The instant at which the device started, ns since 1970; 0 where no receiver tells it."""
    for data in messages:
        utc = data.data.get("time_utc_usec")
        if utc is not None and (utc > 0).any():
            k = int(np.flatnonzero(utc > 0)[0])
            return (int(utc[k]) - int(data.data["timestamp"][k])) * 1000
    return 0

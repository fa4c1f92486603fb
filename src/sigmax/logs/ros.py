"""Bags of ROS 1 and ROS 2, by rosbags."""

from pathlib import Path
from typing import Any

import pandas as pd
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from sigmax.errors import InputError
from sigmax.logs.flat import flat
from sigmax.logs.read import Log

# Axes of a covariance of a place, as REP 103 has them.
_OF_PLACES = {"x": "east", "y": "north", "z": "up"}


def tables(path: Path) -> Log:
    """A table for each topic; `time` is that of the header, else when the message was written.

    Standard deviations stand beside what has a covariance, such as `east_std` of a NavSatFix. Long arrays, such as
    pictures and points, are left out of their rows.
    """
    where = path.parent if path.suffix == ".db3" and (path.parent / "metadata.yaml").is_file() else path
    rows: dict[str, list[dict[str, Any]]] = {}
    unknown: set[str] = set()
    with AnyReader([where], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, written, raw in reader.messages():
            if connection.msgtype not in reader.typestore.types:
                unknown.add(connection.topic)
                continue
            message = reader.deserialize(raw, connection.msgtype)
            row = row_of(flat(message), written, connection.msgtype.rsplit("/", 1)[-1])
            rows.setdefault(connection.topic, []).append(row)
    if not rows and unknown:
        raise InputError(f"{path.name}: the types of the topics {', '.join(sorted(unknown))} are not known")
    notes = (f"Topics of types that are not known were left out: {', '.join(sorted(unknown))}.",) if unknown else ()
    return Log({topic: table_of(found) for topic, found in rows.items()}, notes)


def table_of(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """Rows as a table, in the order of their times."""
    table = pd.DataFrame(rows)
    table["time"] = pd.to_datetime(table["time"], unit="ns", utc=True)
    return table.sort_values("time", kind="stable", ignore_index=True)


def row_of(flat_message: dict[str, Any], written: int, kind: str) -> dict[str, Any]:
    """A row with its time, ns since 1970, and with the deviations of a place by their directions."""
    stamp = stamp_of(flat_message, ("header.stamp.sec", "header.stamp.nanosec"), written)
    row = {"time": stamp, **flat_message}
    if kind in ("NavSatFix", "LocationFix"):
        for axis, direction in _OF_PLACES.items():
            deviation = row.pop(f"position_{axis}_std", None)
            # Of a type of 0 the covariance is not known.
            if deviation is not None and row.get("position_covariance_type", 1) != 0:
                row[f"{direction}_std"] = deviation
    return row


def stamp_of(flat_message: dict[str, Any], parts: tuple[str, str], written: int) -> int:
    """The time that a message has in seconds and nanoseconds, which are taken out of it, else when it was written."""
    seconds, nanoseconds = (flat_message.pop(part, None) for part in parts)
    return int(seconds) * 1_000_000_000 + int(nanoseconds or 0) if seconds else written

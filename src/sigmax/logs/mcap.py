"""MCAP: messages of ROS by rosbags, those in JSON by mcap itself."""

import json
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from sigmax.errors import InputError
from sigmax.logs import ros
from sigmax.logs.flat import flat
from sigmax.logs.read import Log


def tables(path: Path) -> Log:
    """A table for each topic, as `ros.tables` has it.

    Raises:
        InputError: where all topics are in another encoding than those of ROS and JSON.
    """
    rows: dict[str, list[dict[str, Any]]] = {}
    other: dict[str, str] = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        encodings = set() if summary is None else {c.message_encoding for c in summary.channels.values()}
        if encodings & {"cdr", "ros1"}:
            return ros.tables(path)
        for schema, channel, message in reader.iter_messages():
            if channel.message_encoding != "json":
                other[channel.topic] = channel.message_encoding
                continue
            content = flat(json.loads(message.data))
            kind = "" if schema is None else schema.name.rsplit(".", 1)[-1]
            made = ros.stamp_of(content, ("timestamp.sec", "timestamp.nsec"), message.log_time)
            rows.setdefault(channel.topic, []).append(ros.row_of(content, made, kind))
    if not rows and other:
        told = ", ".join(f"{topic} in {encoding}" for topic, encoding in sorted(other.items()))
        raise InputError(f"{path.name} has {told}; messages of ROS and in JSON can be read")
    notes = (f"Topics in other encodings than JSON were left out: {', '.join(sorted(other))}.",) if other else ()
    return Log({topic: ros.table_of(found) for topic, found in rows.items()}, notes)

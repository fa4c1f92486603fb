"""Logs of one small world in every format, written by the writers of the packages that read them."""

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import asterix.generated as asterix
import h5py
import numpy as np
import pandas as pd
import pynmea2
import xarray
from mcap.writer import Writer as McapWriter
from pyais import encode_dict
from pyulog import ULog
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore

KNOT = 1852 / 3600


class Written(NamedTuple):
    """A log, and what a description of it must say.

    Attributes:
        path: of the file.
        tracks: how many there are.
        tolerance: of positions, m, for what the format rounds.
        epoch: whether it has dates.
        deviation: of each coordinate (east, north) where it is said in each row.
        velocity: whether speed and course are told, too.
    """

    path: Path
    tracks: int = 2
    tolerance: float = 0.02
    epoch: bool = True
    deviation: tuple[float, float] | None = None
    velocity: bool = True


def since_1970(w: pd.DataFrame) -> np.ndarray:
    return 1714564800.0 + w.t.to_numpy(float)


def ais(path: Path, w: pd.DataFrame) -> Written:
    lines = []
    for row, time in zip(w.itertuples(), since_1970(w), strict=True):
        report = {"type": 18, "mmsi": row.id, "lat": row.lat, "lon": row.lon, "course": row.course, "accuracy": 1}
        tag = f"s:station,c:{time:.0f}"
        check = 0
        for c in tag:
            check ^= ord(c)
        lines += [rf"\{tag}*{check:02X}\{s}" for s in encode_dict(report | {"speed": row.speed / KNOT})]
    path = path / "harbour.ais"
    path.write_text("\n".join(lines) + "\n")
    return Written(path, tolerance=0.2)


def angle(degrees: float, width: int) -> str:
    whole = int(abs(degrees))
    return f"{whole:0{width}d}{(abs(degrees) - whole) * 60:09.6f}"


def nmea(path: Path, w: pd.DataFrame) -> Written:
    """One ship that sails over midnight."""
    lines = []
    for row in w[w.id == w.id.iloc[0]].itertuples():
        at = pd.Timestamp("2024-05-01T23:59:30") + pd.Timedelta(seconds=row.t)
        clock = f"{at:%H%M%S}.{at.microsecond // 10000:02d}"
        place = (angle(row.lat, 2), "N" if row.lat > 0 else "S", angle(row.lon, 3), "E" if row.lon > 0 else "W")
        fix = pynmea2.GGA("GP", "GGA", (clock, *place, "1", "08", "0.9", "12.0", "M", "-33.0", "M", "", ""))
        noise = pynmea2.GST("GP", "GST", (clock, "3", "", "", "", "1.5", "2.5", "4.0"))
        speed = (f"{row.speed / KNOT:.5f}", f"{row.course:.5f}")
        minimum = pynmea2.RMC("GP", "RMC", (clock, "A", *place, *speed, f"{at:%d%m%y}", "", ""))
        lines += [str(fix), str(minimum), str(noise)]
    path = path / "boat.nmea"
    path.write_text("\r\n".join(lines) + "\r\n")
    return Written(path, tracks=1, deviation=(2.5, 1.5))


def ulog(path: Path, w: pd.DataFrame) -> Written:
    """What a device writes, by the format's description, and pyulog again."""
    fields = "uint64_t timestamp;uint64_t time_utc_usec;double latitude_deg;double longitude_deg;float eph;"
    other = "uint64_t timestamp;float x;float y;"

    def block(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + block("B", bytes(40))
    content += block("F", f"sensor_gps:{fields}".encode()) + block("F", f"vehicle_thing:{other}".encode())
    content += block("A", struct.pack("<BH", 0, 0) + b"sensor_gps") + block(
        "A", struct.pack("<BH", 0, 1) + b"vehicle_thing"
    )
    one = w[w.id == w.id.iloc[0]]
    for row, time in zip(one.itertuples(), since_1970(one), strict=True):
        stamp = round((5 + row.t) * 1e6)
        gps = struct.pack("<HQQddf", 0, stamp, round(time * 1e6), row.lat, row.lon, 1.25)
        content += block("D", gps) + block("D", struct.pack("<HQff", 1, stamp, row.y, row.x))
    raw = path / "raw.ulg"
    raw.write_bytes(content)
    ULog(str(raw)).write_ulog(str(path / "flight.ulg"))
    return Written(path / "flight.ulg", tracks=1, deviation=(1.25, 1.25), velocity=False)


def ros(path: Path, w: pd.DataFrame, kind: str) -> Written:
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
    of = store.types
    one = w[w.id == w.id.iloc[0]]
    more: dict[str, Any] = {"seq": 0} if kind == "bag" else {}
    where = path / {"bag": "drive.bag", "db3": "drive", "mcap": "drive"}[kind]
    storage = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer: Any = Bag1(where) if kind == "bag" else Bag2(where, version=9, storage_plugin=storage)
    with writer:
        fix, imu = (
            writer.add_connection(topic, f"sensor_msgs/msg/{name}", typestore=store)
            for topic, name in (("/gps/fix", "NavSatFix"), ("/temperature", "Temperature"))
        )
        for row, time in zip(one.itertuples(), since_1970(one), strict=True):
            stamp = of["builtin_interfaces/msg/Time"](sec=int(time), nanosec=round(time % 1 * 1e9))
            header = of["std_msgs/msg/Header"](stamp=stamp, frame_id="gps", **more)
            status = of["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
            covariance = np.diag([4.0, 9.0, 25.0]).ravel()
            place = of["sensor_msgs/msg/NavSatFix"](header, status, row.lat, row.lon, 20.0, covariance, 2)
            warm = of["sensor_msgs/msg/Temperature"](header, 20.0, 0.1)
            for connection, message in ((fix, place), (imu, warm)):
                encode = store.serialize_ros1 if kind == "bag" else store.serialize_cdr
                # Written a little later than made.
                writer.write(connection, round(time * 1e9) + 30_000_000, encode(message, connection.msgtype))
    return Written(where, tracks=1, deviation=(2.0, 3.0), velocity=False)


def mcap_of_ros(path: Path, w: pd.DataFrame) -> Written:
    written = ros(path, w, "mcap")
    return written._replace(path=next(written.path.glob("*.mcap")))


def mcap_of_json(path: Path, w: pd.DataFrame) -> Written:
    where = path / "fleet.mcap"
    with where.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("foxglove.LocationFix", "jsonschema", b"{}")
        channel = writer.register_channel("/fix", "json", schema)
        one = w[w.id == w.id.iloc[0]]
        for row, time in zip(one.itertuples(), since_1970(one), strict=True):
            stamp = {"sec": int(time), "nsec": round(time % 1 * 1e9)}
            place = {"latitude": row.lat, "longitude": row.lon, "altitude": 3.0, "timestamp": stamp}
            message = json.dumps(place | {"position_covariance": [4, 0, 0, 0, 9, 0, 0, 0, 1]}).encode()
            writer.add_message(channel, round(time * 1e9) + 10**9, message, round(time * 1e9) + 10**9)
        writer.finish()
    return Written(where, tracks=1, deviation=(2.0, 3.0), velocity=False)


def hdf5(path: Path, w: pd.DataFrame) -> Written:
    where = path / "log.h5"
    with h5py.File(where, "w") as file:
        group = file.create_group("radar/plots")
        for name, values in {"time": since_1970(w), "id": w.id, "lat": w.lat, "lon": w.lon, "acc": 3 + 0 * w.t}.items():
            group[name] = np.asarray(values)
        file["radar/picture"] = np.zeros((4, 100, 100))
        file["radar/sites"] = np.array([(1.0, 2.0)], dtype=[("x", "f8"), ("y", "f8")])
    return Written(where, deviation=(3.0, 3.0), velocity=False)


def netcdf(path: Path, w: pd.DataFrame, engine: str) -> Written:
    where = path / f"log.{'nc' if engine == 'scipy' else 'nc4'}"
    times = pd.to_datetime(since_1970(w), unit="s")
    columns = {"lat": w.lat, "lon": w.lon, "vessel_id": w.id.astype("int32"), "sog": w.speed / KNOT, "cog": w.course}
    data = xarray.Dataset({k: ("obs", np.asarray(v)) for k, v in columns.items()})
    data["time"] = ("obs", times.to_numpy())
    data.to_netcdf(where, engine=engine)
    return Written(where)


def plots(w: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    return np.hypot(w.x, w.y), np.degrees(np.arctan2(w.x, w.y)) % 360


def asterix_reports(path: Path, w: pd.DataFrame) -> Written:
    """ADS-B in category 021, beside a category that nobody reads."""
    edition, content = asterix.Cat_021_2_6, b"\x19\x00\x04\x00"
    for row in w.itertuples():
        place = (("LAT", (row.lat, "°")), ("LON", (row.lon, "°")))
        quality = (("NUCRNACV", 0), ("NUCPNIC", 0), None), (("NICBARO", 0), ("SIL", 0), ("NACP", 9), None)
        ground = (0, ("GS", (row.speed / 1852, "NM/s")), ("TA", (row.course, "°")))
        record = edition.cv_record.create(
            {"010": (("SAC", 1), ("SIC", 2)), "071": (row.t + 43200, "s"), "131": place, "090": quality, "160": ground}
            | {"080": row.id % 2**24}
        )
        content += edition.create([record]).unparse().to_bytes()
    path = path / "traffic.ast"
    path.write_bytes(content)
    # 30 m hold 95 % of the positions.
    scale = 30 / math.sqrt(-2 * math.log(0.05))
    return Written(path, epoch=False, tolerance=0.1, deviation=(scale, scale))


def asterix_tracks(path: Path, w: pd.DataFrame) -> Written:
    edition, content = asterix.Cat_062_1_20, b""
    for row in w.itertuples():
        place = (("LAT", (row.lat, "°")), ("LON", (row.lon, "°")))
        record = edition.cv_record.create(
            {"010": (("SAC", 1), ("SIC", 2)), "070": (row.t, "s"), "105": place, "040": row.id % 1000}
            | {"500": {"APC": (("X", (25.0, "m")), ("Y", (30.0, "m")))}}
        )
        content += edition.create([record]).unparse().to_bytes()
    path = path / "tracks.ast"
    path.write_bytes(content)
    return Written(path, epoch=False, tolerance=0.7, deviation=(25.0, 30.0), velocity=False)


def opensky(path: Path, w: pd.DataFrame) -> Written:
    answers = []
    for row, time in zip(w.itertuples(), since_1970(w), strict=True):
        address = f"{row.id % 2**24:06x}"
        state = [address, "KLM1    ", "x", time, time + 1, row.lon, row.lat, 9000, False, row.speed, row.course, 0.0]
        answers.append({"time": time + 2, "states": [[*state, None, 9000, "1000", False, 0]]})
    path = path / "states.jsonl"
    # The same answer twice, as one who asks too often gets it.
    path.write_text("\n".join(json.dumps(a) for a in [*answers, answers[-1]]))
    return Written(path)


def readsb(path: Path, w: pd.DataFrame) -> Written:
    answers = []
    for row, time in zip(w.itertuples(), since_1970(w), strict=True):
        one = {"hex": f"{row.id % 2**24:06x}", "lat": row.lat, "lon": row.lon, "gs": row.speed / KNOT}
        answers.append({"now": time + 1.5, "messages": 9, "aircraft": [one | {"track": row.course, "seen_pos": 1.5}]})
    path = path / "aircraft.json"
    path.write_text(json.dumps(answers))
    return Written(path)


def basestation(path: Path, w: pd.DataFrame) -> Written:
    lines = []
    for row, time in zip(w.itertuples(), since_1970(w), strict=True):
        at = pd.Timestamp(time, unit="s")
        who = f"1,1,{row.id % 2**24:06X},1,{at:%Y/%m/%d,%H:%M:%S.000},{at:%Y/%m/%d,%H:%M:%S.000}"
        lines.append(f"MSG,3,{who},,30000,,,{row.lat:.7f},{row.lon:.7f},,,0,0,0,0")
        lines.append(f"MSG,4,{who},,,{row.speed / KNOT:.1f},{row.course:.1f},,,0,,,,,")
    path = path / "receiver.sbs"
    path.write_text("\n".join(lines))
    return Written(path, velocity=False)


WRITERS: dict[str, Callable[[Path, pd.DataFrame], Written]] = {
    "ais": ais,
    "nmea": nmea,
    "ulog": ulog,
    "ROS 1": lambda path, w: ros(path, w, "bag"),
    "ROS 2": lambda path, w: ros(path, w, "db3"),
    "MCAP of ROS": mcap_of_ros,
    "MCAP of JSON": mcap_of_json,
    "hdf5": hdf5,
    "netcdf 4": lambda path, w: netcdf(path, w, "h5netcdf"),
    "netcdf 3": lambda path, w: netcdf(path, w, "scipy"),
    "asterix 021": asterix_reports,
    "asterix 062": asterix_tracks,
    "opensky": opensky,
    "readsb": readsb,
    "basestation": basestation,
}

"""Which formats there are, and how a file of each is known: by the ending of its name, else by how it begins."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple


class Format(NamedTuple):
    """A format of log files.

    Attributes:
        name: in words.
        endings: of file names, in small letters.
        begins: whether a file of this format begins with these bytes.
        module: in this folder; its function `tables(path)` reads a file.
        packages: what to install for it, as imported and as pip calls it.
    """

    name: str
    endings: tuple[str, ...]
    begins: Callable[[bytes], bool]
    module: str
    packages: tuple[tuple[str, str], ...] = ()


def _starts(*beginnings: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(beginnings)


def _ais(head: bytes) -> bool:
    return any(re.search(rb"![A-Z]{2}VD[MO],\d,\d,", line) for line in head.splitlines()[:10])


def _nmea(head: bytes) -> bool:
    return any(head[:1] == b"$" and head[3:6] == kind for kind in (b"GGA", b"RMC", b"GLL", b"GSA", b"GSV", b"VTG"))


def _never(head: bytes) -> bool:
    return False


# AIS comes before NMEA, whose sentences may stand beside its own.
FORMATS = (
    Format("AIS", (".ais",), _ais, "ais", (("pyais", "pyais"),)),
    Format("NMEA 0183", (".nmea", ".nme"), _nmea, "nmea", (("pynmea2", "pynmea2"),)),
    Format("ULog", (".ulg", ".ulog"), _starts(b"ULog\x01\x12\x35"), "ulog", (("pyulog", "pyulog"),)),
    Format("ROS bag", (".bag", ".db3"), _starts(b"#ROSBAG V2"), "ros", (("rosbags", "rosbags"),)),
    Format("MCAP", (".mcap",), _starts(b"\x89MCAP"), "mcap", (("mcap", "mcap"), ("rosbags", "rosbags"))),
    Format("NetCDF", (".nc", ".nc4", ".cdf"), _starts(b"CDF\x01", b"CDF\x02"), "netcdf", (
        ("xarray", "xarray"), ("h5netcdf", "h5netcdf"))),
    Format("HDF5", (".h5", ".hdf5", ".hdf", ".mat"), _starts(b"\x89HDF\r\n\x1a\n"), "hdf5", (("h5py", "h5py"),)),
    Format("ASTERIX", (".ast", ".asterix"), _never, "asterix", (("asterix", "libasterix"),)),
    Format("ADS-B of BaseStation", (".sbs", ".bst"), _starts(b"MSG,"), "basestation"),
    Format("JSON", (".json", ".jsonl", ".ndjson", ".json.gz", ".jsonl.gz"), _never, "states"),
)  # fmt: skip
# So many bytes tell a format.
_HEAD = 2048


def format_of(path: Path) -> Format | None:
    """The format of a log, by the ending of its name, else by how it begins; None for anything else."""
    name = path.name.casefold()
    found = next((one for one in FORMATS if name.endswith(one.endings)), None)
    if found is None and path.is_dir():
        found = next(one for one in FORMATS if one.module == "ros") if (path / "metadata.yaml").is_file() else None
    elif found is None and path.is_file():
        try:
            with path.open("rb") as file:
                head = file.read(_HEAD)
        except OSError:
            return None
        found = next((one for one in FORMATS if one.begins(head)), None)
    # AIS receivers write the ending of NMEA, too.
    if found is not None and found.module == "nmea" and path.is_file():
        with path.open("rb") as file:
            if _ais(file.read(_HEAD)):
                return FORMATS[0]
    return found

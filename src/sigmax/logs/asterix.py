"""ASTERIX of EUROCONTROL, by libasterix: plots of radars (048), ADS-B (021), tracks of a system (062)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
from asterix import generated
from asterix.base import Bits, RawDatablock

from sigmax.errors import InputError
from sigmax.logs.read import Log

_DAY = 86400.0
# Half the width that holds 95 % of positions (EPU) by NACp: RTCA DO-260B, table 2-71. It is 2.448 standard deviations.
_EPU = {11: 3.0, 10: 10.0, 9: 30.0, 8: 92.6, 7: 185.2, 6: 555.6, 5: 926.0, 4: 1852.0, 3: 3704.0, 2: 7408.0, 1: 18520.0}
_OF_95 = 2.4477
_FEET_OF_A_LEVEL = 100.0


def tables(path: Path) -> Log:
    """Tables `plots`, `reports` and `tracks` of the categories 048, 021 and 062; others are left out and named.

    `time` is in seconds since midnight, as in ASTERIX, and goes on past the next midnight. Ranges are in nautical
    miles, angles in degrees, lengths in m, speeds in m/s; `icao24` is in hexadecimal.

    Raises:
        InputError: where the blocks of the file do not follow one another.
    """
    blocks = RawDatablock.parse(Bits.from_bytes(path.read_bytes()))
    if isinstance(blocks, ValueError):
        raise InputError(
            f"{path.name} is no whole file of ASTERIX: its blocks do not follow one another to the end; what was "
            "captured with headers of a network has to be unpacked first"
        )
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name, _, _ in _CATEGORIES.values()}
    others: dict[int, int] = {}
    bad = 0
    for block in blocks:
        category = block.get_category()
        if category not in _CATEGORIES:
            others[category] = others.get(category, 0) + 1
            continue
        name, edition, row_of = _CATEGORIES[category]
        records: Any = edition.cv_uap.parse(block.get_raw_records())
        if isinstance(records, ValueError):
            bad += 1
            continue
        rows[name] += [row for record in records if (row := row_of(record)).get("time") is not None]
    notes = [f"{bad} blocks could not be read and were left out."] if bad else []
    if others:
        told = ", ".join(f"{category:03d} ({count} blocks)" for category, count in sorted(others.items()))
        notes.append(f"Categories that are not read were left out: {told}.")
    return Log({name: _counting_on(pd.DataFrame(found)) for name, found in rows.items()}, tuple(notes))


def _counting_on(table: pd.DataFrame) -> pd.DataFrame:
    """Times of day that fall by more than half a day are of the next."""
    if len(table):
        table["time"] += _DAY * (table["time"].diff() < -_DAY / 2).cumsum()
    return table


def _plot(record: Any) -> dict[str, Any]:
    return {
        "time": _quantity(record, "140", unit="s"),
        "radar": _source(record),
        "track_id": _whole(record, "161", "TRN"),
        "icao24": _address(record, "220"),
        "callsign": _text(record, "240"),
        "range_nm": _quantity(record, "040", "RHO", unit="NM"),
        "azimuth_deg": _quantity(record, "040", "THETA", unit="°"),
        "flight_level_ft": _feet(_quantity(record, "090", "FL", unit="FL")),
    }


def _report(record: Any) -> dict[str, Any]:
    """High resolution, the time of the position, and an accuracy, where they are sent."""
    fine = _quantity(record, "131", "LAT", unit="°"), _quantity(record, "131", "LON", unit="°")
    coarse = _quantity(record, "130", "LAT", unit="°"), _quantity(record, "130", "LON", unit="°")
    latitude, longitude = coarse if None in fine else fine
    times = (_quantity(record, item, unit="s") for item in ("071", "073", "077"))
    epu = _EPU.get(_whole(record, "090", "NACP") or 0)
    return {
        "time": next((t for t in times if t is not None), None),
        "station": _source(record),
        "icao24": _address(record, "080"),
        "callsign": _text(record, "170"),
        "latitude": latitude,
        "longitude": longitude,
        "speed_mps": _times(1852.0, _quantity(record, "160", "GS", unit="NM/s")),
        "course_deg": _quantity(record, "160", "TA", unit="°"),
        "flight_level_ft": _feet(_quantity(record, "145", unit="FL")),
        "accuracy": None if epu is None else epu / _OF_95,
    }


def _track(record: Any) -> dict[str, Any]:
    return {
        "time": _quantity(record, "070", unit="s"),
        "system": _source(record),
        "track_id": _whole(record, "040"),
        "icao24": _address(record, "380", "ADR"),
        "latitude": _quantity(record, "105", "LAT", unit="°"),
        "longitude": _quantity(record, "105", "LON", unit="°"),
        "x_m": _quantity(record, "100", "X", unit="m"),
        "y_m": _quantity(record, "100", "Y", unit="m"),
        "vx_mps": _quantity(record, "185", "VX", unit="m/s"),
        "vy_mps": _quantity(record, "185", "VY", unit="m/s"),
        "flight_level_ft": _feet(_quantity(record, "136", unit="FL")),
        "east_std": _quantity(record, "500", "APC", "X", unit="m"),
        "north_std": _quantity(record, "500", "APC", "Y", unit="m"),
    }


_CATEGORIES: dict[int, tuple[str, Any, Callable[[Any], dict[str, Any]]]] = {
    48: ("plots", generated.Cat_048_1_32, _plot),
    21: ("reports", generated.Cat_021_2_6, _report),
    62: ("tracks", generated.Cat_062_1_20, _track),
}


def _leaf(record: Any, path: tuple[str, ...]) -> Any:
    """What stands in an item or a part of it; None where it was not sent."""
    item = record
    for k, name in enumerate(path):
        try:
            item = (item if k == 0 else item.variation).get_item(name)
        except (KeyError, AttributeError, ValueError):
            return None
        if item is None:
            return None
    return item.variation.content


def _quantity(record: Any, *path: str, unit: str) -> float | None:
    content = _leaf(record, path)
    return None if content is None else float(content.as_quantity(unit))


def _whole(record: Any, *path: str) -> int | None:
    content = _leaf(record, path)
    return None if content is None else int(content.as_uint())


def _address(record: Any, *path: str) -> str | None:
    found = _whole(record, *path)
    return None if found is None else f"{found:06x}"


def _text(record: Any, item: str) -> str | None:
    content = _leaf(record, (item,))
    return None if content is None else str(content.as_string()).strip()


def _source(record: Any) -> str:
    return "/".join(str(_whole(record, "010", part)) for part in ("SAC", "SIC"))


def _feet(level: float | None) -> float | None:
    return _times(_FEET_OF_A_LEVEL, level)


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value

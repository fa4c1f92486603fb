"""Distances to beacons whose places stand in the same rows, as tables of a description."""

import re

import numpy as np

from sigmax.files.description import Column
from sigmax.files.table import Table
from sigmax.files.units import LENGTH, is_unit_of, to_si
from sigmax.proposals.positions import Seen, column_toml
from sigmax.proposals.roles import TimeRole, base_and_unit, has_numbers, named

# The beginning of the name of a beacon's coordinate: ax, anchor_x, beaconX, bs_pos_x, station_east.
_BEACON = r"(?P<of>(a|b|bs|ap|anchor|beacon|base|station|node|landmark)\d*_?(pos(ition)?_?)?)"


def beacons(table: Table, time: TimeRole, track: str | None) -> Seen | None:
    """One column of distances with two of the places they are measured from; None where there are none."""
    taken = (time.column, track)
    ranges = named(table, "range", taken)
    places = _places(table, (*taken, *ranges))
    if len(ranges) != 1 or places is None or all(named(table, role, taken) for role in ("x", "y")):
        return None
    # Beside ax and ay, az is a height and no azimuth.
    if any(base_and_unit(n)[0] != "az" for n in named(table, "azimuth", taken)):
        return None
    names = (ranges[0], *places)
    units = [unit if is_unit_of(unit := base_and_unit(n)[1], LENGTH) else "m" for n in names]
    reach, x, y = (column_toml(Column(column=n, unit=u)) for n, u in zip(names, units, strict=True))
    at = np.column_stack([table.numbers(n) * to_si(u, LENGTH, n) for n, u in zip(places, units[1:], strict=True)])
    middle, wide = np.nanmean(at, axis=0), max(float(np.nanmax(np.ptp(at[~np.isnan(at).any(1)], axis=0))), 1.0)
    tables = (
        f'[sensors.beacon]\nkind = "range_only"\ncolumns = {{ range = {reach} }}\n'
        f'inputs = {{ beacon_x = {x}, beacon_y = {y} }}\nnoise = {{ range = "30 cm" }}\n'
    )
    prior = "\n".join(
        f'{axis} = {{ mean = "{value:.6g} m", std = "{wide:.3g} m" }}' for axis, value in zip("xy", middle, strict=True)
    )
    remark = (
        f"{names[0]!r} in {units[0]} is taken for the distance to a beacon, which stands at {names[1]!r}, {names[2]!r} "
        f"in {units[1]}. Nothing says where a track begins: the prior is among the beacons."
    )
    nowhere = np.full((len(table), 2), np.nan)
    return Seen(tables, ("x", "y"), nowhere, (remark,), names, "beacon", prior)


def _places(table: Table, but: tuple[str | None, ...]) -> tuple[str, str] | None:
    bases = {base_and_unit(n)[0]: n for n in table.names if n not in but and has_numbers(table, n)}
    for base, name in bases.items():
        for first, second in (("x", "y"), ("east", "north")):
            found = re.fullmatch(_BEACON + first, base)
            if found and (other := bases.get(found["of"] + second)) is not None:
                distinct = table.columns[[name, other]].drop_duplicates()
                # Where they are new in every row, ax and ay are accelerations.
                return None if found["of"] == "a" and 2 * len(distinct) > len(table) else (name, other)
    return None

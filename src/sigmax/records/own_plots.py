"""A user's own plots: a table of plots without identities, and the TOML that describes it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from sigmax.descriptions.described_model import DescribedModel
from sigmax.descriptions.local import MADE, frame_of, local_columns, placed, with_local
from sigmax.descriptions.model import build
from sigmax.descriptions.plot_positions import locate
from sigmax.descriptions.trial import parse_trial, with_updates
from sigmax.errors import InputError, unknown
from sigmax.files.description import read_toml
from sigmax.files.plot_description import DetectionPart, PlotDescription, TrackingPart, extent_of
from sigmax.files.read_table import data_of, read_table
from sigmax.files.units import LENGTH, SPEED, TIME, quantity
from sigmax.filters import Filter
from sigmax.modelling.switching import SwitchingModel
from sigmax.records.own import check_columns, columns, instants, measured_columns
from sigmax.records.plots import PlotRecord
from sigmax.tracking import (
    Cycle,
    Detector,
    Layout,
    Modes,
    Scan,
    Truth,
    by_existence,
    m_of_n,
    two_point,
)
from sigmax.tracking.associations import ASSOCIATIONS

# Rows that cannot be read are quoted up to so many.
_QUOTED = 20


def own_plots(path: Path) -> PlotRecord:
    """The plots that a TOML file describes.

    Raises:
        InputError: for whatever does not fit, in the description or the data.
    """
    description = read_toml(path, PlotDescription)
    try:
        return _record(path, description, description.tracking)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error


def build_plots(path: Path, description: PlotDescription) -> DescribedModel:
    """The model of a description of plots, its sensors checked.

    Raises:
        InputError: for whatever does not fit.
    """
    part = description.tracking
    if description.track is not None:
        raise InputError(
            f"track = {description.track!r} says whose each plot is; drop it, or [tracking] and give a [prior]"
        )
    if description.landmarks is not None:
        raise InputError("[landmarks] does not go with [tracking]: name the columns of the places as inputs")
    if description.tables:
        raise InputError("[tables] does not go with [tracking]: plots come in one table")
    if description.bias:
        raise InputError("[bias] does not go with [tracking]: find it on recorded tracks and correct the columns")
    built = build(description, path.parent)
    check_columns(description, built)
    for name, sensing in built.sensings.items():
        if sensing.deviations is not None:
            raise InputError(f"sensors.{name}.noise: the plots of a scan share one noise; give numbers, no columns")
    for name in part.sensors:
        if name not in built.sensings:
            raise InputError(f"tracking.sensors: {unknown('sensor', name, built.sensings)}")
    missing = [name for name in built.sensings if name not in part.sensors]
    if missing:
        raise InputError(f"tracking.sensors needs detection and clutter of {missing[0]!r}")
    return built


def _modes(filter: Filter, built: DescribedModel) -> Modes:
    """What a target may be doing: the description's motion, or its modes."""
    model = built.model
    if not isinstance(model, SwitchingModel):
        return Modes([(with_updates(filter, built.updates), model)])
    filters = [with_updates(own or filter, built.updates) for own in model.filters]
    return Modes(list(zip(filters, model.models, strict=True)), model.sojourn)


def _record(path: Path, description: PlotDescription, part: TrackingPart) -> PlotRecord:
    built = build_plots(path, description)
    whole = data_of(description, path.parent, lenient=True)
    wanted = {name: measured_columns(description, built, name) for name in built.sensings}
    used = {column.column for one in wanted.values() for column, _, _ in one}
    used |= {item.column.column for item in built.inputs}
    used |= local_columns(description.local)
    used -= MADE
    table, skipped = whole.readable(used, description.time.column, description.time.format)
    if not len(table):
        raise InputError(f"no row of {table.path.name} can be read; the first is {skipped[0]}")
    frame = None if description.local is None else frame_of(description.local, table)
    table = with_local(table, description.local, frame)
    time, epoch = instants(table, description.time)
    inputs = columns(table, [(i.column, i.dimension, i.where) for i in built.inputs]) if built.inputs else None
    scans: list[Scan] = []
    for name, one in wanted.items():
        made_at = time - built.sensings[name].delay
        scans += _scans(name, part.sensors[name], made_at, columns(table, one), inputs)
    made = cycle_of(built, description, part)
    made(parse_trial(description.filters[0]).filter)
    more = f" and {len(skipped) - _QUOTED} more" if len(skipped) > _QUOTED else ""
    return PlotRecord(
        name=path.stem,
        title=description.title or path.stem,
        scans=tuple(sorted(scans, key=lambda s: (s.time, s.sensor))),
        cycle=made,
        filter=description.filters[0],
        window=quantity(part.late, TIME, "tracking.late"),
        truth=_truth(path.parent, description, part, built, epoch),
        cutoff=_cutoff(part, built),
        dimensions=built.dimensions,
        epoch=epoch,
        skipped=(*skipped[:_QUOTED], *([more.strip()] if more else [])),
        source=description.source or description.data,
        licence=description.licence,
        placed=placed(description, built, frame),
    )


def _scans(name: str, part: DetectionPart, time: np.ndarray, z: np.ndarray, inputs: np.ndarray | None) -> list[Scan]:
    """Rows of a sensor that belong together: of one time, or of one period of a sensor that turns."""
    rows = np.flatnonzero(~np.isnan(z).all(1))
    if not len(rows):
        return []
    period = period_of(name, part)
    key = time[rows] if period is None else np.floor((time[rows] - time[rows].min()) / period)
    _, group = np.unique(key, return_inverse=True)
    order = np.argsort(group, kind="stable")
    parts = np.split(rows[order], np.flatnonzero(np.diff(group[order])) + 1)
    return [
        Scan(float(np.mean(time[r])), name, z[r], None if inputs is None else np.nan_to_num(inputs[r[0]]))
        for r in parts
    ]


def period_of(name: str, part: DetectionPart) -> float | None:
    """Seconds that a sensor takes to turn; None for one whose plots of a scan have one time."""
    period = None if part.scan is None else quantity(part.scan, TIME, f"tracking.sensors.{name}.scan")
    if period is not None and not period > 0:
        raise InputError(f"tracking.sensors.{name}.scan must be a period above 0; it is {part.scan!r}")
    return period


def cycle_of(built: DescribedModel, description: PlotDescription, part: TrackingPart) -> Callable[[Filter], Cycle]:
    """What gives the cycle of a description with a filter.

    Raises:
        InputError: for names, options and units that do not fit.
    """
    top = quantity(part.max_speed, SPEED, "tracking.max_speed")
    if part.associate not in ASSOCIATIONS:
        raise InputError(f"tracking.associate: {unknown('rule', part.associate, ASSOCIATIONS)}")
    state = [str(name) for name in built.model.state]
    names = [state[i] for i in built.position]
    layout = _layout(built, description, state, names)
    periods = [quantity(s.scan, TIME, "scan") for s in part.sensors.values() if s.scan is not None]
    within = (
        quantity(part.within, TIME, "tracking.within") if part.within is not None else 3 * max(periods, default=4.0)
    )
    coast = np.inf if part.coast is None else quantity(part.coast, TIME, "tracking.coast")
    if part.confirm is not None and len(part.confirm) != 2:
        raise InputError(f"tracking.confirm is [m, n]: m plots of n chances; it is {part.confirm}")
    rule = by_existence(coast=coast) if part.confirm is None else m_of_n(part.confirm[0], part.confirm[1], coast=coast)
    extent = extent_of(part)
    detectors = {}
    for name, sensing in built.sensings.items():
        own = [k for k, item in enumerate(built.inputs) if item.sensor == name]
        detectors[name] = Detector(part.sensors[name].detection, part.sensors[name].clutter, locate(sensing, own))
    if not any(d.locate is not None for d in detectors.values()):
        raise InputError(
            "no sensor can begin tracks: one of the kind position, relative_position or range_azimuth is needed"
        )

    def cycle(filter: Filter) -> Cycle:
        return Cycle(
            _modes(filter, built),
            detectors,
            two_point(top, within),
            layout=layout,
            associate=ASSOCIATIONS[part.associate],
            rule=rule,
            extent=extent,
            max_speed=top,
        )

    return cycle


def _layout(built: DescribedModel, description: PlotDescription, state: list[str], names: list[str]) -> Layout:
    velocity = [f"v{name}" for name in names]
    polar = ["speed", "course"]
    if not all(v in state for v in velocity) and not (len(names) == 2 and all(p in state for p in polar)):
        raise InputError(f"tracks need a state with {', '.join(velocity)}, or with speed and course; it has {state}")
    cartesian = all(v in state for v in velocity)
    known = [*names, *(velocity if cartesian else polar)]
    rest = {}
    for i, name in enumerate(state):
        if name not in known:
            given = description.prior.get(name)
            if not isinstance(given, dict) or set(given) != {"mean", "std"}:
                raise InputError(f"prior.{name} = {{ mean = …, std = … }} is needed for new tracks")
            at = f"prior.{name}"
            rest[name] = (
                quantity(given["mean"], built.dimensions[i], at),
                quantity(given["std"], built.dimensions[i], at),
            )
    places = tuple(state.index(v) for v in velocity) if cartesian else None
    return Layout(built.position, places, None if cartesian else (state.index("speed"), state.index("course")), rest)


def _truth(
    folder: Path, description: PlotDescription, part: TrackingPart, built: DescribedModel, epoch: pd.Timestamp | None
) -> tuple[Truth, ...]:
    if part.truth is None:
        return ()
    table = read_table(folder / part.truth.data, decimal=description.decimal)
    time, began = instants(table, part.truth.time)
    if (began is None) != (epoch is None):
        raise InputError("tracking.truth counts time otherwise than the plots: both timestamps, or both seconds")
    if began is not None and epoch is not None:
        time = time + (began - epoch).total_seconds()
    names = [str(built.model.state[i]) for i in built.position]
    for name in names:
        if name not in description.truth:
            raise InputError(f"[truth] needs {name!r}: the column of {part.truth.data} that holds it")
    wanted = [
        (description.truth[n], built.dimensions[i], f"truth.{n}") for n, i in zip(names, built.position, strict=True)
    ]
    place = columns(table, wanted)
    series = table.column(part.truth.target).astype("string")
    made = []
    for target in sorted(series.dropna().unique()):
        rows = np.flatnonzero((series == target).to_numpy(bool) & ~np.isnan(place).any(1))
        # A time that is told twice counts once.
        moments, first = np.unique(time[rows], return_index=True)
        if len(moments):
            made.append(Truth(str(target), moments, place[rows[first]]))
    return tuple(made)


def _cutoff(part: TrackingPart, built: DescribedModel) -> float:
    """What was asked for, or ten times the largest deviation of a sensor that measures positions."""
    if part.cutoff is not None:
        return quantity(part.cutoff, LENGTH, "tracking.cutoff")
    known = [s.R for s in built.sensings.values() if not callable(s.R) and "position" in s.kind]
    lengths = [np.sqrt(np.max(np.diag(R) if np.ndim(R) == 2 else np.asarray(R))) for R in known]
    return float(max(100.0, 10 * max(lengths, default=10.0)))

"""Measurements of sensors with a known delay: rows of their own, at the time at which they were made."""

from typing import NamedTuple

import numpy as np

from sigmax.descriptions.described_model import DescribedModel


class Rows(NamedTuple):
    """Rows in the order of time.

    Attributes:
        time: of the rows, seconds.
        tracks: which rows belong to each track, in their order.
        measured: by sensor (rows, m).
        inputs: (rows, k), or None.
        truth: (rows, n), NaN where it is not known.
    """

    time: np.ndarray
    tracks: list[np.ndarray]
    measured: dict[str, np.ndarray]
    inputs: np.ndarray | None
    truth: np.ndarray


def undelayed(rows: Rows, built: DescribedModel) -> tuple[Rows, tuple[str, ...]]:
    """The rows with what sensors measured at the times at which they did, and a note of it for the reader.

    A delayed measurement moves to a row of its own, with the inputs of its sensor as they stood beside it; those of the
    motion are of the row in which that time ends, as everywhere. A row that is left with nothing is dropped.
    """
    delays = {s: sensing.delay for s, sensing in built.sensings.items() if sensing.delay}
    if not delays:
        return rows, ()
    count, time = len(rows.time), rows.time
    sources, times, end = [np.arange(count)], [time], count
    moved: dict[str, tuple[slice, np.ndarray]] = {}
    for delay in sorted(set(delays.values())):
        late = [s for s, d in delays.items() if d == delay]
        heard = np.flatnonzero(np.any([~np.isnan(rows.measured[s]).all(1) for s in late], axis=0))
        moved |= dict.fromkeys(late, (slice(end, end + len(heard)), heard))
        sources.append(heard)
        times.append(time[heard] - delay)
        end += len(heard)
    source, all_times = np.concatenate(sources), np.concatenate(times)
    measured = {s: np.full((end, v.shape[1]), np.nan) for s, v in rows.measured.items()}
    for s, values in rows.measured.items():
        place, heard = moved.get(s, (slice(count), np.arange(count)))
        measured[s][place] = values[heard]
    truth = np.concatenate([rows.truth, np.full((end - count, rows.truth.shape[1]), np.nan)])
    useful = ~np.isnan(truth).all(1) | built.model.motion_driven
    for values in measured.values():
        useful |= ~np.isnan(values).all(1)
    tracks, inputs = [], None if rows.inputs is None else rows.inputs[source]
    of_motion = np.flatnonzero([item.sensor is None for item in built.inputs])
    for track in rows.tracks:
        own = np.concatenate([track, count + np.flatnonzero(np.isin(source[count:], track))])
        own = own[useful[own]] if useful[own].any() else track
        own = own[np.argsort(all_times[own], kind="stable")]
        if rows.inputs is not None and inputs is not None:
            ends = track[np.minimum(np.searchsorted(time[track], all_times[own]), len(track) - 1)]
            inputs[np.ix_(own, of_motion)] = rows.inputs[np.ix_(ends, of_motion)]
        tracks.append(own)
    told = ", ".join(f"{s} {delay:g} s" for s, delay in delays.items())
    note = f"Measurements are taken at the time of their row less the delay of their sensor: {told}."
    return Rows(all_times, tracks, measured, inputs, truth), (note,)

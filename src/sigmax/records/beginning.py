"""A record whose tracks begin with what their own first measurements tell: `prior = "from measurements"`."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.bias import joint
from sigmax.modelling.switching import check_one_mode
from sigmax.models import Gaussian, Model
from sigmax.records.record import Record
from sigmax.rewriting.augment import augment
from sigmax.running.start import PoorFit, Undetermined, start

# What a description and the command line say.
WORDS = "from measurements"
_SAY = "say in [prior] where to look: NAME = { mean = …, std = … }"
# Rows with measurements that are tried before a track counts as not determined.
_MOST = 64
# The deviation of a bias that is known exactly, in units of its size: `start` wants one above 0.
_EXACT = 1e-9


class _Track(NamedTuple):
    """One track, its bias behind its state.

    Attributes:
        model: the model, augmented.
        z: measurements by sensor (T, m).
        dt: (T,).
        inputs: (T, k), or None.
        at: where the search begins.
        within: deviations about it, by name.
        turning: the places of angles of which nothing is known.
    """

    model: Model
    z: dict[str, np.ndarray]
    dt: np.ndarray
    inputs: np.ndarray | None
    at: np.ndarray
    within: dict[str, float]
    turning: tuple[int, ...]


class _Begun(NamedTuple):
    """Mean and covariance at the last of so many rows, and whether the measurements fit badly."""

    mean: np.ndarray
    cov: np.ndarray
    rows: int
    doubtful: bool


def from_measurements(record: Record, at: np.ndarray, within: Mapping[str, float] | None = None) -> Record:
    """The record from where its first measurements determine the state, with the prior that they give.

    Of each track the fewest rows are taken that leave a number to spare, so that a bad fit shows. They are not used
    again: the track begins with the last of them. A bias keeps its prior; what is not known of it widens the state's.

    Args:
        record: its prior is not read.
        at: states (B, n) near the first ones, where the search begins.
        within: standard deviations about `at` of components that measurements need not determine, by name.

    Raises:
        InputError: where no track is determined, naming what is open, and for several modes.
    """
    check_one_mode(record.model, f"prior = {WORDS!r}")
    begun: dict[int, _Begun] = {}
    failed: dict[int, InputError] = {}
    for b in range(len(record.tracks)):
        try:
            begun[b] = _begun(_track(record, b, at[b], dict(within or {})))
        except InputError as error:
            failed[b] = error
    if not begun:
        raise InputError(f"prior = {WORDS!r}: {failed[0]}")
    notes = [_told([one.rows for one in begun.values()], within)]
    if failed:
        b, why = next(iter(failed.items()))
        notes.append(f"{len(failed)} of {len(record.tracks)} tracks are left out; {record.tracks[b]!r}: {why}.")
    bad = [record.tracks[b] for b, one in begun.items() if one.doubtful]
    doubts = [f"prior = {WORDS!r}: those of {', '.join(bad[:5])} fit badly, by an outlier or another place; {_SAY}"]
    n, d = record.model.size, record.model.dim
    prior = Gaussian(*(np.stack(a) for a in zip(*((o.mean[:n], o.cov[:d, :d]) for o in begun.values()), strict=True)))
    made = _cut(record, list(begun), np.array([one.rows - 1 for one in begun.values()]))
    return replace(made, prior=prior, notes=(*record.notes, *notes), doubts=(*record.doubts, *(doubts if bad else ())))


def _told(rows: list[int], within: Mapping[str, float] | None) -> str:
    count = f"{min(rows)}" if min(rows) == max(rows) else f"{min(rows)} to {max(rows)}"
    said = f" and what is said of {', '.join(within)}" if within else ""
    return f"Each track begins with the state that its first {count} rows{said} tell; they are not used again."


def _track(record: Record, b: int, at: np.ndarray, within: dict[str, float]) -> _Track:
    steps, bias = int(record.steps[b]), record.model.bias
    periodic = record.model.angular if record.model.space.flat else ()
    turning = tuple(i for i, turns in enumerate(periodic) if turns and record.model.state[i] not in within)
    if bias is not None:
        both = joint(Gaussian(at, np.eye(record.model.dim)), bias.prior, False)
        at = both.mean if both.mean.ndim == 1 else both.mean[b]
        P = both.cov if both.cov.ndim == 2 else both.cov[b]
        own = np.sqrt(np.diagonal(P))[record.model.dim :]
        floor = _EXACT * np.maximum(np.abs(at[record.model.size :]), 1)
        within |= dict(zip(map(str, bias.names), np.maximum(own, floor).tolist(), strict=True))
    by_sensor = record.z if isinstance(record.z, dict) else {"": record.z}
    z = {s: v[b, :steps] for s, v in by_sensor.items()}
    inputs = None if record.inputs is None else record.inputs[b, :steps]
    return _Track(augment(record.model), z, record.dt[b, :steps], inputs, at, within, turning)


def _begun(track: _Track) -> _Begun:
    """The beginning of a track by the fewest rows.

    Raises:
        InputError: where they do not determine it.
    """
    seen = np.sum([(~np.isnan(v)).sum(1) for v in track.z.values()], axis=0)
    unknown = track.model.dim - len(track.within)
    ends = np.flatnonzero((seen > 0) & (np.cumsum(seen) > unknown))[:_MOST] + 1
    if not len(ends):
        raise InputError(f"{seen.sum()} numbers do not tell {unknown} components with one to spare; {_SAY}")
    open_: tuple[str, ...] = ()
    for rows in map(int, ends):
        try:
            return _best(track, rows)
        except Undetermined as error:
            open_ = error.names
    raise InputError(f"its first {ends[-1]} rows do not determine {', '.join(open_)}; {_SAY}")


def _best(track: _Track, rows: int) -> _Begun:
    """The beginning by so many rows: from `at`, and where that ends badly with unknown angles turned by quarters.

    Raises:
        Undetermined: where they leave something open.
        InputError: where the search ends nowhere.
    """
    doubtful: _Begun | None = None
    why = InputError("")
    for turns in product(*([0.0, 0.5, 1.0, -0.5],) * len(track.turning)):
        at = track.at.copy()
        at[list(track.turning)] += np.pi * np.array(turns)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                found = _start(track, rows, at)
            except Undetermined:
                raise
            except InputError as error:
                why = InputError(f"{str(error).partition('; give at=')[0]}; {_SAY}")
                continue
        made = _Begun(found.mean, found.cov, rows, any(issubclass(w.category, PoorFit) for w in said))
        if not made.doubtful:
            return made
        doubtful = doubtful or made
    if doubtful is None:
        raise why
    return doubtful


def _start(track: _Track, rows: int, at: np.ndarray) -> Gaussian:
    """The state at the last of so many rows; rows of nothing and no time behind them, for one compilation of many."""
    more = (1 << (rows - 1).bit_length()) - rows

    def longer(a: np.ndarray, mode: Any, **kind: Any) -> np.ndarray:
        return np.pad(a[:rows], ((0, more), *((0, 0),) * (a.ndim - 1)), mode, **kind)

    z = {s: longer(v, "constant", constant_values=np.nan) for s, v in track.z.items()}
    return start(
        track.model,
        z if track.model.several else next(iter(z.values())),
        dt=longer(track.dt, "constant"),
        at=at,
        within=track.within,
        inputs=None if track.inputs is None else longer(track.inputs, "edge"),
    )


def _cut(record: Record, tracks: list[int], first: np.ndarray) -> Record:
    """Some tracks of a record, each from a row on whose measurements are used already; the prior is not touched."""
    steps = record.steps[tracks] - first
    places = np.arange(steps.max())
    index = np.minimum(first[:, None] + places, record.steps[tracks][:, None] - 1)
    left = places < steps[:, None]
    left[:, 0] = False
    at = np.array(tracks)[:, None], index

    def measured(z: np.ndarray) -> np.ndarray:
        return np.where(left[..., None], z[at], np.nan)

    time = record.time[at]
    backdrop = record.backdrop
    return replace(
        record,
        tracks=tuple(record.tracks[b] for b in tracks),
        time=time,
        steps=steps,
        z={s: measured(v) for s, v in record.z.items()} if isinstance(record.z, dict) else measured(record.z),
        dt=np.diff(time, axis=1, prepend=time[:, :1]),
        inputs=None if record.inputs is None else record.inputs[at],
        truth=record.truth[at],
        backdrop=None if backdrop is None else backdrop._replace(offset=backdrop.offset[at]),
        update_first=True,
    )

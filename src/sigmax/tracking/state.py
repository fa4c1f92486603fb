"""What the cycle carries from scan to scan, and what it tells of each."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from sigmax.tracking.branches import Branches
from sigmax.tracking.life import Tracks


class Gates(NamedTuple):
    """What the gates of one scan say of its sensor.

    Attributes:
        plots: how many plots the scan had.
        gated: how many of them lay in the gate of a track.
        expected: how many plots confirmed tracks should have had, Σ P_D.
        found: how many they had.
        nis: the sum of these plots' NIS.
        dof: the number of components they measured.
    """

    plots: int
    gated: int
    expected: float
    found: float
    nis: float
    dof: float


class Told(NamedTuple):
    """What one scan did to the tracks that were there after it.

    Attributes:
        time: seconds.
        sensor: which reported.
        id: of the tracks (B,).
        confirmed: whether each is confirmed (B,).
        existence: the probability that there is a target (B,).
        mean: (B, n).
        cov: (B, n, n).
        mode: the probability of each mode (B, M).
        plot: the plot that most likely belongs to it, -1 for none (B,).
        nis: of that plot (B,), NaN for none.
        gates: what the gates say of the sensor.
        ended: ids of tracks that ended.
        faults: tracks that ended because a number was not sound.
    """

    time: float
    sensor: str
    id: np.ndarray
    confirmed: np.ndarray
    existence: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    mode: np.ndarray
    plot: np.ndarray
    nis: np.ndarray
    gates: Gates
    ended: np.ndarray
    faults: int


class State(NamedTuple):
    """All that the cycle carries from scan to scan; a value, never changed in place.

    Attributes:
        tracks: the tracks.
        next_id: of the next track that begins.
        memory: what the rule of initiation remembers, by sensor.
        branches: with `mht`, what tells the branches of targets apart: each row of `tracks` is a branch, and those of
            one target have its number; else None.
    """

    tracks: Tracks
    next_id: int
    memory: Mapping[str, Any]
    branches: Branches | None = None

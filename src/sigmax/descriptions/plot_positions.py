"""Positions of plots from a described sensor, for the initiation of tracks."""

import numpy as np

from sigmax.descriptions.sensor import Sensing, first_position
from sigmax.tracking import Located
from sigmax.tracking.detector import Locate, covariance_of


def locate(sensing: Sensing, inputs: list[int]) -> Locate | None:
    """What gives positions to plots of a sensor; None where it does not tell them.

    Args:
        sensing: the sensor.
        inputs: where its inputs stand among all.
    """
    if callable(sensing.R) or sensing.kind not in ("position", "relative_position", "range_azimuth"):
        return None
    d = len(sensing.at)
    R = np.asarray(sensing.R)
    cov = np.diag(R) if R.ndim == 1 else covariance_of(R)

    def located(z: np.ndarray, u: np.ndarray | None) -> Located:
        if sensing.kind == "relative_position":
            return Located(z + (0.0 if u is None else u[inputs]), np.tile(cov, (len(z), 1, 1)))
        place, spread = first_position(sensing, z)
        if sensing.kind == "position" or z.shape[1] == d:
            return Located(place, np.array(spread))
        away = (place - np.asarray(sensing.origin)) / np.maximum(z[:, :1], 1e-9)
        return Located(place, spread, away, z[:, d], float(cov[d, d]))

    return located

"""FilterPy's classes and attributes on the algebra of this library: a script moves by changing an import.

Covariances are carried as factors, all hooks are honoured, points are drawn anew before every measurement.
"""

from typing import Any

from sigmax.filterpy.extended import ExtendedKalmanFilter
from sigmax.filterpy.imm import IMMEstimator
from sigmax.filterpy.linear import KalmanFilter
from sigmax.filterpy.mmae import MMAEFilterBank
from sigmax.filterpy.points import JulierSigmaPoints, MerweScaledSigmaPoints, SimplexSigmaPoints
from sigmax.filterpy.sampled import CubatureKalmanFilter, UnscentedKalmanFilter

__all__ = [
    "CubatureKalmanFilter",
    "ExtendedKalmanFilter",
    "IMMEstimator",
    "JulierSigmaPoints",
    "KalmanFilter",
    "MMAEFilterBank",
    "MerweScaledSigmaPoints",
    "SimplexSigmaPoints",
    "UnscentedKalmanFilter",
]

# What FilterPy has beside, and what does the same here.
_INSTEAD = {
    "SquareRootKalmanFilter": "KalmanFilter, which carries the factor of P and takes P, Q and R as they are",
    "InformationFilter": "KalmanFilter, or the filters EIF, CIF and HCIF of sigmax.run",
    "FadingKalmanFilter": "KalmanFilter with alpha, as FilterPy itself advises",
    "FixedLagSmoother": "rts_smoother over the last steps, or sigmax.smooth",
    "EnsembleKalmanFilter": "UnscentedKalmanFilter or CubatureKalmanFilter, whose points are not drawn at random",
    "unscented_transform": "UnscentedKalmanFilter with x_mean_fn, z_mean_fn, residual_x and residual_z",
}


def __getattr__(name: str) -> Any:
    if name in _INSTEAD:
        raise ImportError(f"sigmax.filterpy has no {name}: use {_INSTEAD[name]}; or keep importing it from filterpy")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

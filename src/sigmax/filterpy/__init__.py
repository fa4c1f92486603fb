"""FilterPy's classes and attributes on the algebra of this library: a script moves by changing an import.

Covariances are carried as factors, all hooks are honoured, points are drawn anew before every measurement.
"""

from sigmax.filterpy.imm import IMMEstimator
from sigmax.filterpy.linear import ExtendedKalmanFilter, KalmanFilter
from sigmax.filterpy.points import JulierSigmaPoints, MerweScaledSigmaPoints, SimplexSigmaPoints
from sigmax.filterpy.sampled import CubatureKalmanFilter, UnscentedKalmanFilter

__all__ = [
    "CubatureKalmanFilter",
    "ExtendedKalmanFilter",
    "IMMEstimator",
    "JulierSigmaPoints",
    "KalmanFilter",
    "MerweScaledSigmaPoints",
    "SimplexSigmaPoints",
    "UnscentedKalmanFilter",
]

"""Models: what moves, what is seen, and how uncertain both are."""

from sigmax.models import motions, sensors
from sigmax.models.bias import Bias
from sigmax.models.derivatives import with_derivatives
from sigmax.models.fusion import fused
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model, angle
from sigmax.models.opaque import opaque
from sigmax.models.parts import Motion, Sensor
from sigmax.models.terrain import Elevation, inertial_errors, radio_altimeter

__all__ = [
    "Bias",
    "Elevation",
    "Gaussian",
    "Model",
    "Motion",
    "Sensor",
    "angle",
    "fused",
    "inertial_errors",
    "motions",
    "opaque",
    "radio_altimeter",
    "sensors",
    "with_derivatives",
]

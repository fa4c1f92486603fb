"""Models: what moves, what is seen, and how uncertain both are."""

from sigmax.models import motions, sensors
from sigmax.models.bias import Bias
from sigmax.models.derivatives import with_derivatives
from sigmax.models.fusion import fused
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model, angle
from sigmax.models.parts import Motion, Sensor

__all__ = ["Bias", "Gaussian", "Model", "Motion", "Sensor", "angle", "fused", "motions", "sensors", "with_derivatives"]

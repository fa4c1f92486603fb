"""Models: what moves, what is seen, and how uncertain both are."""

from sigmax.models import earth, motions, navigation, sensors
from sigmax.models.augment import augment
from sigmax.models.bias import Bias
from sigmax.models.components import angle, direction, extended_pose, part, pose2, pose3, rotation
from sigmax.models.constraint import constrain
from sigmax.models.correlated import after, correlated, shifted
from sigmax.models.correlated_at_end import correlated_at_end
from sigmax.models.derivatives import with_derivatives
from sigmax.models.fusion import fused
from sigmax.models.gaussian import Gaussian
from sigmax.models.imm import imm
from sigmax.models.inside import inside
from sigmax.models.model import Model
from sigmax.models.opaque import opaque
from sigmax.models.parts import Motion, Sensor
from sigmax.models.sde import sde
from sigmax.models.switching import SwitchingModel
from sigmax.models.terrain import Elevation, inertial_errors, radio_altimeter

__all__ = [
    "Bias",
    "Elevation",
    "Gaussian",
    "Model",
    "Motion",
    "Sensor",
    "SwitchingModel",
    "after",
    "angle",
    "augment",
    "constrain",
    "correlated",
    "correlated_at_end",
    "direction",
    "earth",
    "extended_pose",
    "fused",
    "imm",
    "inertial_errors",
    "inside",
    "motions",
    "navigation",
    "opaque",
    "part",
    "pose2",
    "pose3",
    "radio_altimeter",
    "rotation",
    "sde",
    "sensors",
    "shifted",
    "with_derivatives",
]

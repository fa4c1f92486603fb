"""Models: what moves, what is seen, and how uncertain both are."""

from sigmax.modelling.bias import Bias
from sigmax.modelling.components import angle, direction, extended_pose, part, pose2, pose3, rotation
from sigmax.modelling.constraint import constrain
from sigmax.modelling.derivatives import with_derivatives
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.imm import imm
from sigmax.modelling.inside import inside
from sigmax.modelling.model import Model
from sigmax.modelling.opaque import opaque
from sigmax.modelling.parts import Motion, Sensor
from sigmax.modelling.switching import SwitchingModel
from sigmax.models import earth, motions, navigation, sensors
from sigmax.models.sde import sde
from sigmax.models.terrain import Elevation, inertial_errors, radio_altimeter
from sigmax.rewriting.augment import augment
from sigmax.rewriting.correlated import after, correlated, shifted
from sigmax.rewriting.correlated_at_end import correlated_at_end
from sigmax.rewriting.fusion import fused

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

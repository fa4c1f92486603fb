"""Spaces of states and measurements: rules, steps and errors know them by ⊞ and ⊟ alone."""

from sigmax.algebra.arrays import wrap
from sigmax.spaces.direction import Direction
from sigmax.spaces.errors import errors
from sigmax.spaces.groups import Pose2, Pose3, Rotation
from sigmax.spaces.moments import moments
from sigmax.spaces.product import Product, product
from sigmax.spaces.quaternions import conjugate, cross, exponential, logarithm, multiply, rotate
from sigmax.spaces.readable import from_roll_pitch_yaw, in_world_axes, readable, roll_pitch_yaw
from sigmax.spaces.reset import reset
from sigmax.spaces.space import Flat, Space

# Every law about spaces holds for these; a space of your own belongs here too.
SPACES: dict[str, Space] = {
    "line": Flat((False,)),
    "circle": Flat((True,)),
    "rotation": Rotation(),
    "direction": Direction(),
    "pose2": Pose2(),
    "pose3": Pose3(),
    "extended pose": Pose3(velocity=True),
    "product": product(Flat((False, True)), Rotation(), Flat(), Direction()),
}

__all__ = [
    "SPACES",
    "Direction",
    "Flat",
    "Pose2",
    "Pose3",
    "Product",
    "Rotation",
    "Space",
    "conjugate",
    "cross",
    "errors",
    "exponential",
    "from_roll_pitch_yaw",
    "in_world_axes",
    "logarithm",
    "moments",
    "multiply",
    "product",
    "readable",
    "reset",
    "roll_pitch_yaw",
    "rotate",
    "wrap",
]

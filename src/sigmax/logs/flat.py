"""Messages with parts in parts as rows of numbers and texts."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

# A longer list is a picture or a scan, not a measurement.
_LONGEST = 36
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")


def flat(message: Any) -> dict[str, Any]:
    """The numbers and texts of a message by the path to each, "pose.position.x"; what is longer is left out.

    A covariance gives standard deviations, too: `x_std` beside `x`, where it says that it is one.
    """
    return dict(_parts(message, ""))


def _parts(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        inside: Any = value.items()
    elif is_dataclass(value):
        inside = ((f.name, getattr(value, f.name)) for f in fields(value))
    elif isinstance(value, np.ndarray | list | tuple):
        if len(value) <= _LONGEST and np.ndim(value) == 1 and np.asarray(value).dtype.kind in "biuf":
            yield from ((f"{path}_{k}", one) for k, one in enumerate(np.asarray(value).tolist()))
            if path.endswith("covariance"):
                yield from _deviations(np.asarray(value, float), path.removesuffix("covariance").rstrip("_"))
        return
    else:
        if isinstance(value, str | int | float | np.number | bool):
            yield path, value
        return
    for name, one in inside:
        if not str(name).startswith("__"):
            yield from _parts(one, f"{path}.{name}" if path else str(name))


def _deviations(covariance: np.ndarray, path: str) -> Iterator[tuple[str, float]]:
    size = round(len(covariance) ** 0.5)
    # Of no length a covariance is not known; a first number of −1 says so (sensor_msgs/Imu).
    if size * size != len(covariance) or size > len(_AXES) or not covariance[0] > 0:
        return
    for name, variance in zip(_AXES, np.diag(covariance.reshape(size, size)), strict=False):
        yield f"{path}{'' if not path or path.endswith('.') else '_'}{name}_std", float(np.sqrt(max(variance, 0.0)))

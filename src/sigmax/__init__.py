"""Nonlinear Kalman filtering for tracking and navigation: every filter a combination of a few parts.

Names are loaded when they are used, so that `import sigmax` and the command line start at once. What the import
does at once is to make JAX 64-bit, whether JAX is there already or comes later: filters subtract nearly equal
numbers for a living, and a constant made in float32 keeps its lost digits for ever.
"""

import importlib
import os
import sys
import warnings
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# JAX reads the variable when it is imported; once it is, only its own setting counts.
os.environ["JAX_ENABLE_X64"] = "1"
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)

_HOME = {
    "sigmax.errors": ("InputError",),
    "sigmax.examination": ("doctor",),
    "sigmax.export": ("export_c",),
    "sigmax.fitting": ("fit",),
    "sigmax.filters": ("Filter", "adaptive", "bank", "catalogue", "get", "iterated", "names", "once", "robust"),
    "sigmax.models": (
        "Bias",
        "Gaussian",
        "Model",
        "angle",
        "constrain",
        "direction",
        "earth",
        "extended_pose",
        "imm",
        "motions",
        "navigation",
        "pose2",
        "pose3",
        "rotation",
        "sde",
        "sensors",
    ),
    "sigmax.models.builtin": ("builtin",),
    "sigmax.running": ("Live", "Result", "constrained", "run", "smooth", "start"),
    "sigmax.studies": ("compare",),
    "sigmax.running.explain": ("explain",),
}
_WHERE = {name: module for module, names in _HOME.items() for name in names}
_MODULES = ("filters", "forms", "models", "records", "reports", "rules", "running", "spaces", "studies", "tracking")
# Where names of version 0.1 went that few need on their first day; they may be called here until 0.3.
_MOVED = {
    **dict.fromkeys(("Marginal", "SigmaPoints", "SigmaSet", "Taylor1", "Taylor2", "sigma_set"), "sigmax.rules"),
    **dict.fromkeys(("Form",), "sigmax.forms"),
    **dict.fromkeys(("Elevation", "Motion", "Sensor", "fused", "opaque", "part", "with_derivatives"), "sigmax.models"),
    **dict.fromkeys(("Contribution", "Fault", "Smoothed", "absorb", "contribution"), "sigmax.running"),
    **dict.fromkeys(("Fit",), "sigmax.fitting"),
    **dict.fromkeys(("Comparison", "Study", "load_studies", "undisturbed"), "sigmax.studies"),
    **dict.fromkeys(("wrap",), "sigmax.spaces"),
}

if TYPE_CHECKING:
    from typing import Any

    from sigmax import filters, forms, models, records, reports, rules, running, spaces, studies, tracking
    from sigmax.errors import InputError
    from sigmax.examination import doctor
    from sigmax.export import export_c
    from sigmax.filters import Filter, adaptive, bank, catalogue, get, iterated, names, once, robust
    from sigmax.fitting import fit
    from sigmax.models import (
        Bias,
        Gaussian,
        Model,
        angle,
        constrain,
        direction,
        earth,
        extended_pose,
        imm,
        motions,
        navigation,
        pose2,
        pose3,
        rotation,
        sde,
        sensors,
    )
    from sigmax.models.builtin import builtin
    from sigmax.running import Live, Result, constrained, run, smooth, start
    from sigmax.running.explain import explain
    from sigmax.studies import compare

__all__ = [
    "Bias",
    "Filter",
    "Gaussian",
    "InputError",
    "Live",
    "Model",
    "Result",
    "adaptive",
    "angle",
    "bank",
    "builtin",
    "catalogue",
    "compare",
    "constrain",
    "constrained",
    "direction",
    "doctor",
    "earth",
    "explain",
    "export_c",
    "extended_pose",
    "filters",
    "fit",
    "forms",
    "get",
    "imm",
    "iterated",
    "models",
    "motions",
    "names",
    "navigation",
    "once",
    "pose2",
    "pose3",
    "records",
    "reports",
    "robust",
    "rotation",
    "rules",
    "run",
    "running",
    "sde",
    "sensors",
    "smooth",
    "spaces",
    "start",
    "studies",
    "tracking",
]


def __getattr__(name: str) -> "Any":
    if name in _WHERE:
        return getattr(_module(_WHERE[name], name), name)
    if name in _MODULES:
        return _module(f"sigmax.{name}", name)
    if name in _MOVED:
        warnings.warn(f"sigmax.{name} is {_MOVED[name]}.{name} now", DeprecationWarning, stacklevel=2)
        return getattr(importlib.import_module(_MOVED[name]), name)
    raise AttributeError(f"module 'sigmax' has no attribute {name!r}")


def _module(path: str, name: str) -> "Any":
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError as error:
        from sigmax.errors import without_app

        told = without_app(f"sigmax.{name}", error)
        if told is None:
            raise
        raise ModuleNotFoundError(told, name=error.name) from error


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])

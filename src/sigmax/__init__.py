"""Nonlinear Kalman filtering for tracking and navigation: every filter a combination of a few parts.

Names are loaded when they are used, so that `import sigmax` and the command line start at once. What the import
does at once is to make JAX 64-bit, whether JAX is there already or comes later: filters subtract nearly equal
numbers for a living, and a constant made in float32 keeps its lost digits for ever.
"""

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# JAX reads the variable when it is imported; once it is, only its own setting counts.
os.environ["JAX_ENABLE_X64"] = "1"
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)

_HOME = {
    "sigmax.algebra.arrays": ("wrap",),
    "sigmax.errors": ("InputError",),
    "sigmax.export": ("export_c",),
    "sigmax.filters": ("Filter", "catalogue", "get", "iterated", "names", "once", "robust"),
    "sigmax.forms": ("Form",),
    "sigmax.models": (
        "Bias",
        "Elevation",
        "Gaussian",
        "Model",
        "Motion",
        "Sensor",
        "angle",
        "direction",
        "extended_pose",
        "fused",
        "motions",
        "opaque",
        "part",
        "pose2",
        "pose3",
        "rotation",
        "sensors",
        "with_derivatives",
    ),
    "sigmax.models.builtin": ("builtin",),
    "sigmax.rules": ("Marginal", "SigmaPoints", "SigmaSet", "Taylor1", "Taylor2", "sigma_set"),
    "sigmax.running": (
        "Contribution",
        "Fault",
        "Fit",
        "Live",
        "Result",
        "Smoothed",
        "absorb",
        "contribution",
        "fit",
        "run",
        "smooth",
    ),
    "sigmax.studies": ("Comparison", "Study", "compare", "load_studies", "undisturbed"),
    "sigmax.running.explain": ("explain",),
}
_WHERE = {name: module for module, names in _HOME.items() for name in names}
_MODULES = ("forms", "records", "reports", "rules", "spaces", "tracking")

if TYPE_CHECKING:
    from typing import Any

    from sigmax import forms, records, reports, rules, spaces, tracking
    from sigmax.algebra.arrays import wrap
    from sigmax.errors import InputError
    from sigmax.export import export_c
    from sigmax.filters import Filter, catalogue, get, iterated, names, once, robust
    from sigmax.forms import Form
    from sigmax.models import (
        Bias,
        Elevation,
        Gaussian,
        Model,
        Motion,
        Sensor,
        angle,
        direction,
        extended_pose,
        fused,
        motions,
        opaque,
        part,
        pose2,
        pose3,
        rotation,
        sensors,
        with_derivatives,
    )
    from sigmax.models.builtin import builtin
    from sigmax.rules import Marginal, SigmaPoints, SigmaSet, Taylor1, Taylor2, sigma_set
    from sigmax.running import Contribution, Fault, Fit, Live, Result, Smoothed, absorb, contribution, fit, run, smooth
    from sigmax.running.explain import explain
    from sigmax.studies import Comparison, Study, compare, load_studies, undisturbed

__all__ = [
    "Bias",
    "Comparison",
    "Contribution",
    "Elevation",
    "Fault",
    "Filter",
    "Fit",
    "Form",
    "Gaussian",
    "InputError",
    "Live",
    "Marginal",
    "Model",
    "Motion",
    "Result",
    "Sensor",
    "SigmaPoints",
    "SigmaSet",
    "Smoothed",
    "Study",
    "Taylor1",
    "Taylor2",
    "absorb",
    "angle",
    "builtin",
    "catalogue",
    "compare",
    "contribution",
    "direction",
    "explain",
    "export_c",
    "extended_pose",
    "fit",
    "forms",
    "fused",
    "get",
    "iterated",
    "load_studies",
    "motions",
    "names",
    "once",
    "opaque",
    "part",
    "pose2",
    "pose3",
    "records",
    "reports",
    "robust",
    "rotation",
    "rules",
    "run",
    "sensors",
    "sigma_set",
    "smooth",
    "spaces",
    "tracking",
    "undisturbed",
    "with_derivatives",
    "wrap",
]


def __getattr__(name: str) -> "Any":
    if name in _WHERE:
        return getattr(importlib.import_module(_WHERE[name]), name)
    if name in _MODULES:
        return importlib.import_module(f"sigmax.{name}")
    raise AttributeError(f"module 'sigmax' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])

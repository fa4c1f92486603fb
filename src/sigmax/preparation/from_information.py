"""Filter, model and prior where the prior is an information pair that leaves directions open: what is refused."""

from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter, FromInformation, once
from sigmax.forms import information, root_information
from sigmax.functions.linearity import check_linear, in_state
from sigmax.modelling.checks import is_traced
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.information import Information
from sigmax.modelling.model import Model
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, takes
from sigmax.modelling.switching import SwitchingModel
from sigmax.rules import Taylor1

_WAY = "; sigmax.start finds an ordinary prior in the first measurements"


def from_information(filter: Filter, model: Model, prior: Information) -> tuple[FromInformation, Gaussian]:
    """The filter that starts from the pair, and the pair in the place of mean and covariance.

    Raises:
        InputError: for a filter other than EIF and SREIF, and a model that is not linear with noises that do not depend
            on the state.
    """
    own = type(filter) is Filter and filter.form in (information, root_information)
    if not own or filter.predict != Taylor1() or filter.correct != Taylor1():
        raise InputError(
            f"the prior's information is singular, and {filter.name} begins with a covariance, which there is not: "
            f"take EIF or SREIF{_WAY}"
        )
    if filter.update not in (None, once) or filter.consider or filter.Q is not None:
        raise InputError(
            f"{filter!r} weighs, adapts or holds by what it knows, and the prior's information is singular: take plain "
            f"{filter.name}{_WAY}"
        )
    _check(model)
    return FromInformation.of(filter), Gaussian.unchecked(prior.y, prior.Y)


def information_of_bias(prior: Gaussian) -> Gaussian:
    """The pair of the bias's own prior, in the place of mean and covariance.

    Raises:
        InputError: where a component of it is known exactly, or leaves directions open.
    """
    if is_traced((prior.mean, prior.cov)):
        raise InputError("the bias's prior is being traced, and the state's information is singular")
    P = np.asarray(prior.cov, float)
    scale = np.sqrt(np.einsum("...ii->...i", P))
    if not (scale > 0).all() or np.linalg.eigvalsh(P / (scale[..., :, None] * scale[..., None, :])).min() < 1e-12:
        raise InputError(
            "where the state's information is singular, that of the bias must be finite: give it variances"
        )
    Y = np.linalg.inv(P)
    return Gaussian.unchecked(np.einsum("...ij,...j->...i", Y, np.asarray(prior.mean, float)), Y)


def somewhere(prior: Gaussian) -> Gaussian:
    """A prior to look at functions with: itself, and 0 where there is no mean."""
    return Gaussian(np.zeros(prior.size), np.eye(prior.size)) if isinstance(prior, Information) else prior


def _check(model: Model) -> None:
    said = "the prior's information is singular, and"
    if isinstance(model, SwitchingModel):
        raise InputError(f"{said} modes would be weighed by it: give a prior with a covariance{_WAY}")
    measured = [m.space for m in model.measured.values() if m is not None]
    if any(not space.flat or any(space.periodic) for space in (model.space, *measured)):
        raise InputError(
            f"{said} {model} has parts that turn or point: an angle of which nothing is known has no mean{_WAY}"
        )
    if model.domain is not None or model.constraints:
        raise InputError(f"{said} a domain or a constraint cuts what is not there: run without it{_WAY}")
    if any(model.noise_inside(s) is not None for s in (None, *model.sensors)):
        raise InputError(f"{said} a noise inside a function depends on the state: give it as Q or R{_WAY}")


def inputs_of(model: Model) -> int | None:
    """How many inputs a model takes, None for none, before any are there.

    Raises:
        InputError: where their names do not tell.
    """
    if not (model.motion_driven or any(map(model.sensor_driven, model.sensors))):
        return None
    if not model.inputs:
        raise InputError(
            "the prior's information is singular, and whether the model is linear shows once its inputs are known: "
            f"name them, as in sigmax.models.Motion(function, state, noise, inputs=('push',)), or take run{_WAY}"
        )
    return len(model.inputs)


def check_straight(model: Model, inputs: int | None) -> None:
    """Refuse a model that is not linear, or whose noises depend on the state; `inputs`: how many it has.

    Raises:
        InputError: for it.
    """
    said = "the prior's information is singular, which is for linear models"
    check_linear(model, inputs, said, "a prior with a covariance: sigmax.start finds one in the first measurements")
    for what, noise, allowed in _noises(model):
        count = takes(noise, what, allowed) if callable(noise) else 0
        if count > (allowed == OF_MOTION) and in_state(noise, count, allowed == OF_MOTION, model.size, inputs or 0):
            raise InputError(f"{said}, and {what} depends on the state, of which nothing is known{_WAY}")


def _noises(model: Model) -> list[tuple[str, Any, tuple[int, ...]]]:
    own = None if model.bias is None else model.bias.Q
    found: list[tuple[str, Any, tuple[int, ...]]] = [("Q", model.Q, OF_MOTION), ("the bias's Q", own, OF_MOTION)]
    return found + [(f"R of the sensor {s!r}" if s else "R", R, OF_SENSOR) for s, R in model.R.items()]

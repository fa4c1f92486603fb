"""What fused sensors need around a run: how they were fused, and what their members say of each other."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.filters import Filter, once
from sigmax.modelling.checks import is_traced, numbers
from sigmax.modelling.model import Model
from sigmax.rewriting.fusion import Fused, chosen, inputs_behind, name_of, put_together
from sigmax.rewriting.stack import stack
from sigmax.rules import Marginal, Taylor1
from sigmax.steps.step import LOG_2PI, Innovation


def additive(filter: Filter) -> bool:
    """Whether the contributions of sensors to the information add up: taken once, and with no Ω in W."""
    rule = filter.correct.rule if isinstance(filter.correct, Marginal) else filter.correct
    return filter.update in (None, once) and (not filter.form.omega or isinstance(rule, Taylor1))


def how(filter: Filter, model: Model) -> tuple[tuple[str, str], ...]:
    """How each sensor is fused, by its name; nothing where they are not."""
    return tuple(chosen(model, additive(filter)).items())


def check_inputs(model: Model, u: Any) -> None:
    """Refuse inputs that are missing: all fused sensors are evaluated, whichever were heard.

    Raises:
        InputError: where a sensor takes inputs and there are none.
    """
    driven = [s for s in model.sensors if model.sensor_driven(s)]
    if u is None and driven:
        raise InputError(f"the sensors are fused, and of them {driven} take inputs; give u=")


class Members(NamedTuple):
    """The sensors of a live filter that are fused: what comes at once, as one measurement.

    Attributes:
        model: with its sensors apart.
        name: of the one sensor.
    """

    model: Model
    name: str

    @classmethod
    def of(cls, model: Model) -> "tuple[Members | None, Model]":
        """The members, if there are any, and the model as an engine takes it."""
        return (None, model) if model.fusion is None else (cls(model, name_of(model)), stack(model))

    def inputs(self, u: Any) -> Any:
        """Inputs of a prediction, with nothing where the covariances of measurements stand."""
        return None if u is None else np.concatenate([u, np.zeros((*np.shape(u)[:-1], inputs_behind(self.model)))], -1)

    def together(self, z: Any, sensor: str | None, R: Any, u: Any, tracks: tuple[int, ...]) -> Fused:
        """Measurements (m,) or (B, m) by name as one.

        Raises:
            InputError: where they are not given by name, in another shape, or with a sensor or a noise beside them.
        """
        if not isinstance(z, Mapping) or sensor is not None:
            raise InputError(f"the sensors are fused: give what came at once as a dict by name of {list(self.model.R)}")
        if R is not None:
            raise InputError(
                "the sensors are fused, each with the R of the model; R= cannot be given with a measurement"
            )
        check_inputs(self.model, u)
        heard = {}
        for s, value in z.items():
            if s not in self.model.sensors:
                raise unknown("sensor", s, self.model.sensors)
            heard[s] = np.asarray(numbers(f"z[{s!r}]", value, missing=True), float)
            names = self.model.measurement[s] or ()
            if heard[s].shape != (*tracks, len(names)):
                raise InputError(
                    f"z[{s!r}] must have the shape {(*tracks, len(names))} for {list(map(str, names))}; "
                    f"it has {heard[s].shape}"
                )
        return put_together(self.model, heard, u)


def with_members(parts: dict[str, Any], total: Any, fused: Fused) -> tuple[Any, dict[str, Any]]:
    """Log-likelihood, NIS and counts as of all members, from those of what they were put together to."""
    array: Any = jnp if is_traced((parts, total, fused)) else np
    used = parts["dof"] > 0
    added = array.where(used, fused.disagreement, 0.0)
    merged = array.where(used, fused.components, 0).astype(parts["dof"].dtype)
    likelihood = -array.where(used, fused.volume, 0.0) - (added + merged * LOG_2PI) / 2
    changed = {"nis": added, "dof": merged, "step_log_likelihood": likelihood}
    parts = parts | {name: parts[name] + change for name, change in changed.items() if name in parts}
    return total + likelihood.sum(-1), parts


def with_members_live(told: Innovation, fused: Fused) -> Innovation:
    """The same for one step."""
    one = {"nis": told.nis, "dof": told.dof, "step_log_likelihood": told.log_likelihood}
    array: Any = jnp if is_traced((told, fused)) else np
    sums = (array.asarray(a)[..., None] for a in (fused.disagreement, fused.components, fused.volume))
    over_time = Fused(fused.z, fused.u, *sums)
    _, parts = with_members({k: array.asarray(v)[..., None] for k, v in one.items()}, 0.0, over_time)
    nis, dof, likelihood = (parts[k][..., 0] for k in one)
    return told._replace(nis=nis, dof=dof, log_likelihood=likelihood)

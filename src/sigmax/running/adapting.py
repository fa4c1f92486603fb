"""An R that a filter finds as it goes: what it knows of noises, and how a measurement changes that.

The noise of a sensor is L_r Λ^½ ε with Λ diagonal, L_r the factor of the model's R, so that all there is to know are
numbers λ, 1 where the model is right, whatever R is: numbers, a function, or different with each measurement.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import times
from sigmax.algebra.factor import Diagonal, Matrix, add, dense, solve_lower
from sigmax.errors import InputError
from sigmax.filters import Bank, Filter, ModeFilters
from sigmax.forms.noise import noise_factor
from sigmax.models.model import Model
from sigmax.models.switching import SwitchingModel
from sigmax.running.updating import Observed, update_on

# How often λ and the state are estimated from each other; a sweep leaves about 1 / memory of what was missing.
_SWEEPS = 2


class Adapted(NamedTuple):
    """A belief of an adaptive filter: mean (n, ...), lower factor (n, n, ...), what is known of noises (k, ...)."""

    mean: Any
    factor: Any
    known: Any


class Noises(NamedTuple):
    """Where it stands what is known of noises.

    Attributes:
        sensors: by name, from where to where its λ stand.
        size: numbers of all together.
    """

    sensors: tuple[tuple[str, int, int], ...] = ()
    size: int = 0

    def of(self, sensor: str) -> slice | None:
        """Where the λ of a sensor stand, None where its R is the model's."""
        return next((slice(a, b) for name, a, b in self.sensors if name == sensor), None)


def adapted_noises(filter: Filter, model: Model) -> Noises:
    """The noises that a filter adapts on a model of one mode, its bias written into its state."""
    if isinstance(filter, Bank | ModeFilters) or isinstance(model, SwitchingModel):
        return Noises()
    sensors, at = [], 0
    for sensor in model.sensors:
        if update_on(filter, model, sensor).memory is None:
            continue
        size = model.measured_space(sensor, len(model.measurement[sensor] or ())).dim
        sensors.append((sensor, at, at + size))
        at += size
    return Noises(tuple(sensors), at)


def adapts(filter: Filter, model: Model) -> bool:
    """Whether a filter, or one of a bank or of several modes, adapts a noise of the model."""
    models = model.models if isinstance(model, SwitchingModel) else (model,)
    filters = filter.modes if isinstance(filter, ModeFilters) else (filter,)
    return any(update_on(f, m, s).memory is not None for f in filters for m in models for s in m.sensors)


def check_adapted(filter: Filter, model: Model) -> None:
    """Refuse to adapt what cannot be adapted.

    Raises:
        InputError: for modes, a bank, fused sensors, noise inside a sensor, and R without names of what is measured.
    """
    if not adapts(filter, model):
        return
    said = f"{filter.name} adapts R"
    if isinstance(filter, Bank | ModeFilters) or isinstance(model, SwitchingModel):
        raise InputError(
            f"{said}, and modes or members of a bank would each find another one; adapt with a filter of one belief, or "
            "let modes differ in their R"
        )
    if model.fusion is not None:
        raise InputError(f"{said}, which fused sensors share; give the model before it was fused")
    for sensor in model.sensors:
        if update_on(filter, model, sensor).memory is None:
            continue
        where = f"of the sensor {sensor!r}" if sensor else "of the sensor"
        if model.noise_inside(sensor) is not None:
            raise InputError(f"{said}, and the noise {where} is inside its function: give it as R, or fit it")
        if model.measurement[sensor] is None:
            raise InputError(f"{said}, a number for each component {where}: name them with measurement= in the model")


def stretched(L: Matrix, by: jax.Array) -> Matrix:
    """A factor with its columns multiplied by numbers (m, ...)."""
    return Diagonal(L.entries * by) if isinstance(L, Diagonal) else L * by[None]


def adapted(
    memory: float, taken: Observed, before: jax.Array, seen: jax.Array, omega: bool
) -> tuple[Observed, jax.Array]:
    """The measurement with the noise that it makes likely, and λ (m, ...) after it.

    λ is inverse gamma with memory / 2 for its shape, what forgetting a share of 1 / memory leaves of any shape in the
    end. With ε = Λ^-½ L_r⁻¹ v, G = S_y⁻¹ L_r Λ^½ and e = S_y⁻¹ ν: E[ε_j² | z] = (Gᵀ e)_j² + 1 − |G_j|². Where there is
    no line missing anything, it is β of Särkkä and Nummenmaa 2009, without forming P or R.

    Args:
        memory: how many measurements are remembered.
        taken: with the noise as λ was before it.
        before: that λ.
        seen: which components were measured (m, ...).
        omega: whether the form takes what the line misses for noise.
    """
    line = taken.line
    if not omega:
        line = line._replace(residual=line.residual[:, :0], deficit=line.deficit[:, :0])
    now, noise = before, taken.noise
    for _ in range(_SWEEPS):
        Sy = add(noise_factor(line, noise)[0], line.slope)
        G = solve_lower(Sy, dense(noise))
        known = times(G.swapaxes(0, 1), solve_lower(Sy, taken.innovation))
        squared = now * (known * known + 1 - (G * G).sum(0))
        now = jnp.where(seen, before + (squared - before) / memory, before)
        noise = stretched(taken.noise, jnp.sqrt(now / before))
    return taken._replace(noise=noise), now

"""What the arrays of a result mean."""

from typing import NamedTuple

from sigmax.filters import Weight
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.modelling.units import Units
from sigmax.spaces import Space
from sigmax.steps.adaptive_noises import Noises


class Layout(NamedTuple):
    """What the arrays of a result mean.

    Attributes:
        state: names of the components of the state.
        space: where it lives.
        batched: whether the first axis is a batch.
        several: whether what was measured is told by sensor.
        bias: names of the components of the bias.
        bias_first: whether the bias stands before the state in what was stored, rather than behind it.
        fusion: how each sensor was fused with the others, by its name.
        modes: names of the modes, where the model has several.
        weights: what weighs the measurements of a sensor, by the name that it has in what was stored.
        filter: the name of the filter.
        named_deviations: names of the deviations of the state.
        units: of all components, by name.
        noises: those that the filter finds as it goes.
        from_information: whether what was stored behind means and factors is what is known of an open start.
        dated: whether stored times are instants: nanoseconds since 1970 rather than seconds.
    """

    state: tuple[str, ...]
    space: Space
    batched: bool
    several: bool
    bias: tuple[str, ...] = ()
    bias_first: bool = False
    fusion: tuple[tuple[str, str], ...] = ()
    modes: tuple[str, ...] = ()
    weights: tuple[tuple[str, Weight | None], ...] = ()
    filter: str = ""
    named_deviations: tuple[str, ...] = ()
    units: Units = ()
    noises: Noises = Noises()
    from_information: bool = False
    dated: bool = False

    @classmethod
    def of(cls, model: Model, batched: bool, bias_first: bool) -> "Layout":
        """The layout of a run on a model as the user has it."""
        bias = () if model.bias is None else model.bias.names
        modes = model.names if isinstance(model, SwitchingModel) else ()
        made = cls(model.state, model.space, batched, model.several, bias, bias_first and bool(bias), modes=modes)
        return made._replace(named_deviations=model.deviations, units=model.units)

    @property
    def numbers(self) -> tuple[slice, slice]:
        """Where the numbers of the state and of the bias stand in what was stored."""
        return self._places(len(self.state))

    @property
    def deviations(self) -> tuple[slice, slice]:
        """Where their deviations stand."""
        return self._places(self.space.dim)

    def _places(self, own: int) -> tuple[slice, slice]:
        p = len(self.bias)
        return (slice(p, p + own), slice(0, p)) if self.bias_first else (slice(0, own), slice(own, own + p))

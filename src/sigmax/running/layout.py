"""What the arrays of a result mean."""

from typing import NamedTuple

from sigmax.models.model import Model
from sigmax.spaces import Space


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
    """

    state: tuple[str, ...]
    space: Space
    batched: bool
    several: bool
    bias: tuple[str, ...] = ()
    bias_first: bool = False
    fusion: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, model: Model, batched: bool) -> "Layout":
        """The layout of a run on a model as an engine takes it."""
        several, bias = model.several, model.bias
        if bias is None:
            return cls(model.state, model.space, batched, several)
        return cls(model.state, model.space, batched, several, bias.names, bias.first)

    @property
    def own(self) -> slice:
        """Where the state stands in what was stored."""
        before = len(self.bias) if self.bias_first else 0
        return slice(before, before + len(self.state))

    @property
    def offsets(self) -> slice:
        """Where the bias stands in what was stored."""
        before = 0 if self.bias_first else len(self.state)
        return slice(before, before + len(self.bias))

"""The half-steps of any filter on any model, of one belief or of several, in one shape for both engines."""

from typing import Any, Protocol

from sigmax.algebra.factor import cholesky
from sigmax.filters import Bank, Filter, FromInformation, ModeFilters
from sigmax.mixtures.bank_steps import BankSteps
from sigmax.mixtures.mode_steps import ModeSteps
from sigmax.modelling.evaluate import noise_root
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.steps import smooth_step, step
from sigmax.steps.adaptive_noises import adapted_noises
from sigmax.steps.adaptive_steps import AdaptiveSteps
from sigmax.steps.information_steps import InformationSteps
from sigmax.steps.step import Belief, Innovation


class HalfSteps(Protocol):
    """Pure functions of small arrays, component first and batch last, that trace to plain operations."""

    def begin(self, mean: Any, cov: Any) -> tuple[Any, Any]:
        """The belief of a prior, and whether it is one (...)."""

    def predict(self, belief: Any, dt: Any, u: Any) -> tuple[Any, Any]:
        """The belief dt later, and the fault (...)."""

    def correct(self, sensor: str, R: Any, belief: Any, z: Any, u: Any) -> tuple[Any, Innovation, Any]:
        """The belief after a measurement, what it said, and the fault; R None for the model's."""


class _OneBelief:
    def __init__(self, filter: Filter, model: Model) -> None:
        self.filter, self.model, self.root = filter, model, noise_root(model.Q)

    def begin(self, mean: Any, cov: Any) -> tuple[Belief, Any]:
        factor, sound = cholesky(cov)
        return Belief(mean, factor), sound

    def predict(self, belief: Belief, dt: Any, u: Any) -> tuple[Belief, Any]:
        return step.predict(self.filter, self.model, self.root, belief, dt, u)

    def correct(self, sensor: str, R: Any, belief: Belief, z: Any, u: Any) -> tuple[Belief, Innovation, Any]:
        return step.correct(self.filter, self.model, sensor, self.model.R[sensor] if R is None else R, belief, z, u)

    def back(self, filtered: Belief, later: Belief, later_fault: Any, dt: Any, u: Any) -> tuple[Belief, Any]:
        new, failed = smooth_step.back(self.filter, self.model, self.root, filtered, later, later_fault, dt, u)
        return Belief(*new), failed


def half_steps(filter: Filter, model: Model) -> HalfSteps:
    """The half-steps of a filter on a model without a bias."""
    if isinstance(filter, FromInformation):
        return InformationSteps(filter, model)
    return BankSteps(filter, model) if isinstance(filter, Bank) else back_steps(filter, model)


def back_steps(filter: Filter, model: Model) -> _OneBelief | ModeSteps | AdaptiveSteps:
    """The same with the steps backwards of a smoother, which a bank takes from its members' filter."""
    if isinstance(model, SwitchingModel):
        assert isinstance(filter, ModeFilters)
        return ModeSteps(filter.modes, model)
    if adapted_noises(filter, model).size:
        return AdaptiveSteps(filter, model)
    return _OneBelief(filter, model)

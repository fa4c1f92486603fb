"""Fixed-interval smoothing from the same quantities as filtering."""

from typing import Any

import numpy as np

from sigmax.engine.backwards import backwards, check_smoothed
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.functions.current import current_model
from sigmax.modelling.checks import is_traced
from sigmax.modelling.model import Model
from sigmax.preparation.joining import modes_of
from sigmax.preparation.layout import Layout
from sigmax.preparation.prepare import as_filter, cast, laid_out_steps
from sigmax.preparation.times import times_of
from sigmax.results.result import Result
from sigmax.results.smoothed import Smoothed
from sigmax.rewriting.augment import augment
from sigmax.steps.adaptive_noises import adapted_noises


def smooth(
    filter: Filter | str | None,
    model: Model,
    result: Result,
    *,
    dt: Any = None,
    t: Any = None,
    inputs: Any = None,
    backend: str | None = None,
) -> Smoothed:
    """Estimates of every step from the whole record (Rauch, Tung and Striebel), in square-root form.

    Each step linearises the motion again with the filter's own rule about the filtered estimate:
    Cov(x, f(x)) = S Eᵀ is the numerator of the gain, and nothing else is needed.

    Args:
        filter: the filter of the run.
        model: the model of the run.
        result: what `run` gave, with mean, factor and fault kept, and modes where the model has several.
        dt: as given to the run, from which it is taken where it is left out; the first is not read.
        t: the same.
        inputs: the same.
        backend: as in `run`.

    Returns:
        Smoothed estimates; where a step could not be smoothed, the filtered estimate and a fault.

    Raises:
        InputError: where filter, model, dt, t or inputs are not those of the run, or a part of it was not kept.
    """
    model = current_model(model)
    if not isinstance(result, Result):
        raise InputError(f"result must be what sigmax.run gave, it is {type(result).__name__}")
    chosen = as_filter(filter, model).on(model.biases)
    for own, _ in modes_of(chosen, model):
        check_smoothed(own)
    kept = result.kept()
    dtype = kept[0].dtype
    check_layout(model, result.layout, chosen.form.bias_first)
    joint = augment(model, chosen.form.bias_first)
    if adapted_noises(chosen, joint) != result.layout.noises:
        raise InputError(f"{chosen.name} is not the filter of the run: other noises are found as it goes")
    steps = kept[0].shape[-2]
    asked = times_of(t, None) if dt is None else dt
    elapsed, u = laid_out_steps(
        model, result.dt if asked is None else asked, result.inputs if inputs is None else inputs, steps, dtype
    )
    if asked is not None:
        _check_same("dt" if t is None else "t", elapsed, result.stored_dt, 1)
    if inputs is not None:
        _check_same("inputs", u, result.stored_inputs, 2)
    model = cast(joint, dtype)
    traced = is_traced((kept, model, elapsed, u))
    made = backwards(chosen, model, kept, elapsed, u, result.layout.batched, traced, backend)
    # What is known of an open start is not smoothed.
    layout = result.layout._replace(from_information=False)
    return Smoothed(layout, *made, stored_dt=result.stored_dt, stored_time=result.stored_time)


def check_layout(model: Model, ran: Layout, bias_first: bool) -> None:
    """Refuse a model of other components than the run, and a filter that carries them in another order."""
    here = Layout.of(model, ran.batched, bias_first)
    for what, ours, theirs in (("state", here.state, ran.state), ("bias", here.bias, ran.bias)):
        if ours != theirs:
            raise InputError(f"the model is not that of the run: its {what} is {list(ours)}, of the run {list(theirs)}")
    if here.space != ran.space:
        marked = [name for name, angle in zip(ran.state, ran.space.periodic, strict=False) if angle]
        what = f"angles are {marked}" if ran.space.flat else f"space is {ran.space}"
        raise InputError(f"the model is not that of the run, whose {what}")
    if here.modes != ran.modes:
        raise InputError(f"the model is not that of the run: its modes are {here.modes}, of the run {ran.modes}")
    if here.several != ran.several:
        raise InputError("the model is not that of the run: one has a sensor, the other several by name")
    if here.bias_first != ran.bias_first:
        raise InputError("model and filter are not those of the run: state and bias stand in another order")


def _check_same(what: str, given: Any, ran: Any, core: int) -> None:
    """Refuse steps other than those of the run, as far as they are known; the first is not read."""
    if ran is None or is_traced((given, ran)):
        return
    ours, theirs = (np.delete(np.asarray(a), 0, -core) for a in (given, ran))
    # One for all tracks, or one for each; in other units of time the last digits may have been rounded another way.
    if ours.shape != theirs.shape[-ours.ndim :] or not np.allclose(ours, theirs, rtol=1e-6, atol=0):
        raise InputError(f"{what} must be those of the run, from which they are taken where {what}= is left out")

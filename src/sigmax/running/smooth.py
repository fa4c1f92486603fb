"""Fixed-interval smoothing from the same quantities as filtering."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.compiling import compiled, tracing
from sigmax.errors import InputError
from sigmax.filters import Filter, of_one_belief
from sigmax.models.augment import augment
from sigmax.models.checks import is_traced
from sigmax.models.model import Model
from sigmax.running import native_engine
from sigmax.running.adaptive_noises import adapted_noises
from sigmax.running.backend import attempt
from sigmax.running.current import current_model
from sigmax.running.half_steps import back_steps
from sigmax.running.joining import modes_of
from sigmax.running.layout import Layout
from sigmax.running.packing import Packing
from sigmax.running.prepare import as_filter, cast, laid_out_steps
from sigmax.running.result import Result
from sigmax.running.smoothed import Smoothed
from sigmax.running.times import times_of
from sigmax.running.xla_engine import batch_first, batch_last


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
    return Smoothed(result.layout, *made, stored_dt=result.stored_dt, stored_time=result.stored_time)


def check_smoothed(filter: Filter) -> None:
    """Refuse a filter whose estimates cannot be smoothed.

    Raises:
        InputError: where it considers components: its errors depend on all measurements by way of these, and a step
            backwards takes them for those of a filter that has used all it was told.
    """
    if filter.consider:
        raise InputError(
            f"{filter.name} considers {', '.join(filter.consider)}, and smoothing takes every component as estimated: "
            "run and smooth the same filter without consider="
        )


def backwards(
    filter: Filter, model: Model, kept: Any, dt: Any, u: Any, batched: bool, traced: bool, backend: str | None
) -> tuple[Any, Any, Any, Any]:
    """Smoothed means, factors, faults and modes of filtered ones, all with the batch first; the arguments checked."""
    filter = of_one_belief(filter)
    kept = kept if Packing.of(filter, model).tail else (*kept[:3], None)

    def with_xla() -> Any:
        mean, factor, fault, rest = (None if a is None else batch_last(a, a.ndim - batched) for a in kept)
        steps = batch_last(dt, 1), None if u is None else batch_last(u, 2)
        made = (_backwards if traced or tracing() else _compiled_backwards)(
            filter, model, mean, factor, fault, rest, *steps
        )
        return jax.tree.map(batch_first if batched else jnp.asarray if traced else np.asarray, made)

    def natively() -> Any:
        return native_engine.smoother(filter, model, 0 if u is None else u.shape[-1], kept[0].dtype)(kept, dt, u)

    made: tuple[Any, Any, Any, Any] = attempt(backend, traced, natively, with_xla)
    return made


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


def _backwards(
    filter: Filter, model: Model, mean: Any, factor: Any, fault: Any, rest: Any, dt: Any, u: Any
) -> tuple[Any, Any, Any, Any]:
    steps, packing = back_steps(filter, model), Packing.of(filter, model)
    arrays = [mean, factor, *packing.behind(rest)]

    def step(later: Any, at: Any) -> tuple[Any, Any]:
        now, next_fault, next_dt, next_u = at
        new, failed = steps.back(packing.belief(now), later, next_fault, next_dt, next_u)
        return new, (packing.arrays(new), failed)

    last = packing.belief([a[-1] for a in arrays])
    inputs = None if u is None else u[1:]
    _, (made, failed) = jax.lax.scan(step, last, ([a[:-1] for a in arrays], fault[1:], dt[1:], inputs), reverse=True)
    all_steps = [jnp.concatenate([a, b[-1:]]) for a, b in zip(made, arrays, strict=True)]
    failed = jnp.concatenate([failed, jnp.zeros_like(fault[-1:])])
    behind = jax.vmap(packing.rest)(packing.belief(all_steps)) if packing.tail else None
    return all_steps[0], all_steps[1], failed, behind


_compiled_backwards = compiled(_backwards, static=(0,))

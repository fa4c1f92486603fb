"""Records longer than memory: filtered forwards in windows, smoothed backwards from the last one to the first."""

import inspect
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sigmax.engine.backwards import backwards, check_smoothed
from sigmax.errors import InputError
from sigmax.filters import Filter, of_one_belief
from sigmax.functions.current import current_model
from sigmax.modelling.checks import is_traced
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.switching import check_one_mode
from sigmax.preparation.prepare import as_filter, cast
from sigmax.results.result import Result
from sigmax.results.smoothed import Smoothed
from sigmax.running.run import run
from sigmax.steps.adaptive_noises import adapts

_KEPT = ("mean", "factor", "fault")


def smooth_in_windows(
    filter: Filter | str, model: Model, prior: Gaussian, z: Any, *, steps: int = 65_536, **given: Any
) -> Iterator[tuple[slice, Smoothed]]:
    """Run and smooth a record so many steps at a time: what `smooth` gives of all of it, to rounding.

    The filter goes over the record once and keeps its belief at the end of each window; then each window, from the last
    one to the first, is filtered again and smoothed from the first step of the window after it. So nothing is lost, the
    filter's work is done twice, and memory holds two windows.

    Args:
        filter: as in `run`.
        model: as in `run`, without a bias of its own.
        prior: as in `run`.
        z: as in `run`; of an array in a file, such as `numpy.memmap`, a window is read at a time.
        steps: in a window.
        given: everything else that `run` takes, but keep.

    Yields:
        Which steps, as a slice, and their smoothed estimates: the last window first.

    Raises:
        InputError: for what a belief at the end of a window does not say all of: a bias, modes, adaptive noises; and
            with the first window whatever `run` raises.
    """
    if "keep" in given:
        raise InputError("what is kept of a window is decided here: leave keep= out")
    inspect.signature(run).bind(filter, model, prior, z, **given)
    if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or steps < 2:
        raise InputError(f"steps must be how many are smoothed at a time, 2 or more; it is {steps!r}")
    chosen = as_filter(filter)
    check_one_mode(model, "smooth_in_windows")
    check_smoothed(chosen)
    if model.bias is not None:
        raise InputError(
            f"a window begins with a belief of the state alone, and {model} has a bias: give augment(model)"
        )
    if adapts(chosen, model):
        raise InputError(
            f"{chosen.name} finds noises as it goes, which a window would not know: run and smooth the whole"
        )
    if is_traced((prior.mean, prior.cov)):
        raise InputError("windows are not traced: run and smooth the whole record in jax.jit and jax.grad")
    sizes = {np.shape(a)[-2] for a in (z.values() if isinstance(z, Mapping) else (z,)) if np.ndim(a) > 1}
    if len(sizes) != 1:
        raise InputError(f"z must be arrays (T, m) or (B, T, m) of one length; their lengths are {sorted(sizes)}")
    (count,) = sizes
    windows = [slice(k, min(k + steps, count)) for k in range(0, count, steps)]
    return _windows(of_one_belief(chosen), model, prior, z, given, windows, count)


def _windows(
    filter: Filter, model: Model, prior: Gaussian, z: Any, given: dict[str, Any], windows: list[slice], count: int
) -> Iterator[tuple[slice, Smoothed]]:
    def filtered(window: slice, prior: Gaussian) -> Result:
        return run(filter, model, prior, _cut(z, window, count), keep=_KEPT, **_at(given, window, count))

    beginnings, seconds, last = [prior], [0.0], None
    for window in windows:
        last = filtered(window, beginnings[-1])
        beginnings.append(Gaussian(last.mean[..., -1, :], last.cov[..., -1, :, :]))
        seconds.append(seconds[-1] + last.dt.sum(-1))
    after: tuple[Any, ...] | None = None
    for k in range(len(windows) - 1, -1, -1):
        result = last if k == len(windows) - 1 else filtered(windows[k], beginnings[k])
        assert result is not None
        kept = [result.stored_mean, result.stored_factor, result.stored_fault, result.dt, result.inputs]
        axes = (-2, -3, -1, -1, -2)
        if after is not None:
            kept = [_joined(a, b, axis) for a, b, axis in zip(kept, after, axes, strict=True)]
        *beliefs, dt, u = kept
        here = cast(current_model(model), beliefs[0].dtype)
        made = backwards(
            filter.on(0), here, (*beliefs, None), dt, u, result.layout.batched, False, given.get("backend")
        )
        first = [
            _first(a, axis)
            for a, axis in zip((*made[:2], result.stored_fault, result.dt, result.inputs), axes, strict=True)
        ]
        after = tuple(first)
        size = windows[k].stop - windows[k].start
        mean, factor, fault = (_first(a, axis, size) for a, axis in zip(made[:3], axes, strict=False))
        time = result.stored_time
        time = np.asarray(seconds[k])[..., None] + result.dt.cumsum(-1) if time is None else time
        yield windows[k], Smoothed(result.layout, mean, factor, fault, None, stored_dt=result.dt, stored_time=time)


def _first(a: Any, axis: int, size: int = 1) -> Any:
    return None if a is None else np.take(a, range(size), a.ndim + axis)


def _joined(a: Any, b: Any, axis: int) -> Any:
    return None if a is None else np.concatenate([a, b], a.ndim + axis)


def _cut(a: Any, window: slice, count: int) -> Any:
    """Rows of what is measured, or of noises: (T, …) or (B, T, …), by sensor or not."""
    if isinstance(a, Mapping):
        return {name: _cut(value, window, count) for name, value in a.items()}
    if not hasattr(a, "shape"):
        a = np.asarray(a)
    # (B, T, m) and (T, m, m) are told apart by their second length.
    return a[:, window] if a.ndim > 2 and a.shape[1] == count else a[window]


def _at(given: dict[str, Any], window: slice, count: int) -> dict[str, Any]:
    """The other arguments of `run` for one window."""
    here, begins = dict(given), window.start == 0
    for name in ("R", "inputs"):
        if given.get(name) is not None:
            here[name] = _cut(given[name], window, count)
    for name in ("dt", "t"):
        value = given.get(name)
        if value is None or np.ndim(value) == 0:
            continue
        array = value if hasattr(value, "shape") else np.asarray(value)
        missing = count - array.shape[-1]  # the first interval may be left out where the prior stands at the first step
        here[name] = array[..., max(window.start - missing, 0) : window.stop - missing]
        if name == "t" and not begins:
            here["t0"] = array[..., window.start - 1]
    if not begins:
        here["update_first"] = False
        if given.get("t") is None:
            here.pop("t0", None)
    return here

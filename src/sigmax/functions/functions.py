"""Checks of a model's own functions, evaluated before a run."""

import functools
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.functions.current import found_once
from sigmax.functions.plain_calls import check_calls, is_compared
from sigmax.functions.shapes import shape, shape_of
from sigmax.modelling.checks import is_traced, numbers, symmetric_semidefinite
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, arguments_of, takes
from sigmax.modelling.switching import SwitchingModel


def check_functions(
    model: Model, prior: Gaussian, dt: Any, u: Any, sizes: Mapping[str, int], dtype: Any = np.float64
) -> bool:
    """Evaluate shapes, and the numbers of Q and R at the start where they are functions.

    Args:
        model: the model as the user has it.
        prior: of its state.
        dt: seconds, of which the first count.
        u: inputs, of which the first count; without them what takes inputs is left out.
        sizes: how many components were measured, by sensor; others are left out.
        dtype: the type of the run.

    Returns:
        Whether a function has captured a number that is being traced, such as a parameter of a gradient.

    Raises:
        InputError: where a function of the model gives a shape or a type that does not fit, or reads beyond what it
            is given.
    """
    driven = u is not None
    captured = check_shapes(model, u.shape[-1] if driven else None, sizes, dtype)
    if captured or any(map(is_traced, (prior.mean, prior.cov, dt, u))):
        return captured
    if isinstance(model, SwitchingModel):
        for part in model.models:
            at = [model.state.index(name) for name in part.state]
            rows = [model.deviations.index(name) for name in part.deviations]
            cov = prior.cov[..., rows, :][..., rows]
            check_functions(part, Gaussian(prior.mean[..., at], cov), dt, u, sizes, dtype)
        return False
    if not _needs_numbers(model, driven, tuple(sizes.items())):
        return False
    start = np.asarray(prior.mean if prior.mean.ndim == 1 else prior.mean[0], dtype)
    first_dt = np.asarray(np.ravel(dt)[0], dtype)
    first_u = () if u is None else (np.asarray(u[(0,) * (u.ndim - 1)], dtype),)
    check_calls(model, prior, first_dt, first_u, sizes)
    for label, function, allowed, size in _noises(model, driven, sizes):
        _check_noise(label, function, arguments_of(function, label, allowed, start, first_dt, first_u), size)
    return False


def check_shapes(model: Model, inputs: int | None, sizes: Mapping[str, int], dtype: Any = np.float64) -> bool:
    """Evaluate the shapes of motion, sensors, domain and bias; no number is needed.

    Args:
        model: the model as the user has it.
        inputs: how many; None where it is not known: what takes inputs is left out.
        sizes: how many components are measured, by sensor; others are left out.
        dtype: the type of the run.

    Returns:
        As `check_functions`.

    Raises:
        InputError: as `check_functions`.
    """
    if isinstance(model, SwitchingModel):
        of_modes = [check_shapes(m, inputs, sizes, dtype) for m in model.models]
        return any(of_modes)
    captured, said = _shapes(model, inputs, tuple(sizes.items()), dtype)
    for text in said:
        warnings.warn(text, stacklevel=2)
    return captured


@found_once
def _needs_numbers(model: Model, driven: bool, measured: tuple[tuple[str, int], ...]) -> bool:
    """Whether noises are functions, or any function may be given numbers to compare."""
    functions = (model.motion, *(model.sensors[s] for s, _ in measured))
    return any(_noises(model, driven, dict(measured))) or any(map(is_compared, functions))


@found_once
def _shapes(
    model: Model, inputs: int | None, measured: tuple[tuple[str, int], ...], dtype: Any
) -> tuple[bool, tuple[str, ...]]:
    """See `check_shapes`, of a model of one mode; and what is to be warned of."""
    sizes, said = dict(measured), list[str]()
    n = model.size
    x, second = (jax.ShapeDtypeStruct(shape, dtype) for shape in ((n,), ()))
    given = () if inputs is None else (jax.ShapeDtypeStruct((inputs,), dtype),)
    found: list[bool] = []
    if model.domain is not None:
        found.append(shape_of("domain", model.domain, (x,), n, model.state, said))
    if given or not model.motion_driven:
        arguments = (x, second, *given)[: 3 if model.motion_inputs else 2]
        found.append(shape_of("motion", model.motion, arguments, n, model.state, said))
    sizes = {s: size for s, size in sizes.items() if given or not model.sensor_driven(s)}
    for s, size in sizes.items():
        names = model.measurement[s] or [f"column {i}" for i in range(size)]
        arguments = (x, *given)[: 2 if model.sensor_inputs[s] else 1]
        found.append(shape_of(f"sensor {s!r}" if s else "sensor", model.sensors[s], arguments, size, names, said))
    if model.bias is not None:
        found += _check_bias(model, x, second, given, sizes, said)
    for label, function, allowed, _ in _noises(model, bool(given), sizes):
        found.append(shape(label, function, arguments_of(function, label, allowed, x, second, given), said).captured)
    return any(found), tuple(said)


def _noises(model: Model, driven: bool, sizes: Mapping[str, int]) -> Iterator[tuple[str, Any, tuple[int, ...], int]]:
    """Noises that are functions: what they are called, how many arguments they may take, and their components."""
    moving = [("Q", model.Q, model.dim)]
    if model.bias is not None:
        moving.append(("the bias's Q", model.bias.Q, model.biases))
    if driven or not model.motion_driven:
        yield from ((label, Q, OF_MOTION, size) for label, Q, size in moving if callable(Q))
    for s, size in sizes.items():
        if callable(model.R[s]) and (driven or not model.sensor_driven(s)):
            yield f"R[{s!r}]" if s else "R", model.R[s], OF_SENSOR, model.measured_space(s, size).dim


def counted(model: Model) -> dict[str, int]:
    """How many components each sensor measures, of those whose components are named."""
    return {s: len(names) for s, names in model.measurement.items() if names is not None}


def _check_bias(
    model: Model, x: Any, dt: Any, given: tuple[Any, ...], sizes: Mapping[str, int], said: list[str]
) -> list[bool]:
    """Shapes of what a bias adds, where functions give it; a sensor's by the columns that were measured."""
    assert model.bias is not None
    p = model.bias.size
    wanted: list[tuple[str, Any, int, tuple[int, ...]]] = [
        ("the motion's bias B", model.bias.motion, model.dim, OF_MOTION)
    ]
    for s, F in model.bias.sensor.items():
        label = f"the bias F of the sensor {s!r}" if s else "the sensor's bias F"
        wanted += [(label, F, model.measured_space(s, sizes[s]).dim, OF_SENSOR)] if s in sizes else []
    # Where one of the two is a function, the numbers of the other are part of it.
    captured = [is_traced((model.Q, model.bias.Q))]
    for what, C, rows, allowed in wanted:
        if C is None or (not given and callable(C) and takes(C, what, allowed) == allowed[-1]):
            continue
        if callable(C):
            found = shape(what, C, arguments_of(C, what, allowed, x, dt, given), said)
            made = found.shape
            captured.append(found.captured)
        else:
            made = C.shape
            captured.append(is_traced(C))
        if made != (rows, p):
            raise InputError(f"{what} must have the shape {(rows, p)}; it has {made}")
    return captured


def _check_noise(label: str, function: Any, arguments: tuple[np.ndarray, ...], size: int) -> None:
    _check_noise_at(label, function, tuple((a.shape, a.dtype.char, a.tobytes()) for a in arguments), size)


@functools.lru_cache(maxsize=512)
def _check_noise_at(label: str, function: Any, at: tuple[tuple[tuple[int, ...], str, bytes], ...], size: int) -> None:
    """Made once for the same arguments: evaluating a function outside a compilation takes milliseconds.

    It is compiled as a whole: each of its operations by itself would take as long.
    """
    arguments = [jnp.asarray(np.frombuffer(content, kind).reshape(shape)) for shape, kind, content in at]
    shape(label, function, tuple(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in arguments), [])
    value = numbers(f"{label}(…)", jax.jit(function)(*arguments))
    if is_traced(value):
        return
    if not np.isfinite(value).all():
        # Called with numbers that it sees, it may say itself what is wrong.
        value = numbers(f"{label}(…)", function(*arguments))
    if value.shape not in ((size,), (size, size)):
        raise InputError(
            f"{label}(…) must give a covariance of shape {(size, size)} or {size} variances, not {value.shape}"
        )
    symmetric_semidefinite(f"{label}(…) at the start", np.diag(value) if value.ndim == 1 else value)

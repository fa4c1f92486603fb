"""Checks of a model's own functions, evaluated before a run."""

import functools
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters.partial_eval import dce_jaxpr

from sigmax.errors import InputError
from sigmax.models.checks import is_traced, numbers, symmetric_semidefinite
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model
from sigmax.models.noise import OF_MOTION, OF_SENSOR, arguments_of, takes
from sigmax.models.switching import SwitchingModel
from sigmax.native.refusal import user_line
from sigmax.running.bounds import check_indices
from sigmax.running.plain_calls import check_calls
from sigmax.running.precision import coarse_constants

# What is returned in another shape, and what to write.
_SHAPED = {0: ", a number: write np.array([…]) around it", 2: ": write .ravel() behind it"}


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
    if captured or is_traced((prior, dt, u)):
        return captured
    if isinstance(model, SwitchingModel):
        for part in model.models:
            at = [model.state.index(name) for name in part.state]
            rows = [model.deviations.index(name) for name in part.deviations]
            cov = prior.cov[..., rows, :][..., rows]
            check_functions(part, Gaussian(prior.mean[..., at], cov), dt, u, sizes, dtype)
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
    n = model.size
    x, second = (jax.ShapeDtypeStruct(shape, dtype) for shape in ((n,), ()))
    given = () if inputs is None else (jax.ShapeDtypeStruct((inputs,), dtype),)
    found: list[bool] = []
    if model.domain is not None:
        found.append(_shape_of("domain", model.domain, (x,), n, model.state))
    if given or not model.motion_driven:
        arguments = (x, second, *given)[: 3 if model.motion_inputs else 2]
        found.append(_shape_of("motion", model.motion, arguments, n, model.state))
    sizes = {s: size for s, size in sizes.items() if given or not model.sensor_driven(s)}
    for s, size in sizes.items():
        names = model.measurement[s] or [f"column {i}" for i in range(size)]
        arguments = (x, *given)[: 2 if model.sensor_inputs[s] else 1]
        found.append(_shape_of(f"sensor {s!r}" if s else "sensor", model.sensors[s], arguments, size, names))
    if model.bias is not None:
        found += _check_bias(model, x, second, given, sizes)
    for label, function, allowed, _ in _noises(model, bool(given), sizes):
        found.append(_shape(label, function, arguments_of(function, label, allowed, x, second, given)).captured)
    return any(found)


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


def _check_bias(model: Model, x: Any, dt: Any, given: tuple[Any, ...], sizes: Mapping[str, int]) -> list[bool]:
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
            found = _shape(what, C, arguments_of(C, what, allowed, x, dt, given))
            shape = found.shape
            captured.append(found.captured)
        else:
            shape = C.shape
            captured.append(is_traced(C))
        if shape != (rows, p):
            raise InputError(f"{what} must have the shape {(rows, p)}; it has {shape}")
    return captured


def _check_noise(label: str, function: Any, arguments: tuple[np.ndarray, ...], size: int) -> None:
    _check_noise_at(label, function, tuple((a.shape, a.dtype.char, a.tobytes()) for a in arguments), size)


@functools.lru_cache(maxsize=512)
def _check_noise_at(label: str, function: Any, at: tuple[tuple[tuple[int, ...], str, bytes], ...], size: int) -> None:
    """Made once for the same arguments: evaluating a function outside a compilation takes milliseconds."""
    arguments = [jnp.asarray(np.frombuffer(content, kind).reshape(shape)) for shape, kind, content in at]
    _shape(label, function, tuple(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in arguments))
    value = numbers(f"{label}(…)", function(*arguments))
    if is_traced(value):
        return
    if value.shape not in ((size,), (size, size)):
        raise InputError(
            f"{label}(…) must give a covariance of shape {(size, size)} or {size} variances, not {value.shape}"
        )
    symmetric_semidefinite(f"{label}(…) at the start", np.diag(value) if value.ndim == 1 else value)


class _Evaluated(NamedTuple):
    """What a function gives: shape, type, whether it depends on anything.

    And what it holds: constants of too few digits, and whether a number that is being traced.
    """

    shape: tuple[int, ...]
    kind: np.dtype[Any]
    varies: bool
    coarse: list[str]
    captured: bool


@functools.lru_cache(maxsize=512)
def _evaluated(function: Any, arguments: tuple[Any, ...]) -> _Evaluated:
    """Found once, because tracing costs more than a short run."""
    traced, made = jax.make_jaxpr(lambda *a: _as_array(function(*a)), return_shape=True)(*arguments)
    check_indices(traced)
    _, used = dce_jaxpr(traced.jaxpr, [True])
    double = arguments[0].dtype == np.float64
    coarse = coarse_constants(function, traced) if double else []
    if double and made.dtype == np.float32:
        coarse.append("what it returns")
    return _Evaluated(made.shape, np.dtype(made.dtype), any(used), coarse, is_traced(traced.consts))


def _as_array(result: Any) -> jax.Array:
    if result is None:
        raise InputError("it returns nothing: is a return missing?")
    try:
        return jnp.asarray(result)
    except (TypeError, ValueError) as error:
        if isinstance(error, jax.errors.JAXTypeError):
            raise
        raise InputError(f"it returns {type(result).__name__}, which is no array of numbers; {error}") from error


def _shape(what: str, function: Any, arguments: tuple[Any, ...]) -> _Evaluated:
    """What a function gives, of real numbers or of whole ones that are the same for all arguments."""
    try:
        found = _evaluated(function, arguments)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    except IndexError as error:
        shapes = [a.shape for a in arguments]
        raise InputError(
            f"{what}, given arrays of the shapes {shapes} (a state is (n,), no column (n, 1)): {error}"
        ) from error
    except (jax.errors.JAXTypeError, jax.errors.ConcretizationTypeError) as error:
        where = user_line(error)
        raise InputError(
            f"{what} needs its numbers to be known while it is compiled{f' ({where})' if where else ''}: write it with "
            "numpy or jax.numpy, where() in the place of if, without float(); or hand it over as "
            "sigmax.models.opaque(…)"
        ) from error
    except Exception as error:
        error.add_note(
            f"sigmax: this happened while evaluating {what} on arrays of shapes {[a.shape for a in arguments]}"
        )
        raise
    if found.coarse:
        warnings.warn(
            f"in {what} {' and '.join(found.coarse)} has the seven digits of float32, and the run is in float64: make "
            "it after `import sigmax`, or from Python's own floats; .astype(float) says that they are all there are",
            stacklevel=2,
        )
    if not jnp.issubdtype(found.kind, jnp.floating) and (found.varies or found.kind.kind not in "iu"):
        raise InputError(
            f"{what} must return real numbers of float64; it returns {found.kind}, which has no derivative: leave out "
            "the conversion to whole numbers, complex ones or truth values"
        )
    return found


def _shape_of(what: str, function: Any, arguments: tuple[Any, ...], size: int, names: Any) -> bool:
    found = _shape(what, function, arguments)
    if not jnp.issubdtype(found.kind, jnp.floating):
        raise InputError(f"{what} must return real numbers of float64, it returns {found.kind}: write 1.0 for 1")
    if found.shape != (size,):
        named = list(names)
        hint = _SHAPED.get(len(found.shape), "") if np.prod(found.shape) == size else ""
        raise InputError(
            f"{what} must return the {size} components {named}, shape ({size},); it returns {found.shape}{hint}"
        )
    return found.captured

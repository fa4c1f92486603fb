"""Checks of a model's own functions, evaluated before a run."""

import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.models.checks import is_traced, numbers, symmetric_semidefinite
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model
from sigmax.models.noise import OF_MOTION, OF_SENSOR, takes
from sigmax.native.refusal import user_line
from sigmax.running.bounds import check_indices


def check_functions(model: Model, prior: Gaussian, dt: Any, u: Any, sizes: Mapping[str, int]) -> None:
    """Evaluate shapes, and the numbers of Q and R at the start where they are functions.

    Args:
        model: the model as the user has it.
        prior: of its state.
        dt: seconds, of which the first count.
        u: inputs, of which the first count; without them what takes inputs is left out.
        sizes: how many components were measured, by sensor; others are left out.

    Raises:
        InputError: where a function of the model gives a shape that does not fit, or reads beyond what it is given.
    """
    driven = u is not None
    check_shapes(model, u.shape[-1] if driven else None, sizes)
    if is_traced((prior, dt, u)):
        return
    start = np.asarray(prior.mean if prior.mean.ndim == 1 else prior.mean[0])
    first_dt = np.ravel(dt)[0]
    first_u = () if u is None else (np.asarray(u)[(0,) * (u.ndim - 1)],)
    moving = [("Q", model.Q, model.size)]
    if model.bias is not None:
        moving.append(("the bias's Q", model.bias.Q, model.biases))
    for label, Q, size in moving:
        if callable(Q) and (driven or not model.motion_driven):
            count = takes(Q, label, OF_MOTION)
            _check_noise(label, Q, ((first_dt,) if count == 1 else (start, first_dt, *first_u)[:count]), size)
    for s, size in sizes.items():
        R = model.R[s]
        if callable(R) and (driven or not model.sensor_driven(s)):
            label = f"R[{s!r}]" if s else "R"
            _check_noise(label, R, (start, *first_u)[: takes(R, label, OF_SENSOR)], size)


def check_shapes(model: Model, inputs: int | None, sizes: Mapping[str, int]) -> None:
    """Evaluate the shapes of motion, sensors and bias; no number is needed.

    Args:
        model: the model as the user has it.
        inputs: how many; None where it is not known: what takes inputs is left out.
        sizes: how many components are measured, by sensor; others are left out.

    Raises:
        InputError: as `check_functions`.
    """
    n = model.size
    x = jax.ShapeDtypeStruct((n,), jnp.float64)
    second = jax.ShapeDtypeStruct((), jnp.float64)
    given = () if inputs is None else (jax.ShapeDtypeStruct((inputs,), jnp.float64),)
    if given or not model.motion_driven:
        _shape_of("motion", model.motion, (x, second, *given)[: 3 if model.motion_inputs else 2], n, model.state)
    sizes = {s: size for s, size in sizes.items() if given or not model.sensor_driven(s)}
    for s, size in sizes.items():
        names = model.measurement[s] or [f"column {i}" for i in range(size)]
        arguments = (x, *given)[: 2 if model.sensor_inputs[s] else 1]
        _shape_of(f"sensor {s!r}" if s else "sensor", model.sensors[s], arguments, size, names)
    if model.bias is not None:
        _check_bias(model, given, sizes)


def counted(model: Model) -> dict[str, int]:
    """How many components each sensor measures, of those whose components are named."""
    return {s: len(names) for s, names in model.measurement.items() if names is not None}


def _check_bias(model: Model, given: tuple[Any, ...], sizes: Mapping[str, int]) -> None:
    """Shapes of what a bias adds, where functions give it; a sensor's by the columns that were measured."""
    assert model.bias is not None
    p = model.bias.size
    x, dt = (jax.ShapeDtypeStruct(shape, jnp.float64) for shape in ((model.size,), ()))
    wanted: list[tuple[str, Any, tuple[Any, ...], int, tuple[int, ...]]] = [
        ("the motion's bias B", model.bias.motion, (x, dt, *given), model.size, OF_MOTION)
    ]
    for s, F in model.bias.sensor.items():
        label = f"the bias F of the sensor {s!r}" if s else "the sensor's bias F"
        wanted += [(label, F, (x, *given), sizes[s], OF_SENSOR)] if s in sizes else []
    for what, C, arguments, rows, allowed in wanted:
        if C is None or (not given and callable(C) and takes(C, what, allowed) == allowed[-1]):
            continue
        if callable(C):
            count = takes(C, what, allowed)
            arguments = (dt,) if allowed == OF_MOTION and count == 1 else arguments[:count]
            shape = _shape(what, C, arguments)
        else:
            shape = C.shape
        if shape != (rows, p):
            raise InputError(f"{what} must have the shape {(rows, p)}; it has {shape}")


def _check_noise(label: str, function: Any, arguments: tuple[np.ndarray, ...], size: int) -> None:
    _check_noise_at(label, function, tuple((a.shape, a.tobytes()) for a in arguments), size)


@functools.lru_cache(maxsize=512)
def _check_noise_at(label: str, function: Any, at: tuple[tuple[tuple[int, ...], bytes], ...], size: int) -> None:
    """Made once for the same arguments: evaluating a function outside a compilation takes milliseconds."""
    arguments = [jnp.asarray(np.frombuffer(content).reshape(shape)) for shape, content in at]
    _shape(label, function, tuple(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in arguments))
    value = numbers(f"{label}(…)", function(*arguments))
    if is_traced(value):
        return
    if value.shape not in ((size,), (size, size)):
        raise InputError(
            f"{label}(…) must give a covariance of shape {(size, size)} or {size} variances, not {value.shape}"
        )
    symmetric_semidefinite(f"{label}(…) at the start", np.diag(value) if value.ndim == 1 else value)


@functools.lru_cache(maxsize=512)
def _evaluated_shape(function: Any, arguments: tuple[Any, ...]) -> tuple[int, ...]:
    """The shape a function gives; found once, because tracing costs more than a short run."""
    traced, made = jax.make_jaxpr(lambda *a: jnp.asarray(function(*a)), return_shape=True)(*arguments)
    check_indices(traced)
    shape: tuple[int, ...] = made.shape
    return shape


def _shape(what: str, function: Any, arguments: tuple[Any, ...]) -> tuple[int, ...]:
    try:
        return _evaluated_shape(function, arguments)
    except IndexError as error:
        shapes = [a.shape for a in arguments]
        raise InputError(f"{what}, given arrays of the shapes {shapes}: {error}") from error
    except (jax.errors.JAXTypeError, jax.errors.ConcretizationTypeError) as error:
        where = user_line(error)
        raise InputError(
            f"{what} needs its numbers to be known while it is compiled{f' ({where})' if where else ''}: write it with "
            "jax.numpy, jnp.where in the place of if, without float(); or hand it over as sigmax.opaque(…)"
        ) from error
    except Exception as error:
        error.add_note(
            f"sigmax: this happened while evaluating {what} on arrays of shapes {[a.shape for a in arguments]}"
        )
        raise


def _shape_of(what: str, function: Any, arguments: tuple[Any, ...], size: int, names: Any) -> None:
    shape = _shape(what, function, arguments)
    if shape != (size,):
        raise InputError(f"{what} must return the {size} components {list(names)}, shape ({size},); it returns {shape}")


def check_linear(model: Model, prior: Gaussian, dt: Any, u: Any) -> None:
    """Refuse a model whose derivative is not the same everywhere, its bias included."""
    if is_traced((prior, dt, u)):
        return
    n = model.size
    rng = np.random.default_rng(0)
    points = rng.standard_normal((2, n)) * 10
    first_dt = float(np.ravel(dt)[0])
    given = () if u is None else (jnp.asarray(np.reshape(u, (-1, u.shape[-1]))[0]),)
    functions = {
        "motion": functools.partial(_drop, model.motion, (first_dt, *given)[: 2 if model.motion_inputs else 1])
    }
    for s, h in model.sensors.items():
        functions[f"sensor {s!r}" if s else "sensor"] = functools.partial(_drop, h, given[: model.sensor_inputs[s]])
    if model.bias is not None:
        B, F = model.bias.motion, model.bias.sensor
        bent = [f"F of the sensor {s!r}" if s else "F" for s, C in F.items() if callable(C)]
        bent += ["B"] if callable(B) and takes(B, "B", OF_MOTION) > 1 else []
        if bent:
            raise InputError(f"KF is for linear models, and {bent[0]} of the bias depends on the state; take EKF")
    for what, g in functions.items():
        a, b = (np.asarray(jax.jacfwd(g)(jnp.asarray(p))) for p in points)
        if not np.allclose(a, b, rtol=1e-9, atol=1e-12 * np.abs(a).max(initial=1)):
            raise InputError(f"KF is for linear models, and {what} is not linear; take EKF or a sigma-point filter")


def _drop(function: Any, rest: tuple[Any, ...], x: Any) -> Any:
    return jnp.asarray(function(x, *rest))

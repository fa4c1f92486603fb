"""The edge: what a user gives, checked before any long work and laid out for the engine."""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Bank, Filter, FromInformation, ModeFilters, get
from sigmax.functions.current import current_model, found_once
from sigmax.functions.functions import check_functions
from sigmax.functions.linearity import check_linear
from sigmax.modelling.checks import by_name, enough_memory, finite, is_traced, numbers
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.preparation.cautions import warn_before
from sigmax.preparation.from_information import check_straight, somewhere
from sigmax.preparation.intervals import intervals
from sigmax.preparation.joining import joined, modes_of
from sigmax.preparation.layout import Layout
from sigmax.preparation.measurements import measurements_of, steps_of
from sigmax.rewriting.fusion import Fused, put_together
from sigmax.rewriting.noise_by_row import noises_by_row, with_noise_by_row
from sigmax.rewriting.stack import stack


class Prepared(NamedTuple):
    """A record ready to run, in the type of the run: the batch first where there is one, then time.

    State and bias of a model that has one stand together, in the order of the filter's form.

    Attributes:
        filter: as it runs on the model.
        model: with its noises in the type of the run, and without a bias: that is in the state.
        mean: (n,) or (B, n).
        cov: (n, n) or (B, n, n).
        z: by sensor, (T, m) or (B, T, m).
        dt: (T,) or (B, T).
        u: (T, k) or (B, T, k), or None.
        batch: B, or None; what has no batch of its own is the same for all tracks.
        layout: what the arrays of the result mean.
        fused: what was put together before the run, where sensors are fused.
        update_first: whether the first step is a correction alone.
        captured: whether a function of the model holds a number that is being traced.
        inputs: u as the user gave it, without what fusion puts behind it.
    """

    filter: Filter
    model: Model
    mean: Any
    cov: Any
    z: dict[str, Any]
    dt: Any
    u: Any
    batch: int | None
    layout: Layout
    fused: Fused | None = None
    update_first: bool = False
    captured: bool = False
    inputs: Any = None

    @property
    def traced(self) -> bool:
        """Whether any of its numbers, or one that a function of the model holds, is being traced."""
        given = self.mean, self.cov, self.dt, self.u, self.inputs, self.fused, *self.z.values()
        return self.captured or any(map(is_traced, given)) or _traced(self.model)


def as_filter(filter: Filter | str | None, model: Model | None = None) -> Filter:
    """A filter from its name or itself, on a model of several modes one for each of them.

    Raises:
        InputError: for what is no filter, or one that no mode would take.
    """
    if isinstance(model, SwitchingModel) and not isinstance(filter, ModeFilters):
        if filter is not None and all(model.filters):
            raise InputError(
                f"all modes, {list(model.names)}, name their own filters: give None in the place of {filter}"
            )
        if isinstance(filter, Bank) or any(isinstance(own, Bank) for own in model.filters):
            raise InputError("a mode has one belief, and a bank several: name the filter of the bank's members")
        return ModeFilters.of([own or as_filter(filter) for own in model.filters])
    if isinstance(filter, Filter):
        return filter
    if isinstance(filter, str):
        return get(filter)
    raise InputError(f"a filter is a name such as 'SRCKFB' or made by sigmax.get; this is {type(filter).__name__}")


def prepare(
    filter: Filter,
    model: Model,
    prior: Gaussian,
    z: Any,
    dt: Any,
    inputs: Any,
    dtype: Any,
    update_first: bool = False,
    keep: Collection[str] = (),
    R: Any = None,
) -> Prepared:
    """Check everything and lay it out; the arguments are those of `run`.

    Raises:
        InputError: for whatever does not fit, in words.
    """
    model = current_model(model)
    given, asked = model, prior
    filter, model, prior = joined(filter, model, prior)
    measured = measurements_of(model, z)
    T = steps_of(measured)
    sizes = {s: v.shape[-1] for s, v in measured.items()}
    # Before anything is laid out; whether the batches fit each other is seen below.
    shapes = [*((v, 3) for v in measured.values()), (prior.mean, 2), (prior.cov, 3), (dt, 2), (inputs, 3)]
    tracks = max((a.shape[0] for a, core in shapes if len(getattr(a, "shape", ())) == core), default=1)
    enough_memory(f"a run of {tracks} tracks over {T} steps", _stored(prior.size, sizes, keep) * tracks * T)
    if not isinstance(update_first, bool):
        raise InputError(f"update_first must be True or False, it is {update_first!r}")
    elapsed = intervals(dt, T, update_first)
    u = inputs_given = _inputs(model, inputs, T)
    for own, part in modes_of(filter, model):
        warn_before(own, part, prior, None if u is None else u.shape[-1])
    fused = None
    if R is not None:
        model, u = with_noise_by_row(model, noises_by_row(model, measured, R), u)
    if model.fusion is not None:
        fused = put_together(model, measured, u)
        model = stack(model)
        (name,) = model.sensors
        measured, u = {name: fused.z}, fused.u
    batches = {f"z[{s!r}]" if s else "z": v.shape[0] for s, v in measured.items() if v.ndim == 3}
    batches |= {"the prior": len(prior.mean)} if prior.mean.ndim == 2 else {}
    batches |= {"the prior's covariance": len(prior.cov)} if prior.cov.ndim == 3 else {}
    batches |= {"dt": len(elapsed)} if elapsed.ndim == 2 else {}
    batches |= {"inputs" if R is None else "inputs and R": len(u)} if u is not None and u.ndim == 3 else {}
    if len(set(batches.values())) > 1:
        raise InputError(f"the batches differ in size: {batches}")
    batch = next(iter(batches.values()), None)
    dtype = run_type(dtype)
    captured = check_functions(given, somewhere(asked), elapsed, inputs_given, sizes, dtype)
    for own, part in modes_of(filter, given):
        if own.linear and part.curved:
            raise InputError(
                "KF is for linear models, and this one lives in a curved space; take EKF or a sigma-point filter"
            )
        if isinstance(filter, FromInformation):
            check_straight(part, None if inputs_given is None else inputs_given.shape[-1])
        # Where a function holds a traced number its slopes are not known; `fit` has seen them at its start.
        if own.linear and not captured:
            check_linear(part, None if inputs_given is None else inputs_given.shape[-1])

    return Prepared(
        filter,
        _cast(model, dtype),
        typed(prior.mean, dtype),
        typed(prior.cov, dtype),
        {s: typed(v, dtype) for s, v in measured.items()},
        typed(elapsed, dtype),
        None if u is None else typed(u, dtype),
        batch,
        _layout(given, batch is not None, filter.form.bias_first),
        fused,
        update_first,
        captured,
        None if inputs_given is None else typed(inputs_given, dtype),
    )


def _stored(n: int, sizes: Mapping[str, int], keep: Collection[str]) -> float:
    """How many numbers of a result are kept of each track and step."""
    each = {"mean": n, "factor": n * n, "innovation": sum(m + m * m for m in sizes.values())}
    return sum((each.get(part, 1) for part in keep), start=0.0)


def laid_out_steps(model: Model, dt: Any, inputs: Any, T: int, dtype: Any) -> tuple[Any, Any]:
    """Dt (T,) or (B, T) and inputs (T, k) or (B, T, k) of a run, checked and in its type."""
    # No smoother goes back beyond the first step: its dt is never read.
    elapsed, u = intervals(dt, T, True), _inputs(model, inputs, T)
    return typed(elapsed, dtype), None if u is None else typed(u, dtype)


def run_type(dtype: Any) -> np.dtype[Any]:
    """The type of a run.

    Raises:
        InputError: for anything but float64 and float32.
    """
    try:
        found = np.dtype(dtype)
    except Exception:  # NumPy raises what it likes for what is no type
        found = None
    if found is None or found not in (np.float64, np.float32):
        raise InputError(f"dtype must be float64 or float32, it is {dtype!r}")
    return found


def typed(a: Any, dtype: Any) -> Any:
    """An array in the type of a run: of NumPy where its numbers are known."""
    return jnp.asarray(a, dtype) if is_traced(a) else np.asarray(a, dtype)


def cast(model: Model, dtype: Any) -> Model:
    """The model with its noises in another type."""
    leaves = jax.tree.leaves(model)
    if all(isinstance(leaf, np.ndarray) and leaf.dtype == dtype for leaf in leaves):
        return model
    return jax.tree.map(lambda leaf: typed(leaf, dtype), model)


_traced, _cast, _layout = found_once(is_traced), found_once(cast), found_once(Layout.of)


def _inputs(model: Model, inputs: Any, T: int) -> Any:
    wanting = ["motion"] if model.motion_driven else []
    wanting += [s or "sensor" for s in model.sensors if model.sensor_driven(s)]
    if inputs is None:
        if wanting:
            verb = "takes" if len(wanting) == 1 else "take"
            raise InputError(f"{' and '.join(wanting)} {verb} inputs u; give inputs= with the shape ({T}, k)")
        return None
    if not wanting:
        raise InputError("inputs= is given, and nothing in this model takes inputs u: leave it out")
    value = numbers("inputs", by_name("inputs", inputs, model.inputs))
    if value.ndim == 1:
        raise InputError(f"inputs must have the shape ({T}, k); for one input use inputs[:, None]")
    if value.ndim not in (2, 3) or value.shape[-2] != T:
        raise InputError(f"inputs must have the shape ({T}, k) or (B, {T}, k); this one has {value.shape}")
    if value.shape[0] == 0:
        raise InputError(f"inputs are empty: their shape is {value.shape}")
    finite("inputs", value)
    return value

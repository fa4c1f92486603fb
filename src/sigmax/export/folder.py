"""`sigmax export c`: a filter on a model as a folder of C99."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import sigmax
from sigmax.engine.backend import natively
from sigmax.engine.lowered import with_numbers
from sigmax.errors import InputError
from sigmax.export.source import Names, header, identifier, identifiers, source
from sigmax.export.testing import makefile, test_program
from sigmax.export.vectors import Rows, filtered, simulated
from sigmax.filters import Filter
from sigmax.leftovers import clear_leftovers, part_of
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.native import Refused
from sigmax.preparation.fusing import how
from sigmax.preparation.prepare import as_filter, cast, prepare, run_type
from sigmax.rewriting.augment import augment
from sigmax.rewriting.fusion import Fused, name_of, put_together
from sigmax.signals import undone_by_signal
from sigmax.steps.adaptive_noises import adapted_noises


class Exported(NamedTuple):
    """What was written.

    Attributes:
        files: their paths.
        operations: scalar operations of predict, and of each sensor's update by its name.
    """

    files: tuple[Path, ...]
    operations: dict[str, int]


def export_c(
    filter: Filter | str | None,
    model: Model,
    prior: Gaussian,
    folder: Path | str,
    *,
    name: str = "filter",
    dt: Any = 1.0,
    inputs: Any = None,
    z: Any = None,
    dtype: Any = "float64",
    about: str = "",
) -> Exported:
    """Write a filter on a model as self-contained C99: header, source, test program, Makefile.

    No allocation, no library but libm, the same operations in the same order on every call.

    Args:
        filter: a name of the catalogue, or a filter; None where each mode of the model names its own.
        model: the model; its noises become constants of the source. Of a fused one (`sigmax.models.fused`) all sensors
            are corrected by one function, in the order of the model, NAN where one is silent.
        prior: where the test program starts, (n,).
        folder: where to write; made if it is not there.
        name: what the files and functions are called.
        dt: seconds between the steps of the test program; with z also (T,).
        inputs: (k,) inputs of the test program, for models that take u; with z also (T, k).
        z: (T, m) or by sensor, as for `sigmax.run`: the test program runs over these rows. Without it they are
            simulated from the prior.
        dtype: float64 for `double`, float32 for `float`.
        about: a line for the head of the files.

    Raises:
        InputError: for what does not fit, or a model that cannot be lowered, with the line that is the reason.
    """
    chosen, dtype, prefix = as_filter(filter, model), run_type(dtype), identifier(name)
    if prior.mean.ndim != 1:
        raise InputError("an exported filter starts from one prior, not from a batch")
    if model.fusion is not None and any(b.given and callable(model.R[s]) for b in model.fusion for s in b.members):
        raise InputError(
            "a sensor whose R is a function cannot wait for messages in C; export sigmax.models.fused(model)"
        )
    given = None if inputs is None else np.asarray(inputs, float)
    u = given if given is None or given.ndim == 1 else given[0]
    one, its_prior = _first_mode(model, prior)
    sizes = _sizes(one, u)
    elapsed = np.asarray(dt, float)
    nothing = {s: np.full((1, m), np.nan) for s, m in sizes.items()}
    silent = nothing if model.several else nothing[""]
    step = float(elapsed.flat[0])
    ready = prepare(chosen, model, prior, silent, step, None if u is None else u[None], dtype)
    # Alone the motion is the same whether sensors are fused or not, and takes no covariances of measurements.
    apart = cast(augment(model, ready.filter.form.bias_first), dtype)
    inputs_count = 0 if u is None else len(u)
    low = with_numbers(ready.filter, apart, inputs_count, dtype)
    try:
        with natively():
            programs = {"start": low.program("start"), "predict": low.program("predict")}
            if model.fusion is None:
                programs |= {s: low.program("correct", s, m) for s, m in sizes.items()}
            else:
                together = with_numbers(ready.filter, ready.model, inputs_count, dtype)
                programs[""] = together.program("correct", name_of(model), sum(sizes.values()), _together(apart, sizes))
    except Refused as error:
        raise InputError(f"this model cannot be exported: {error}") from error
    parts = {s: identifiers(one.measurement[s] or [f"z{i}" for i in range(m)]) for s, m in sizes.items()}
    if model.fusion is not None:
        parts = {"": tuple(f"{identifier(s)}_{part}" for s, own in parts.items() for part in own)}
    curved = {s: own.deviations for s, own in model.measured.items() if own is not None and not own.space.flat}
    residuals = parts | {s: identifiers(names) for s, names in curved.items()}
    rows_of = identifiers(ready.model.state), identifiers(ready.model.deviations)
    modes = model.names if isinstance(model, SwitchingModel) else ()
    rest = low.packing.size - low.packing.head
    noises = adapted_noises(ready.filter, ready.model).names
    names = Names(prefix, *rows_of, parts, residuals, 0 if u is None else len(u), rest, modes, noises)
    single = dtype == np.float32
    rows = simulated(one, its_prior, step, u) if z is None else _rows(model, z, elapsed, given)
    vectors = filtered(chosen, model, prior, rows, dtype)
    start = Gaussian(ready.mean, ready.cov)
    head = _head(chosen, model, name, about, single)
    out = Path(folder)
    texts = {
        f"{prefix}.h": header(names, head, single),
        f"{prefix}.c": source(names, programs, head, single),
        f"test_{prefix}.c": test_program(names, vectors, start, single),
        "Makefile": makefile(prefix),
    }
    _write(out, texts)
    counted = {k or "update": p.operations for k, p in programs.items() if k != "start"}
    return Exported(tuple(out / file for file in texts), counted)


def _write(folder: Path, texts: Mapping[str, str]) -> None:
    """Put files beside others, each whole; a folder that was not there appears with all of them or not at all.

    Raises:
        InputError: where the disk does not take them.
    """
    fresh = [p for p in (folder, *folder.parents) if not p.exists()]
    parts = {file: part_of(folder / file) for file in texts}

    def undo() -> None:
        for part in parts.values():
            with contextlib.suppress(OSError):
                part.unlink()
        for place in fresh:
            if place.is_dir() and not any(place.iterdir()):
                place.rmdir()

    try:
        with undone_by_signal(undo):
            folder.mkdir(parents=True, exist_ok=True)
            for file, text in texts.items():
                clear_leftovers(folder / file)
                parts[file].write_text(text, encoding="utf-8")
            for file, part in parts.items():
                part.replace(folder / file)
    except OSError as error:
        undo()
        raise InputError(f"{folder} cannot be written: {error}") from error


def _rows(model: Model, z: Any, dt: np.ndarray, inputs: np.ndarray | None) -> Rows:
    """Rows of a record as they were measured."""
    by_sensor = {s: np.asarray(v, float) for s, v in (z if model.several else {"": z}).items()}
    count = len(next(iter(by_sensor.values())))
    u = None if inputs is None else np.broadcast_to(inputs, (count, inputs.shape[-1]))
    return Rows(np.broadcast_to(dt, (count,)), u, by_sensor)


def _first_mode(model: Model, prior: Gaussian) -> tuple[Model, Gaussian]:
    """What rows are simulated with: the model and its prior, of several modes the first and its components."""
    if not isinstance(model, SwitchingModel):
        return model, prior
    first = model.models[0]
    mean, cov = np.asarray(prior.mean), np.asarray(prior.cov)
    rows = [model.deviations.index(name) for name in first.deviations]
    return first, Gaussian(mean[[model.state.index(name) for name in first.state]], cov[np.ix_(rows, rows)])


def _together(model: Model, sizes: Mapping[str, int]) -> Callable[[Any, Any], Fused]:
    """What all sensors measured, one after the other in the order of the model, as the one measurement it makes."""

    def together(z: Any, u: Any) -> Fused:
        cuts = np.cumsum(list(sizes.values()))[:-1]
        return put_together(model, dict(zip(sizes, jnp.split(z, cuts), strict=True)), u)

    return together


def _sizes(model: Model, u: np.ndarray | None) -> dict[str, int]:
    """The number of components of each sensor."""
    x = jnp.zeros(model.size)
    found = {}
    for s, h in model.sensors.items():
        if model.sensor_inputs[s] and u is None:
            raise InputError("the model takes inputs u; give inputs=")
        given = (u,) if model.sensor_inputs[s] else ()
        found[s] = jax.eval_shape(h, x, *given).shape[0]
    return found


def _head(filter: Filter, model: Model, name: str, about: str, single: bool) -> str:
    lines = [
        f"{name}: {filter.name}{f' for {about}' if about else ''}, written by sigmax {sigmax.__version__}.",
        f"Prediction {filter.predict}, correction {filter.correct}, form {filter.form.name}; "
        f"numbers are {'float' if single else 'double'}.",
        "SI units and radians. Nothing is allocated, nothing but libm is called, every call does the same operations.",
        *(line for own in _modes(model).items() for line in _noises(*own)),
        *([] if model.bias is None else [f"Q per second of the bias{_numbers(model.bias.Q)}."]),
        *([] if model.fusion is None else [f"Corrected together: {_said(how(filter, model))}."]),
    ]
    return "\n".join(lines)


def _modes(model: Model) -> dict[str, Model]:
    return model.modes if isinstance(model, SwitchingModel) else {"": model}


def _noises(mode: str, model: Model) -> list[str]:
    when = f" in {mode}" if mode else ""
    measured = (f"R{f' of {s}' if s else ''}{when}{_numbers(R)}." for s, R in model.R.items())
    return [f"Q per second{when}{_numbers(model.Q)}.", *measured]


def _said(fused: Sequence[tuple[str, str]]) -> str:
    return ", ".join(f"{s} {way}" for s, way in fused)


def _numbers(noise: Any) -> str:
    if callable(noise):
        return ": a function of the model"
    entries = np.asarray(getattr(noise, "entries", noise))
    return f": {'diagonal ' if entries.ndim == 1 else ''}{np.array2string(entries, precision=6, separator=', ')}"

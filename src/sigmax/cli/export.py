"""`sigmax export c`."""

from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.markup import escape

from sigmax.errors import InputError
from sigmax.export import export_c
from sigmax.models import Gaussian, Model
from sigmax.models.builtin import BUILTIN, builtin
from sigmax.records import load, parse_trial
from sigmax.records.userfile import Functions, is_reference


class _Task(NamedTuple):
    model: Model
    prior: Gaussian
    dt: float
    inputs: Any
    about: str
    name: str


def export_model(model: str, filter: str, out: Path | None, single: bool) -> None:
    """Find the model, write the folder, say what lies where.

    Raises:
        InputError: for whatever does not fit.
    """
    console, errors = Console(), Console(stderr=True)
    trial = parse_trial(filter)
    if trial.fixed:
        raise InputError(f"{filter!r}: fixed components belong to sigmax track; give them a variance of 0 in the prior")
    task = _task(model)
    folder = out if out is not None else Path("export") / task.name
    with errors.status("lowering, and running the filter that the C is compared with"):
        done = export_c(
            trial.filter,
            task.model,
            task.prior,
            folder,
            name=task.name,
            dt=task.dt,
            inputs=task.inputs,
            dtype="float32" if single else "float64",
            about=task.about,
        )
    for path in done.files:
        console.print(escape(str(path)), highlight=False, soft_wrap=True)
    counts = ", ".join(f"{name} {count}" for name, count in done.operations.items())
    console.print(f"\nScalar operations: {counts}. To test it: make -C {escape(str(folder))} test", highlight=False)


def _task(name: str) -> _Task:
    if name in BUILTIN:
        made = builtin(name)
        return _Task(made.model, made.prior, made.dt, made.inputs, made.about, name)
    if is_reference(name):
        path, _, function = name.rpartition(":")
        made_by = Functions(Path())(f"{path}:{function}", name)()
        if not (isinstance(made_by, tuple) and len(made_by) == 2 and isinstance(made_by[0], Model)):
            kind = type(made_by).__name__
            raise InputError(f"{name}() must give a pair (sigmax.Model, sigmax.Gaussian); it gives {kind}")
        return _Task(made_by[0], made_by[1], 1.0, None, "", Path(path).stem)
    if name.casefold().endswith(".toml") or name in ("plaza1", "plaza2"):
        record = load(name)
        steps = record.dt[0][record.dt[0] > 0]
        inputs = None if record.inputs is None else record.inputs[0, 0]
        mean = record.prior.mean if record.prior.mean.ndim == 1 else record.prior.mean[0]
        cov = record.prior.cov if record.prior.cov.ndim == 2 else record.prior.cov[0]
        return _Task(
            record.model,
            Gaussian(mean, cov),
            float(steps.mean()) if len(steps) else 1.0,
            inputs,
            record.title,
            record.name,
        )
    raise InputError(
        f"{name!r} is no model: give a built-in one ({', '.join(BUILTIN)}), the .toml description of a record, "
        "or file.py:function that gives (model, prior)"
    )

"""`sigmax export c`."""

from pathlib import Path

from rich.console import Console
from rich.markup import escape

from sigmax.errors import InputError
from sigmax.export import export_c
from sigmax.records import find_model, parse_trial


def export_model(model: str, filter: str, out: Path | None, single: bool) -> None:
    """Find the model, write the folder, say what lies where.

    Raises:
        InputError: for whatever does not fit.
    """
    console, errors = Console(), Console(stderr=True)
    trial = parse_trial(filter)
    if trial.fixed:
        raise InputError(f"{filter!r}: fixed components belong to sigmax track; give them a variance of 0 in the prior")
    task = find_model(model)
    name = Path(model.rpartition(":")[0] or model).stem
    folder = out if out is not None else Path("export") / name
    with errors.status("lowering, and running the filter that the C is compared with"):
        done = export_c(
            trial.filter,
            task.model,
            task.prior,
            folder,
            name=name,
            dt=task.dt,
            inputs=task.inputs,
            dtype="float32" if single else "float64",
            about=task.about,
        )
    for path in done.files:
        console.print(escape(str(path)), highlight=False, soft_wrap=True)
    counts = ", ".join(f"{name} {count}" for name, count in done.operations.items())
    console.print(f"\nScalar operations: {counts}. To test it: make -C {escape(str(folder))} test", highlight=False)

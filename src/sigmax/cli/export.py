"""`sigmax export c`."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from sigmax.errors import InputError
from sigmax.export import export_c
from sigmax.records import Record, find_model, load, parse_trial, with_updates
from sigmax.records.find_model import is_record, scenario_of


def _rows(record: Record) -> dict[str, Any]:
    """What was measured on the first track, from the first row that needs a step of the motion."""
    steps = int(record.steps[0])
    moved = np.flatnonzero(record.dt[0, :steps] > 0)
    part = slice(int(moved[0]) if len(moved) else 0, steps)
    z = {s: v[0, part] for s, v in record.z.items()} if isinstance(record.z, dict) else record.z[0, part]
    return {"dt": record.dt[0, part], "inputs": None if record.inputs is None else record.inputs[0, part], "z": z}


def export_model(model: str, filter: str, out: Path | None, single: bool) -> None:
    """Find the model, write the folder, say what lies where.

    Raises:
        InputError: for whatever does not fit.
    """
    console, errors = Console(), Console(stderr=True)
    trial = parse_trial(filter)
    if trial.fixed:
        raise InputError(f"{filter!r}: fixed components belong to sigmax track; give them a variance of 0 in the prior")
    record = load(model) if is_record(model) else None
    task = find_model(model) if record is None else scenario_of(record)
    rows = {"dt": task.dt, "inputs": task.inputs} if record is None else _rows(record)
    name = Path(model.rpartition(":")[0] or model).stem
    folder = out if out is not None else Path("export") / name
    with errors.status("lowering, and running the filter that the C is compared with"):
        done = export_c(
            trial.filter if record is None else with_updates(trial.filter, record.updates),
            task.model,
            task.prior,
            folder,
            name=name,
            **rows,
            dtype="float32" if single else "float64",
            about=task.about,
        )
    for path in done.files:
        console.print(escape(str(path)), highlight=False, soft_wrap=True)
    counts = ", ".join(f"{name} {count}" for name, count in done.operations.items())
    console.print(f"\nScalar operations: {counts}. To test it: make -C {escape(str(folder))} test", highlight=False)

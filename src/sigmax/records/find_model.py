"""Finding a model by its name, by a record that is described, or in a file of the user's."""

from pathlib import Path

from sigmax.errors import InputError
from sigmax.files.userfile import Functions, called, check_runnable, is_reference
from sigmax.models import Gaussian, Model
from sigmax.models.builtin import BUILTIN, Scenario, builtin
from sigmax.records.load import builtin as builtin_records
from sigmax.records.load import load
from sigmax.records.record import Record


def find_model(name: str, folder: Path | None = None) -> Scenario:
    """The model that a name means, with a prior and a step.

    Args:
        name: a built-in model, a built-in record, a record's .toml description, or "file.py:function" that gives
            (model, prior).
        folder: that of the description which says the name; None where the user did.

    Raises:
        InputError: for whatever is missing or does not fit.
    """
    if name in BUILTIN:
        return builtin(name)
    if is_reference(name):
        path, _, function = name.rpartition(":")
        find = Functions(folder or Path(), named_by_user=folder is None)
        made_by = called(find(f"{path}:{function}", name), name)
        if not (isinstance(made_by, tuple) and len(made_by) == 2 and isinstance(made_by[0], Model)):
            kind = type(made_by).__name__
            raise InputError(f"{name}() must give a pair (sigmax.Model, sigmax.Gaussian); it gives {kind}")
        return Scenario(made_by[0], made_by[1], 1.0, None, False, "")
    if is_record(name):
        if folder is not None and name.casefold().endswith(".toml"):
            check_runnable(folder / name, folder, name)
            name = str(folder / name)
        return scenario_of(load(name))
    raise InputError(
        f"{name!r} is no model: give a built-in one ({', '.join(BUILTIN)}), the .toml description of a record, "
        "or file.py:function that gives (model, prior)"
    )


def is_record(name: str) -> bool:
    """Whether a name is that of a record: a built-in one, or a description."""
    return name not in BUILTIN and (name.casefold().endswith(".toml") or name.casefold() in builtin_records())


def scenario_of(record: Record) -> Scenario:
    """The model of a record with the prior and the inputs of its first track, and its mean step."""
    steps = record.dt[0][record.dt[0] > 0]
    mean = record.prior.mean if record.prior.mean.ndim == 1 else record.prior.mean[0]
    cov = record.prior.cov if record.prior.cov.ndim == 2 else record.prior.cov[0]
    return Scenario(
        record.model,
        Gaussian(mean, cov),
        float(steps.mean()) if len(steps) else 1.0,
        None if record.inputs is None else record.inputs[0, 0],
        False,
        record.title,
    )

"""The TOML of a record with the numbers that were fitted, and the reason at each line that is changed."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sigmax.corrections.correct import Correction, correct
from sigmax.corrections.filter_numbers import NAMES, changed, with_weights
from sigmax.corrections.free_numbers import Number
from sigmax.descriptions.trial import Trial
from sigmax.errors import InputError
from sigmax.examination import Finding
from sigmax.files.toml_edit import Document
from sigmax.filters import named
from sigmax.views import words


def fitted(path: Path, trial: Trial, numbers: Mapping[Number, tuple[float, float]]) -> Correction:
    """The description at `path` with numbers in it that were fitted; its comments stay.

    Args:
        path: of the description.
        trial: the filter that was fitted.
        numbers: their values and standard errors, NaN for those that the record does not determine: they stay.

    Raises:
        InputError: where the description does not fit.
    """
    factors = [
        _factor(n, value, said(n, value, std)) for n, (value, std) in numbers.items() if n.kind == "factor" and std > 0
    ]
    first = correct(path, factors)
    document, changed = Document(first.text), list(first.changed)
    left = [
        *first.left,
        *(f"{n.name}: not written, it is not determined" for n, (_, s) in numbers.items() if not s > 0),
    ]
    for n, (value, std) in numbers.items():
        if n.kind == "factor" or not std > 0:
            continue
        reason, before = said(n, value, std), document.text
        try:
            if n.kind == "place":
                document.put(n.at, _quantity(value, std, n.unit), reason)
            elif n.kind == "filter":
                _put_filter(document, n, value, trial, reason)
            else:
                _put_value(document, n, value, std, reason)
            changed.append(reason)
        except (InputError, KeyError) as error:
            document.text = before
            left.append(f"{reason}: not written, {error}; to do: set it by hand")
    return Correction(document.text, tuple(changed), tuple(left))


def said(n: Number, value: float, std: float) -> str:
    """What was fitted, in a line."""
    what = "a factor of the variances " if n.kind == "factor" else ""
    return f"{n.name} fitted: {what}{words.measured(value, std, n.unit)}, was {n.start:.6g}"


def _factor(n: Number, value: float, reason: str) -> Finding:
    """The factor as a finding of the doctor, whose editor puts it where the noise is said."""
    head, *behind = map(str, n.at)
    where = ".".join(behind) if behind else "all components"
    return Finding(head, where, reason, "", "multiply its variances by the factor", np.log(value), 0.0, 0.0, 1.0, 1.0)


def _quantity(value: float, std: float, unit: str) -> str | float:
    """A number to a hundredth of its standard error."""
    return _rounded(value, max(2, int(np.ceil(np.log10(max(abs(value) / std, 1e-3)))) + 2), unit)


def _rounded(value: float, digits: int, unit: str) -> str | float:
    return f"{value:.{digits}g} {unit}" if unit else float(f"{value:.{digits}g}")


def _put_filter(document: Document, n: Number, value: float, trial: Trial, reason: str) -> None:
    """A number of the filter where it is written: in `filters`, or in the update of sensors."""
    if NAMES[n.name].of == "points":
        written = document.get(("filters",))
        if trial.name not in written:
            raise InputError(f"filters does not list {trial.name}")
        new_ones = [changed(trial, {n.name: value}) if name == trial.name else name for name in written]
        document.put(("filters",), new_ones, reason)
        return
    done = False
    for sensor, part in document.get(("sensors",)).items():
        update = named(part["update"]) if "update" in part else None
        new = with_weights(update, {NAMES[n.name].called: value})
        if new != update:
            document.put(("sensors", sensor, "update"), str(new), reason)
            done = True
    if not done:
        raise InputError("no sensor has an update with it")


def _put_value(document: Document, n: Number, value: float, std: float, reason: str) -> None:
    """The value of a component as its prior, known to its standard error."""
    (name,) = n.at
    for table in ("bias", "prior"):
        try:
            document.get((table, str(name), "std"))
        except KeyError:
            continue
        document.put((table, str(name), "mean"), _quantity(value, std, n.unit), reason)
        document.put((table, str(name), "std"), _rounded(std, 2, n.unit), reason)
        return
    raise InputError("its prior comes from the measurements")

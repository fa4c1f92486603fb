"""Finding studies by a name, a description, or a function of the user's."""

import inspect
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from sigmax.errors import InputError, unknown
from sigmax.files.description import Section, read_toml
from sigmax.files.userfile import Functions, called, check_runnable, is_reference
from sigmax.filters import Filter
from sigmax.models.builtin import BUILTIN, Scenario
from sigmax.records import find_model, load, parse_trial
from sigmax.records.load import builtin as builtin_records
from sigmax.studies.named import NAMED
from sigmax.studies.of_record import of_record
from sigmax.studies.study import Study, undisturbed

# Filters and length where nothing is said.
_FILTERS, _STEPS = ("EKF", "UKF", "SRCKFB", "SRECKFB"), 100
TRUTHS = ("driven", "fixed")


class StudyDescription(Section):
    """A study on a model of the user's, as TOML."""

    model: str
    steps: int | None = Field(default=None, ge=1)
    dt: float | list[float] | None = None
    runs: int = Field(default=1000, ge=2)
    title: str = ""
    filters: list[str] = Field(default=list(_FILTERS), min_length=1)
    truth: str = "driven"
    start: list[float] | None = None
    estimate: str = "prior"
    detection: float | dict[str, float] = 1.0
    look: list[int] = Field(default_factory=list)
    limit: list[float] | None = None
    particles: int = Field(default=0, ge=0)
    optimum: str = "guided"
    optimum_runs: int = Field(default=500, ge=1)


def load_studies(name: str, options: Mapping[str, str] | None = None) -> list[Study]:
    """The studies that a name means; most names mean one.

    Args:
        name: of a study (see `sigmax studies`), a built-in model or a built-in record; the path of a TOML description
            of a study or of a record; or "file.py:function" that gives a `Study`, a list of them, or a pair
            (model, prior).
        options: of a named study, of the user's function, or of a record (`steps`, `track`), as text.

    Raises:
        InputError: for whatever is missing or does not fit.
    """
    given = dict(options or {})
    named = {n.casefold(): n for n in NAMED}
    if name.casefold() in named:
        return _listed(_made(NAMED[named[name.casefold()]].make, given, name))
    if is_reference(name):
        file = name.rpartition(":")[0]
        found = _made(Functions(Path(), named_by_user=True)(name, name), given, name)
        if isinstance(found, tuple):
            return [_on_model(find_model(name), Path(file).stem)]
        return _listed(found)
    path = Path(name)
    if name.casefold() in builtin_records() or _is_record(path):
        return [_with_defaults(_made(partial(of_record, load(name), f"{path.stem}-study"), given, name))]
    if given:
        raise InputError(f"{name} takes no options; {', '.join(given)} belongs to a named study")
    if name in BUILTIN:
        return [_on_model(find_model(name), name)]
    if path.suffix.casefold() == ".toml":
        return [_described(path)]
    known = [*NAMED, *BUILTIN, *builtin_records()]
    raise InputError(f"{unknown('study', name, known)}; or give a .toml description, or file.py:function")


def _is_record(path: Path) -> bool:
    """Whether a TOML file describes a record: what cannot be read is told later, as a description of a study."""
    try:
        return path.suffix.casefold() == ".toml" and "data" in tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False


def _with_defaults(study: Study) -> Study:
    return study if study.filters else _with_filters(study, _FILTERS)


def _listed(found: Any) -> list[Study]:
    studies = list(found) if isinstance(found, list | tuple) else [found]
    for study in studies:
        if not isinstance(study, Study):
            raise InputError(f"a study must be a sigmax.studies.Study; this is {type(study).__name__}")
    return studies


def _made(make: Any, given: Mapping[str, str], name: str) -> Any:
    parameters = inspect.signature(make).parameters
    values = {}
    for key, text in given.items():
        if key not in parameters:
            takes = ", ".join(f"{k} ({p.default})" for k, p in parameters.items()) or "none"
            raise InputError(f"{name} has no option {key!r}; its options are: {takes}")
        values[key] = _as(type(parameters[key].default), text, key)
    return called(make, name, **values)


def _as(kind: type, text: str, key: str) -> Any:
    if kind not in (int, float):
        return text
    try:
        return kind(text)
    except ValueError as error:
        wanted = "a whole number" if kind is int else "a number"
        raise InputError(f"{key} must be {wanted}; it is {text!r}") from error


def parsed_filters(texts: Sequence[str], study: Study) -> dict[str, Filter]:
    """Filters from "NAME" or "NAME:parameter=value,…"; a bare name that the study sets up means that setting.

    Raises:
        InputError: for names and parameters that are not known.
    """
    known = {name.casefold(): name for name in study.filters}
    chosen = {}
    for text in texts:
        if text.strip().casefold() in known:
            name = known[text.strip().casefold()]
            chosen[name] = study.filters[name]
            continue
        trial = parse_trial(text)
        if trial.fixed:
            raise InputError(f"{text!r}: fixed components belong to sigmax track; set their variance in the prior to 0")
        chosen[trial.name if ":" in trial.name else trial.filter.name] = trial.filter
    return chosen


def _on_model(scenario: Scenario, name: str) -> Study:
    """Truth drawn as the model says."""
    inputs = None if scenario.inputs is None else np.tile(scenario.inputs, (_STEPS, 1))
    study = Study(
        name=name,
        model=scenario.model,
        prior=scenario.prior,
        steps=_STEPS,
        dt=scenario.dt,
        title=scenario.about or name,
        inputs=inputs,
        about=("Truth is drawn from the model: its start from the prior, its motion with the noise Q.",),
    )
    return _with_filters(study, _FILTERS)


def _with_filters(study: Study, texts: Sequence[str]) -> Study:
    return replace(study, filters=parsed_filters(texts, study))


def _described(path: Path) -> Study:
    given = read_toml(path, StudyDescription)
    if given.truth not in TRUTHS:
        raise InputError(f"{path.name}: {unknown('truth', given.truth, TRUTHS)}")
    try:
        study = _modelled(given, path)
        study = replace(
            study,
            nature=undisturbed(study.apart or study.model) if given.truth == "fixed" else None,
            start=given.start,
            estimate=given.estimate,
            detection=given.detection,
            runs=given.runs,
            look=tuple(given.look),
            limit=given.limit,
            particles=given.particles,
            optimum=given.optimum,
            optimum_runs=given.optimum_runs,
        )
        return _with_filters(study, given.filters)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error


def _modelled(given: StudyDescription, path: Path) -> Study:
    """A study on the model of a description, with the rows of the record where it is that of one."""
    title, record = given.title or path.stem, given.model
    if not is_reference(record) and record.casefold().endswith(".toml"):
        check_runnable(path.parent / record, path.parent, "model")
        record = str(path.parent / record)
    if record.casefold() in builtin_records() or _is_record(Path(record)):
        return replace(of_record(load(record), path.stem, given.steps or 0, dt=given.dt), title=title)
    scenario = find_model(given.model, path.parent)
    steps = given.steps or _STEPS
    return Study(
        name=path.stem,
        model=scenario.model,
        prior=scenario.prior,
        steps=steps,
        dt=scenario.dt if given.dt is None else given.dt,
        title=title,
        inputs=None if scenario.inputs is None else np.tile(scenario.inputs, (steps, 1)),
    )

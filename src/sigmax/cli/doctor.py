"""`sigmax doctor`."""

import json
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from sigmax.cli.descriptions import Beside
from sigmax.cli.progress import progress_on
from sigmax.corrections.correct import correct
from sigmax.errors import InputError, unknown
from sigmax.examination import Examination, doctor, not_examined
from sigmax.filters import Filter
from sigmax.models import Gaussian, Model
from sigmax.records import Outcome, Record, load, load_plots, parse_trial
from sigmax.reports import Grade, Score, TrackExamination, grade

_CORRECTED = Beside("corrected", "doctor")


def examine_record(name: str, filter: str | None, tracks: Sequence[str], as_json: bool, write: bool) -> None:
    """Examine each track of a record, or some, and print what was found; write the description without it if wished.

    Raises:
        InputError: for plots, which belong to no track yet, and whatever `sigmax.doctor` refuses.
        SystemExit: with the status of the examinations: 1 where one has findings, 2 where none could be made.
    """
    console, errors = Console(), Console(stderr=True)
    with errors.status("reading the record"):
        if load_plots(name, None) is not None:
            raise no_tracks(name)
        record = load(name)
    target = _CORRECTED.target(name) if write else None
    trial = record.trials[0] if filter is None else parse_trial(filter)
    judge, model, prior = record.of_trial(trial)
    for track in tracks:
        if track not in record.tracks:
            raise unknown("track", track, record.tracks)
    chosen = [i for i, track in enumerate(record.tracks) if not tracks or track in tracks]
    found: dict[str, Examination] = {}
    with progress_on(errors) as progress:
        task = progress.add_task("", total=len(chosen))
        for i in chosen:
            about = f"{record.name}: examining {record.tracks[i]}"

            def say(said: str, about: str = about) -> None:
                progress.update(task, description=escape(f"{about}, {said}"))

            progress.update(task, description=escape(about))
            found[record.tracks[i]] = _examined(record, i, judge, model, prior, say)
            progress.advance(task)
    if as_json:
        print(json.dumps({track: one.to_dict() for track, one in found.items()}, indent=2))
    else:
        for track, one in found.items():
            title = record.title if len(record.tracks) == 1 else f"{record.title}: {track}"
            console.print(f"[bold]{escape(title)}[/]\n{escape(repr(one))}", highlight=False, soft_wrap=True)
    if target is not None:
        _write(Path(name), target, found, errors)
    statuses = {one.status for one in found.values()}
    # One track that can be examined is enough for an answer.
    raise SystemExit(1 if 1 in statuses else 0 if 0 in statuses else 2)


def no_tracks(name: str) -> InputError:
    """The refusal of a record of plots."""
    return InputError(f"{name} holds plots: the doctor examines records whose measurements belong to a track")


def _write(path: Path, target: Path, found: dict[str, Examination], errors: Console) -> None:
    """The description without what was found in one track, and what is to be done by hand, to standard error."""
    ill = [track for track, one in found.items() if one.findings]
    if not ill:
        errors.print("nothing to correct: no file was written", highlight=False)
        return
    if len(ill) > 1:
        raise InputError(f"--write: the tracks {', '.join(ill)} have findings of their own: choose one by --track")
    correction = correct(path, found[ill[0]].findings)
    again = shlex.join(["sigmax", "doctor", str(target)])
    _CORRECTED.write(path, target, correction, errors, f"; examine it: {again}")


def proposal(name: str, prior: str | None, record: Record, outcomes: Sequence[Outcome], scores: Sequence[Score]) -> str:
    """The command that says why no filter can be believed; empty where one can, or the model is not examined."""
    if any(grade(s).believable or grade(s) is Grade.UNKNOWN for s in scores[: len(outcomes)]):
        return ""
    chosen = _examinable(record, outcomes, scores)
    if chosen is None:
        return ""
    outcome, _ = chosen
    if prior is not None:
        return shlex.join(["sigmax", "track", name, "--filter", outcome.trial.name, "--prior", prior, "--doctor"])
    words = ["sigmax", "doctor", name, "--filter", outcome.trial.name]
    if len(record.tracks) > 1:
        words += ["--track", record.tracks[_worst(record, outcome)]]
    return shlex.join(words)


def examine_worst(record: Record, outcomes: Sequence[Outcome], scores: Sequence[Score]) -> TrackExamination | None:
    """What is wrong on the track that the likeliest filter believes least; None where the model is not examined."""
    chosen = _examinable(record, outcomes, scores)
    if chosen is None:
        return None
    outcome, label = chosen
    i = _worst(record, outcome)
    return TrackExamination(i, label, _examined(record, i, *record.of_trial(outcome.trial)))


def _examinable(record: Record, outcomes: Sequence[Outcome], scores: Sequence[Score]) -> tuple[Outcome, str] | None:
    """The outcome of the largest likelihood whose filter and model the doctor knows, and its label."""
    known = [
        (s.log_likelihood if s.log_likelihood is not None else -np.inf, o, s.label)
        for o, s in zip(outcomes, scores, strict=False)
        if o.result is not None and _can_examine(record, o)
    ]
    return max(known, key=lambda one: one[0])[1:] if known else None


def _can_examine(record: Record, outcome: Outcome) -> bool:
    filter, model, _ = record.of_trial(outcome.trial)
    return not not_examined(model, filter)


def _worst(record: Record, outcome: Outcome) -> int:
    """The track with the largest NIS for the number of its values, of those with enough of them."""
    assert outcome.result is not None
    nis, dof = (np.where(record.real, np.nan_to_num(v), 0.0).sum(1) for v in (outcome.result.nis, outcome.result.dof))
    enough = dof > min(50, dof.max() / 2)
    return int(np.argmax(np.where(enough, nis / np.maximum(dof, 1), -1.0)))


def _examined(
    record: Record,
    i: int,
    judge: Filter,
    model: Model,
    prior: Gaussian,
    progress: Callable[[str], Any] | None = None,
) -> Examination:
    steps = slice(0, int(record.steps[i]))
    own = [np.asarray(a)[i] if np.ndim(a) > d else a for a, d in ((prior.mean, 1), (prior.cov, 2))]
    by_sensor = isinstance(record.z, dict)
    z = {s: v[i, steps] for s, v in record.z.items()} if by_sensor else record.z[i, steps]
    return doctor(
        model,
        Gaussian(*own),
        z,
        filter=judge,
        dt=record.dt[i, steps],
        inputs=None if record.inputs is None else record.inputs[i, steps],
        update_first=record.update_first,
        progress=progress,
    )

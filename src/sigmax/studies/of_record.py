"""A study of the model of a record: what filters would be worth on many such records."""

from typing import Any

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.models import Gaussian
from sigmax.records import Record
from sigmax.studies.study import Study


def of_record(record: Record, name: str, steps: int = 0, track: str = "", dt: Any = None) -> Study:
    """Truth drawn from the model of a record, at the record's own times, with its inputs and its gaps.

    Args:
        record: whose model, prior and rows are taken.
        name: of the study.
        steps: how many of its rows, from the first on; 0 for all.
        track: which track; without it the longest.
        dt: seconds between measurements, instead of the record's own.

    Raises:
        InputError: for a track that it does not have, or more steps than it has rows.
    """
    if track and track not in record.tracks:
        raise InputError(f"{name}: {unknown('track', track, record.tracks)}")
    k = record.tracks.index(track) if track else int(record.steps.argmax())
    rows = int(record.steps[k])
    if not 0 <= steps <= rows:
        raise InputError(
            f"{name}: track {record.tracks[k]} has {rows} rows, of which a study can take 1 to {rows}; steps = {steps}"
        )
    T = steps or rows
    by_sensor = record.z if isinstance(record.z, dict) else {"": record.z}
    prior = record.prior
    mean = prior.mean if prior.mean.ndim == 1 else prior.mean[k]
    cov = prior.cov if prior.cov.ndim == 2 else prior.cov[k]
    which = f" of track {record.tracks[k]}" if len(record.tracks) > 1 else ""
    return Study(
        name=name,
        model=record.model,
        prior=Gaussian(mean, cov),
        steps=T,
        dt=record.dt[k, :T] if dt is None else dt,
        title=record.title,
        inputs=None if record.inputs is None else record.inputs[k, :T],
        measured={sensor: ~np.isnan(np.asarray(z, float)[k, :T]) for sensor, z in by_sensor.items()},
        filters={trial.name: trial.filter for trial in record.trials if not trial.fixed},
        units=[dimension.symbol for dimension in record.components.values()],
        about=(
            "Truth is drawn from the model: its start from the prior, its motion with the noise Q. Times, inputs and "
            f"missing measurements are those of {T} rows{which} of the record {record.name}.",
        ),
    )

"""The folder of a run: all of it, or none of it."""

import json
import math
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

import sigmax
from sigmax.errors import InputError
from sigmax.files.frame import Frame
from sigmax.leftovers import clear_leftovers
from sigmax.records import Outcome, Record
from sigmax.reports.component_estimates import component_estimates
from sigmax.reports.document import versions
from sigmax.reports.examination_section import TrackExamination
from sigmax.reports.grade import grade
from sigmax.reports.page import page
from sigmax.reports.replaced import replaced
from sigmax.reports.score import Score
from sigmax.reports.verdict import verdict
from sigmax.steps.adaptive_noises import scales

FILES = ("estimates.parquet", "summary.json", "report.html")


def check_folder(folder: Path, names: Collection[str] = FILES, mark: str = "summary.json") -> None:
    """Refuse a place where a result cannot be put without destroying something.

    Args:
        folder: the place.
        names: what a former result may consist of.
        mark: the file by which it is known to be one.

    Raises:
        InputError: for a file, a folder with other things in it, or a place that cannot be written.
    """
    try:
        _check_folder(folder, names, mark)
    except OSError as error:
        raise InputError(f"{folder} cannot be used for results: {error}; give --out another folder") from error


def _check_folder(folder: Path, names: Collection[str], mark: str) -> None:
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise InputError(f"{folder} is a {'link' if folder.is_symlink() else 'file'}; give --out a folder")
    if folder.is_dir():
        for name in names:
            clear_leftovers(folder / name)
        inside = sorted(p.name for p in folder.iterdir())
        others = [name for name in inside if name not in names]
        if others or (inside and not (folder / mark).is_file()) or not _ours(folder):
            raise InputError(
                f"{folder} holds other things ({', '.join((others or inside)[:3])}) and would be replaced; "
                "give --out a new or an empty folder"
            )
    dangling = next((p for p in folder.absolute().parents if p.is_symlink() and not p.exists()), None)
    if dangling is not None:
        raise InputError(f"{dangling} is a link that leads nowhere; give --out another folder")
    above = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    if not above.is_dir():
        raise InputError(f"{above} is no folder; give --out another folder")
    place = above if folder != above else above.parent
    try:
        # Asked before hours of work; the rights of a folder do not tell all.
        with tempfile.TemporaryDirectory(dir=place, prefix=".sigmax-"):
            pass
    except OSError as error:
        raise InputError(f"{place} cannot be written to ({error.strerror}); give --out another folder") from error


def _ours(folder: Path) -> bool:
    """Whether the summary, if there is one, is of this library."""
    path = folder / "summary.json"
    try:
        return not path.exists() or "sigmax" in json.loads(path.read_text(encoding="utf-8"))["versions"]
    except (OSError, ValueError, KeyError, TypeError):
        return False


def write_json(path: Path, content: Any) -> None:
    """A file of JSON; NaN is refused."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def write(
    folder: Path,
    record: Record,
    outcomes: Sequence[Outcome],
    scores: Sequence[Score],
    examined: TrackExamination | None = None,
) -> None:
    """Write estimates.parquet, summary.json and report.html; the folder appears whole or not at all.

    Raises:
        InputError: where something else is in the way (see `check_folder`), or the disk does not take it.
    """
    check_folder(folder)
    with replaced(folder) as part:
        _estimates(part / "estimates.parquet", record, outcomes)
        write_json(part / "summary.json", summary(record, scores, examined))
        (part / "report.html").write_text(page(record, outcomes, scores, examined), encoding="utf-8")


def summary(record: Record, scores: Sequence[Score], examined: TrackExamination | None = None) -> dict[str, Any]:
    """The content of summary.json; numbers in SI and radians, null where there is none."""
    units = {str(n): d.symbol for n, d in record.components.items()}
    return {
        "record": record.name,
        "title": record.title,
        "verdict": verdict(scores)[0],
        "tracks": len(record.tracks),
        "steps": int(record.steps.sum()),
        "units": units,
        "filters": {s.name: _one(s) for s in scores},
        "source": record.source,
        "licence": record.licence,
        "notes": list(record.notes),
        "frame": None if record.placed is None else frame_in_numbers(record.placed.frame),
        "versions": versions(),
    } | ({} if examined is None else {"examination": examined.examination.to_dict()})


def frame_in_numbers(frame: Frame) -> dict[str, Any]:
    """For JSON: which metres, and the origin in degrees, with a height in m where there is one."""
    angles = [math.degrees(v) for v in frame.origin[:2]]
    return {"metres": frame.name, "origin": [*angles, *frame.origin[2:]]}


def _one(score: Score) -> dict[str, Any]:
    return {
        "label": score.label,
        "rmse_position_m": score.rmse_position_m,
        "mean_nis": score.mean_nis,
        "expected_nis": score.expected_nis,
        "nis_bounds": score.nis_bounds,
        "grade": grade(score).value,
        "beyond_4_sigma": score.beyond,
        "kurtosis": score.kurtosis,
        "correlation_of_misses": score.stretches,
        "seconds": score.seconds,
        "compile_seconds": score.compile_seconds,
        "rmse": score.rmse,
        "constants": {n: {"mean": m, "std": s} for n, (m, s) in (score.constants or {}).items()},
        "measurements": score.measurements,
        "log_likelihood": score.log_likelihood,
        "weights": {sensor: w._asdict() for sensor, w in score.weighed.items()},
        "modes": score.modes,
        "faults": score.faults,
        "first_fault": score.first_fault or None,
        "failure": score.failure or None,
    }


def _estimates(path: Path, record: Record, outcomes: Sequence[Outcome]) -> None:
    """One row a filter, track and step; the unit of a column is in the metadata of its field."""
    real = record.real
    seconds = record.time[real]
    track = np.repeat(np.arange(len(record.tracks)), record.steps)
    if record.epoch is None:
        time: Any = pa.array(seconds)
    else:
        nanoseconds = record.epoch.value + np.round(seconds * 1e9).astype(np.int64)
        time = pa.array(nanoseconds, pa.timestamp("ns", tz="UTC"))
    writer = None
    try:
        for outcome in outcomes:
            if outcome.result is None:
                continue
            r = outcome.result
            names = pa.DictionaryArray.from_arrays(pa.array(track, pa.int32()), pa.array(record.tracks))
            columns: dict[str, tuple[Any, str]] = {
                "filter": (pa.array([outcome.trial.name] * len(track)).dictionary_encode(), ""),
                "track": (names, ""),
                "time": (time, "s" if record.epoch is None else ""),
            }
            for one in component_estimates(record, r):
                columns[one.name] = (pa.array(one.mean[real]), one.dimension.symbol)
                columns[f"{one.name}_std"] = (pa.array(one.deviation[real]), one.dimension.symbol)
                columns[f"{one.name}_truth"] = (pa.array(one.truth[real], from_pandas=True), one.dimension.symbol)
            if record.placed is not None:
                for name, (values, unit) in record.placed.columns(np.asarray(r.mean)[real]).items():
                    columns.setdefault(name, (pa.array(values, from_pandas=True), unit))
            for k, mode in enumerate(r.modes):
                columns[f"probability_{mode}"] = (pa.array(r.probability[real][:, k]), "")
            for name, values in _noises(outcomes, r, real).items():
                columns[name] = (pa.array(values, from_pandas=True), "")
            columns["nis"] = (pa.array(r.nis[real], from_pandas=True), "")
            columns["dof"] = (pa.array(r.dof[real].astype(np.int32)), "")
            columns["ok"] = (pa.array(r.ok[real]), "")
            fields = [pa.field(n, c.type, metadata={"unit": unit}) for n, (c, unit) in columns.items()]
            schema = pa.schema(fields, metadata={"record": record.name, "sigmax": sigmax.__version__})
            table = pa.Table.from_arrays([c for c, _ in columns.values()], schema=schema)
            writer = writer or parquet.ParquetWriter(path, schema)
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def _noises(outcomes: Sequence[Outcome], r: Any, real: np.ndarray) -> dict[str, np.ndarray]:
    """What variances of noises were multiplied by in a result, NaN where only another filter of the record does so."""
    names = dict.fromkeys(n for o in outcomes if o.result is not None for n in o.result.layout.noises.names)
    known = r.known_noises()
    found = {} if known is None else scales(r.layout.noises, known[real])
    return {name: found.get(name, np.full(int(real.sum()), np.nan)) for name in names}

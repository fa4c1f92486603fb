"""The folder of a run over plots: tracks.parquet, summary.json, report.html."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from sigmax.reports.document import versions
from sigmax.reports.folder import check_folder, write_json
from sigmax.reports.replaced import replaced
from sigmax.reports.tracking_outcome import TrackingOutcome, summary_of
from sigmax.reports.tracks_page import tracks_page

TRACK_FILES = ("tracks.parquet", "summary.json", "report.html")


def write_tracks(folder: Path, run: TrackingOutcome) -> None:
    """Write everything; the folder appears whole or not at all.

    Raises:
        InputError: where something else is in the way (see `check_folder`), or the disk does not take it.
    """
    check_folder(folder, TRACK_FILES)
    with replaced(folder) as part:
        _tracks(part / "tracks.parquet", run)
        write_json(part / "summary.json", summary_of(run, versions()))
        (part / "report.html").write_text(tracks_page(run), encoding="utf-8")


def _tracks(path: Path, run: TrackingOutcome) -> None:
    """One row a scan and track, tentative ones too; the unit of a column is in the metadata of its field."""
    told = run.history
    count = [len(t.id) for t in told]
    model = run.cycle.modes.model
    mean = np.concatenate([t.mean for t in told])
    deviation = np.concatenate([np.sqrt(np.einsum("kii->ki", t.cov)) for t in told])
    sensors = pa.array(np.repeat([t.sensor for t in told], count)).dictionary_encode()
    columns: dict[str, tuple[Any, str]] = {
        "time": (pa.array(np.repeat([t.time for t in told], count)), "s"),
        "sensor": (sensors, ""),
        "track": (pa.array(np.concatenate([t.id for t in told])), ""),
        "confirmed": (pa.array(np.concatenate([t.confirmed for t in told])), ""),
        "existence": (pa.array(np.concatenate([t.existence for t in told])), ""),
        "plot": (pa.array(np.concatenate([t.plot for t in told])), ""),
        "nis": (pa.array(np.concatenate([t.nis for t in told]), from_pandas=True), ""),
    }
    for i, (name, dimension) in enumerate(zip(model.state, run.record.dimensions, strict=True)):
        columns[str(name)] = (pa.array(mean[:, i]), dimension.symbol)
        columns[f"{name}_std"] = (pa.array(deviation[:, i]), dimension.symbol)
    if run.record.placed is not None:
        for label, (values, unit) in run.record.placed.columns(mean).items():
            columns.setdefault(label, (pa.array(values, from_pandas=True), unit))
    fields = [pa.field(n, c.type, metadata={"unit": unit}) for n, (c, unit) in columns.items()]
    parquet.write_table(pa.Table.from_arrays([c for c, _ in columns.values()], schema=pa.schema(fields)), path)

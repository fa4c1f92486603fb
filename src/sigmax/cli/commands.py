"""Commands that need little of their own to be read; what is slow to load is inside them."""

from pathlib import Path
from typing import Annotated

import typer

from sigmax.signals import say_on_signal


def track_command(
    record: Annotated[
        str,
        typer.Argument(
            help="A built-in record (see: sigmax records), a TOML file that describes your data, or autoferry:N.",
            show_default=False,
        ),
    ],
    filter: Annotated[
        list[str] | None,
        typer.Option(
            "--filter",
            "-f",
            help="NAME or NAME:parameter=value,…; may be repeated. Without it: what the record says.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder for the results; a former one is replaced. Without it: runs/RECORD.",
            show_default=False,
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option("--data", help="Folder of a data set that does not come along: autoferry.", show_default=False),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            help='"from measurements": begin where the first ones say. Without it: what the record says.',
            show_default=False,
        ),
    ] = None,
    doctor: Annotated[
        bool, typer.Option("--doctor", help="Say in the report what is wrong with the model, as sigmax doctor does.")
    ] = False,
) -> None:
    """Track a record with one or several filters and write estimates, summary and report.

    Leaves estimates.parquet, summary.json and report.html in the folder; for plots without identities (a TOML
    file with a table [tracking], or autoferry:N) tracks.parquet instead of the first.

    Example: sigmax track plaza1 --filter EKF --filter SRUKFB:alpha=0.45,beta=2,kappa=-2 --out runs/try
    """
    say_on_signal("nothing was written")
    from sigmax.cli.track import track_record

    track_record(record, filter or [], out, data, prior, doctor)


def terrain_command(
    map: Annotated[str, typer.Argument(help="jacksboro, or an .npz or GeoTIFF of your own.")] = "jacksboro",
    filter: Annotated[
        list[str] | None,
        typer.Option("--filter", "-f", help="NAME or NAME:parameter=value,…; may be repeated.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder for the results. Without it: runs/MAP.", show_default=False),
    ] = None,
    method: Annotated[str, typer.Option(help="bicubic or bilinear look-up.")] = "bicubic",
    flights: Annotated[int, typer.Option(min=1, help="How many, each with errors of its own.")] = 1,
    seed: Annotated[int, typer.Option(help="Fixes all draws.")] = 1,
) -> None:
    """Fly over an elevation map with a drifting inertial system, and find the position by the heights below.

    Leaves estimates.parquet, summary.json and report.html, with the map, in the folder.

    Example: sigmax terrain jacksboro --filter EKF --filter CKF:permute=1 --out runs/fault
    """
    say_on_signal("nothing was written")
    from sigmax.cli.terrain import fly

    fly(map, filter or [], out, method, flights, seed)


def explain_command(
    model: Annotated[
        str,
        typer.Argument(
            help="A built-in model (see: sigmax models), a record, a TOML file, or file.py:function.",
            show_default=False,
        ),
    ],
    filter: Annotated[str, typer.Option("--filter", "-f", help="NAME or NAME:parameter=value,…")] = "SRCKFB",
    measure: Annotated[bool, typer.Option(help="Take the time of the linearisations, too.")] = True,
) -> None:
    """Show what a filter evaluates in a model, how often, and what another order of the state saves.

    Example: sigmax explain terrain --filter UKF
    """
    from sigmax.cli.explain import explain_model

    explain_model(model, filter, measure)


def doctor_command(
    record: Annotated[
        str,
        typer.Argument(
            help="A built-in record (see: sigmax records), or a TOML file that describes your data.",
            show_default=False,
        ),
    ],
    filter: Annotated[
        str | None,
        typer.Option(
            "--filter", "-f", help="Whose likelihood judges, as for track; else the record's first.", show_default=False
        ),
    ] = None,
    track: Annotated[
        list[str] | None,
        typer.Option("--track", help="Examine this track alone; may be repeated.", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the examinations of all tracks as JSON.")] = False,
    write: Annotated[
        bool,
        typer.Option("--write", help="Leave a corrected description, NAME-corrected.toml, beside that of the record."),
    ] = False,
) -> None:
    """Say what is wrong with the model of a record: causes with evidence, size, remedy and proof.

    Exit status: 0 nothing found; 1 findings; 2 it cannot be examined.

    Example: sigmax doctor plaza2 --filter EKF:fixed=range_scale
    """
    say_on_signal("the examination was not finished")
    from sigmax.cli.doctor import examine_record

    examine_record(record, filter, track or [], as_json, write)


def fit_command(
    records: Annotated[
        list[str],
        typer.Argument(
            help="Built-in records (see: sigmax records), or TOML files of your data; they share the numbers.",
            show_default=False,
        ),
    ],
    free: Annotated[
        list[str],
        typer.Option(
            "--free",
            help="Numbers to fit, separated by commas: Q, R, Q.COMPONENT, R.SENSOR.COMPONENT, a component of state "
            "or bias, or the end of a path in the description such as noise.range; NAME=LOW..HIGH keeps one within. "
            "May be repeated.",
            show_default=False,
        ),
    ],
    filter: Annotated[
        str | None,
        typer.Option(
            "--filter", "-f", help="Whose likelihood, as for track; else that of the first record.", show_default=False
        ),
    ] = None,
    hold_out: Annotated[
        float,
        typer.Option(
            "--hold-out", help="Share of the steps, the last ones, held out to test a fit of the others; 0 for none."
        ),
    ] = 0.3,
    by_em: Annotated[
        bool, typer.Option("--em", help="Start the factors of Q and R from expectation–maximisation (EM).")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the fit as JSON.")] = False,
    write: Annotated[
        bool,
        typer.Option("--write", help="Leave a description with the numbers, NAME-fitted.toml, beside each record's."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Folder for report.html and summary.json; without it none.", show_default=False
        ),
    ] = None,
) -> None:
    """Fit numbers of a model to records by likelihood: standard errors, correlations, what is not determined.

    Exit status: 0 all is determined; 1 something is not; 2 it cannot be fitted.

    Example: sigmax fit plaza2 --free Q,R,range_scale --out runs/fit
    """
    say_on_signal("the fit was not finished")
    from sigmax.cli.fit import fit_records

    fit_records(records, free, filter, hold_out, by_em, as_json, write, out)


def serve_command(
    description: Annotated[
        Path,
        typer.Argument(help="A TOML file with a table [tracking]; a line is a row of its table.", show_default=False),
    ],
    filter: Annotated[
        str | None,
        typer.Option(
            "--filter", "-f", help="NAME or NAME:parameter=value,…; else the file's first.", show_default=False
        ),
    ] = None,
    source: Annotated[
        str,
        typer.Option("--from", help="Plots: -, tcp:PORT (on loopback), tcp:HOST:PORT, nats:HOST:PORT/SUBJECT."),
    ] = "-",
    sink: Annotated[str, typer.Option("--to", help="Updates: the same forms.")] = "-",
    checkpoint: Annotated[
        Path | None,
        typer.Option("--checkpoint", "-c", help="Folder to go on from, after any kind of end.", show_default=False),
    ] = None,
    max_line: Annotated[int, typer.Option(help="Bytes; longer lines are refused.")] = 1 << 20,
    quiet: Annotated[
        float | None,
        typer.Option(
            help="Seconds of silence that end a scan; else 1, or one and a half turns of the slowest sensor.",
            show_default=False,
        ),
    ] = None,
    tentative: Annotated[bool, typer.Option("--tentative", help="Tell of tracks not yet confirmed, too.")] = False,
) -> None:
    """Track plots as they come: lines of JSON in, an update of the tracks as a line of JSON for every scan.

    Example: sigmax serve plots.toml --from tcp:7700 --to tcp:7701 --checkpoint state
    """
    from sigmax.cli.serve import serve_plots

    serve_plots(description, filter, source, sink, checkpoint, max_line, quiet, tentative)

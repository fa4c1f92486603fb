"""The commands. What is slow to load is loaded inside them, so that help comes at once."""

from pathlib import Path
from typing import Annotated

import typer

from sigmax.cli.commands import (
    doctor_command,
    explain_command,
    fit_command,
    serve_command,
    terrain_command,
    track_command,
)
from sigmax.signals import say_on_signal

app = typer.Typer(
    name="sigmax",
    help="Nonlinear Kalman filtering on recorded measurements.\n\nExample: sigmax track plaza1\n\n"
    "Exit status: 0 all is well; 1 it ran, but no filter gave a result; 2 something given does not fit, and nothing "
    "was written; 70 a fault of sigmax; 130 and 143 interrupted and terminated.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Rich help would take longer to load than all the rest.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def allow_callback(
    context: typer.Context,
    allow: Annotated[
        list[Path] | None,
        typer.Option(
            "--allow",
            metavar="FOLDER",
            help="Run functions of files in this folder, wherever the description lies that names them and whoever "
            "could have written them; may be repeated. Without it: those beside or below the description that "
            "nobody else could have written.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Nonlinear Kalman filtering on recorded measurements."""
    if allow:
        from sigmax.files.userfile import functions_allowed_from

        context.with_resource(functions_allowed_from(*allow))


app.command("track")(track_command)
app.command("terrain")(terrain_command)
app.command("explain")(explain_command)
app.command("doctor")(doctor_command)
app.command("fit")(fit_command)
app.command("serve")(serve_command)


@app.command("filters")
def filters_command() -> None:
    """List the catalogue of filters: prediction rule, correction rule and form of each.

    Example: sigmax filters
    """
    from sigmax.cli.lists import print_filters

    print_filters()


@app.command("records")
def records_command() -> None:
    """List the built-in records of real measurements.

    Example: sigmax records
    """
    from sigmax.cli.lists import print_records

    print_records()


@app.command("compare")
def compare_command(
    study: Annotated[
        str,
        typer.Argument(
            help="A named study (see: sigmax studies), a built-in model, a TOML description, or file.py:function.",
            show_default=False,
        ),
    ],
    filter: Annotated[
        list[str] | None,
        typer.Option(
            "--filter",
            "-f",
            "--filters",
            help="NAME or NAME:parameter=value,…; several with blanks, or repeated. Without it: those of the study.",
            show_default=False,
        ),
    ] = None,
    runs: Annotated[
        int | None,
        typer.Option("--runs", "-n", help="Without it as the study says.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(help="Fixes all draws.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder for the results; a stopped study goes on there. Without it: runs/STUDY.",
            show_default=False,
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="option=value of a named study; may be repeated.", show_default=False),
    ] = None,
    particles: Annotated[
        int | None, typer.Option(help="Of the optimum, 0 for none; without it as the study says.", show_default=False)
    ] = None,
    show: Annotated[
        list[int] | None,
        typer.Option(
            help="A run, from 1, of which the page shows every estimate over time; may be repeated.", show_default=False
        ),
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Without it one for each core.", show_default=False)] = None,
    chunk: Annotated[int, typer.Option(help="Blocks of runs that a worker is given at a time.")] = 1,
    cluster: Annotated[
        str | None,
        typer.Option(help="A backend of joblib: loky, dask, ray. Without it threads.", show_default=False),
    ] = None,
) -> None:
    """Compare filters over many runs of a study: errors, honesty, lost runs, cost, distance to the optimum.

    Leaves report.html, summary.json, measures.parquet and figures in the folder.

    Example: sigmax compare single-beacon --filter EKF --filter PF --runs 500 --out runs/beacon
    """
    say_on_signal("the same command goes on where this one stopped")
    from sigmax.cli.compare import compare_study

    compare_study(study, filter or [], runs, seed, out, set_ or [], particles, show or [], workers, chunk, cluster)


@app.command("studies")
def studies_command() -> None:
    """List the named studies.

    Example: sigmax studies
    """
    from sigmax.cli.lists import print_studies

    print_studies()


@app.command("papers")
def papers_command(
    paper: Annotated[
        str | None, typer.Argument(help="One of them; without it their names.", show_default=False)
    ] = None,
) -> None:
    """List the papers that the filters come from, or the rows of one: what shows each, and what comes of it.

    Example: sigmax papers sobolev
    """
    from sigmax.cli.papers import print_paper, print_papers

    if paper is None:
        print_papers()
    else:
        print_paper(paper)


export = typer.Typer(help="Write a filter out as source code.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(export, name="export")


@export.callback()
def export_group() -> None:
    """Write a filter out as source code for other machines.

    Example: sigmax export c radar-ct --filter SRECKFB --out radar
    """


@export.command("c")
def export_c_command(
    model: Annotated[
        str,
        typer.Argument(
            help="A built-in model (see: sigmax models), a record's TOML file, or file.py:function that gives "
            "(model, prior).",
            show_default=False,
        ),
    ],
    filter: Annotated[str, typer.Option("--filter", "-f", help="NAME or NAME:parameter=value,…")] = "SRECKFB",
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder for the files. Without it: export/MODEL.", show_default=False),
    ] = None,
    single: Annotated[bool, typer.Option("--float", help="Numbers of type float instead of double.")] = False,
) -> None:
    """Write a filter on a model as self-contained C99 with a test program and a Makefile.

    Example: sigmax export c radar-ct --filter SRECKFB --out radar && make -C radar test
    """
    from sigmax.cli.export import export_model

    export_model(model, filter, out, single)


@app.command("models")
def models_command() -> None:
    """List the built-in models.

    Example: sigmax models
    """
    from sigmax.cli.lists import print_models

    print_models()

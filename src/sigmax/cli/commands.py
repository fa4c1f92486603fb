"""Commands of the cheap transform and of terrain-aided navigation; what is slow to load is loaded inside."""

import sys
from pathlib import Path
from typing import Annotated

import typer


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
    from sigmax.cli.terrain import fly

    try:
        fly(map, filter or [], out, method, flights, seed)
    except KeyboardInterrupt:
        print("sigmax: interrupted; nothing was written", file=sys.stderr)
        raise typer.Exit(130) from None


def explain_command(
    model: Annotated[
        str,
        typer.Argument(
            help="A built-in model (see: sigmax models), a record, a TOML file, or file.py:function.",
            show_default=False,
        ),
    ],
    filter: Annotated[
        str, typer.Option("--filter", "-f", help="NAME or NAME:parameter=value,… with sigma points.")
    ] = "SRCKFB",
    measure: Annotated[bool, typer.Option(help="Take the time of the linearisations, too.")] = True,
) -> None:
    """Show what a sigma-point filter evaluates in a model, how often, and what another order of the state saves.

    Example: sigmax explain terrain --filter UKF
    """
    from sigmax.cli.explain import explain_model

    explain_model(model, filter, measure)

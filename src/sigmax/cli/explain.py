"""`sigmax explain`."""

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sigmax.records import find_model, parse_trial
from sigmax.running.explain import Explained, explain


def explain_model(model: str, filter: str, measure: bool) -> None:
    """Find the model, take it apart, say what was found.

    Raises:
        InputError: for whatever does not fit.
    """
    console, errors = Console(), Console(stderr=True)
    trial = parse_trial(filter)
    task = find_model(model)
    with errors.status("tracing, and measuring"):
        found = explain(trial.filter, task.model, task.prior, dt=task.dt, inputs=task.inputs, measure=measure)
    for one in found:
        console.print(_table(one))
        for line in _sentences(one):
            console.print(escape(line), highlight=False, soft_wrap=True)
        console.print()
    if any(one.estimated > 0 for one in found):
        name = trial.name.partition(":")[0]
        console.print(f"To draw the points in this order: --filter {name}:permute=1", highlight=False)


def _table(one: Explained) -> Table:
    table = Table(
        box=None,
        pad_edge=False,
        header_style="bold",
        title=f"{escape(one.function)}: {escape(one.rule)}, {one.points} points",
        title_justify="left",
        title_style="bold",
    )
    for head in ("reads", "operations"):
        table.add_column(head, overflow="fold")
    for head in ("cost", "evaluations", "permuted"):
        table.add_column(head, justify="right", no_wrap=True)
    for part in sorted(one.parts, key=lambda p: -p.cost):
        counts = str(part.given), str(part.permuted)
        table.add_row(escape(", ".join(part.reads)), part.what, f"{part.cost:g}", *counts)
    return table


def _sentences(one: Explained) -> Sequence[str]:
    said = []
    if one.straight:
        said.append(f"{one.straight} of {one.results} results are straight: exact, without any point.")
    if one.held and one.parts:
        said.append(f"Not sampled: {', '.join(one.held)}.")
    if one.estimated > 0:
        said.append(f"Order: {', '.join(one.order)}; it saves {one.estimated:.0%} of the cost of all evaluations.")
    elif one.parts:
        said.append("No other order of the state saves more than it costs.")
    if one.parts:
        said.append(f"Belov's Q: {one.Q[0]:.0f} as the state stands, {one.Q[1]:.0f} sorted.")
    if one.seconds is not None and one.estimated > 0:
        before, after = (f"{s * 1e6:.3g} µs" for s in one.seconds)
        said.append(f"Measured for one linearisation of one track: {before} → {after}, {one.measured:.0%} less.")
    return said

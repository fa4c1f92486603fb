"""`sigmax explain`."""

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sigmax.filters import Bank
from sigmax.preparation.bending import bending
from sigmax.preparation.folding import folding
from sigmax.preparation.joining import modes_of
from sigmax.preparation.prepare import as_filter
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
    console.print(_table(found, trial.name))
    if isinstance(trial.filter, Bank):
        console.print(
            "All of it for each member of the bank, and the second differences by which they split.", highlight=False
        )
    for one in found:
        for line in _sentences(one):
            console.print(f"{escape(one.function)}: {escape(line)}", highlight=False, soft_wrap=True)
    if any(one.estimated > 0 for one in found):
        name = trial.name.partition(":")[0]
        console.print(f"To draw the points in this order: --filter {name}:permute=1", highlight=False)
    k = None if task.inputs is None else len(task.inputs)
    plain = [] if task.model.bias is not None else modes_of(as_filter(trial.filter, task.model).on(0), task.model)
    careful = [
        line for own, part in plain for line in (*folding(own, part, task.prior, k), *bending(own, part, task.prior))
    ]
    for line in dict.fromkeys(careful):
        console.print(f"[yellow]Careful:[/yellow] {escape(line)}.", highlight=False, soft_wrap=True)


def _table(found: Sequence[Explained], name: str) -> Table:
    """The whole model, a row for each part that is sampled."""
    table = Table(
        box=None,
        pad_edge=False,
        header_style="bold",
        title=f"{escape(name)}: what is evaluated in a step, and how often",
        title_justify="left",
        title_style="bold",
    )
    table.add_column("function", overflow="fold")
    for head in ("reads", "operations"):
        table.add_column(head, overflow="fold")
    for head in ("cost", "evaluations", "permuted"):
        table.add_column(head, justify="right", no_wrap=True)
    for one in found:
        if not one.parts:
            table.add_row(escape(one.function), "", "straight: exact", "", "", "")
        for k, part in enumerate(sorted(one.parts, key=lambda p: -p.cost)):
            counts = str(part.given), str(part.permuted)
            function = escape(one.function) if k == 0 else ""
            table.add_row(function, escape(", ".join(part.reads)), part.what, f"{part.cost:g}", *counts)
    return table


def _sentences(one: Explained) -> Sequence[str]:
    points = one.Q is not None
    said = [f"{one.rule}, {one.points} {'points' if points else 'values and derivatives'}."]
    if one.straight:
        said.append(f"{one.straight} of {one.results} results are straight: exact{', without any point' * points}.")
    if one.held and one.parts:
        said.append(f"Not sampled: {', '.join(one.held)}.")
    if one.estimated > 0:
        said.append(f"Order: {', '.join(one.order)}; it saves {one.estimated:.0%} of the cost of all evaluations.")
    elif one.parts and points:
        said.append("No other order of the state saves more than it costs.")
    if one.parts and one.Q is not None:
        weights = ", ".join(f"{name} {weight:g}" for name, weight in one.W.items() if weight)
        said.append(f"Belov's W: {weights}; Q: {one.Q[0]:.0f} as the state stands, {one.Q[1]:.0f} sorted.")
    if one.seconds is not None and one.estimated > 0:
        before, after = (f"{s * 1e6:.3g} µs" for s in one.seconds)
        said.append(f"Measured for one linearisation of one track: {before} → {after}, {one.measured:.0%} less.")
    return said

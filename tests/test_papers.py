"""The tables of the papers: every command in them parses, every study, test, script and call in them is there."""

import ast
import re
import shlex
from functools import reduce
from pathlib import Path

import pytest
import typer.main
from typer.testing import CliRunner

import sigmax
from sigmax import InputError
from sigmax.cli.app import app
from sigmax.models.builtin import BUILTIN
from sigmax.papers import PAPERS, rows, table
from sigmax.records import parse_trial
from sigmax.studies import load_studies
from sigmax.studies.load import parsed_filters

ROOT = Path(__file__).parent.parent
COMMANDS = typer.main.get_command(app).commands
ROWS = [(paper, row) for paper in PAPERS for row in rows(paper)]


def check_sigmax(name, *arguments):
    """Parsed by the command line itself, without running it; studies, options, filters and models looked up."""
    command = COMMANDS[name]
    given = command.make_context(name, list(arguments)).params
    if name == "compare":
        options = dict(text.split("=") for text in given["set_"] or ())
        for study in load_studies(given["study"], options):
            parsed_filters([f for text in given["filter"] or () for f in text.split()], study)
    elif name == "explain":
        assert given["model"] in BUILTIN
        parse_trial(given["filter"])
    elif name == "papers":
        assert given["paper"] is None or rows(given["paper"])


def check_pytest(file, k=None, expression=""):
    found = re.findall(r"^def (test_\w+)", (ROOT / file).read_text(), re.MULTILINE)
    assert found
    assert k in (None, "-k")
    assert any(expression in name for name in found), f"{file} has no test with {expression!r} in its name"


def check_python(script, *arguments):
    assert (ROOT / script).exists()


CHECKED = {"sigmax": check_sigmax, "pytest": check_pytest, "python": check_python}


def check_call(text):
    """Names are looked up, from `sigmax` on; what is called with constants is called."""
    tree = ast.parse(text, mode="eval").body
    named = tree.func if isinstance(tree, ast.Call) else tree
    parts = ast.unparse(named).split(".")
    assert parts[0] == "sigmax"
    __import__("sigmax.dependence")
    found = reduce(getattr, parts[1:], sigmax)
    if isinstance(tree, ast.Call):
        values = [ast.literal_eval(a) for a in tree.args]
        assert found(*values, **{k.arg: ast.literal_eval(k.value) for k in tree.keywords}) is not None


def check(command):
    first, *arguments = shlex.split(command)
    if first in CHECKED:
        CHECKED[first](*arguments)
    else:
        check_call(command)


@pytest.mark.parametrize(("paper", "row"), ROWS, ids=lambda v: v if isinstance(v, str) else v.row[:40])
def test_what_a_row_names_is_there(paper, row):
    assert row.row
    assert len(row.verdict) > 4
    assert "@@" not in row.verdict
    assert row.commands or re.match(r"\*\*(refused|contradict)", row.verdict), "a row without a command says why"
    for command in row.commands:
        check(command)


def test_what_is_checked_can_fail():
    for wrong in (
        "sigmax compare sobolev-rms",
        "sigmax compare sobolev-rmse --set p1=x",
        "sigmax compare sobolev-rmse --filter NOPE",
        "sigmax explain terrain --filter NOPE",
        "sigmax papers nobody",
        "pytest tests/laws/test_bias.py -k nothing_of_that_name",
        "python benchmarks/nothing.py",
        "sigmax.get('NOPE')",
        "sigmax.rules.Nothing",
    ):
        with pytest.raises((InputError, AssertionError, AttributeError)):
            check(wrong)


@pytest.mark.parametrize("paper", PAPERS)
def test_a_table_is_whole_and_the_page_shows_it(paper):
    lines = table(paper).splitlines()
    assert lines[0] == "| row of the paper | command or call | verdict, with our figure |"
    assert len(lines) == len(rows(paper)) + 2
    assert f'--8<-- "src/sigmax/papers/{paper}.md"' in (ROOT / "docs" / "papers" / f"{paper}.md").read_text()


def test_papers_are_listed_and_printed():
    listed = CliRunner().invoke(app, ["papers"]).output
    assert all(paper in listed for paper in PAPERS)
    printed = CliRunner().invoke(app, ["papers", "Belov"], env={"COLUMNS": "200"}).output
    assert "sigmax explain terrain" in printed
    assert "**" not in printed

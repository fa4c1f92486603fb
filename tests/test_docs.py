"""Every snippet and command of the README and of the docs is executed, page by page.

How a block is treated depends on its language and its title alone:

- any block titled with a file name (`toml title="radar.toml"`) is first written to that file;
- `python` blocks run in the order of the page, in one namespace and in a temporary directory;
- a block titled "Output" holds what the Python block before it prints: words exactly, numbers to 1 %;
- a picture that the page shows is drawn by its Python blocks, and kept for the site;
- in `console` blocks the lines that begin with `$ ` go to a shell, in that directory; those that
  would install things or build an environment are compared with the Makefile and pyproject.toml;
  commands of sigmax alone run in this process, which has loaded already what takes them seconds to load, but for
  those of the README.
"""

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path
from typing import Any

import pytest
from docs.pages import Block, blocks_of, gallery, pictures_of
from typer.testing import CliRunner

import sigmax
from sigmax.cli.app import app

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
TARGETS = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def _name(page: Path) -> str:
    return page.stem if page.parent in (ROOT, ROOT / "docs") else f"{page.parent.name}/{page.stem}"


def execute(page: Path, block: Block, namespace: dict[str, Any]) -> str:
    """What a Python block prints; a failure points at the line of the page."""
    code = compile("\n" * block.line + block.body, str(page), "exec")
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(code, namespace)
    return printed.getvalue()


def assert_same_output(promised: str, printed: str, where: str) -> None:
    words = [" ".join(_NUMBER.sub("#", text).split()) for text in (promised, printed)]
    assert words[0] == words[1], f"{where} promises\n{promised}\nbut the block before it prints\n{printed}"
    numbers = [[float(n) for n in _NUMBER.findall(text)] for text in (promised, printed)]
    assert numbers[1] == pytest.approx(numbers[0], rel=0.01), f"{where}: the block before it prints\n{printed}"


def check_make(arguments: list[str], where: str) -> None:
    assert arguments, f"{where}: make without a target"
    for target in arguments:
        assert target in TARGETS, f"{where}: the Makefile has no target {target}, it has {sorted(TARGETS)}"


def check_pip(arguments: list[str], where: str) -> None:
    assert arguments[0] == "install", f"{where}: pip {arguments[0]}"
    for wanted in (a for a in arguments[1:] if not a.startswith("-")):
        name, _, extras = wanted.rstrip("]").partition("[")
        assert name in (".", PROJECT["name"]), f"{where}: installs {name}, the project is {PROJECT['name']}"
        for extra in filter(None, extras.split(",")):
            assert extra in PROJECT["optional-dependencies"], f"{where}: there is no extra {extra}"


COMPARED = {"make": check_make, "pip": check_pip}


def shell(command: str, directory: Path, where: str, here: bool = False) -> None:
    first, *arguments = shlex.split(command)
    if here and first == "sigmax" and not set(command) & set("|;&<>$`*"):
        with warnings.catch_warnings():
            warnings.simplefilter("default")  # as in a shell
            done = CliRunner().invoke(app, arguments)
        assert done.exit_code == 0, (
            f"{where}: `{command}` ended with {done.exit_code}:\n{done.output}\n{done.exception}"
        )
        return
    # In a folder that the page has made itself, make is run.
    if first in COMPARED and "-C" not in arguments:
        COMPARED[first](arguments, where)
        return
    # The commands of the environment that runs the tests, as a newcomer's shell would find them.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    env = {**os.environ, "PATH": path}
    done = subprocess.run(
        ["bash", "-c", command], cwd=directory, env=env, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, f"{where}: `{command}` ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    blocks = blocks_of(page)
    for block in (b for b in blocks if b.is_file):
        (tmp_path / block.title).write_text(block.body)
    namespace: dict[str, Any] = {"__name__": page.stem}
    printed: str | None = None
    for block in blocks:
        where = f"{page.name}, line {block.line}"
        if block.is_file:
            continue
        if block.title == "Output":
            assert printed is not None, f"{where}: an output without a Python block before it"
            assert_same_output(block.body, printed, where)
        elif block.language == "python":
            printed = execute(page, block, namespace)
        elif block.language == "console":
            commands = [line[2:] for line in block.body.splitlines() if line.startswith("$ ")]
            assert commands, f"{where}: a console block without a command"
            for command in commands:
                shell(command, tmp_path, where, here=page.stem != "README")
    for picture in pictures_of(page):
        assert (tmp_path / picture).exists(), f"{page.name} shows {picture}, which nothing on it draws"
        gallery(page).mkdir(parents=True, exist_ok=True)
        shutil.copy(tmp_path / picture, gallery(page) / picture)


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_page_has_no_block_that_nobody_looks_at(page: Path) -> None:
    """A block is executed, written to a file, compared, or plain text: a language without a rule is a mistake."""
    known = {"python", "console", "text"}
    for block in blocks_of(page):
        assert block.language in known or block.is_file, f"{page.name}, line {block.line}: what is {block.language!r}?"


def test_fences_are_all_found() -> None:
    """The pattern sees as many blocks as there are pairs of fences: none is passed over in silence."""
    for page in PAGES:
        fences = [line for line in page.read_text().splitlines() if line.lstrip().startswith("```")]
        assert 2 * len(blocks_of(page)) == len(fences), page.name


def test_what_the_tests_compare_can_fail() -> None:
    assert_same_output("rmse 1.000 m", "rmse  1.001 m\n", "here")
    with pytest.raises(AssertionError):
        assert_same_output("rmse 1.00 m", "rmse 1.02 m", "here")
    with pytest.raises(AssertionError):
        assert_same_output("rmse 1.00 m", "bias 1.00 m", "here")
    with pytest.raises(AssertionError):
        check_make(["dmeo"], "here")
    with pytest.raises(AssertionError):
        check_pip(["install", ".[piazza]"], "here")


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_links_to_pages_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text()):
        drawn = target in pictures_of(page)
        assert drawn or (page.parent / target).exists(), f"{page.name} links to {target}, which is not there"


def test_table_of_the_readme_is_the_catalogue() -> None:
    table = (ROOT / "README.md").read_text().split("[start:catalogue]")[1].split("[end:catalogue]")[0]
    lines = [line.strip("|").split("|") for line in table.splitlines() if line.startswith("|")]
    forms = [cell.strip() for cell in lines[0][1:]]
    cells = [pair for line in lines[2:] for pair in zip(line[1:], forms, strict=True)]
    listed = [(name, form) for cell, form in cells for name in re.findall(r"`(\w+)`", cell)]
    assert sorted(listed) == sorted((name, sigmax.get(name).form.name) for name in sigmax.names())

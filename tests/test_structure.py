"""The folders are the architecture: imports go one way, files can be read at a sitting, names are documented."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import sigmax

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "sigmax"
FILES = sorted(SOURCE.rglob("*.py"))
ORDER = [
    "errors",
    "native",
    "algebra",
    "dependence",
    "rules",
    "forms",
    "filters",
    "models",
    "running",
    "tracking",
    "filterpy",
    "conformance",
    "records",
    "serving",
    "stonesoup",
    "studies",
    "reports",
    "export",
    "cli",
]


def layer(path):
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sigmax"):
            yield node.module.split(".")[1] if "." in node.module else node.names[0].name
        elif isinstance(node, ast.Import):
            yield from (a.name.split(".")[1] for a in node.names if a.name.startswith("sigmax."))


@pytest.mark.parametrize("path", [f for f in FILES if layer(f) != "__init__"], ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_go_one_way(path):
    own = ORDER.index(layer(path))
    assert all(ORDER.index(other) <= own for other in imported(path) if other in ORDER)


def test_no_folder_is_missing_from_the_order():
    assert {layer(f) for f in FILES} - {"__init__"} == set(ORDER)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_files_can_be_read_at_a_sitting(path):
    assert len(path.read_text().splitlines()) <= 260


@pytest.mark.parametrize("name", [n for n in sigmax.__all__ if not inspect.ismodule(getattr(sigmax, n))])
def test_every_public_name_says_what_it_is(name):
    assert len((getattr(sigmax, name).__doc__ or "").strip()) > 20


def test_importing_loads_nothing_heavy():
    code = "import sigmax, sys; print([m for m in ('jax', 'pandas', 'plotly', 'scipy') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"

"""The folders are the architecture: imports go one way, files can be read at a sitting, names are documented."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import sigmax

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "sigmax"
FILES = sorted(SOURCE.rglob("*.py"))
# The table of folders that people read: a row may hold several names, from the lowest up.
_TABLE = (ROOT / "CONTRIBUTING.md").read_text().split("| folder of `src/sigmax` |")[1].split("\n\n")[0]
ORDER = [name for row in _TABLE.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])]


def layer(path):
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def home(name):
    """The folder that a name of the package comes from, None for what `__init__` itself says."""
    return sigmax._WHERE[name].split(".")[1] if name in sigmax._WHERE else name if name in ORDER else None


def imported(source, package="sigmax"):
    """The folders that a file takes from, whichever way it imports; a `package` of its own for relative imports."""
    names = {}  # what the package or a part of it is called in the file: "sigmax", or "sigmax.folder..."
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
            module = ".".join([*above, *filter(None, [node.module])]).split(".")
            if module[0] == "sigmax":
                yield from [module[1]] if len(module) > 1 else [home(a.name) for a in node.names]
        elif isinstance(node, ast.Import):
            for a in node.names:
                if a.name.split(".")[0] == "sigmax":
                    yield from a.name.split(".")[1:2]
                    names[a.asname or "sigmax"] = a.name if a.asname else "sigmax"
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            called = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
            texts = [a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
            if called in ("import_module", "__import__"):
                yield from (t.split(".")[1] for t in texts if t.startswith("sigmax."))
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and names.get(node.value.id) == "sigmax"
        ):
            yield home(node.attr)


@pytest.mark.parametrize(
    "source",
    [
        "import sigmax.running.live",
        "import sigmax.running as r",
        "from sigmax.running import Live",
        "from sigmax import Live",
        "from sigmax import Live as L",
        "import sigmax\nsigmax.Live",
        "import sigmax as s\ndef f():\n    return s.run(1)",
        "def f():\n    from sigmax import running",
        "from ..running import live",
        "from .. import running",
        "import importlib\nimportlib.import_module('sigmax.running')",
    ],
)
def test_the_law_sees_every_way_to_import(source):
    assert "running" in set(imported(source, "sigmax.native"))


@pytest.mark.parametrize("path", [f for f in FILES if layer(f) != "__init__"], ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_go_one_way(path):
    own = ORDER.index(layer(path))
    package = ".".join(path.relative_to(SOURCE.parent).parts[:-1])
    assert all(ORDER.index(other) <= own for other in imported(path.read_text(), package) if other in ORDER)


def test_no_folder_is_missing_from_the_order():
    assert {layer(f) for f in FILES} - {"__init__"} == set(ORDER)
    assert len(ORDER) == len(set(ORDER))


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_files_can_be_read_at_a_sitting(path):
    assert len(path.read_text().splitlines()) <= 260


@pytest.mark.parametrize("folder", sorted({f.parent for f in FILES}), ids=lambda p: str(p.relative_to(SOURCE)))
def test_folders_can_be_overlooked(folder):
    assert sum(f.stem != "__init__" for f in folder.glob("*.py")) <= 20


@pytest.mark.parametrize("name", [n for n in sigmax.__all__ if not inspect.ismodule(getattr(sigmax, n))])
def test_every_public_name_says_what_it_is(name):
    assert len((getattr(sigmax, name).__doc__ or "").strip()) > 20


@pytest.mark.parametrize("name", sigmax._MOVED)
def test_names_of_the_last_version_are_found_with_a_note_of_where_they_are(name):
    with pytest.warns(DeprecationWarning, match=f"{sigmax._MOVED[name]}.{name}"):
        found = getattr(sigmax, name)
    assert found is getattr(importlib.import_module(sigmax._MOVED[name]), name)
    assert name not in sigmax.__all__


def test_importing_loads_nothing_heavy():
    code = "import sigmax, sys; print([m for m in ('jax', 'pandas', 'plotly', 'scipy') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"

"""What a core install can do, what it says of the rest, and what an index shows of the package."""

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from sigmax.errors import APP

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
WITHOUT = f"import sys\nsys.modules.update(dict.fromkeys({[*APP, 'plotly', 'xarray', 'polars']!r}))\n"


def names(requirements):
    return {re.match(r"[\w-]+", r)[0] for r in requirements}


def core(code, *arguments):
    command = [sys.executable, "-c", WITHOUT + code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def test_the_extra_has_what_the_message_knows():
    assert names(PROJECT["optional-dependencies"]["app"]) == set(APP)
    assert names(PROJECT["dependencies"]) == {"jax", "numpy", "scipy", "platformdirs"}


def test_the_core_filters_tracks_and_exports():
    done = core(
        "import numpy as np, sigmax\n"
        "from sigmax import tracking, filterpy, conformance\n"
        "s = sigmax.builtin('position-cv')\n"
        "r = sigmax.run('SRCKFB', s.model, s.prior, np.ones((3, 2)), t=[0.0, 1.0, 2.0], t0=-1.0)\n"
        "live = sigmax.Live('SRCKFB', s.model, s.prior)\n"
        "live.step([1.0, 1.0], 1.0)\n"
        "print(r, sigmax.smooth, live, r._repr_html_()[:5], sigmax.export_c, sigmax.explain)\n"
        "for call in (r.to_frame, r.plot, r.to_xarray, lambda: r.to_parquet('x')):\n"
        "    try: call()\n"
        "    except sigmax.InputError as e: print(e)\n"
    )
    assert done.returncode == 0, done.stderr
    for package in ("pandas", "plotly", "xarray", "pyarrow"):
        assert f"pip install {package}" in done.stdout
    assert "Result of SRCKFB: 3 steps" in done.stdout


def test_the_core_says_what_is_to_be_installed_for_the_rest():
    done = core("from sigmax.cli import main\nmain()", "track", "plaza1")
    assert done.returncode == 2
    assert re.fullmatch(r"sigmax: the command line needs \w+, .*pip install 'sigmax\[app\]'\n", done.stderr)
    for name in ("compare", "records", "studies"):
        done = core(f"import sigmax\nsigmax.{name}")
        assert re.search(rf"ModuleNotFoundError: sigmax.{name} needs \w+, .*'sigmax\[app\]'", done.stderr)


def test_an_index_is_shown_links_that_lead_somewhere(monkeypatch):
    pytest.importorskip("hatchling")
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    hook = module.CustomMetadataHook(str(ROOT), {})
    for home in ("", "https://example.org/me/sigmax"):
        monkeypatch.setenv("SIGMAX_REPOSITORY", home)
        shown = {}
        hook.update(shown)
        links = re.findall(r"\]\(([^)]+)\)", shown["readme"]["text"])
        assert len(links) > 20
        for link in links:
            assert not home or link.startswith(home)
            assert (ROOT / link.removeprefix(f"{home}/blob/main/").partition("#")[0]).exists()
        assert bool(shown["urls"]) == bool(home)
        assert all(url.startswith(home) for url in shown["urls"].values())

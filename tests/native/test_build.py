"""What can go wrong around a compiler: every time a right answer, and at most one line of warning."""

import errno
import logging
import os
import pathlib
import stat
import subprocess
import sys
import tempfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax import InputError
from sigmax.native import build, machine
from sigmax.ownership import stranger

PROGRAM = """
import numpy as np, sigmax
model = sigmax.Model(motion=lambda x, dt: x * (1 + SCALE * dt), sensor=lambda x: x, Q=[0.1], R=[1.0])
result = sigmax.run("SRCKFB", model, sigmax.Gaussian([1.0], [[1.0]]), np.ones((4, 1)), backend=BACKEND)
print(repr(result.mean[-1, 0]))
"""


def filtered(tmp_path, scale="0.1", backend=None, **environment):
    """The last estimate of a process of its own, and what it wrote to its error channel."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.replace("SCALE", scale).replace("BACKEND", repr(backend))],
        env=os.environ | {"SIGMAX_CACHE": str(tmp_path / "cache"), "JAX_PLATFORMS": "cpu"} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return float(done.stdout.split("(")[-1].rstrip(")\n")), done.stderr


@pytest.fixture(scope="session")
def right(tmp_path_factory):
    value, warned = filtered(tmp_path_factory.mktemp("xla"), backend="xla")
    assert warned == ""
    return value


def libraries(tmp_path):
    return sorted((tmp_path / "cache").rglob("*.so"))


def test_a_damaged_cache_is_made_again(tmp_path, right):
    value, warned = filtered(tmp_path)
    assert value == pytest.approx(right, rel=1e-12)
    kept = libraries(tmp_path)
    assert len(kept) == 4  # driver, start, predict, correct
    kept[0].write_bytes(kept[0].read_bytes()[:100])
    kept[1].write_bytes(b"")
    kept[2].write_bytes(kept[2].read_bytes()[::-1])
    assert filtered(tmp_path) == (value, "")
    assert warned == ""


def test_what_is_in_the_cache_needs_no_compiler_run(tmp_path, right):
    filtered(tmp_path)
    before = [(p, p.stat().st_ino) for p in libraries(tmp_path)]
    filtered(tmp_path)
    assert [(p, p.stat().st_ino) for p in libraries(tmp_path)] == before


def test_a_cache_that_grows_too_large_loses_what_was_not_used_for_longest(tmp_path, monkeypatch):
    monkeypatch.setattr(build, "_MOST_FILES", 7)
    (tmp_path / "ab").mkdir()
    for k in range(8):
        (tmp_path / "ab" / f"{k}.so").write_bytes(b"")
        os.utime(tmp_path / "ab" / f"{k}.so", (1000 - k, 1000 - k))
    build._prune(tmp_path)
    assert sorted(p.name for p in (tmp_path / "ab").iterdir()) == [f"{k}.so" for k in range(6)]


def test_without_a_compiler_xla_takes_over_and_one_line_says_what_that_costs(tmp_path, right):
    value, warned = filtered(tmp_path, SIGMAX_CC="")
    assert value == pytest.approx(right, rel=1e-12)
    assert len(warned.splitlines()) == 1
    assert "no C compiler was found" in warned
    assert "sixty times" in warned
    assert libraries(tmp_path) == []


@pytest.mark.parametrize("script", ["kill -SEGV $$", "echo 'error: no' >&2; exit 3", "exit 0"])
def test_a_compiler_that_fails_costs_one_line(tmp_path, right, script):
    broken = tmp_path / "cc"
    broken.write_text(f"#!/bin/sh\n{script}\n")
    broken.chmod(broken.stat().st_mode | stat.S_IXUSR)
    value, warned = filtered(tmp_path, SIGMAX_CC=str(broken))
    assert value == pytest.approx(right, rel=1e-12)
    assert len(warned.splitlines()) == 1
    assert "sigmax uses XLA" in warned
    assert libraries(tmp_path) == []


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path, right):
    (tmp_path / "cache").write_text("a file where the folder should be")
    value, warned = filtered(tmp_path)
    assert value == pytest.approx(right, rel=1e-12)
    assert len(warned.splitlines()) == 1
    assert "compiles for this process alone" in warned


def _damage(cache):
    """Ways in which a cache is not to be trusted or used; each is done to one that was used before."""
    library = next(cache.rglob("*.so"))
    return {
        "a library that others may write": lambda: library.chmod(0o777),
        "a folder that others may write": lambda: library.parent.chmod(0o777),
        "a cache that the group may write": lambda: cache.chmod(0o770),
        "a link": lambda: (library.rename(cache / "real"), library.symlink_to(cache / "real")),
    }


@pytest.mark.parametrize("way", range(4))
def test_nothing_is_loaded_from_where_others_may_write(tmp_path, monkeypatch, caplog, way):
    monkeypatch.setenv("SIGMAX_CACHE", str(tmp_path / "cache"))
    source, settings = "int f(void) { return 1; }", ("-O1",)
    first = build.built(source, settings)
    assert build.built(source, settings) == first
    list(_damage(tmp_path / "cache").values())[way]()
    build._found_folder.cache_clear()
    with caplog.at_level(logging.WARNING, logger="sigmax"):
        again = build.built(source, settings)
    assert not stranger(again, again.parents[1])
    assert ("is a link" if way == 3 else "can be written by") in caplog.text


def test_a_source_that_others_may_write_is_not_taken(tmp_path, monkeypatch):
    monkeypatch.setenv("SIGMAX_CACHE", str(tmp_path / "cache"))
    build.remember("name", "int f;")
    assert build.remembered("name") == "int f;"
    next((tmp_path / "cache").rglob("*.c")).chmod(0o666)
    assert build.remembered("name") is None


def test_a_folder_of_the_cache_that_cannot_be_written_is_done_without(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("SIGMAX_CACHE", str(tmp_path / "cache"))
    build.cache_folder()
    monkeypatch.setattr(
        build.tempfile, "TemporaryDirectory", _refusing(tmp_path / "cache", tempfile.TemporaryDirectory)
    )
    with caplog.at_level(logging.WARNING, logger="sigmax"):
        found = build.built("int g(void) { return 1; }", ("-O1",))
    assert found.exists()
    assert tmp_path not in found.parents
    assert "compiles for this process alone" in caplog.text


def _refusing(folder, make):
    """Temporary folders, but for those below a folder, as on a full disk or without the right to write."""

    def made(*about, dir=None, **others):
        if dir is not None and folder in pathlib.Path(dir).parents:
            raise OSError(errno.ENOSPC, "No space left on device")
        return make(*about, dir=dir, **others)

    return made


@pytest.mark.slow
def test_processes_that_compile_at_once_do_not_disturb_each_other(tmp_path, right):
    code = PROGRAM.replace("SCALE", "0.1").replace("BACKEND", "'native'")
    environment = os.environ | {"SIGMAX_CACHE": str(tmp_path / "cache"), "JAX_PLATFORMS": "cpu"}
    both = [
        subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    for process in both:
        told, _ = process.communicate()
        assert process.returncode == 0
        assert float(told.split("(")[-1].rstrip(")\n")) == pytest.approx(right, rel=1e-12)
    assert not [p for p in (tmp_path / "cache").rglob("*") if p.is_dir() and p.name.startswith("tmp")]


def test_the_environment_chooses_the_backend(tmp_path, right):
    value, _ = filtered(tmp_path, SIGMAX_BACKEND="xla")
    assert value == right
    assert libraries(tmp_path) == []


WIDTH = """
import sys
import sigmax.native.build, sigmax.native.driver, sigmax.native.machine
for module in (sigmax.native.build, sigmax.native.driver, sigmax.native.machine):
    module.lane_bytes = lambda: int(sys.argv[1])
import numpy as np, sigmax
made = sigmax.builtin("radar-ct")
z = np.array([223_700.0, 0.4637, 94.9]) + np.random.default_rng(0).standard_normal((11, 5, 3)) * [50, 1e-4, 0.02]
z[3, 2], z[5, 1, 0] = np.nan, np.nan
for dtype in ("float64", "float32"):
    results = [sigmax.run("SRUKFB", made.model, made.prior, z, dtype=dtype, backend=b) for b in ("native", "xla")]
    apart = np.abs((results[0].mean - results[1].mean) / results[1].std)
    alone = sigmax.run("SRUKFB", made.model, made.prior, z[5], dtype=dtype, backend="native")
    live = sigmax.Live("SRUKFB", made.model, made.prior, dtype=dtype, backend="native")
    for row in z[5]:
        live.step(row, 1.0)
    print(apart.max() < (1e-9 if dtype == "float64" else 0.1), np.array_equal(alone.mean, results[0].mean[5]))
    print(np.array_equal(live.mean, alone.mean[-1]))
"""


def widths():
    """The narrowest quickly; each takes a dozen compilations."""
    return [
        pytest.param(width, marks=[pytest.mark.slow] if width > 16 else [])
        for width in (16, 32, 64)
        if width <= machine.lane_bytes()
    ]


@pytest.mark.parametrize("width", widths())
@pytest.mark.slow
def test_every_width_of_lanes_computes_the_same(width, tmp_path):
    environment = os.environ | {"SIGMAX_CACHE": str(tmp_path / "cache"), "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-c", WIDTH, str(width)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True"] * 6


def sorting():
    def sensor(x):
        return jnp.sort(x)

    return sigmax.Model(motion=lambda x, dt: x, sensor=sensor, Q=[1.0, 1.0], R=[1.0, 1.0])


def test_a_model_that_cannot_be_lowered_runs_on_xla_with_one_line(caplog):
    prior, z = sigmax.Gaussian([0.0, 1.0], np.eye(2)), np.zeros((3, 2))
    model = sorting()
    with caplog.at_level(logging.WARNING, logger="sigmax"):
        first = sigmax.run("SRCKFB", model, prior, z)
        second = sigmax.run("SRCKFB", model, prior, z)
    assert np.array_equal(first.mean, second.mean)
    assert len(caplog.records) == 1
    assert "'sort'" in caplog.text
    assert "test_build.py, line" in caplog.text
    live = sigmax.Live("SRCKFB", model, prior)
    for t in range(3):
        live.step(z[t], 1.0)
    np.testing.assert_allclose(live.mean, first.mean[-1], rtol=1e-12)


@pytest.mark.parametrize("halves", [False, True])
def test_a_live_filter_goes_on_with_xla_where_a_part_turns_out_not_to_be_lowered(halves):
    model = sigmax.Model(
        motion=lambda x, dt, u: x + dt * u, sensor=lambda x: jnp.sort(x) ** 3, Q=[1.0, 1.0], R=[1.0, 1.0]
    )
    prior, z, u = sigmax.Gaussian([0.5, 1.0], np.eye(2)), np.ones((4, 2)), np.full((4, 2), 0.1)
    wanted = sigmax.run("SRCKFB", model, prior, z, inputs=u, backend="xla")
    live = sigmax.Live("SRCKFB", model, prior)
    for t in range(4):
        if halves:
            live.predict(1.0, u[t])
            live.update(z[t])
        else:
            live.step(z[t], 1.0, u=u[t])
        np.testing.assert_allclose(live.mean, wanted.mean[t], rtol=1e-10)
        np.testing.assert_allclose(live.cov, wanted.cov[t], rtol=1e-9)
    with pytest.raises(InputError, match="'sort' cannot be lowered"):
        sigmax.Live("SRCKFB", model, prior, backend="native").step(z[0], 1.0, u=u[0])


def test_native_where_it_cannot_be_had_is_refused_with_the_reason():
    prior, z = sigmax.Gaussian([0.0, 1.0], np.eye(2)), np.zeros((3, 2))
    with pytest.raises(InputError, match=r"'sort' cannot be lowered to C \(test_build.py, line \d+, in .*sensor\)"):
        sigmax.run("SRCKFB", sorting(), prior, z, backend="native")
    with pytest.raises(InputError, match="inside a trace"):
        jax.grad(lambda m: sigmax.run("EKF", sorting(), sigmax.Gaussian(m, np.eye(2)), z, backend="native").mean.sum())(
            jnp.zeros(2)
        )
    with pytest.raises(InputError, match="did you mean native"):
        sigmax.run("SRCKFB", sorting(), prior, z, backend="nativ")


def test_a_named_compiler_is_taken_with_its_arguments(monkeypatch):
    monkeypatch.setenv("SIGMAX_CC", f"{sys.executable} -m some cc")
    machine.compiler.cache_clear()
    try:
        found = machine.compiler()
        assert found is not None
        assert found.command[1:] == ("-m", "some", "cc")
        assert not found.is_gcc
    finally:
        monkeypatch.undo()
        machine.compiler.cache_clear()


def test_the_cache_is_where_the_environment_says(monkeypatch, tmp_path):
    monkeypatch.setenv("SIGMAX_CACHE", str(tmp_path / "there"))
    assert build.cache_folder() == tmp_path / "there"


def test_a_step_that_no_compiler_would_get_through_is_left_to_xla(monkeypatch, caplog):
    monkeypatch.setattr("sigmax.native.driver.LARGEST", 10)
    monkeypatch.setattr("sigmax.native.driver.remembered", lambda name: None)
    made = sigmax.builtin("position-cv")
    model = sigmax.Model(motion=made.model.motion, sensor=made.model.sensors[""], Q=np.eye(4), R=[1.0, 2.0])
    result = sigmax.run("EKF", model, made.prior, np.zeros((4, 2)))
    assert result.ok.all()
    assert "operations, more than 10" in caplog.text
    with pytest.raises(sigmax.InputError, match="operations, more than 10"):
        sigmax.run("EKF", model, made.prior, np.zeros((4, 2)), backend="native")

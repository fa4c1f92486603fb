"""Studies on clusters, and one that is killed."""

import os
import signal
import subprocess
import sys
import time

import joblib
import numpy as np
import pytest

from sigmax.studies import compare
from tests.studies.problems import scalar

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def here():
    return compare(scalar(particles=40, optimum_runs=512), runs=1500)


def assert_same(a, b):
    for name, m in a.measures.items():
        np.testing.assert_array_equal(m.rmse.value, b.measures[name].rmse.value)
        np.testing.assert_array_equal(m.nees.value, b.measures[name].nees.value)
    np.testing.assert_array_equal(a.optimum.check.rmse.value, b.optimum.check.rmse.value)


def test_processes_give_the_same_bits(here):
    with joblib.parallel_config(backend="loky", n_jobs=2):
        assert_same(here, compare(scalar(particles=40, optimum_runs=512), runs=1500))


@pytest.mark.filterwarnings("ignore")
def test_dask_gives_the_same_bits(here):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.Client(n_workers=2, threads_per_worker=1, dashboard_address=None),
        joblib.parallel_config(backend="dask"),
    ):
        assert_same(here, compare(scalar(particles=40, optimum_runs=512), runs=1500))


@pytest.mark.filterwarnings("ignore")
def test_ray_gives_the_same_bits(here):
    ray = pytest.importorskip("ray")
    from ray.util.joblib import register_ray

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        register_ray()
        with joblib.parallel_config(backend="ray", n_jobs=2):
            assert_same(here, compare(scalar(particles=40, optimum_runs=512), runs=1500))
    finally:
        ray.shutdown()


@pytest.mark.parametrize("cluster", ["dask", "ray"])
def test_the_command_starts_a_cluster_where_there_is_none(cluster, tmp_path):
    pytest.importorskip({"dask": "distributed"}.get(cluster, cluster))
    command = [
        sys.executable,
        "-m",
        "sigmax.cli",
        "compare",
        "growth",
        "-f",
        "EKF",
        "--runs",
        "600",
        "--particles",
        "0",
    ]
    for name, more in (("here", []), ("there", ["--cluster", cluster])):
        done = subprocess.run([*command, *more, "--out", str(tmp_path / name)], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "here" / "sums.npz") as here, np.load(tmp_path / "there" / "sums.npz") as there:
        for name in set(here.files) - {"about"}:
            np.testing.assert_array_equal(here[name], there[name])


def test_a_study_that_is_killed_goes_on(tmp_path):
    """Killed without warning in the middle of it, the same command ends with the sums of one that was not."""
    command = [sys.executable, "-m", "sigmax.cli", "compare", "growth", "-f", "EKF", "--particles", "0"]
    command += ["--runs", "60000", "--workers", "1"]
    code = "from sigmax.cli import main; import sys; sys.argv = sys.argv[1:]; main()"
    first = subprocess.Popen(
        [sys.executable, "-c", code, "sigmax", *command[3:], "--out", str(tmp_path / "killed")],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    sums = tmp_path / "killed" / "sums.npz"
    deadline = time.monotonic() + 120
    while not sums.exists() and time.monotonic() < deadline and first.poll() is None:
        time.sleep(0.01)
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    assert sums.exists()
    assert not (tmp_path / "killed" / "report.html").exists()
    for name in ("killed", "whole"):
        subprocess.run([*command, "--out", str(tmp_path / name)], check=True, capture_output=True)
    with np.load(tmp_path / "killed" / "sums.npz") as killed, np.load(tmp_path / "whole" / "sums.npz") as whole:
        assert set(killed.files) == set(whole.files)
        for name in killed.files:
            np.testing.assert_array_equal(killed[name], whole[name])

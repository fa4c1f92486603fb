"""Many threads may run filters at the same time; what one computes does not depend on the others."""

import threading

import numpy as np
import pytest

import sigmax
from sigmax.models.builtin import builtin

FILTERS = ("EKF", "SRCKFB", "UKF")


def bits(filter: str, z: np.ndarray) -> bytes:
    made = builtin("radar-ct-cartesian")
    result = sigmax.run(filter, made.model, made.prior, z, dt=made.dt, backend="native")
    return b"".join(np.asarray(a).tobytes() for a in (result.mean, result.cov, result.nis, result.ok))


def check(threads: int, runs: int) -> None:
    rng = np.random.default_rng(3)
    records = [
        np.array([22e3, 0.46]) + rng.standard_normal((tracks, 20, 2)) * [50.0, 0.002] for tracks in (1, 3, 8, 17)
    ]
    jobs = [(f, z[0] if len(z) == 1 else z) for f in FILTERS for z in records]
    alone = [bits(*job) for job in jobs]
    wrong: list[object] = []
    ready = threading.Barrier(threads)

    def work(first: int) -> None:
        ready.wait()
        try:
            for k in range(runs):
                i = (first * 5 + k) % len(jobs)
                if bits(*jobs[i]) != alone[i]:
                    wrong.append((first, k, jobs[i][0]))
        except Exception as error:
            wrong.append(error)

    all_threads = [threading.Thread(target=work, args=(i,)) for i in range(threads)]
    for thread in all_threads:
        thread.start()
    for thread in all_threads:
        thread.join()
    assert wrong == []


def test_threads_compute_the_bits_that_each_would_alone() -> None:
    check(4, 30)


@pytest.mark.slow
def test_eight_threads_of_two_hundred_runs_compute_the_bits_that_each_would_alone() -> None:
    check(8, 200)

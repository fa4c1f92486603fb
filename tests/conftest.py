import collections
import ctypes
import ctypes.util
import itertools
import os

import hypothesis
import jax
import pytest

# A defect of the lowering, which users see as a line of warning and XLA, is an error here.
os.environ["SIGMAX_DEFECTS"] = "raise"

# XLA computes the same whatever it does to be quick about it, and takes twice as long to compile as tests take to run;
# `tests/native/test_engine.py` has it as users have it. At level 0 XLA 0.10.2 computes one and the same optimised HLO
# wrong where it compiles it in 32 parts, and right in one (`tests/laws/test_inside.py`, IEKF).
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1")

# Compiling makes the first example slow; what matters here is what is computed.
hypothesis.settings.register_profile("sigmax", deadline=None, max_examples=60, derandomize=True)
hypothesis.settings.load_profile("sigmax")

_tests = itertools.count(1)
_trim = getattr(ctypes.CDLL(ctypes.util.find_library("c")), "malloc_trim", None)


@pytest.fixture(autouse=True)
def memory():
    """What JAX has compiled is forgotten from time to time: over hundreds of filters it comes to many gigabytes."""
    yield
    if next(_tests) % 50 == 0:
        jax.clear_caches()
        if _trim is not None:
            _trim(0)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Of a test marked `one_in(k)` the quick suite runs each k-th case; the others are slow."""
    seen = collections.Counter()
    for item in items:
        mark = item.get_closest_marker("one_in")
        if mark is not None and item.get_closest_marker("slow") is None:
            name = item.nodeid.partition("[")[0]
            if seen[name] % mark.args[0]:
                item.add_marker(pytest.mark.slow)
            seen[name] += 1

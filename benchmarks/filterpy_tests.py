"""FilterPy's own tests, run on `sigmax.filterpy`: its source is a folder that holds `filterpy/kalman/tests`.

pip download --no-deps --no-binary :all: filterpy==2.0.0 && tar xzf filterpy-2.0.0.tar.gz
python benchmarks/filterpy_tests.py filterpy-2.0.0
"""

import argparse
import os
import sys
from pathlib import Path

import pytest

# Where it fails by what we do otherwise, and why that is right.
KNOWN = {
    "test_kf.py::test_procedure_form": "compares positions of 1e5 to 1e-12: that is one order of operations",
    "test_imm.py::test_imm": "puts an array into an element before any filter runs, which NumPy 2.4 refuses",
    "test_mmae.py::test_MMAE2": "its Q has a variance of zero beside covariances that are not, which is no covariance",
}


class Ours:
    """Puts our classes in the place of FilterPy's before its tests are imported; keeps what became of each."""

    def __init__(self) -> None:
        self.outcomes: dict[str, str] = {}

    def pytest_configure(self) -> None:
        """Swap the classes."""
        import filterpy.kalman

        import sigmax.filterpy

        for name in sigmax.filterpy.__all__:
            setattr(filterpy.kalman, name, getattr(sigmax.filterpy, name))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note an outcome."""
        if report.when == "call" or report.failed:
            self.outcomes["::".join(report.nodeid.split("/")[-1].split("::"))] = report.outcome


def main() -> int:
    """Run them; 1 where one fails that is not known to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, help="the source of FilterPy, unpacked")
    folder = parser.parse_args().source.resolve() / "filterpy" / "kalman" / "tests"
    if not folder.is_dir():
        parser.error(f"{folder} is not there")
    os.environ["MPLBACKEND"] = "Agg"
    # From beside the source, the tests would import it in place of the package that is installed.
    os.chdir(folder)
    ours = Ours()
    pytest.main(["-q", "--tb=short", "-p", "no:cacheprovider", "-W", "ignore", "--import-mode=importlib", "."], [ours])
    failed = {name for name, outcome in ours.outcomes.items() if outcome != "passed"}
    print(f"{len(ours.outcomes) - len(failed)} of {len(ours.outcomes)} passed on sigmax.filterpy")
    for name in sorted(failed):
        print(f"{name}: {KNOWN.get(name, 'NOT KNOWN')}")
    return int(not ours.outcomes or not failed <= KNOWN.keys())


if __name__ == "__main__":
    sys.exit(main())

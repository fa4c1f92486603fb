"""The conformance kit: ours keeps every law, and a fault put in on purpose breaks the law that is about it."""

import dataclasses
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from sigmax.conformance import LAWS, Adapter, check, own
from sigmax.errors import InputError
from sigmax.filters import names

ROOT = Path(__file__).parent.parent


class Extended:
    """An extended filter in ten lines, with places for faults."""

    def __init__(self, task, mean, cov, forget=(), jitter=0.0, plain=False):
        self.task, self.mean, self.cov = task, mean, cov
        self.forget, self.jitter, self.plain = forget, jitter, plain

    def predict(self):
        before, after = self.mean, self.task.f(self.mean)
        F = self.task.jacobians[0](after if "where F" in self.forget else before)
        self.mean, self.at = after, before if "where H" in self.forget else after
        Q = np.diag(np.diag(self.task.Q)) if "Q across" in self.forget else self.task.Q
        self.cov = F @ self.cov @ F.T + (0 if "Q" in self.forget else Q)

    def update(self, z):
        seen = ~np.isnan(z)
        if "missing" in self.forget:
            z, seen = np.nan_to_num(z), np.full(len(z), True)
        H = self.task.jacobians[1](self.at if "where H" in self.forget else self.mean)[seen]
        R = np.diag(np.diag(self.task.R)) if "R across" in self.forget else self.task.R
        R = R[np.ix_(seen, seen)] + self.jitter * np.eye(seen.sum())
        K = np.linalg.solve(H @ self.cov @ H.T + R, H @ self.cov).T
        y = z - self.task.h(self.mean)
        self.mean = self.mean + K @ (y if self.plain else self.task.wrapped(y))[seen]
        J = np.eye(len(self.mean)) - K @ H
        self.cov = J @ self.cov @ J.T + K @ R @ K.T


def faulty(**faults):
    return Adapter("faulty", lambda *given: Extended(*given, **faults), degree=1)


def broken(adapter, laws):
    return [o.law.name for o in check(adapter, laws) if o.applies and not o.kept]


LINEAR = ["linear", "offset", "stiff R", "Q = 0", "order", "missing", "partly missing"]
EXACT = [*LINEAR, "small noise", "rotation", "bearing at π"]


def test_a_sound_filter_keeps_the_laws():
    assert broken(faulty(), [*EXACT, "honest: beacons"]) == []


@pytest.mark.parametrize(
    ("faults", "expected"),
    [
        ({"forget": ("Q",)}, {*LINEAR, "small noise"} - {"Q = 0"}),
        ({"forget": ("Q across",)}, {*LINEAR, "small noise"} - {"Q = 0"}),
        ({"forget": ("R across",)}, {*LINEAR, "small noise"}),
        ({"forget": ("where F",)}, {"small noise"}),
        ({"forget": ("where H",)}, {"small noise"}),
        ({"forget": ("missing",)}, {"missing", "partly missing"}),
        ({"plain": True}, {"bearing at π"}),
    ],
    ids=["no Q", "diagonal Q", "diagonal R", "F too late", "H too early", "missing taken for zero", "no angles"],
)
@pytest.mark.one_in(4)
def test_a_fault_breaks_the_laws_that_are_about_it(faults, expected):
    assert set(broken(faulty(**faults), EXACT)) == expected


class HalfSampled(Extended):
    """Points of degree 3 for the motion, and a linearised sensor."""

    def predict(self):
        n = len(self.mean)
        spread = np.sqrt(n) * np.linalg.cholesky(self.cov)
        points = self.task.f(np.hstack([self.mean[:, None] + spread, self.mean[:, None] - spread]))
        self.mean = points.mean(axis=1)
        self.cov = np.cov(points, bias=True) + self.task.Q


@pytest.mark.parametrize("kind", [Extended, HalfSampled])
def test_the_degree_is_that_of_the_lesser_half(kind):
    """Who samples the motion alone and says 3 is found out by the sensor."""
    assert broken(Adapter("half", kind, 1), ["linear", "small noise", "moments 3"]) == []
    assert broken(Adapter("half", kind, 3), ["linear", "small noise", "moments 3"]) == ["moments 3"]


HONEST = [name for name in LAWS if name.startswith("honest")]


@pytest.mark.parametrize(("what", "factor"), [("Q", 0.5), ("R", 2.5)])
def test_a_covariance_that_is_half_or_double_is_not_honest(what, factor):
    """The filter is told another noise than the draws have, and gives itself away on all four problems."""
    told = {}

    def start(task, mean, cov):
        if task not in told:
            told[task] = dataclasses.replace(task, **{what: factor * getattr(task, what)})
        return Extended(told[task], mean, cov)

    assert broken(Adapter("misled", start, degree=1), HONEST) == HONEST


def test_an_exception_and_a_number_that_is_none_are_broken_laws():
    def start(task, mean, cov):
        raise RuntimeError("no such filter")

    (outcome,) = check(Adapter("none", start), ["linear"])
    assert not outcome.kept
    assert "no such filter" in outcome.note
    (outcome,) = check(faulty(jitter=np.nan), ["linear"])
    assert not outcome.kept


@pytest.mark.parametrize(
    ("mean", "cov"),
    [
        (lambda m: m[:1], None),
        (lambda m: m[0], None),
        (None, np.diag),
        (None, lambda c: c[None]),
        (None, lambda c: c[:1]),
    ],
    ids=["one component", "a number", "variances", "a batch", "a row"],
)
def test_a_wrong_shape_is_a_broken_law_and_said(mean, cov):
    """Most of these would broadcast to some answer."""

    class Shaped(Extended):
        def __getattribute__(self, name):
            value = super().__getattribute__(name)
            turned = {"mean": mean, "cov": cov}.get(name)
            return value if turned is None or not super().__getattribute__("shown") else turned(value)

        shown = False

        def update(self, z):
            self.shown = False
            super().update(z)
            self.shown = True

        def predict(self):
            self.shown = False
            super().predict()
            self.shown = True

    for outcome in check(
        Adapter("shaped", Shaped, degree=3), ["linear", "stiff R", "rotation", "moments 3", HONEST[0]]
    ):
        assert not outcome.kept
        assert "must have the shapes" in outcome.note


def test_a_law_or_an_offer_that_is_not_known_is_refused():
    with pytest.raises(InputError, match="unknown law 'liner'; did you mean linear"):
        check(faulty(), ["liner"])
    with pytest.raises(InputError, match="unknown offer 'angle'; did you mean angles"):
        Adapter("none", Extended, offers=frozenset({"angle"}))
    assert [o.law.name for o in check(faulty(), "linear")] == ["linear"]
    assert Adapter("one", Extended, offers=["angles"]).offers == {"angles"}


def test_a_law_that_does_not_apply_is_neither_kept_nor_broken():
    plain = Adapter("plain", Extended, degree=1, offers=frozenset())
    for outcome in check(plain, ["bearing at π", "partly missing", "moments 3"]):
        assert not outcome.applies
        assert not outcome.kept


def test_ours_keeps_the_laws():
    """One compiled filter on the laws that share a model; all filters, all laws in the slow test."""
    laws = ["linear", "offset", "missing", "partly missing", "small noise", "bearing at π", "moments 3"]
    assert broken(own("SRCKF"), laws) == []


@pytest.mark.parametrize("module", ["filterpy.kalman", "sigmax.filterpy"])
def test_filterpys_adapter(module, monkeypatch):
    if module.startswith("filterpy") and find_spec("filterpy") is None:
        pytest.skip("FilterPy is not installed")
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    from conforming.filterpy import of_module

    found = {a.name[-3:]: broken(a, ["linear", "moments 3"]) for a in of_module("x", module, "")}
    theirs = module.startswith("filterpy")
    assert found == {"EKF": [], "UKF": [], "CKF": ["linear"] if theirs else []}


# To which degree means are exact, by what is left of a name without its form. An iterated correction is not
# linear in the measurement, and no mean of a sensor can be read off it.
DEGREES = {
    "EKF": 1, "EUKF": 1, "ECKF": 1, "EHCKF": 1, "EIF": 1, "IEKF": 1, "IPLF": 1,
    "SKF": 2, "PF": 2, "SOKF": 2, "PIF": 2, "SOIF": 2,
    "UKF": 3, "CKF": 3, "UIF": 3, "CIF": 3,
    "HCKF": 5, "GHKF": 5, "HCIF": 5, "TKF": 3,
}  # fmt: skip
# The others are for linear models, or for biases.
CATALOGUE = [(n, d) for n in names() if (d := DEGREES.get(n.removeprefix("SR").removesuffix("B"))) is not None]


def test_the_catalogue_is_all_there():
    left = set(names()) - {name for name, _ in CATALOGUE}
    assert all(name == "KF" or name.startswith(("TS", "MTS")) for name in left)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "degree"), CATALOGUE)
def test_ours_keeps_all_laws(name, degree):
    assert broken(own(name, degree), LAWS) == []


@pytest.mark.slow
def test_the_command_says_what_it_measured():
    command = [sys.executable, "benchmarks/conformance.py", "sigmax.filterpy EKF", "linear", "--jobs", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("sigmax.filterpy EKF: linear: kept")

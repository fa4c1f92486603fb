"""The edge of the Python library: whatever is given, it is taken for what it is or refused in words."""

import datetime
import decimal
import fractions
import itertools
import multiprocessing
import pickle
import subprocess
import sys
import threading
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import sigmax
from sigmax import forms, motions, sensors
from sigmax.models.builtin import BUILTIN
from sigmax.models.checks import numbers
from sigmax.tracking import Cycle, Detector, Modes, Scan, Tracker, by_existence, gnn, jpda, m_of_n, positions, two_point

CV = motions.constant_velocity(("a",))
SEEN = sensors.position(at=(0,), names=("a",))
PRIOR = sigmax.Gaussian([0.0, 1.0], [1.0, 1.0])
Z = np.array([[0.1], [0.9], [2.2], [2.9]])


def model(**changes):
    given = dict(motion=CV, sensor=SEEN, Q=CV.noise(0.1), R=[0.25], state=("a", "va"), measurement=("a",))
    return sigmax.Model(**given | changes)


PLAIN = model()
DRIVEN = model(motion=lambda x, dt, u: jnp.stack([x[0] + dt * x[1], x[1] + dt * u[0]]), Q=[0.1, 0.1])


WRONG = {
    "None": None,
    "text": "abc",
    "bytes": b"abc",
    "an object": object(),
    "a complex number": 1j,
    "complex": np.ones((4, 1)) * 1j,
    "a dict": {},
    "a set": {1.0},
    "a function": lambda *a: None,
    "a class": float,
    "a list of None": [None],
    "ragged": [[1.0], [1.0, 2.0]],
    "text in a list": [["a"]],
    "NaN": float("nan"),
    "infinity": float("inf"),
    "negative": -1.0,
    "a date": np.array("2020-01-01", "M8[s]"),
    "dates": np.array(["2020-01-01"] * 4, "M8[s]"),
    "a time": datetime.datetime(2020, 1, 1),
    "masked": np.ma.masked,
    "a masked array": np.ma.masked_all((4, 1)),
    "a huge whole number": 10**400,
    "a generator": (i for i in ()),
    "nothing": [],
    "no rows": np.zeros((0, 1)),
    "no columns": np.zeros((4, 0)),
    "four axes": np.zeros((2, 3, 4, 5)),
    "another length": np.ones(3),
    "another shape": np.ones((4, 7)),
    "NA": pd.NA,
    "a frame of text": pd.DataFrame({"a": ["x"] * 4}),
    "a random key": jax.random.key(0),
    "a bool": True,
}


def live():
    return sigmax.Live("EKF", PLAIN, PRIOR)


LIVE = live()
RESULT = sigmax.run("EKF", PLAIN, PRIOR, Z)
FLAT = motions.constant_velocity(("x", "y"))
PLANE = sigmax.Model(motion=FLAT, sensor=sensors.position(), Q=FLAT.noise(0.1), R=[0.25, 0.25])


def tracker():
    found = Detector(0.9, 0.01, positions([0.25, 0.25]))
    return Tracker(Cycle(Modes([("EKF", PLANE)]), {"": found}, two_point(5.0, 3.0), associate=jpda, rule=m_of_n()))


SCANS = tracker()
DRIVEN_LIVE = sigmax.Live("EKF", DRIVEN, PRIOR)


def built(parameters):
    return model(R=[parameters["r"]]), PRIOR


# Each with one thing given wrong.
ENTRIES = {
    "run filter": lambda w: sigmax.run(w, PLAIN, PRIOR, Z),
    "run model": lambda w: sigmax.run("EKF", w, PRIOR, Z),
    "run prior": lambda w: sigmax.run("EKF", PLAIN, w, Z),
    "run z": lambda w: sigmax.run("EKF", PLAIN, PRIOR, w),
    "run dt": lambda w: sigmax.run("EKF", PLAIN, PRIOR, Z, dt=w),
    "run inputs": lambda w: sigmax.run("EKF", DRIVEN, PRIOR, Z, inputs=w),
    "run update_first": lambda w: sigmax.run("EKF", PLAIN, PRIOR, Z, update_first=w),
    "run keep": lambda w: sigmax.run("EKF", PLAIN, PRIOR, Z, keep=w),
    "run dtype": lambda w: sigmax.run("EKF", PLAIN, PRIOR, Z, dtype=w),
    "run backend": lambda w: sigmax.run("EKF", PLAIN, PRIOR, Z, backend=w),
    "smooth filter": lambda w: sigmax.smooth(w, PLAIN, RESULT),
    "smooth model": lambda w: sigmax.smooth("EKF", w, RESULT),
    "smooth result": lambda w: sigmax.smooth("EKF", PLAIN, w),
    "smooth dt": lambda w: sigmax.smooth("EKF", PLAIN, RESULT, dt=w),
    "smooth inputs": lambda w: sigmax.smooth("EKF", PLAIN, RESULT, inputs=w),
    "fit filter": lambda w: sigmax.fit(w, built, {"r": 1.0}, Z[:, :0]),
    "fit build": lambda w: sigmax.fit("EKF", w, {"r": 1.0}, Z),
    "fit start": lambda w: sigmax.fit("EKF", built, w, Z[:, :0]),
    "fit a start": lambda w: sigmax.fit("EKF", built, {"r": w}, Z[:, :0]),
    "fit z": lambda w: sigmax.fit("EKF", built, {"r": 1.0}, w),
    "fit positive": lambda w: sigmax.fit("EKF", built, {"r": 1.0}, Z[:, :0], positive=w),
    "Live filter": lambda w: sigmax.Live(w, PLAIN, PRIOR),
    "Live model": lambda w: sigmax.Live("EKF", w, PRIOR),
    "Live prior": lambda w: sigmax.Live("EKF", PLAIN, w),
    "Live dtype": lambda w: sigmax.Live("EKF", PLAIN, PRIOR, dtype=w),
    "Live.step z": lambda w: LIVE.step(w, 1.0),
    "Live.step dt": lambda w: LIVE.step([0.0], w),
    "Live.step sensor": lambda w: LIVE.step([0.0], 1.0, w),
    "Live.step R": lambda w: LIVE.step([0.0], 1.0, R=w),
    "Live.step u": lambda w: DRIVEN_LIVE.step([0.0], 1.0, u=w),
    "Live.predict": lambda w: LIVE.predict(w),
    "Live.predict u": lambda w: DRIVEN_LIVE.predict(1.0, w),
    "Live.update": lambda w: LIVE.update(w),
    "Live.expect": lambda w: LIVE.expect(w),
    "Live.restore": lambda w: LIVE.restore(w),
    "Gaussian mean": lambda w: sigmax.Gaussian(w, [1.0]),
    "Gaussian cov": lambda w: sigmax.Gaussian([0.0], w),
    "Model motion": lambda w: model(motion=w),
    "Model sensor": lambda w: model(sensor=w),
    "Model Q": lambda w: model(Q=w),
    "Model R": lambda w: model(R=w),
    "Model R unnamed": lambda w: sigmax.Model(motion=lambda x, dt: x, sensor=lambda x: x, Q=[1.0], R=w),
    "Model state": lambda w: model(state=w),
    "Model measurement": lambda w: model(measurement=w),
    "Model domain": lambda w: model(domain=w),
    "Model bias": lambda w: model(bias=w),
    "Bias prior": lambda w: sigmax.Bias(prior=w, sensor=[[1.0]]),
    "Bias sensor": lambda w: sigmax.Bias(prior=sigmax.Gaussian([0.0], [1.0]), sensor=w),
    "Bias motion": lambda w: sigmax.Bias(prior=sigmax.Gaussian([0.0], [1.0]), motion=w),
    "Bias Q": lambda w: sigmax.Bias(prior=sigmax.Gaussian([0.0], [1.0]), sensor=[[1.0]], Q=w),
    "Bias names": lambda w: sigmax.Bias(prior=sigmax.Gaussian([0.0], [1.0]), sensor=[[1.0]], names=w),
    "Filter predict": lambda w: sigmax.Filter(w, sigmax.Taylor1(), forms.block),
    "Filter correct": lambda w: sigmax.Filter(sigmax.Taylor1(), w, forms.block),
    "Filter form": lambda w: sigmax.Filter(sigmax.Taylor1(), sigmax.Taylor1(), w),
    "get": lambda w: sigmax.get(w),
    "get alpha": lambda w: sigmax.get("UKF", alpha=w),
    "get order": lambda w: sigmax.get("GHKF", order=w),
    "get permute": lambda w: sigmax.get("CKF", permute=w),
    "get information": lambda w: sigmax.get("EIF", information=w),
    "fused": lambda w: sigmax.fused(w),
    "Modes": lambda w: Modes(w),
    "Modes sojourn": lambda w: Modes([("EKF", PLAIN)] * 2, sojourn=w),
    "Scan time": lambda w: SCANS.step(Scan(w, "", np.zeros((1, 2)))),
    "Scan sensor": lambda w: SCANS.step(Scan(1.0, w, np.zeros((1, 2)))),
    "Scan z": lambda w: SCANS.step(Scan(1.0, "", w)),
    "Scan u": lambda w: SCANS.step(Scan(1.0, "", np.zeros((1, 2)), w)),
    "builtin": lambda w: sigmax.builtin(w),
    "angle": lambda w: model(state=(sigmax.angle("a"), w)),
    "explain": lambda w: sigmax.explain(w, PLAIN, PRIOR, dt=1.0, measure=False),
    "contribution": lambda w: sigmax.contribution(LIVE, w, ""),
    "absorb": lambda w: sigmax.absorb(LIVE, w),
}


@pytest.mark.parametrize("entry", ENTRIES)
def test_whatever_is_given_the_answer_is_right_or_an_error_in_words(entry):
    """Some of what is wrong in one place is right in another; nothing raises anything but InputError."""
    raised = {}
    for what, value in WRONG.items():
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                ENTRIES[entry](value)
            except sigmax.InputError as error:
                assert len(str(error)) > 20
            except Exception as error:  # this is what is looked for
                raised[what] = f"{type(error).__name__}: {error}"[:200]
    assert not raised

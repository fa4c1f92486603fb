"""The edge of the Python library: whatever is given, it is taken for what it is or refused in words."""

import datetime
import decimal
import fractions
import inspect
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import sigmax
from sigmax import filterpy as names_of_filterpy
from sigmax import forms, motions, navigation, sensors
from sigmax.modelling.parts import Motion, Sensor
from sigmax.models import terrain
from sigmax.tracking import Cycle, Detector, Modes, Scan, Tracker, jpda, m_of_n, positions, two_point

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
    "Filter predict": lambda w: sigmax.Filter(w, sigmax.rules.Taylor1(), forms.block),
    "Filter correct": lambda w: sigmax.Filter(sigmax.rules.Taylor1(), w, forms.block),
    "Filter form": lambda w: sigmax.Filter(sigmax.rules.Taylor1(), sigmax.rules.Taylor1(), w),
    "get": lambda w: sigmax.get(w),
    "get alpha": lambda w: sigmax.get("UKF", alpha=w),
    "get order": lambda w: sigmax.get("GHKF", order=w),
    "get permute": lambda w: sigmax.get("CKF", permute=w),
    "get information": lambda w: sigmax.get("EIF", information=w),
    "fused": lambda w: sigmax.models.fused(w),
    "Modes": lambda w: Modes(w),
    "Modes sojourn": lambda w: Modes([("EKF", PLAIN)] * 2, sojourn=w),
    "Scan time": lambda w: SCANS.step(Scan(w, "", np.zeros((1, 2)))),
    "Scan sensor": lambda w: SCANS.step(Scan(1.0, w, np.zeros((1, 2)))),
    "Scan z": lambda w: SCANS.step(Scan(1.0, "", w)),
    "Scan u": lambda w: SCANS.step(Scan(1.0, "", np.zeros((1, 2)), w)),
    "builtin": lambda w: sigmax.builtin(w),
    "angle": lambda w: model(state=(sigmax.angle("a"), w)),
    "explain": lambda w: sigmax.explain(w, PLAIN, PRIOR, dt=1.0, measure=False),
    "contribution": lambda w: sigmax.running.contribution(LIVE, w, ""),
    "absorb": lambda w: sigmax.running.absorb(LIVE, w),
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
                words = str(error)
                raised |= {} if len(words) > 20 else {what: words}
            except Exception as error:  # this is what is looked for
                raised[what] = f"{type(error).__name__}: {error}"[:200]
    assert not raised


# What makes ready-made parts, and a right value for each argument that has none of its own.
def makers():
    for module in (motions, sensors, navigation, terrain):
        for name, make in vars(module).items():
            ours = inspect.isfunction(make) and make.__module__.startswith("sigmax.models") and not name.startswith("_")
            if ours and inspect.signature(make, eval_str=True).return_annotation in (Motion, Sensor):
                yield f"{module.__name__.rpartition('.')[2]}.{name}", make


def to_star(star):
    return navigation.line_of_sight(star=star)


def to_landmark(landmark):
    return navigation.line_of_sight(landmark=landmark)


# A line of sight wants one of two arguments.
MAKERS = dict(makers()) | {
    "navigation.line_of_sight": to_star,
    "navigation.line_of_sight, landmark": to_landmark,
    "sde": sigmax.sde,
}
ARGUMENTS = {
    "first": CV, "second": FLAT, "Phi0": [1.0], "Phi_x": [[1.0]], "Phi_xx": [[[1.0]]], "H0": [1.0], "H_x": [[1.0]],
    "H_xx": [[[1.0]]], "field": [1.0, 0.0, 0.0], "ground": lambda x, z: x + z, "drift": lambda x: -x,
    "diffusion": [[1.0]], "star": [1.0, 0.0, 0.0], "landmark": [1.0, 2.0, 3.0],
}  # fmt: skip


def refused_in_words(call, parameter):
    """What a call with each wrong value of one parameter raises other than words."""
    raised = {}
    for what, value in WRONG.items():
        try:
            call(**{parameter: value})
        except sigmax.InputError as error:
            raised |= {} if len(str(error)) > 20 else {what: str(error)}
        except Exception as error:  # this is what is looked for
            raised[what] = f"{type(error).__name__}: {error}"[:120]
    return raised


def wanting(function):
    """The arguments of a function without a value of their own, with a right one."""
    free = {n: p for n, p in inspect.signature(function).parameters.items() if p.default is p.empty}
    return {n: ARGUMENTS.get(n, 0.1) for n, p in free.items() if p.kind is not p.VAR_POSITIONAL}


@pytest.mark.parametrize("name", MAKERS)
def test_what_ready_made_parts_are_made_of_is_taken_or_refused_in_words(name):
    """Every argument of every ready-made motion and sensor, and of the noise of the motion."""
    make = MAKERS[name]
    right = wanting(make)
    part, raised = make(**right), {}
    for parameter in inspect.signature(make).parameters:
        raised[parameter] = refused_in_words(lambda **wrong: make(**right | wrong), parameter)
    if isinstance(part, Motion):
        noise = getattr(part.noise, "function", part.noise)
        given = wanting(noise)
        for parameter, p in inspect.signature(noise).parameters.items():
            if p.kind is p.VAR_POSITIONAL:
                raised["noise"] = refused_in_words(lambda one: part.noise(one), "one")
            else:
                raised[f"noise {parameter}"] = refused_in_words(lambda **w: part.noise(**given | w), parameter)
    assert not {of: what for of, what in raised.items() if what}


REAL = {
    "float16": np.float16,
    "float32": np.float32,
    "float64": np.float64,
    "longdouble": np.longdouble,
    "big-endian": lambda a: np.asarray(a, ">f8"),
    "whole numbers": lambda a: np.asarray(a, int),
    "small whole numbers": lambda a: np.asarray(a, np.int8),
    "jax": jnp.asarray,
    "jax float32": lambda a: jnp.asarray(a, jnp.float32),
    "bfloat16": lambda a: jnp.asarray(a, jnp.bfloat16),
    "lists": lambda a: np.asarray(a).tolist(),
    "whole numbers of Python": lambda a: np.asarray(a, int).tolist(),
    "fractions": lambda a: np.vectorize(fractions.Fraction, otypes=[object])(np.asarray(a, int)),
    "decimals": lambda a: np.vectorize(decimal.Decimal, otypes=[object])(np.asarray(a, int)),
    "masked, nothing masked": lambda a: np.ma.masked_array(a),
}


@pytest.mark.parametrize("kind", REAL)
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.one_in(3)
def test_numbers_of_every_type_run_in_the_type_of_the_run(kind, dtype):
    """Whole numbers, which all types hold exactly: the same bits, with noises in numbers and as functions."""
    of = REAL[kind]
    z, u = np.array([[1.0], [2.0], [4.0], [3.0]]), np.array([[1.0], [0.0], [2.0], [1.0]])

    def results(of):
        prior = sigmax.Gaussian(of([0.0, 1.0]), of([[4.0, 1.0], [1.0, 2.0]]))
        for Q, R in ((CV.noise(1.0), lambda x: jnp.stack([x[0] ** 2 + 1])), (of([1.0, 2.0]), of([3.0]))):
            driven = model(motion=DRIVEN.motion, Q=Q, R=R)
            yield sigmax.run("EKF", driven, prior, of(z), dt=of([1, 2, 1, 3]), inputs=of(u), dtype=dtype).mean
            live = sigmax.Live("EKF", driven, prior, dtype=dtype)
            live.step(of(z[0]), of(1), u=of(u[0]))
            live.update(of(z[1]), R=of([2.0]))
            yield live.mean

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for got, want in zip(results(of), results(np.float64), strict=True):
            assert got.dtype == dtype
            assert np.array_equal(got, want)


TWO_SECONDS = [datetime.timedelta(seconds=2), np.timedelta64(2000, "ms"), pd.Timedelta(2, "s"), fractions.Fraction(2)]


@pytest.mark.parametrize("seconds", TWO_SECONDS)
def test_an_interval_may_be_a_difference_of_times(seconds):
    want = sigmax.run("EKF", PLAIN, PRIOR, Z, dt=2.0).mean
    assert np.array_equal(sigmax.run("EKF", PLAIN, PRIOR, Z, dt=seconds).mean, want)
    assert np.array_equal(sigmax.run("EKF", PLAIN, PRIOR, Z, dt=[seconds] * 4).mean, want)
    assert np.array_equal(sigmax.run("EKF", PLAIN, PRIOR, Z, dt=pd.Series([seconds] * 4)).mean, want)
    stepwise = live()
    for row in Z:
        stepwise.step(row, seconds)
    assert np.allclose(stepwise.mean, want[-1], rtol=1e-12)


MISSING = {
    "NaN": [[0.1], [np.nan], [2.2], [2.9]],
    "None": [[0.1], [None], [2.2], [2.9]],
    "an array of objects": np.array([[0.1], [None], [2.2], [2.9]], object),
    "masked": np.ma.masked_equal([[0.1], [-9999.0], [2.2], [2.9]], -9999.0),
    "masked, in float32": np.ma.masked_equal(np.array([[0.1], [-9999.0], [2.2], [2.9]], np.float32), -9999.0),
    "masked, in a list": [np.ma.masked_equal([v], -9999.0) for v in (0.1, -9999.0, 2.2, 2.9)],
    "masked, one by one": [[0.1], [np.ma.masked], [2.2], [2.9]],
    "NA": [[0.1], [pd.NA], [2.2], [2.9]],
    "NaT": [[0.1], [pd.NaT], [2.2], [2.9]],
    "a frame": pd.DataFrame({"a": [0.1, None, 2.2, 2.9]}),
    "a frame of nullable numbers": pd.DataFrame({"a": pd.array([0.1, None, 2.2, 2.9], dtype="Float64")}),
}


@pytest.mark.parametrize("kind", MISSING)
def test_what_is_missing_is_missing_however_it_is_said(kind):
    """In records, batches, live filters, trackers and under FilterPy's names: as NaN, bit for bit."""
    given, plain = MISSING[kind], np.asarray(MISSING["NaN"])
    single = "float32" if "float32" in kind else "float64"
    plain = plain.astype(single).astype(float)
    want = sigmax.run("SREKF", PLAIN, PRIOR, plain)
    assert np.array_equal(sigmax.run("SREKF", PLAIN, PRIOR, given).mean, want.mean)
    if not isinstance(given, pd.DataFrame):
        assert np.array_equal(sigmax.run("SREKF", PLAIN, PRIOR, [given, given]).mean[1], want.mean)
    rows = given.to_numpy() if isinstance(given, pd.DataFrame) else given
    one, other = sigmax.Live("SREKF", PLAIN, PRIOR), sigmax.Live("SREKF", PLAIN, PRIOR)
    for row, number in zip(rows, plain, strict=True):
        told = one.step(row, 1.0)
        assert np.array_equal(told.nis, other.step(number, 1.0).nis, equal_nan=True)
    assert np.array_equal(one.mean, other.mean)

    def by_name():
        kf = names_of_filterpy.KalmanFilter(2, 1)
        kf.F, kf.H, kf.x = np.array([[1.0, 1], [0, 1]]), np.array([[1.0, 0]]), np.array([0.0, 1.0])
        return kf

    assert np.array_equal(by_name().batch_filter(list(rows))[0], by_name().batch_filter(list(plain))[0])
    flat = np.column_stack([plain, np.ones(4)])
    pairs = [[row[0], 1.0] for row in rows]
    told = [track.step(Scan(1.0, "", z)) for track, z in ((tracker(), flat), (tracker(), pairs))]
    assert told[0].gates == told[1].gates


HOLES = {"None": [None, 1.0], "masked": np.ma.masked_equal([-9.0, 1.0], -9.0), "NA": [pd.NA, 1.0], "NaN": [np.nan, 1.0]}
COMPLETE = {
    "a prior's mean": lambda hole: sigmax.Gaussian(hole, np.eye(2)),
    "a prior's covariance": lambda hole: sigmax.Gaussian([0.0, 0.0], hole),
    "Q": lambda hole: model(Q=hole),
    "R": lambda hole: model(R=hole, measurement=("a", "b")),
    "dt": lambda hole: sigmax.run("EKF", PLAIN, PRIOR, Z[:2], dt=hole),
    "inputs": lambda hole: sigmax.run("EKF", DRIVEN, PRIOR, Z[:2], inputs=[[h] for h in hole]),
    "R of one measurement": lambda hole: LIVE.update([0.0], R=hole[:1]),
    "u of one step": lambda hole: DRIVEN_LIVE.predict(1.0, hole[:1]),
}


@pytest.mark.parametrize("hole", HOLES)
@pytest.mark.parametrize("what", COMPLETE)
def test_only_measurements_may_be_missing(what, hole):
    with pytest.raises(sigmax.InputError, match=r"complete|finite"):
        COMPLETE[what](HOLES[hole])


KINDS = {
    "complex": lambda a: a + 0j,
    "whole numbers": lambda a: a.astype(int),
    "truth values": lambda a: a > 0,
    "nothing": lambda a: None,
    "text": lambda a: "text",
    "a dict": lambda a: {"a": a},
    "None in a list": lambda a: [None],
}
FUNCTIONS = {
    "motion": lambda f: model(motion=lambda x, dt: f(x)),
    "sensor": lambda f: model(sensor=lambda x: f(x[:1])),
    "domain": lambda f: model(domain=f),
    "Q": lambda f: model(Q=lambda dt: f(jnp.ones(2) * dt)),
    "Q of the state": lambda f: model(Q=lambda x, dt: f(x**2 + dt)),
    "R": lambda f: model(R=lambda x: f(x[:1] ** 2 + 1)),
    "B": lambda f: model(bias=sigmax.Bias(prior=ONE, motion=lambda dt: f(jnp.ones((2, 1)) * dt))),
    "F": lambda f: model(bias=sigmax.Bias(prior=ONE, sensor=lambda x: f(x[:1, None]))),
    "Q of a bias": lambda f: model(bias=sigmax.Bias(prior=ONE, sensor=[[1.0]], Q=lambda dt: f(jnp.ones(1) * dt))),
}
ONE = sigmax.Gaussian([0.0], [1.0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("place", FUNCTIONS)
def test_a_function_that_gives_no_real_numbers_is_refused(place, kind):
    made = FUNCTIONS[place](KINDS[kind])
    with pytest.raises(sigmax.InputError, match=r"return"):
        sigmax.run("CKF", made, PRIOR, Z)
    with pytest.raises(sigmax.InputError, match=r"return"):
        sigmax.Live("CKF", made, PRIOR)
    with pytest.raises(sigmax.InputError, match=r"return"):
        Modes([("CKF", made)])


def test_whole_numbers_that_never_change_are_numbers():
    made = model(R=lambda x: jnp.array([1]), bias=sigmax.Bias(prior=ONE, sensor=lambda x: jnp.array([[1]])))
    same = model(R=[1.0], bias=sigmax.Bias(prior=ONE, sensor=[[1.0]]))
    assert np.allclose(sigmax.run("CKF", made, PRIOR, Z).mean, sigmax.run("CKF", same, PRIOR, Z).mean)


@pytest.mark.parametrize(("make", "shows"), [
    (lambda: sigmax.run("EKF", PLAIN, PRIOR, np.broadcast_to(np.zeros((5, 1)), (10**9, 5, 1))), "GiB"),
    (lambda: sigmax.run("EKF", PLAIN, PRIOR, np.broadcast_to(np.zeros((1, 1)), (10**11, 1))), "GiB"),
    (lambda: sigmax.run("EKF", PLAIN, PRIOR, Z, dt=np.broadcast_to(1.0, (10**10, 4))), "GiB"),
    (lambda: sigmax.Gaussian(np.zeros(2), np.broadcast_to(np.eye(2), (10**10, 2, 2))), "GiB"),
    (lambda: sigmax.Gaussian(np.broadcast_to(np.zeros(2), (10**11, 2)), np.eye(2)), "GiB"),
    (lambda: sigmax.Gaussian(np.zeros((0, 2)), np.eye(2)), "B ≥ 1"),
    (lambda: sigmax.run("EKF", PLAIN, PRIOR, np.zeros((0, 4, 1))), "no tracks"),
    (lambda: sigmax.run("EKF", PLAIN, PRIOR, Z, dt=np.zeros((0, 4))), "shape"),
])  # fmt: skip
def test_too_many_tracks_and_none_are_refused_before_memory_is_taken(make, shows):
    with pytest.raises(sigmax.InputError, match=shows):
        make()


COVARIANCES = {
    "a covariance without a variance": [[0, 0.5], [0.5, 1]],
    "nearly without": [[1e-20, 0.5], [0.5, 1]],
    "in tiny units": [[1e-40, 2e-40], [2e-40, 1e-40]],
    "in mixed units": [[1e-12, 2.0], [2.0, 1e12]],
}


@pytest.mark.parametrize("case", COVARIANCES)
def test_no_covariance_is_larger_than_its_variances_allow(case):
    for make in (lambda P: sigmax.Gaussian([0.0, 0.0], P), lambda P: model(Q=P), lambda P: LIVE.update([0, 0], R=P)):
        with pytest.raises(sigmax.InputError, match=r"semidefinite|shape"):
            make(COVARIANCES[case])


MESSAGES = {
    "a forgotten return": (
        lambda: sigmax.run("EKF", model(motion=lambda x, dt: None), PRIOR, Z),
        "is a return missing",
    ),
    "a filter as the command line writes it": (lambda: sigmax.get("UKF:alpha=1"), r"write get\('UKF', alpha=1\)"),
    "a sensor of complex numbers": (
        lambda: sigmax.run("EKF", model(sensor=lambda x: x * 1j), PRIOR, Z),
        "sensor must return real numbers",
    ),
    "a parameter in words": (lambda: sigmax.get("UKF", alpha="abc"), "alpha of UKF must be a finite number"),
    "no noise": (lambda: sigmax.Model(motion=lambda x, dt: x, sensor=lambda x: x, Q=[1.0], R=[]), "R is empty"),
    "forms": (
        lambda: sigmax.Filter(sigmax.rules.Taylor1(), sigmax.rules.Taylor1(), forms.two_stage),
        r"write two_stage\(",
    ),
    "a class": (lambda: sigmax.Filter(sigmax.rules.Taylor1, sigmax.rules.Taylor1(), forms.block), r"write Taylor1\(\)"),
    "noise by row": (lambda: model(R=np.ones((4, 1))), "one for each row is given to run as R="),
    "dt too short by one": (lambda: sigmax.run("EKF", PLAIN, PRIOR, Z, dt=[1, 1, 1]), "update_first=True"),
}


@pytest.mark.parametrize("case", MESSAGES)
def test_a_message_says_how_to_mend_it(case):
    make, says = MESSAGES[case]
    with pytest.raises(sigmax.InputError, match=says):
        make()


def test_noise_from_row_to_row_goes_the_way_that_the_message_names():
    R = np.array([[0.1], [4.0], [0.2], [9.0]])
    by_row = sigmax.run("EKF", model(R=lambda x, u: u), PRIOR, Z, inputs=R)
    stepwise = live()
    for z, r in zip(Z, R, strict=True):
        stepwise.step(z, 1.0, R=r)
    assert np.allclose(by_row.mean[-1], stepwise.mean, rtol=1e-12)


@pytest.mark.parametrize("name", ["EIF", "SREIF", "CIF", "TSCIF"])
def test_a_sensor_without_noise_is_exact_or_a_fault_and_no_warning(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        got = sigmax.run(name, model(R=[0.0]), PRIOR, Z)
    want = sigmax.run("SREKF", model(R=[0.0]), PRIOR, Z)
    assert not got.ok.all() or np.allclose(got.mean, want.mean, atol=1e-6)

"""The doctor: silent on sound records, right about faults that are put into them."""

import json
import re

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import sigmax
from sigmax.cli.app import app
from sigmax.examination.alternatives import FACTORS, alternatives
from sigmax.examination.envelope import Parameter, envelope
from sigmax.examination.exchanged import of_exchanged
from sigmax.examination.families import prior_of, view
from sigmax.examination.record_data import RecordData
from sigmax.examination.search import Candidate
from sigmax.examination.values import copies, flaw
from sigmax.examination.words import in_words
from tests.own_records import RADAR

T = 250


def radar():
    flight = sigmax.motions.constant_velocity(("north", "east"))
    seen = sigmax.sensors.range_azimuth()
    model = sigmax.Model(motion=flight, Q=flight.noise(0.5), sensor=seen, R=[900.0, 4e-6])
    return model, sigmax.Gaussian([-20e3, 5e3, 60.0, -80.0], [1e4, 1e4, 100.0, 100.0])


def record(seed):
    """Of the radar's model."""
    return flown(seed, [-20e3, 5e3, 60.0, -80.0], [100, 100, 10, 10], 0.5, [30.0, 0.002])


def flown(seed, mean, spread, density, deviations):
    """Range and azimuth, drawn without the library: white acceleration of a spectral density."""
    rng = np.random.default_rng(seed)
    noise = density * np.kron([[1 / 3, 1 / 2], [1 / 2, 1.0]], np.eye(2))
    root = np.linalg.cholesky(noise)
    x = np.array(mean) + rng.normal(size=4) * spread
    z = []
    for _ in range(T):
        x = np.concatenate([x[:2] + x[2:], x[2:]]) + root @ rng.normal(size=4)
        z.append([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])])
    return np.array(z) + rng.normal(size=(T, 2)) * deviations


def test_the_test_draws_what_the_model_says():
    model, _ = radar()
    Q = model.Q(1.0) if callable(model.Q) else model.Q
    np.testing.assert_allclose(np.asarray(Q), 0.5 * np.kron([[1 / 3, 1 / 2], [1 / 2, 1.0]], np.eye(2)))


def test_sound_records_have_no_findings():
    model, prior = radar()
    spoken = [seed for seed in range(8) if sigmax.doctor(model, prior, record(seed)).findings]
    # One in a hundred would be allowed; two of eight then come once in four hundred times.
    assert len(spoken) < 2


def changed(z, j, values):
    z = z.copy()
    z[:, j] = values
    return z


NOISE = np.random.default_rng(99).normal(size=T)
FAULTS = {
    "R": lambda z: changed(z, 0, z[:, 0] + 60.0 * NOISE),
    "degrees": lambda z: changed(z, 1, np.rad2deg(z[:, 1])),
    "units": lambda z: changed(z, 0, z[:, 0] / 1000),
    "outliers": lambda z: changed(z, 0, z[:, 0] + 500 * (np.arange(T) % 16 == 9) * np.sign(NOISE)),
    "coarse": lambda z: changed(z, 0, np.round(z[:, 0] / 150) * 150),
    "stuck": lambda z: changed(z, 0, np.where((np.arange(T) > 100) & (np.arange(T) < 120), z[100, 0], z[:, 0])),
    "copies": lambda z: np.where((np.arange(T) % 20 == 7)[:, None], np.roll(z, 1, 0), z),
    "sign": lambda z: changed(z, 1, -z[:, 1]),
}


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_is_named_first(kind):
    model, prior = radar()
    found = sigmax.doctor(model, prior, FAULTS[kind](record(3)))
    assert found.status == 1
    assert kind in (found.findings[0].kind, *found.findings[0].either_kinds), found


@pytest.mark.parametrize("kind", ["units", "degrees"])
def test_a_start_made_from_the_same_values_moves_with_them(kind):
    """A prior from the first measurement, as descriptions make it, is wrong in the same way as the measurements."""
    model, prior = radar()
    z = FAULTS[kind](record(3))
    first = z[0, 0] * np.array([np.cos(z[0, 1]), np.sin(z[0, 1])])
    begun = sigmax.Gaussian([*first, 60.0, -80.0], prior.cov)
    found = sigmax.doctor(model, begun, z).findings[0]
    assert kind in (found.kind, *found.either_kinds), found
    assert found.nis_after < 1.5


def test_the_size_of_a_wrong_R_is_within_its_error_and_its_change_mends_it():
    model, prior = radar()
    z = FAULTS["R"](record(5))
    (found,) = sigmax.doctor(model, prior, z).findings
    assert found.where == "range"
    assert abs(found.value - np.log(5)) < 3 * found.std < 0.6
    assert found.nis_before > 2 > 1.2 > found.nis_after > 0.8
    mended = sigmax.Model(
        motion=model.motion, state=model.state, Q=model.Q, sensor=model.sensors[""], measurement=model.measurement[""],
        R=[900.0 * np.exp(found.value), 4e-6],
    )  # fmt: skip
    assert sigmax.doctor(mended, prior, z).status == 0


def test_a_deviation_for_a_variance_is_called_so():
    model, prior = radar()
    wrong = sigmax.Model(
        motion=model.motion, state=model.state, Q=model.Q, sensor=model.sensors[""], measurement=model.measurement[""],
        R=[30.0, 4e-6],
    )  # fmt: skip
    (found,) = sigmax.doctor(wrong, prior, record(6)).findings
    assert (found.kind, found.where) == ("R", "range")
    assert "R wants the variance 900" in found.size


def two_gauges(seed, shift=0.0):
    rng = np.random.default_rng(seed)
    level = 10 + np.cumsum(rng.normal(size=T) * 0.2)
    z = {"near": level[:, None] + 0.3 * rng.normal(size=(T, 1)), "far": level[:, None] + 0.5 * rng.normal(size=(T, 1))}
    z["far"] += shift
    walk = sigmax.motions.random_walk(("level",))
    seen = {s: sigmax.sensors.position(at=(0,), names=("level",)) for s in z}
    model = sigmax.Model(motion=walk, Q=[0.04], sensor=seen, R={"near": [0.09], "far": [0.25]})
    return model, sigmax.Gaussian([10.0], [1.0]), z


def test_an_offset_between_two_sensors_has_its_size_and_either_may_have_it():
    found = sigmax.doctor(*two_gauges(2, 0.6)).findings[0]
    assert found.kind == "bias"
    signed = found.value if found.where == "far.level" else -found.value
    assert abs(signed - 0.6) < 3 * found.std
    assert any("offset" in other or "factor" in other for other in found.either)
    assert not sigmax.doctor(*two_gauges(1)).findings


def driven(seed, late=0.0, turned=0.0, slower=0.0):
    """A body whose acceleration is known; its own positions and those of another sensor, which sees the past."""
    rng = np.random.default_rng(seed)
    t = np.arange(T)
    u = np.column_stack([0.4 * np.sin(t / 9), 0.3 * np.cos(t / 14)])
    c, s = np.cos(turned), np.sin(turned)
    x, states = np.array([0.0, 0.0, 1.0, 0.0]) + rng.normal(size=4) * [1, 1, 0.2, 0.2], []
    for k in range(T):
        x = np.concatenate([x[:2] + x[2:] + u[k] / 2, x[2:] + u[k]]) + rng.normal(size=4) * [0.01, 0.01, 0.03, 0.03]
        states.append(x)
    states = np.array(states)
    z = {"own": states[:, :2] + 0.5 * rng.normal(size=(T, 2))}
    then = np.column_stack([np.interp(t * (1 - slower), t, x) for x in states[:, :2].T])
    z["other"] = then - late * states[:, 2:] + 0.7 * rng.normal(size=(T, 2))
    motion = lambda x, dt, u: jnp.concatenate([x[:2] + dt * x[2:] + dt * dt / 2 * u, x[2:] + dt * u])  # noqa: E731
    model = sigmax.Model(
        motion=motion, Q=[1e-4, 1e-4, 9e-4, 9e-4], sensor={"own": lambda x: x[:2], "other": lambda x: x[:2]},
        R={"own": [0.25] * 2, "other": [0.49] * 2}, state=("x", "y", "vx", "vy"),
    )  # fmt: skip
    prior = sigmax.Gaussian([0.0, 0.0, 1.0, 0.0], [1.0, 1.0, 0.04, 0.04])
    return model, prior, z, u @ np.array([[c, s], [-s, c]])


def test_times_and_axes_have_their_size():
    model, prior, z, u = driven(1)
    assert not sigmax.doctor(model, prior, z, inputs=u).findings
    model, prior, z, u = driven(2, late=0.3)
    found = sigmax.doctor(model, prior, z, inputs=u).findings[0]
    assert found.kind == "delay"
    assert abs((found.value if found.where == "other" else -found.value) - 0.3) < 3 * found.std < 0.1
    model, prior, z, u = driven(3, turned=0.2)
    found = sigmax.doctor(model, prior, z, inputs=u).findings[0]
    assert found.kind == "input rotation"
    assert abs(found.value + 0.2) < 3 * found.std < 0.1
    model, prior, z, u = driven(4)
    assert sigmax.doctor(model, prior, z, inputs=u[:, ::-1]).findings[0].kind == "swap"
    found = sigmax.doctor(model, prior, z, inputs=u[:, ::-1] * [-1, 1]).findings[0]
    assert (found.kind, found.change) == ("axes", "give (input 1, −input 0)")
    model, prior, z, u = driven(6, slower=0.004)
    found = sigmax.doctor(model, prior, z, inputs=u).findings[0]
    assert found.kind == "skew"
    assert abs((found.value if found.where == "other" else -found.value) - 0.004) < 3 * found.std < 0.001
    model, prior, z, u = driven(5)
    turn = np.array([[np.cos(0.05), np.sin(0.05)], [-np.sin(0.05), np.cos(0.05)]])
    found = sigmax.doctor(model, prior, z | {"other": z["other"] @ turn}, inputs=u).findings[0]
    assert found.kind == "rotation"
    assert abs(abs(found.value) - 0.05) < 3 * found.std < 0.02


def test_other_readings_of_inputs_have_the_names_of_the_inputs():
    drive = sigmax.motions.unicycle()
    model = sigmax.Model(
        motion=drive, Q=drive.noise(position=0.05, heading=0.01), sensor=sigmax.sensors.position(), R=[0.25, 0.25]
    )
    axes = Parameter("input rotation", "speed, turn_rate", (0, 1))
    family = envelope(model, (axes,), 2, 2, (("", 2),))
    none = np.zeros((5, 2))
    record = RecordData({"": none}, np.ones(5), none, np.zeros(3), np.eye(3), none[0], none > 0, none[0], np.ones(5))
    found = {(a.kind, a.where) for a in alternatives(family, record, timed=False)}
    assert {("sign", "speed"), ("degrees", "turn_rate"), ("units", "speed"), ("swap", "speed, turn_rate")} <= found
    assert not [where for _, where in found if "input" in where]


@pytest.mark.parametrize("share", [0.05, 0.15])
def test_outliers_are_no_other_unit(share):
    """A smaller unit brings outliers nearer, and positions at constant velocity have no unit of their own."""
    rng = np.random.default_rng(1)
    v = np.array([10, -5]) + np.cumsum(0.4 * rng.normal(size=(T, 2)), 0)
    z = np.cumsum(v, 0) + 5 * rng.normal(size=(T, 2))
    z[:, 0] += 50 * (rng.random(T) < share) * rng.normal(size=T)
    flight = sigmax.motions.constant_velocity()
    model = sigmax.Model(motion=flight, Q=flight.noise(0.16), sensor=sigmax.sensors.position(), R=[25.0, 25.0])
    prior = sigmax.Gaussian([0.0, 0.0, 10.0, -5.0], [100.0, 100.0, 9.0, 9.0])
    assert sigmax.doctor(model, prior, z).findings[0].kind == "outliers"


def test_what_is_too_short_is_not_examined():
    model, prior = radar()
    found = sigmax.doctor(model, prior, record(1)[:10])
    assert found.status == 2
    assert "too few" in str(found)


def test_missing_values_and_times_are_those_of_run():
    model, prior = radar()
    z = record(2)
    z[30:45] = np.nan
    z[80, 1] = np.nan
    one = sigmax.doctor(model, prior, z, dt=1.0)
    other = sigmax.doctor(model, prior, z, t=np.arange(1.0, T + 1), t0=0.0)
    assert one.nis == pytest.approx(other.nis)
    assert one.status == other.status == 0
    assert one.to_dict()["status"] == 0


def test_what_cannot_be_examined_is_refused_in_words():
    model, prior = radar()
    with pytest.raises(sigmax.InputError, match="one record"):
        sigmax.doctor(model, prior, np.stack([record(1)] * 2))
    with pytest.raises(sigmax.InputError, match=r"examines a sigmax.Model"):
        sigmax.doctor("radar", prior, record(1))
    turning = sigmax.imm({"calm": model, "wild": model}, transition=[[0.9, 0.1], [0.1, 0.9]])
    with pytest.raises(sigmax.InputError, match=r"give one of its models.* calm, wild"):
        sigmax.doctor(turning, prior, record(1))
    with pytest.raises(sigmax.InputError, match="one of its members"):
        sigmax.doctor(model, prior, record(1), filter=sigmax.bank("EKF"))


def test_coarse_values_are_neither_stuck_nor_copies():
    rng = np.random.default_rng(0)
    v = np.round(np.cumsum(rng.normal(size=300)) / 2) * 2
    found = flaw(v, 0.5)
    assert found.kind == "coarse"
    assert found.size == 2
    assert found.extra == pytest.approx(4 / 12)
    assert copies(v[:, None]) is None
    heard = np.repeat(rng.normal(size=(60, 1)), 2, 0)[:80]
    heard[::2] = np.nan  # another sensor is heard in these rows
    heard[[7, 41]] = heard[[5, 39]]
    np.testing.assert_array_equal(np.flatnonzero(copies(heard).rows), [7, 41])
    assert flaw(rng.normal(size=300), 1.0) is None


def examined(capsys, *arguments):
    """Exit status and standard output of `sigmax doctor`."""
    with pytest.raises(SystemExit) as ended:
        app(["doctor", *arguments])
    return ended.value.code, capsys.readouterr().out


def test_the_command_ends_with_its_answer(tmp_path, capsys):
    """Two tracks, one with ranges in other units; sound, with findings, and too short."""
    rng = np.random.default_rng(8)
    t = np.arange(300.0)
    rows = []
    for name, unit in (("sound", 1.0), ("feet", 1 / 0.3048)):
        v = np.cumsum(rng.normal(size=(300, 2)) * 0.7, 0) + np.array([60.0, -80.0])
        x = np.cumsum(v, 0) + np.array([-20e3, 50e3])
        r = np.hypot(*x.T) + 30 * rng.normal(size=300)
        a = np.degrees(np.arctan2(x[:, 1], x[:, 0])) + 0.2 * rng.normal(size=300)
        rows.append(pd.DataFrame({"t": t, "aircraft": name, "range_km": r * unit / 1000, "azimuth_deg": a}))
    pd.concat([*rows, rows[0][:9].assign(aircraft="short")]).to_csv(tmp_path / "radar.csv", index=False)
    text = RADAR[: RADAR.index("[truth]")]
    (tmp_path / "radar.toml").write_text(text)
    path = str(tmp_path / "radar.toml")
    assert examined(capsys, path, "--track", "sound")[0] == 0
    assert examined(capsys, path, "--track", "short")[0] == 2
    status, out = examined(capsys, path, "--track", "feet", "--json")
    first = json.loads(out)["feet"]["findings"][0]
    assert status == 1
    assert first["kind"] == "units"
    assert "feet" in " ".join([first["cause"], *first["either"]])
    with pytest.raises(sigmax.InputError, match="unknown track"):
        app(["doctor", path, "--track", "other"])


@pytest.mark.parametrize("value", [-3.0, -1.0, 0.5])
def test_a_factor_of_any_sign_has_words(value):
    cause, size, change = in_words(Candidate("scale", "range", 9.0, np.array([value]), 1e-4), None)
    assert "factor" in cause
    assert "wanted" not in size
    assert "range" in change


@pytest.mark.parametrize("factor", FACTORS)
def test_a_scale_is_called_as_another_reading_of_the_values_is(factor):
    """Values that a factor mends are too long by its inverse."""
    scale = Candidate("scale", "range", 9.0, np.array([1 / factor - 1]), 1e-5 / factor)
    gain = Candidate("input gain", "speed", 9.0, np.array([factor - 1]), 1e-5 * factor)
    for _, size, _ in (in_words(scale, None), in_words(gain, None)):
        found = re.search(r"\((.*?)(?:: (.*) where (.*) are wanted)?\)", size)
        assert found is not None
        assert eval(found[1]) == pytest.approx(factor, rel=1e-3)
        if found[2]:
            assert FACTORS[factor] == f"in {found[2]} where the model has {found[3]}"


def test_a_length_is_proposed_in_no_unit_of_speed():
    model, prior = radar()
    none = np.zeros((5, 2))
    family = envelope(model, (), 0, 0, (("", 2),))
    row = none[0]
    before = RecordData({"": none}, np.ones(5), none[:, :0], prior.mean, prior.cov, row, none > 0, row, np.ones(5))
    said = " ".join(a.cause for a in alternatives(family, before, timed=False))
    assert "feet" in said
    assert "km/h" not in said
    assert "knots" not in said


def test_directions_that_the_record_tells_nothing_of_are_named():
    """A sensor of one axis says nothing of the other one."""
    flight = sigmax.motions.constant_velocity(("east", "north"))
    model = sigmax.Model(motion=flight, Q=flight.noise(0.2), sensor=lambda x: x[:1], R=[25.0])
    rng = np.random.default_rng(2)
    z = np.cumsum(np.cumsum(0.4 * rng.normal(size=T)) + 5.0) + 5 * rng.normal(size=T)
    found = sigmax.doctor(model, sigmax.Gaussian([0.0, 0.0, 5.0, 0.0], [25.0, 25.0, 1.0, 1.0]), z[:, None])
    along = [one for one in found.undetermined if "no surer" in one]
    assert len(along) == 2
    assert all("north" in one and "east" not in one for one in along)


def test_a_turn_is_a_manoeuvre_and_tells_where():
    rng = np.random.default_rng(4)
    v = np.array([60.0, -80.0]) + np.cumsum(0.7 * rng.normal(size=(T, 2)), 0)
    v[120:] += [40.0, 40.0]
    x = np.array([-20e3, 5e3]) + np.cumsum(v, 0)
    z = np.column_stack([np.hypot(*x.T), np.arctan2(x[:, 1], x[:, 0])]) + rng.normal(size=(T, 2)) * [30.0, 0.002]
    model, prior = radar()
    found = sigmax.doctor(model, prior, z).findings[0]
    assert found.kind == "manoeuvre"
    rows = [int(row) for row in re.findall(r"\d+", found.where)]
    assert min(abs(row - 120) for row in rows) < 8


def near_and_unknown(seed):
    """A radar whose ranges are close and whose target may be anywhere within some km: the EKF goes astray."""
    mean, spread = [2000.0, 1000.0, 0.0, 0.0], [1000.0, 1000.0, 10.0, 10.0]
    flight = sigmax.motions.constant_velocity(("north", "east"))
    seen = sigmax.sensors.range_azimuth()
    model = sigmax.Model(motion=flight, Q=flight.noise(1e-4), sensor=seen, R=[1.0, 0.05**2])
    return model, sigmax.Gaussian(mean, np.square(spread)), flown(seed, mean, spread, 1e-4, [1.0, 0.05])


def test_a_linearisation_that_goes_astray_is_named_and_the_filter_that_does_not():
    model, prior, z = near_and_unknown(11)
    (found,) = sigmax.doctor(model, prior, z).findings
    assert found.kind == "linearisation"
    assert found.nis_before > 10
    assert found.nis_after < 1.2
    EKF, other = (float(np.sum(sigmax.run(name, model, prior, z).log_likelihood)) for name in ("EKF", found.where))
    assert other > EKF + 1000
    assert not sigmax.doctor(model, prior, z, filter=found.where).findings


@pytest.mark.slow
def test_a_linearisation_is_named_in_some_of_the_records_that_it_spoils():
    """docs/doctor.md has the number."""
    first = [next(iter(sigmax.doctor(*near_and_unknown(seed)).findings), None) for seed in range(12)]
    named = [f for f in first if f is not None and f.kind == "linearisation"]
    print(f"{len(named)} of {len(first)} named")
    assert len(named) >= 9


@pytest.mark.slow
def test_the_rows_after_the_first_of_a_long_record_are_looked_at():
    """A gauge whose noise grows late: the first rows, which are searched, are sound."""
    rng = np.random.default_rng(6)
    level = 10 + np.cumsum(rng.normal(size=14000) * 0.2)
    noise = np.where(np.arange(14000) < 5000, 0.3, 0.9)
    walk = sigmax.motions.random_walk(("level",))
    model = sigmax.Model(motion=walk, Q=[0.04], sensor=sigmax.sensors.position(at=(0,), names=("level",)), R=[0.09])
    z = (level + noise * rng.normal(size=14000))[:, None]
    prior = sigmax.Gaussian([10.0], [1.0])
    assert not sigmax.doctor(model, prior, z[:5000]).findings
    assert sigmax.doctor(model, prior, z).findings[0].kind == "R"


def star_tracker(seed, axes=lambda w: w, quaternion=lambda q: q):
    """A body that turns, gyroscopes that drive it, and its attitudes as a star tracker has them, by SciPy alone."""
    rng = np.random.default_rng(seed)
    t = np.arange(T) * 0.1
    w = np.column_stack([0.3 * np.sin(t), 0.2 * np.cos(0.7 * t), 0.25 * np.sin(0.5 * t + 1)])
    body, seen = Rotation.identity(), []
    for k in range(T):
        body *= Rotation.from_rotvec(w[k] * 0.1 + rng.normal(size=3) * 0.002 * np.sqrt(0.1))
        seen.append((body * Rotation.from_rotvec(rng.normal(size=3) * 0.01)).as_quat(scalar_first=True))
    space = sigmax.spaces.Rotation()
    attitude = sigmax.rotation("attitude")
    model = sigmax.Model(
        motion=lambda x, dt, u: space.add(x, u * dt), state=(attitude,), Q=[0.002**2] * 3,
        sensor=lambda x: x, measurement=(attitude,), R=[0.01**2] * 3,
    )  # fmt: skip
    prior = sigmax.Gaussian([1.0, 0, 0, 0], [0.05**2] * 3)
    return model, prior, np.array([quaternion(q) for q in seen]), np.array([axes(v) for v in w])


def test_attitudes_are_examined_in_their_deviations():
    model, prior, z, u = star_tracker(1)
    assert not sigmax.doctor(model, prior, z, dt=0.1, inputs=u).findings
    u[:, 0] += 0.02
    found = sigmax.doctor(model, prior, z, dt=0.1, inputs=u).findings[0]
    assert {found.kind, *found.either_kinds} >= {"input offset", "drift"}
    assert abs(abs(found.value) - 0.02) < 3 * found.std < 0.002
    model, prior, z, u = star_tracker(2, axes=lambda w: [w[1], w[0], -w[2]])
    found = sigmax.doctor(model, prior, z, dt=0.1, inputs=u).findings[0]
    assert found.kind == "axes"
    assert "north, east, down" in found.cause
    model, prior, z, u = star_tracker(3, quaternion=lambda q: np.roll(q, -1))
    found = sigmax.doctor(model, prior, z, dt=0.1, inputs=u).findings[0]
    assert found.kind == "convention"
    assert "scalar last" in found.cause


def flight_with_jerk(seed, density):
    """Positions of a target whose acceleration wanders, drawn without the library."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(density * np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1]]))
    x, z = np.array([[0.0, 0.0], [10.0, -5.0], [0.0, 0.0]]), []
    for _ in range(T):
        x = np.array([[1, 1, 1 / 2], [0, 1, 1], [0, 0, 1]]) @ x + root @ rng.normal(size=(3, 2))
        z.append(x[0] + 5 * rng.normal(size=2))
    return np.array(z)


def plane(motion, *noise):
    k = len(motion.state)
    prior = sigmax.Gaussian([0.0, 0.0, 10.0, -5.0, 0.0, 0.0][:k], [100.0, 100.0, 25.0, 25.0, 1.0, 1.0][:k])
    return sigmax.Model(motion=motion, Q=motion.noise(*noise), sensor=sigmax.sensors.position(), R=[25.0, 25.0]), prior


@pytest.mark.slow
def test_another_family_of_motions_is_named_and_the_page_mends_it():
    z = flight_with_jerk(1, 0.01)
    (found,) = sigmax.doctor(*plane(sigmax.motions.constant_velocity(), 0.2), z).findings
    assert (found.kind, found.where) == ("motion", "constant_acceleration(('x', 'y'))")
    density = float(re.search(r"density=([\d.]+)", found.change)[1])
    assert 0.005 < density < 0.02
    assert found.nis_before > 2 > 1.2 > found.nis_after > 0.8
    assert not sigmax.doctor(*plane(sigmax.motions.constant_acceleration(), density), z).findings
    # The family is right here, and its noise is not.
    rng = np.random.default_rng(2)
    v = np.array([10.0, -5.0]) + np.cumsum(1.8 * rng.normal(size=(T, 2)), 0)
    z = np.cumsum(v, 0) + 5 * rng.normal(size=(T, 2))
    assert sigmax.doctor(*plane(sigmax.motions.constant_velocity(), 0.2), z).findings[0].kind == "Q"


def test_a_state_is_that_of_another_motion_where_both_know_it():
    turn, straight = sigmax.motions.coordinated_turn(), sigmax.motions.constant_velocity(("north", "east"))
    seen = sigmax.sensors.range_azimuth()
    Q = turn.noise(position=1.0, speed=0.5, course=0.003, turn_rate=0.0003)
    model = sigmax.Model(motion=turn, Q=Q, sensor=seen, R=[900.0, 4e-6])
    there = view(model, straight)
    np.testing.assert_allclose(there(jnp.array([1.0, 2.0, 3.0, -4.0])), [1, 2, 5, np.arctan2(-4, 3), 0], atol=1e-12)
    prior = prior_of(model, straight, sigmax.Gaussian([1.0, 2, 5, 0.3, 0.01], [4.0, 1, 9, 0.01, 1e-6]), 1.0)
    c, s = np.cos(0.3), np.sin(0.3)
    np.testing.assert_allclose(prior.mean, [1, 2, 5 * c, 5 * s])
    slope = np.array([[c, -5 * s], [s, 5 * c]])
    np.testing.assert_allclose(prior.cov[2:, 2:], slope @ np.diag([9, 0.01]) @ slope.T)
    # A sensor of the turn rate sees what a straight flight has not.
    gyro = sigmax.Model(motion=turn, Q=Q, sensor=lambda x: x[4:], R=[1e-6])
    assert view(gyro, straight) is None


def test_sensors_and_places_that_were_exchanged():
    model, prior, z = two_gauges(4)
    found = sigmax.doctor(model, prior, {"near": z["far"], "far": z["near"]}).findings[0]
    assert (found.kind, found.where) == ("swap", "near, far")
    # Of places that stand in the rows each pair, and nothing that the motion reads.
    drive, heard = sigmax.motions.unicycle(), sigmax.sensors.range_only()
    model = sigmax.Model(
        motion=lambda x, dt, u: drive.function(x, dt, u[:2]), state=drive.state, Q=[0.1] * 3,
        sensor=lambda x, u: heard.function(x, u[2:]), R=[1.0],
    )  # fmt: skip
    u = np.column_stack([np.full(6, 2.0), [0, 1, 0, 1, 0, 1], [0, 5, 5, 0, 5, 0], [0, 0, 9, 0, 0, 0]])
    row, none = np.zeros(1), np.zeros((6, 1), bool)
    record = RecordData({"": np.ones((6, 1))}, np.ones(6), u, np.zeros(3), np.eye(3), row, none, row, np.ones(6))
    some = [a for a in of_exchanged(envelope(model, (), 4, 4, (("", 1),)), record) if a.kind == "swap"]
    assert len(some) == 3
    (one,) = [a for a in some if "(0, 0) and (5, 0)" in a.cause]
    np.testing.assert_array_equal(one.change(record).u[:, 2:], [[5, 0], [0, 0], [5, 9], [5, 0], [0, 0], [5, 0]])

"""Sensors corrected together: the central filter, however it is come by."""

import json
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from tests.laws.problems import DT

STEPS = 40
PRIOR = sigmax.Gaussian([3.0, 2.0, 0.1, -0.05], np.diag([0.4, 0.3, 0.05, 0.05]))
MOVING = sigmax.motions.constant_velocity()
Q = MOVING.noise(0.02)


def bearings(x):
    return jnp.stack([jnp.arctan2(x[1], x[0]), jnp.arctan2(x[1], x[0] + 4)])


def distance(x):
    return jnp.hypot(x[0] - 6, x[1])[None]


ANGLES = (sigmax.angle("left"), sigmax.angle("right"))
R = {
    "west": np.array([[0.02, 0.006], [0.006, 0.03]]),
    "east": np.array([0.01, 0.02]),
    "south": np.array([[0.03, -0.01], [-0.01, 0.02]]),
    "sonar": np.array([0.04]),
}
BIAS = sigmax.Gaussian([0.02], [0.01])


def model(names, bias=True):
    sensor = {s: distance if s == "sonar" else bearings for s in names}
    F = {s: np.ones((1 if s == "sonar" else 2, 1)) for s in names if s != "sonar"}
    return sigmax.Model(
        motion=MOVING,
        sensor=sensor,
        measurement={s: ("range",) if s == "sonar" else ANGLES for s in names},
        Q=Q,
        R={s: R[s] for s in names},
        bias=sigmax.Bias(sensor=F, prior=BIAS, Q=[1e-4]) if bias else None,
    )


def central(names, bias=True):
    """The same by hand: one sensor that measures everything, its R block by block."""
    blocks = [np.diag(R[s]) if R[s].ndim == 1 else R[s] for s in names]
    whole = np.zeros((sum(map(len, blocks)),) * 2)
    place = 0
    for block in blocks:
        whole[place : place + len(block), place : place + len(block)] = block
        place += len(block)
    F = np.concatenate([np.zeros((1, 1)) if s == "sonar" else np.ones((2, 1)) for s in names])
    measured = [
        sigmax.angle(f"{s}{i}") if s != "sonar" else f"{s}{i}" for s in names for i in range(1 if s == "sonar" else 2)
    ]
    return sigmax.Model(
        motion=MOVING,
        sensor=lambda x: jnp.concatenate([distance(x) if s == "sonar" else bearings(x) for s in names]),
        measurement=measured,
        Q=Q,
        R=whole,
        bias=sigmax.Bias(sensor=F, prior=BIAS, Q=[1e-4]) if bias else None,
    )


@cache
def record():
    """Each sensor now and then: whole, in part, or not at all; angles turned by whole circles."""
    rng = np.random.default_rng(5)
    x = np.array([3.2, 1.8, 0.12, -0.04])
    z = {s: [] for s in R}
    for _ in range(STEPS):
        x = np.asarray(MOVING.function(x, DT))
        for s in R:
            h = np.asarray((distance if s == "sonar" else bearings)(x))
            z[s].append(h + (0.05 if s != "sonar" else 0) + 0.1 * rng.standard_normal(len(h)))
    z = {s: np.array(v) for s, v in z.items()}
    z["west"][3] = z["east"][4:8] = z["south"][6, 0] = z["sonar"][::3] = np.nan
    for s in z:
        z[s][7] = np.nan
    for s in ("west", "south"):
        z[s] += 2 * np.pi * rng.integers(-1, 2, z[s].shape)
    return z


def gap(a, b):
    return max(np.abs((a.mean - b.mean) / b.std).max(), np.abs(a.cov - b.cov).max() / b.cov.max())


@cache
def by_hand(filter, names):
    return sigmax.run(filter, central(names), PRIOR, np.concatenate([record()[s] for s in names], -1), dt=DT)


@cache
def fused(filter, names):
    return sigmax.run(filter, sigmax.models.fused(model(names)), PRIOR, {s: record()[s] for s in names}, dt=DT)


ALIKE = ("west", "east", "south")
MIXED = ("west", "sonar", "east")


@pytest.mark.parametrize("names", [ALIKE, MIXED], ids=["alike", "mixed"])
@pytest.mark.parametrize("filter", ["CKF", "MTSHCIF", "TSCIF"])
@pytest.mark.one_in(2)
def test_fused_sensors_are_the_central_filter(filter, names):
    """Also NIS, its degrees of freedom and the likelihood are those of all the members."""
    got, want = fused(filter, names), by_hand(filter, names)
    assert got.ok.all()
    assert gap(got, want) < 1e-9
    assert np.abs((got.bias_mean - want.bias_mean) / want.bias_std).max() < 1e-9
    assert np.array_equal(got.dof, want.dof)
    assert np.allclose(got.nis, want.nis, rtol=1e-8, equal_nan=True)
    assert got.log_likelihood == pytest.approx(want.log_likelihood, rel=1e-9)
    assert got.fusion == {s: "stacked" if s == "sonar" else "compressed" for s in names}


def test_one_after_the_other_is_another_filter():
    """Points are drawn anew between the sensors; where there are none, nothing differs on a linear sensor."""
    apart = sigmax.run("CKF", model(ALIKE), PRIOR, {s: record()[s] for s in ALIKE}, dt=DT)
    assert apart.fusion == {}
    assert gap(apart, by_hand("CKF", ALIKE)) > 1e-4


def test_the_order_of_fused_sensors_does_not_matter():
    a, b = (fused("TSCIF", names) for names in (MIXED, ("sonar", "east", "west")))
    assert gap(a, b) < 1e-11
    assert a.log_likelihood == pytest.approx(b.log_likelihood, rel=1e-12)


@pytest.mark.parametrize(("filter", "options"), [("EIF", {}), ("CIF", {"information": "paper"})])
def test_what_is_summed_is_said(filter, options):
    """Without Ω the contributions of different sensors add up, and stacking them is that sum."""
    chosen = sigmax.get(filter, **options)
    got = fused(chosen, MIXED)
    assert got.fusion == {"west": "compressed", "sonar": "summed", "east": "compressed"}
    assert gap(got, by_hand(chosen, MIXED)) < 1e-9


def test_live_takes_what_came_at_once():
    z = {s: record()[s] for s in MIXED}
    live = sigmax.Live("TSCIF", sigmax.models.fused(model(MIXED)), PRIOR)
    whole = fused("TSCIF", MIXED)
    for k in range(10):
        heard = {s: v[k] for s, v in z.items() if np.isfinite(v[k]).any()}
        live.predict(DT)
        told = live.update(heard or {"west": z["west"][k]})
        assert np.allclose(live.mean, whole.mean[k], rtol=1e-10)
        assert np.allclose(live.bias_mean, whole.bias_mean[k], rtol=1e-8)
        assert np.allclose(told.nis, whole.nis[k], rtol=1e-8, equal_nan=True)
    with pytest.raises(sigmax.InputError, match="as a dict by name"):
        live.update(z["west"][0])
    with pytest.raises(sigmax.InputError, match="unknown sensor"):
        live.update({"wset": z["west"][0]})


def test_live_on_fused_sensors_refuses_what_it_would_not_use():
    live = sigmax.Live("EKF", sigmax.models.fused(model(MIXED)), PRIOR)
    before = live.save()
    z = record()["west"][0]
    for says, given in {
        "R= cannot be given": {"z": {"west": z}, "R": [1.0, 1.0]},
        "as a dict by name": {"z": {"west": z}, "sensor": "west"},
        r"z\['west'\] must have the shape \(2,\) for \['left', 'right'\]; it has \(1,\)": {"z": {"west": z[:1]}},
        r"z\['west'\] must be an array of real numbers": {"z": {"west": "far"}},
    }.items():
        with pytest.raises(sigmax.InputError, match=says):
            live.update(**given)
        with pytest.raises(sigmax.InputError, match=says):
            live.step(dt=DT, **given)
    assert live.save() == before
    with pytest.raises(sigmax.InputError, match="the sensors are fused; expect one of them"):
        live.expect()


def test_fused_sensors_that_take_inputs_say_so():
    watched = sigmax.Model(
        motion=MOVING,
        sensor={"buoy": lambda x, u: jnp.hypot(x[0] - u[0], x[1])[None], "sonar": distance},
        measurement={"buoy": ("range",), "sonar": ("range",)},
        Q=Q,
        R={"buoy": [0.04], "sonar": [0.04]},
    )
    live = sigmax.Live("EKF", sigmax.models.fused(watched, messages=True), PRIOR)
    one = sigmax.running.contribution(live, [4.0], "buoy")
    for asked in (
        lambda: live.update({"sonar": [4.0]}),
        lambda: live.step({"buoy": [4.0]}, DT),
        lambda: sigmax.running.absorb(live, [one]),
    ):
        with pytest.raises(sigmax.InputError, match=r"\['buoy'\] take inputs; give u="):
            asked()
    assert np.isfinite(sigmax.running.absorb(live, [one], u=[6.0]).nis)


@pytest.mark.parametrize("messages", [False, True])
@pytest.mark.one_in(2)
def test_live_on_fused_sensors_answers_the_same_on_both_engines(messages):
    """The noise of what was put together is a function of inputs: it must not be taken for numbers."""
    z = {s: record()[s][0] for s in MIXED}
    together = sigmax.models.fused(model(MIXED), messages=messages)
    native, xla = (sigmax.Live("EKF", together, PRIOR, backend=backend) for backend in ("native", "xla"))
    for live in (native, xla):
        live.step(z, DT)
        live.update(z)
    assert np.allclose(native.mean, xla.mean, rtol=1e-12)
    assert np.allclose(native.bias_cov, xla.bias_cov, rtol=1e-10)


def test_a_batch_with_gaps_of_its_own_and_a_smoother():
    z = {s: np.array([record()[s], record()[s][::-1]]) for s in MIXED}
    together = sigmax.models.fused(model(MIXED))
    batch = sigmax.run("TSCIF", together, PRIOR, z, dt=DT)
    alone = sigmax.run("TSCIF", together, PRIOR, {s: v[1] for s, v in z.items()}, dt=DT)
    assert np.allclose(batch.mean[0], fused("TSCIF", MIXED).mean, rtol=1e-12)
    assert np.allclose(batch.mean[1], alone.mean, rtol=1e-12)
    assert np.allclose(batch.nis[1], alone.nis, equal_nan=True)
    smoothed = sigmax.smooth("TSCIF", together, batch, dt=DT)
    assert (smoothed.std[0, 0] < batch.std[0, 0]).all()


def test_what_cannot_be_fused_is_refused():
    with pytest.raises(sigmax.InputError, match="nothing to fuse"):
        sigmax.models.fused(central(ALIKE))
    unnamed = sigmax.Model(
        motion=MOVING, sensor={"a": bearings, "b": distance}, Q=Q, R={"a": lambda x: jnp.ones(2), "b": [1.0]}
    )
    with pytest.raises(sigmax.InputError, match="name the components of the sensor 'a'"):
        sigmax.models.fused(unnamed)


def stations(filter, names, fusing):
    """A filter for each station, all in step, and the messages of one instant as they go over the wire."""
    return {s: sigmax.Live(filter, fusing, PRIOR) for s in names}


def heard(names, k):
    return {s: record()[s][k] for s in names}


def test_stations_answer_what_the_central_filter_answers():
    """Each tells the others R⁻¹ z and R⁻¹; what comes late in a message or not at all is left out."""
    names = MIXED
    whole = by_hand("TSCIF", names)
    there = stations("TSCIF", names[:2], sigmax.models.fused(model(names), messages=True))
    for k in range(12):
        messages = []
        for live in there.values():
            live.predict(DT)
        for s, z in heard(names, k).items():
            messages.append(sigmax.running.contribution(there["west"], z, s, time=k * DT).to_json())
        for order, live in zip((1, -1), there.values(), strict=True):
            told = sigmax.running.absorb(live, [sigmax.running.Contribution.from_json(m) for m in messages[::order]])
            assert live.ok
            assert np.allclose(live.mean, whole.mean[k], rtol=1e-9)
            assert np.allclose(live.bias_mean, whole.bias_mean[k], rtol=1e-7)
            assert np.allclose(live.bias_cov, whole.bias_cov[k], rtol=1e-9)
            assert np.allclose(told.nis, whole.nis[k], rtol=1e-7, equal_nan=True)
            assert told.dof == whole.dof[k]
            if told.dof:
                assert np.allclose(told.log_likelihood, whole.step_log_likelihood[k], rtol=1e-7)


@pytest.mark.parametrize(
    ("filter", "options"), [("SREIF", {}), ("EKF", {}), ("TSEKF", {}), ("TSCIF", {"information": "paper"})]
)
@pytest.mark.one_in(4)
def test_contributions_to_the_state_add_up(filter, options):
    """Where there is no Ω, or it is left out, a receiver need not know the sensors: (i, I) is enough."""
    names = ("sonar", "west")
    chosen = sigmax.get(filter, **options)
    here, there = (sigmax.Live(chosen, model(names), PRIOR) for _ in range(2))
    whole = by_hand(chosen, names)
    for k in range(8):
        messages = []
        for live in (here, there):
            live.predict(DT)
        for s, z in heard(names, k).items():
            messages.append(sigmax.running.contribution(there, z, s, space="state").to_json())
        for live in (here, there):
            sigmax.running.absorb(live, map(sigmax.running.Contribution.from_json, messages))
            assert np.allclose(live.mean, whole.mean[k], rtol=1e-9)
            assert np.allclose(live.cov, whole.cov[k], rtol=1e-8, atol=1e-12)
            assert np.allclose(live.bias_mean, whole.bias_mean[k], rtol=1e-7)


def test_messages_that_do_not_fit_are_refused():
    names = ("sonar", "west")
    live = sigmax.Live("TSCIF", sigmax.models.fused(model(names), messages=True), PRIOR)
    one = sigmax.running.contribution(live, record()["west"][0], "west")
    with pytest.raises(sigmax.InputError, match=r"add up where there is no Ω.*TSCIF counts it"):
        sigmax.running.contribution(live, record()["west"][0], "west", space="state")
    with pytest.raises(sigmax.InputError, match="messages=True"):
        sigmax.running.absorb(sigmax.Live("TSCIF", model(names), PRIOR), [one])
    with pytest.raises(sigmax.InputError, match="unknown sensor"):
        sigmax.running.absorb(live, [one._replace(sensor="north")])
    with pytest.raises(sigmax.InputError, match="of measurements and of the state"):
        sigmax.running.absorb(live, [one, one._replace(space="state")])
    twice = [one, one._replace(time=1.0), sigmax.running.Contribution.from_json(one.to_json())]
    with pytest.raises(sigmax.InputError, match="of 'west' is there twice"):
        sigmax.running.absorb(live, twice)
    with pytest.raises(sigmax.InputError, match=r"measures \['left', 'right'\] here, .* of \['x', 'y'\]"):
        sigmax.running.absorb(live, [one._replace(components=("x", "y"))])
    for no_list in ([one.to_json()], one, [None]):
        with pytest.raises(sigmax.InputError, match=r"a list of sigmax\.running\.Contribution"):
            sigmax.running.absorb(live, no_list)


FIELDS = {
    "space": "sky",
    "sensor": 5,
    "components": "ab",
    "about": [1.0, 2.0, 3.0],
    "vector": [float("nan"), 0.0],
    "matrix": [[1.0, 5.0], [5.0, 1.0]],
    "square": None,
    "volume": [1.0],
    "seen": -2,
    "time": "noon",
}


@pytest.mark.parametrize("field", FIELDS)
def test_a_message_is_refused_by_the_field_that_is_wrong(field):
    live = sigmax.Live("EKF", model(MIXED), PRIOR)
    message = json.loads(sigmax.running.contribution(live, record()["west"][0], "west", time=np.float32(2)).to_json())
    assert sigmax.running.Contribution.from_json(json.dumps(message)).time == 2.0
    with pytest.raises(sigmax.InputError, match=f"{field} of a contribution"):
        sigmax.running.Contribution.from_json(json.dumps(message | {field: FIELDS[field]}))


def test_a_measurement_known_very_unevenly_is_a_message_and_one_without_noise_is_none():
    live = sigmax.Live("EKF", model(MIXED), PRIOR)
    one = sigmax.running.contribution(live, record()["west"][0], "west", R=[1e-12, 1e12])
    again = sigmax.running.Contribution.from_json(one.to_json())
    assert np.array_equal(again.matrix, one.matrix)
    nothing = sigmax.running.contribution(live, [np.nan, np.nan], "west")
    assert sigmax.running.Contribution.from_json(nothing.to_json()).seen == 0
    with pytest.raises(sigmax.InputError, match="must have an inverse"):
        sigmax.running.Contribution.from_json(one._replace(matrix=np.ones((2, 2))).to_json())


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", "null", '{"format": "another"}', '{"format": "sigmax contribution 1"}']
)
@pytest.mark.one_in(3)
def test_what_is_no_message_is_refused(text):
    with pytest.raises(sigmax.InputError, match="format 'sigmax contribution 1'"):
        sigmax.running.Contribution.from_json(text)


def test_a_contribution_is_refused_before_it_is_sent():
    live = sigmax.Live("EIF", model(MIXED), PRIOR)
    z = record()["west"][0]
    for says, given in {
        "has no inverse": {"z": z, "R": [0.0, 1.0]},
        "numbers": {"z": "far"},
        "z must be finite": {"z": [np.inf, 0.0]},
        "unknown space": {"z": z, "space": "stat"},
        "it is a function": {"z": z, "R": lambda x: jnp.ones(2)},
        "time must be": {"z": z, "time": "noon"},
    }.items():
        with pytest.raises(sigmax.InputError, match=says):
            sigmax.running.contribution(live, sensor="west", **given)

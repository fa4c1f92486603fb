"""Elevation maps, flights over them, opaque functions, and what explain says."""

import json
from math import comb
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.models import radio_altimeter
from sigmax.models.terrain import hills
from sigmax.records.maps import elevation
from sigmax.records.terrain import flight, terrain
from sigmax.running.explain import explain
from tests.browser import unpacked

SHARED = Path(__file__).parents[2] / "shared" / "data" / "terrain" / "jacksboro_fault_dem.npz"
MADE = sigmax.builtin("terrain")


def grid(method, heights=None):
    rng = np.random.default_rng(0)
    chosen = rng.uniform(0, 100, (6, 8)) if heights is None else heights
    return sigmax.models.Elevation(chosen, (50.0, 40.0), (10.0, -5.0), method)


def model_with(sensor):
    return sigmax.Model(motion=MADE.model.motion, state=MADE.model.state, Q=MADE.model.Q, sensor=sensor, R=[25.0])


@pytest.mark.parametrize("method", ["bilinear", "bicubic"])
def test_a_look_up_goes_through_the_heights_with_the_derivatives_of_itself(method):
    ground = grid(method)
    (x0, x1), (z0, z1) = ground.extent
    x, z = np.meshgrid(np.linspace(x0, x1, 8), np.linspace(z0, z1, 6))
    np.testing.assert_allclose(ground(x, z), ground.heights, atol=1e-10)
    slope = jax.jit(jax.vmap(jax.grad(lambda p: ground(p[0], p[1]))))
    at = np.random.default_rng(1).uniform([x0 + 1, z0 + 1], [x1 - 1, z1 - 1], (20, 2))
    steps = at[:, None] + 1e-4 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    found = np.asarray(ground(steps[..., 0], steps[..., 1]))
    numeric = (found[:, ::2] - found[:, 1::2]) / 2e-4
    np.testing.assert_allclose(slope(at), numeric, atol=1e-6)


@pytest.mark.parametrize("method", ["bilinear", "bicubic"])
def test_a_plane_is_looked_up_exactly_to_its_edges_and_nothing_beyond(method):
    at = np.add.outer(3.0 * np.arange(6), 2.0 * np.arange(8))
    ground = grid(method, at)
    (x0, x1), (z0, z1) = ground.extent
    x, z = np.random.default_rng(2).uniform([x0, z0], [x1, z1], (20, 2)).T
    np.testing.assert_allclose(ground(x, z), 2 * (x - 10) / 50 + 3 * (z + 5) / 40, atol=1e-9)
    assert np.isnan(np.asarray(ground(np.array([x0 - 1, x1, np.nan]), np.array([z0, z1 + 1, z0])))).all()


def test_slopes_of_the_bicubic_do_not_jump_where_those_of_the_bilinear_do():
    def jump(ground):
        slope = jax.grad(lambda x: ground(x, 60.0))
        return abs(float(slope(10.0 + 100.0 - 1e-7) - slope(10.0 + 100.0 + 1e-7)))

    assert jump(grid("bicubic")) < 1e-5 < jump(grid("bilinear"))


@pytest.mark.parametrize("given", [np.zeros((1, 5)), np.zeros(3)])
def test_what_is_no_grid_is_refused(given):
    with pytest.raises(sigmax.InputError, match="2 × 2"):
        sigmax.models.Elevation(given, (1.0, 1.0))


def test_a_method_that_is_not_known_is_refused():
    with pytest.raises(sigmax.InputError, match="bilinear"):
        sigmax.models.Elevation(np.zeros((3, 3)), (1.0, 1.0), method="bilinaer")


def test_off_the_map_the_correction_is_a_fault_and_over_flat_ground_it_tells_the_height_alone():
    u = np.tile(MADE.inputs, (3, 1))
    u[1, 1:] = -1e6
    z = np.full((3, 1), 1000.0)
    result = sigmax.run("EKF", MADE.model, MADE.prior, z, inputs=u)
    assert result.fault.tolist() == [0, sigmax.running.Fault.SENSOR_NOT_FINITE, 0]
    flat = sigmax.models.Elevation(np.full((4, 4), 300.0), (5e3, 5e3), method="bilinear")
    model = sigmax.Model(
        motion=MADE.model.motion,
        state=MADE.model.state,
        Q=MADE.model.Q,
        sensor=radio_altimeter(flat),
        R=[25.0],
    )
    for name in ("EKF", "SRCKFB"):
        level = sigmax.run(name, model, MADE.prior, z + 205, inputs=np.tile(MADE.inputs, (3, 1)))
        assert np.abs(level.mean[:, 5:]).max() < 1e-9
        assert level.mean[-1, 0] == pytest.approx(5, abs=2)


def record():
    return terrain(hills(), "hills", seed=2, flights=2)


def test_the_positions_are_found_by_the_heights_below():
    made = record()
    for name in ("CKF", "SRCKFB"):
        found = sigmax.run(
            sigmax.get(name, permute=True), made.model, made.prior, made.z, dt=made.dt, inputs=made.inputs
        )
        error = np.sqrt((found.errors(made.truth)[:, -20:, 5:] ** 2).mean())
        assert found.ok.all()
        assert error < 40 < np.sqrt((made.truth[:, -20:, 5:] ** 2).mean())


def test_forms_and_engines_agree_with_the_permutation():
    made = record()
    given = made.model, made.prior, made.z[:, :12]
    more = {"dt": made.dt[:, :12], "inputs": made.inputs[:, :12]}
    wanted = sigmax.run(sigmax.get("CKF", permute=True), *given, **more)
    for name, backend in (("SRCKFB", "native"), ("SRCKFB", "xla")):
        other = sigmax.run(sigmax.get(name, permute=True), *given, **more, backend=backend)
        assert (np.abs(other.mean - wanted.mean) / wanted.std).max() < 1e-9
        np.testing.assert_allclose(other.std, wanted.std, rtol=1e-8)


def test_explain_tells_the_counts_of_the_paper():
    motion, sensor = explain("CKF", MADE.model, MADE.prior, inputs=MADE.inputs, measure=False)
    assert (motion.straight, motion.parts) == (7, ())
    (look_up,) = (p for p in sensor.parts if "look-up" in p.what)
    assert (look_up.reads, look_up.given, look_up.permuted) == (("dx", "dz"), 14, 5)
    assert set(sensor.held) == {"dh", "dv", "da", "dvx", "dvz"}
    assert 0.6 < sensor.estimated < 0.65


@pytest.mark.parametrize("name", sigmax.names())
def test_explain_answers_for_every_filter(name):
    """What is evaluated is what the points and derivatives of its rules say, counted by hand."""
    made = sigmax.builtin("radar-ct")
    motion, sensor = explain(name, made.model, made.prior, dt=made.dt, measure=False)
    assert (motion.function, sensor.function) == ("motion", "sensor")
    n = made.model.size
    by_rule = {"Taylor1": n + 1, "Taylor2": comb(n + 2, 2), "Taylor(": comb(n + 3, 3)}
    by_rule |= {"SigmaPoints(cubature, degree=3)": 2 * n, "SigmaPoints(cubature, degree=5)": 2 * n**2 + 1}
    by_rule |= {"SigmaPoints(gauss_hermite": 3**n, "SigmaPoints(scaled": 2 * n + 1, "SigmaPoints(simplex": n + 1}
    for one in (motion, sensor):
        assert one.points == next(count for rule, count in by_rule.items() if one.rule.startswith(rule))
        assert one.parts
        assert set(one.W) == {"north", "east", "speed", "course", "turn_rate"}
        assert all(part.permuted > 0 and part.given <= one.points for part in one.parts)


def opaque_model(function, **more):
    height = sigmax.models.opaque(function, **more)

    def sensor(x, u):
        ground = height(x) if more else height(u[1] + x[5], u[2] + x[6])
        return jnp.stack([u[0] + x[0] - ground])

    return model_with(sensor)


@pytest.mark.parametrize(
    ("name", "parameters", "points"),
    [("CKF", {}, 14), ("SRSKFB", {"permute": True}, 3)],
)
def test_an_opaque_function_is_called_once_a_step_with_all_distinct_points_of_the_batch(name, parameters, points):
    calls = []

    def database(x, z):
        calls.append(x.shape)
        return 400 + 60 * np.sin(x / 700) * np.cos(z / 900)

    # As many tracks as would else be cut in parts for the cores.
    tracks = 600
    z = np.random.default_rng(0).normal(1000, 5, (tracks, 4, 1))
    u = np.tile(MADE.inputs, (4, 1))
    chosen = sigmax.get(name, **parameters)
    result = sigmax.run(chosen, opaque_model(database), MADE.prior, z, inputs=u)
    assert calls == [(tracks * points,)] * 4

    def traced(x, z):
        return 400 + 60 * jnp.sin(x / 700) * jnp.cos(z / 900)

    sensor = radio_altimeter(traced)
    same = model_with(sensor)
    seen = sigmax.run(chosen, same, MADE.prior, z, inputs=u)
    assert (np.abs(result.mean - seen.mean) / seen.std).max() < 1e-9


def test_declared_dependencies_derivatives_and_refusals_of_opaque_functions():
    z, u = np.full((3, 1), 1000.0), np.tile(MADE.inputs, (3, 1))
    shapes = []

    def plane(x):
        shapes.append(x.shape)
        return 500 + 0.1 * x[:, 0] - 0.2 * x[:, 1]

    declared = opaque_model(plane, reads=(5, 6))
    cheap = sigmax.run(sigmax.get("CKF", permute=True), declared, MADE.prior, z, inputs=u)
    assert shapes == [(5, 2)] * 3
    with pytest.raises(sigmax.InputError, match="plane is opaque and has no derivatives"):
        sigmax.run("EKF", declared, MADE.prior, z, inputs=u)
    value = sigmax.models.opaque(lambda x: (500 + 0.1 * x[:, 5] - 0.2 * x[:, 6])[:, None], size=1)
    known = sigmax.models.with_derivatives(value, lambda x: jnp.array([[0, 0, 0, 0, 0, 0.1, -0.2]]))

    def sensor(x, u):
        return u[:1] + x[:1] - known(x)

    given = model_with(sensor)
    np.testing.assert_allclose(sigmax.run("EKF", given, MADE.prior, z, inputs=u).mean, cheap.mean, atol=1e-9)


def test_maps_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(sigmax.InputError, match="give jacksboro"):
        elevation(str(tmp_path / "nowhere.npz"))
    np.savez(tmp_path / "other.npz", heights=np.zeros((3, 3)))
    with pytest.raises(sigmax.InputError, match="should hold elevation"):
        elevation(str(tmp_path / "other.npz"))


@pytest.mark.skipif(not SHARED.exists(), reason="the map of the Jacksboro fault is not there")
def test_the_real_map_lies_north_up():
    ground = elevation(str(SHARED), "bilinear")
    raw = np.load(SHARED)["elevation"]
    assert ground.heights.shape == (344, 403)
    assert ground.heights[0, 0] == raw[-1, 0]
    assert ground.spacing == pytest.approx((74.5, 92.6), abs=0.2)
    place = flight(ground).place
    assert np.isfinite(np.asarray(ground(place[:, 1], place[:, 2]))).all()


def test_the_command_leaves_a_report_with_the_map(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from sigmax.cli.app import app

    monkeypatch.chdir(tmp_path)
    ground = hills(24)
    degree = 1 / 111_132.95
    np.savez("small.npz", elevation=ground.heights[::-1], dx=250 * degree, dy=250 * degree, ymin=0.1, ymax=-0.1)
    done = CliRunner().invoke(app, ["terrain", "small.npz", "-f", "CKF:permute=1", "--out", "made"])
    assert done.exit_code == 0, done.output
    told = json.loads(Path("made/summary.json").read_text())
    assert told["record"] == "small"
    assert told["filters"]["CKF:permute=1"]["faults"] == 0
    assert '"heatmap"' in unpacked(Path("made/report.html").read_text(), "figures")


def test_what_goes_wrong_in_an_opaque_function_is_raised_as_it_was(caplog):
    def gone(x, z):
        raise ConnectionError("the database does not answer")

    z, u = np.full((3, 1), 1000.0), np.tile(MADE.inputs, (3, 1))
    with pytest.raises(ConnectionError, match="does not answer"):
        sigmax.run("CKF", opaque_model(gone), MADE.prior, z, inputs=u)
    with pytest.raises(sigmax.InputError, match=r"given 14 points .* returned \(3,\)"):
        sigmax.run("CKF", opaque_model(lambda x, z: np.zeros(3)), MADE.prior, z, inputs=u)
    assert {r.name for r in caplog.records} <= {"sigmax"}


def test_one_live_track_calls_an_opaque_function_once_a_step_and_tells_of_its_failures():
    calls = []

    def database(x, z):
        calls.append(len(x))
        if len(calls) > 2:
            raise ConnectionError("the database does not answer")
        return 400 + 60 * np.sin(x / 700) * np.cos(z / 900)

    live = sigmax.Live(sigmax.get("SRCKFB", permute=True), opaque_model(database), MADE.prior)
    for _ in range(2):
        live.step([1000.0], 1.0, u=MADE.inputs)
    assert calls == [5, 5]
    before = live.mean
    with pytest.raises(ConnectionError):
        live.step([1000.0], 1.0, u=MADE.inputs)
    np.testing.assert_array_equal(live.mean, before)

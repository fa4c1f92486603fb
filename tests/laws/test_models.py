"""Ready-made motions and sensors: right, and finite with their derivatives where textbooks divide by zero."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm

import sigmax
from sigmax import motions, sensors
from sigmax.models.smooth import cosc, decay, decay2, direction, length, sinc
from sigmax.models.terrain import inertial_errors

START = {
    "constant_velocity": [1.0, -2, 3, 0.5],
    "constant_acceleration": [1.0, -2, 3, 0.5, 0.2, -0.3],
    "singer": [1.0, -2, 3, 0.5, 0.2, -0.3],
    "coordinated_turn": [10.0, 20, 15, 0.7, 0.02],
    "coordinated_turn_cartesian": [10.0, 20, 15, -3, 0.02],
    "unicycle": [1.0, 2, 0.4],
}
RATES = {
    "constant_velocity": lambda x: [x[2], x[3], 0, 0],
    "constant_acceleration": lambda x: [x[2], x[3], x[4], x[5], 0, 0],
    "singer": lambda x: [x[2], x[3], x[4], x[5], -x[4] / 10, -x[5] / 10],
    "coordinated_turn": lambda x: [x[2] * np.cos(x[3]), x[2] * np.sin(x[3]), 0, x[4], 0],
    "coordinated_turn_cartesian": lambda x: [x[2], x[3], -x[4] * x[3], x[4] * x[2], 0],
    "unicycle": lambda x: [2.0 * np.cos(x[2]), 2.0 * np.sin(x[2]), 0.3],
}
INPUTS = {"unicycle": (jnp.array([2.0, 0.3]),)}


@pytest.mark.parametrize("name", START)
@pytest.mark.parametrize("dt", [0.01, 1.0, 7.0])
def test_motions_solve_their_differential_equation(name, dt):
    motion = getattr(motions, name)()
    got = motion.function(jnp.array(START[name]), dt, *INPUTS.get(name, ()))
    want = solve_ivp(lambda _, x: RATES[name](x), (0, dt), START[name], rtol=1e-11, atol=1e-11).y[:, -1]
    assert len(motion.state) == len(want)
    assert np.allclose(got, want, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", ["coordinated_turn", "coordinated_turn_cartesian"])
def test_turn_rate_zero_is_an_ordinary_point(name):
    """The derivatives in the turn rate, first and second, are continuous through zero."""
    function = getattr(motions, name)().function

    def position(turn):
        return function(jnp.array([*START[name][:4], 0.0]).at[4].set(turn), 2.0)[:2]

    for derivative in (jax.jit(jax.jacfwd(position)), jax.jit(jax.jacfwd(jax.jacfwd(position)))):
        values = [derivative(t) for t in (-1e-3, -1e-7, 0.0, 1e-12, 1e-7, 1e-3)]
        assert np.isfinite(values).all()
        assert np.allclose(values, values[2], rtol=2e-2, atol=1e-3)
        assert np.allclose(values[1:5], values[2], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("series", "formula"), [
    (sinc, lambda a: np.sin(a) / a),
    (cosc, lambda a: (1 - np.cos(a)) / a),
    (decay, lambda a: -np.expm1(-a) / a),
    (decay2, lambda a: (np.expm1(-a) + a) / a**2),
])  # fmt: skip
def test_series_and_formula_meet(series, formula):
    a = np.array([0.0999999, 0.1000001, 0.5, 3.0])
    assert np.allclose(series(jnp.asarray(a)), formula(a), rtol=1e-13)
    gap = np.diff(jax.vmap(jax.grad(series))(jnp.array([0.1 - 1e-9, 0.1 + 1e-9])))
    assert abs(gap[0]) < 1e-8


def chain(order):
    A = np.diag(np.ones(order - 1), 1)
    return A, np.eye(order)[:, -1:]


@pytest.mark.parametrize(("name", "order"), [("constant_velocity", 2), ("constant_acceleration", 3)])
def test_noise_of_integrators_is_the_integral(name, order):
    dt, density = 1.7, 0.6
    A, g = chain(order)
    want = [
        [
            quad(lambda s, i=i, j=j: density * (expm(A * s) @ g @ g.T @ expm(A * s).T)[i, j], 0, dt)[0]
            for j in range(order)
        ]
        for i in range(order)
    ]
    got = getattr(motions, name)(axes=("x", "y")).noise(density)(dt)
    assert np.allclose(got, np.kron(want, np.eye(2)), rtol=1e-10)


@pytest.mark.parametrize("dt", [1e-3, 1.0, 40.0])
def test_noise_of_singer_is_the_integral(dt):
    tau, sigma = 10.0, 2.0
    A = np.array([[0, 1, 0], [0, 0, 1], [0, 0, -1 / tau]])
    g = np.array([[0.0], [0], [1]]) * np.sqrt(2 / tau) * sigma
    nodes, weights = np.polynomial.legendre.leggauss(60)
    s = dt * (nodes + 1) / 2
    want = sum(w * dt / 2 * expm(A * t) @ g @ g.T @ expm(A * t).T for t, w in zip(s, weights, strict=True))
    got = motions.singer(axes=("x",), tau=tau).noise(sigma)(dt)
    assert np.allclose(got, want, rtol=1e-9, atol=1e-9 * want.min())


SENSORS = {
    "range_only": sensors.range_only(origin=(0.0, 0.0)),
    "bearing": sensors.bearing(),
    "range_azimuth": sensors.range_azimuth(),
    "doppler": sensors.range_azimuth(velocity=(2, 3)),
    "polar doppler": sensors.range_azimuth(polar_velocity=(2, 3)),
    "elevation": sensors.range_azimuth(at=(0, 1, 2)),
}


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("where", ["at the sensor", "overhead", "behind"])
@pytest.mark.one_in(2)
def test_sensors_are_finite_everywhere(name, where):
    x = {"at the sensor": [0.0, 0, 0, 0], "overhead": [0.0, 0, 5, 1], "behind": [-5.0, 0.0, 1, 1]}[where]
    function = SENSORS[name].function
    x = jnp.array(x)
    assert function(x).shape == (len(SENSORS[name].measurement),)
    for derivative in (jax.jacfwd, jax.jacrev, lambda f: jax.jacfwd(jax.jacfwd(f))):
        assert np.isfinite(jax.jit(derivative(function))(x)).all()


def test_sensors_measure_what_they_say():
    x = jnp.array([3.0, 4.0, 2.0, -1.0])
    assert np.allclose(sensors.range_azimuth(velocity=(2, 3)).function(x), [5, np.arctan2(4, 3), (6 - 4) / 5])
    speed, course = np.hypot(2, -1), np.arctan2(-1, 2)
    polar = sensors.range_azimuth(polar_velocity=(2, 3)).function(jnp.array([3.0, 4.0, speed, course]))
    assert np.allclose(polar, [5, np.arctan2(4, 3), 0.4])
    assert np.allclose(
        sensors.range_azimuth(at=(0, 1, 2)).function(jnp.array([3.0, 4.0, 5.0])), [50**0.5, np.arctan2(4, 3), np.pi / 4]
    )
    assert np.allclose(sensors.camera_bearing().function(x, jnp.array([2.0, 4.0, 0.5])), [-0.5])
    assert np.allclose(sensors.range_only(scale=2).function(x, jnp.zeros(2)), [10.0])
    assert sensors.position(at=(1, 3)).function(x).tolist() == [4, -1]


def test_length_and_direction_at_the_origin():
    zero = jnp.zeros(())
    assert length(zero, zero) == direction(zero, zero) == 0
    assert jax.grad(length, (0, 1))(0.0, 0.0) == (0, 0)
    assert jax.grad(direction, (0, 1))(0.0, 0.0) == (0, 0)


def test_equal_parts_are_one_part():
    """A compiled filter is found by its functions: making them again must not compile again."""
    assert motions.constant_velocity(["x", "y"]) is motions.constant_velocity(("x", "y"))
    assert sensors.range_azimuth(polar_velocity=[2, 3]) is sensors.range_azimuth(polar_velocity=[2, 3])
    turn, radar = motions.coordinated_turn(), sensors.range_azimuth(polar_velocity=(2, 3))
    model = sigmax.Model(motion=turn, sensor=radar, Q=turn.noise(1, 1, 1, 1), R=np.ones(3))
    assert model.state == turn.state
    assert model.measurement[""] == radar.measurement
    assert model.angular == (False, False, False, True, False)


def test_joined_motions():
    vehicle, scale = motions.unicycle(), motions.random_walk(("scale",))
    both = motions.join(vehicle, scale)
    assert both.state == ("x", "y", "heading", "scale")
    assert both.inputs == vehicle.inputs
    moved = both.function(jnp.array([1.0, 2, 0.4, 1.07]), 0.5, jnp.array([2.0, 0.3]))
    assert moved[3] == 1.07
    assert np.allclose(moved[:3], vehicle.function(jnp.array([1.0, 2, 0.4]), 0.5, jnp.array([2.0, 0.3])))
    assert both.noise(vehicle.noise(0.1, 0.2), scale.noise(0.3)).tolist() == pytest.approx([0.01, 0.01, 0.04, 0.09])
    matrix = motions.join(motions.constant_velocity(("x",)), scale).noise(
        motions.constant_velocity(("x",)).noise(2.0), scale.noise(0.3)
    )(3.0)
    assert np.allclose(np.diagonal(matrix), [18, 6, 0.27])


def test_a_jacobian_of_ones_own_is_used():
    """A deliberately wrong Jacobian must show, in the filter and in second derivatives."""
    sensor = sigmax.models.with_derivatives(lambda x: x[:1] ** 2, lambda x: jnp.array([[5.0 * x[0]]]))
    assert jax.jacfwd(sensor)(jnp.array([2.0])).tolist() == [[10.0]]
    assert jax.jacfwd(jax.jacfwd(sensor))(jnp.array([2.0])).tolist() == [[[5.0]]]
    model = sigmax.Model(motion=lambda x, dt: x, sensor=sensor, Q=[0.0], R=[1.0], state=["x"])
    got = sigmax.run("EKF", model, sigmax.Gaussian([2.0], [1.0]), np.array([[4.0]]))
    assert got.innovation_cov[0, 0, 0] == pytest.approx(101.0)


NOISES = {
    "random_walk": lambda q: motions.random_walk(("a", "b")).noise(q, 2 * q),
    "constant_velocity": lambda q: motions.constant_velocity().noise(q),
    "constant_velocity by axis": lambda q: motions.constant_velocity().noise([q, 2 * q]),
    "constant_acceleration": lambda q: motions.constant_acceleration().noise(q),
    "singer": lambda q: motions.singer().noise([q, 2.0]),
    "coordinated_turn": lambda q: motions.coordinated_turn().noise(q, 0.1, 2 * q, q),
    "coordinated_turn_cartesian": lambda q: motions.coordinated_turn_cartesian().noise(q, 2 * q),
    "unicycle": lambda q: motions.unicycle().noise(q, 0.1),
    "join": lambda q: motions.join(motions.unicycle(), SCALE).noise(motions.unicycle().noise(q, 0.1), SCALE.noise(q)),
    "join of functions": lambda q: motions.join(LINE, SCALE).noise(LINE.noise(q), SCALE.noise(q)),
    "quadratic": lambda q: motions.quadratic([0.0], [[1.0]], [[[0.0]]]).noise([q]),
    "inertial_errors": lambda q: inertial_errors().noise(q, q, 2 * q, q, q),
}
LINE, SCALE = motions.constant_velocity(("x",)), motions.random_walk(("s",))


@pytest.mark.parametrize("name", NOISES)
def test_noises_of_ready_made_motions_differentiate(name):
    """So that they can be fitted: against differences of their values."""

    def noise(q):
        Q = NOISES[name](q)
        return jnp.ravel(jnp.asarray(Q(0.7) if callable(Q) else Q))

    slope = jax.jit(jax.jacfwd(noise))(0.3)
    want = (np.asarray(noise(0.3 + 1e-6)) - np.asarray(noise(0.3 - 1e-6))) / 2e-6
    assert np.allclose(slope, want, rtol=1e-6, atol=1e-9)
    assert np.abs(want).max() > 0

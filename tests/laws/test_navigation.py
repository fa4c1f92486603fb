"""Laws of inertial navigation: against differential equations, a filter in matrices of its own, and turned worlds."""

import importlib.util

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

import sigmax
from sigmax import navigation
from sigmax.spaces import from_roll_pitch_yaw, roll_pitch_yaw

NOISES = (1e-3, 0.02, 1e-5, 1e-3)
FIX = navigation.satellite_position((0.5, -0.2, 1.0))


def flight(steps, seed=0):
    """Inputs (T, 6) of a vehicle that turns and speeds up."""
    rng, t = np.random.default_rng(seed), np.arange(steps)[:, None] * 0.1
    turn = 0.3 * np.sin(t / np.array([3.0, 5.0, 7.0]) + rng.uniform(size=3))
    force = np.array([0.2, 0.0, 9.8]) + np.sin(t / np.array([2.0, 4.0, 6.0]) + rng.uniform(size=3))
    return np.concatenate([turn, force], 1)


def a_state(rng):
    q = from_roll_pitch_yaw(*rng.uniform(-1, 1, 3))
    return np.concatenate([q, rng.normal(size=3) * 5, rng.normal(size=3) * 100, rng.normal(size=6) * 0.01])


def matrix(q):
    return Rotation.from_quat(np.roll(q, -1)).as_matrix()


@pytest.mark.parametrize("latitude", [None, 0.7])
def test_a_step_is_the_integral_of_its_differential_equations(latitude):
    rng = np.random.default_rng(1)
    motion = navigation.strapdown(latitude=latitude, height=300.0)
    g = 9.80665 if latitude is None else navigation.gravity(0.7, 300.0)
    earth = np.zeros(3) if latitude is None else 7.292115e-5 * np.array([0, np.cos(0.7), np.sin(0.7)])
    for _ in range(3):
        x, u, dt = a_state(rng), np.concatenate([rng.normal(size=3), 10 * rng.normal(size=3)]), 0.3

        def slope(_, y, u=u, x=x):
            R = y[:9].reshape(3, 3)
            turned = R @ _skew(u[:3] - x[10:13]) - _skew(earth) @ R
            pulled = R @ (u[3:] - x[13:]) - [0, 0, g] - 2 * np.cross(earth, y[9:12])
            return np.concatenate([turned.ravel(), pulled, y[9:12]])

        start = np.concatenate([matrix(x[:4]).ravel(), x[4:10]])
        want = solve_ivp(slope, (0, dt), start, rtol=1e-12, atol=1e-12).y[:, -1]
        got = np.asarray(motion.function(x, dt, u))
        # Coriolis' force is held over the step.
        near = 1e-9 if latitude is None else 2e-4
        assert np.allclose(matrix(got[:4]).ravel(), want[:9], atol=near)
        assert np.allclose(got[4:10], want[9:], atol=near)
        assert np.array_equal(got[10:], x[10:])


def _skew(v):
    return np.cross(v, np.eye(3)).T


def test_the_noise_is_the_integral_of_its_densities():
    """Of a body that does not turn: white noise on turn and speed, walks of the biases, by quadrature over a step."""
    given = {"gyro": [1e-3, 2e-3, 3e-3], "accelerometer": [0.1, 0.2, 0.3], "gyro_bias": 4e-4,
             "accelerometer_bias": [5e-3, 6e-3, 7e-3], "position": 0.05}  # fmt: skip
    dt, densities = 0.7, np.zeros((15, 15))
    for k, name in ((0, "gyro"), (3, "accelerometer"), (6, "position"), (9, "gyro_bias"), (12, "accelerometer_bias")):
        densities[k : k + 3, k : k + 3] = np.diag(np.broadcast_to(np.square(given[name]), 3))
    nodes, weights = np.polynomial.legendre.leggauss(5)
    want = np.zeros((15, 15))
    for s, w in zip(dt * (nodes + 1) / 2, weights * dt / 2, strict=True):
        carried = np.eye(15)
        carried[6:9, 3:6] = s * np.eye(3)
        want += w * carried @ densities @ carried.T
    assert np.allclose(navigation.strapdown().noise(**given)(dt), want, atol=1e-15)


def test_a_start_is_uncertain_in_the_axes_of_the_world():
    turned, stds = (0.3, -0.4, 2.0), {"attitude_std": [0.01, 0.02, 0.3], "velocity_std": [1.0, 2.0, 3.0],
                                      "position_std": [4.0, 5.0, 6.0]}  # fmt: skip
    prior = navigation.prior(turned, (1, 2, 3), (4, 5, 6), **stds, gyro_bias_std=0.1, accelerometer_bias_std=0.2)
    R = Rotation.from_euler("ZYX", turned[::-1]).as_matrix()
    assert np.allclose(matrix(prior.mean[:4]), R)
    for k, name in enumerate(stds):
        block = np.asarray(prior.cov)[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        assert np.allclose(R @ block @ R.T, np.diag(np.square(stds[name])), atol=1e-12)


@pytest.mark.parametrize("north", [0, 1])
def test_a_vehicle_at_rest_on_the_turning_earth_stays(north):
    latitude, q = 0.8, from_roll_pitch_yaw(0.1, -0.2, 2.0)
    motion = navigation.strapdown(latitude=latitude, north=north)
    level = [np.cos(latitude), 0] if north == 0 else [0, np.cos(latitude)]
    earth = 7.292115e-5 * np.array([*level, np.sin(latitude)])
    back = matrix(q).T
    u = np.concatenate([back @ earth, back @ [0, 0, navigation.gravity(latitude)]])
    x = np.concatenate([q, np.zeros(12)])
    for _ in range(100):
        x = np.asarray(motion.function(x, 0.1, u))
    assert np.allclose(x[4:10], 0, atol=1e-6)
    assert np.allclose(np.abs(x[:4] @ q), 1, atol=1e-9)


def test_gravity_is_that_of_the_ellipsoid():
    assert navigation.gravity(0.0) == pytest.approx(9.7803253359, abs=1e-9)
    assert navigation.gravity(np.pi / 2) == pytest.approx(9.8321849378, abs=1e-9)
    assert navigation.gravity(np.pi / 4) == pytest.approx(9.80620, abs=5e-6)
    # A kilometre up it is 3.08 mm/s² less.
    assert navigation.gravity(np.pi / 4) - navigation.gravity(np.pi / 4, 1000.0) == pytest.approx(3.0854e-3, abs=2e-6)


class Matrices:
    """SE₂(3) as matrices of five rows, biases behind: a filter with derivatives by differences."""

    def __init__(self, q, v, p, b):
        self.X = np.eye(5)
        self.X[:3] = np.column_stack([matrix(q), v, p])
        self.b = b

    @staticmethod
    def algebra(d):
        A = np.zeros((5, 5))
        A[:3] = np.column_stack([_skew(d[:3]), d[3:6], d[6:9]])
        return A

    def plus(self, d):
        made = object.__new__(Matrices)
        made.X, made.b = self.X @ expm(self.algebra(d)), self.b + d[9:]
        return made

    def minus(self, other):
        A = np.real(logm(np.linalg.inv(other.X) @ self.X))
        return np.concatenate([[A[2, 1], A[0, 2], A[1, 0]], A[:3, 3], A[:3, 4], self.b - other.b])

    def moved(self, dt, u):
        """By the differential equations, integrated."""

        def slope(_, y):
            R = y[:9].reshape(3, 3)
            pulled = R @ (u[3:] - self.b[3:]) - [0, 0, 9.80665]
            return np.concatenate([(R @ _skew(u[:3] - self.b[:3])).ravel(), pulled, y[9:12]])

        start = np.concatenate([self.X[:3, :3].ravel(), self.X[:3, 3], self.X[:3, 4]])
        y = solve_ivp(slope, (0, dt), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
        made = self.plus(np.zeros(15))
        made.X[:3] = np.column_stack([y[:9].reshape(3, 3), y[9:12], y[12:]])
        return made

    def seen(self):
        return self.X[:3, 4] + self.X[:3, :3] @ [0.5, -0.2, 1.0]


def derivative(function, size=15, h=1e-5):
    columns = [(function(h * e) - function(-h * e)) / (2 * h) for e in np.eye(size)]
    return np.stack(columns, axis=1)


def test_it_is_the_error_state_filter_of_the_matrices():
    motion, u, dt = navigation.strapdown(), flight(6), 0.1
    model = sigmax.Model(motion=motion, Q=motion.noise(*NOISES), sensor=FIX, R=[0.04, 0.04, 0.09])
    prior = navigation.prior(
        (0.1, -0.1, 0.8), (1.0, 2.0, 0.0), (5.0, 6.0, 7.0), attitude_std=[0.05, 0.05, 0.3], velocity_std=0.5,
        position_std=2.0, gyro_bias_std=0.01, accelerometer_bias_std=0.1,
    )  # fmt: skip
    rng = np.random.default_rng(2)
    z = np.cumsum(rng.normal(size=(6, 3)) * 0.3, 0) + np.array([5.0, 6.0, 7.0])
    z[::3] = np.nan
    got = sigmax.run(sigmax.get("EKF", update="once"), model, prior, z, dt=dt, inputs=u)
    x, P = Matrices(prior.mean[:4], prior.mean[4:7], prior.mean[7:10], prior.mean[10:]), np.array(prior.cov)
    Q, R = np.asarray(motion.noise(*NOISES)(dt)), np.diag([0.04, 0.04, 0.09])
    for k in range(6):
        ahead = x.moved(dt, u[k])
        F = derivative(lambda d, x=x, k=k, ahead=ahead: x.plus(d).moved(dt, u[k]).minus(ahead))
        x, P = ahead, F @ P @ F.T + Q
        if np.isfinite(z[k, 0]):
            H = derivative(lambda d, x=x: x.plus(d).seen())
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            d = K @ (z[k] - x.seen())
            before, x = x, x.plus(d)
            # Seen from the corrected mean.
            J = derivative(lambda e, before=before, d=d, x=x: before.plus(d + e).minus(x))
            P = J @ (P - K @ H @ P) @ J.T
        deviation = np.sqrt(np.diag(P))
        q = got.mean[k, :4]
        mine = Matrices(q, got.mean[k, 4:7], got.mean[k, 7:10], got.mean[k, 10:])
        assert np.abs(mine.minus(x) / deviation).max() < 1e-7
        assert np.abs((got.cov[k] - P) / np.outer(deviation, deviation)).max() < 1e-7


@pytest.mark.parametrize("name", ["EKF", pytest.param("SREUKFB", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_world_turned_about_its_vertical_gives_the_same_turned(name):
    u, turn = flight(40), 2.1
    motion = navigation.strapdown()
    model = sigmax.Model(motion=motion, Q=motion.noise(*NOISES), sensor=FIX, R=[0.04, 0.04, 0.09])
    R = matrix(from_roll_pitch_yaw(0, 0, turn))
    z = np.cumsum(np.random.default_rng(3).normal(size=(40, 3)), 0)
    given = {"attitude_std": 0.1, "velocity_std": 1.0, "position_std": 3.0, "gyro_bias_std": 0.01,
             "accelerometer_bias_std": 0.1}  # fmt: skip
    here = sigmax.run(name, model, navigation.prior((0, 0.1, 0.5), (3, 1, 0), (0, 0, 0), **given), z, dt=0.1, inputs=u)
    there = sigmax.run(
        name, model, navigation.prior((0, 0.1, 0.5 + turn), R @ [3, 1, 0], (0, 0, 0), **given), z @ R.T, dt=0.1,
        inputs=u,
    )  # fmt: skip
    assert np.allclose(there.mean[:, 7:10], here.mean[:, 7:10] @ R.T, atol=1e-7)
    assert np.allclose(there.mean[:, 10:], here.mean[:, 10:], atol=1e-9)
    assert np.allclose(there.cov, here.cov, atol=1e-9)
    assert np.allclose(there.nis, here.nis)
    yaw = roll_pitch_yaw(there.mean[:, :4])[:, 2] - roll_pitch_yaw(here.mean[:, :4])[:, 2]
    assert np.allclose(np.cos(yaw - turn), 1)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "xla"])
def test_it_runs_alike_however_it_is_run(backend):
    u, motion = flight(20), navigation.strapdown()
    model = sigmax.Model(motion=motion, Q=motion.noise(*NOISES), sensor=FIX, R=[0.04, 0.04, 0.09])
    prior = navigation.prior((0, 0, 0.5), (3, 1, 0), (0, 0, 0), attitude_std=0.1, velocity_std=1.0, position_std=3.0,
                             gyro_bias_std=0.01, accelerometer_bias_std=0.1)  # fmt: skip
    z = np.cumsum(np.random.default_rng(3).normal(size=(20, 3)), 0)
    native, *others = (
        sigmax.run(name, model, prior, z, dt=0.1, inputs=u, backend=engine)
        for name, engine in (("EKF", "native"), ("EKF", backend), ("EIF", "native"))
    )
    for other in others:
        assert np.allclose(other.mean, native.mean, atol=1e-8)
        assert np.allclose(other.cov, native.cov, atol=1e-8)
    live = sigmax.Live("EKF", model, prior)
    for k in range(20):
        live.step(z[k], 0.1, u=u[k])
    assert np.allclose(live.mean, native.mean[-1], atol=1e-9)
    single = sigmax.run("SREKFB", model, prior, z, dt=0.1, inputs=u, dtype="float32")
    assert np.abs(single.mean[-1, 7:10] - native.mean[-1, 7:10]).max() < 1e-3


def test_sensors_see_what_they_say():
    rng = np.random.default_rng(5)
    x, u = a_state(rng), rng.normal(size=6)
    R, arm = matrix(x[:4]), np.array([1.0, 2.0, 3.0])
    field, star, place = np.array([20.0, 3.0, -40.0]), np.array([0.0, 3.0, 4.0]), np.array([50.0, 60.0, 20.0])
    turning = x[4:7] + R @ np.cross(u[:3] - x[10:13], arm)
    away = place - x[7:10]
    cases = [
        (navigation.satellite_position(arm).function(x), x[7:10] + R @ arm),
        (navigation.satellite_velocity(arm).function(x, u), turning),
        (navigation.satellite_velocity().function(x), x[4:7]),
        (navigation.body_velocity((0, 2)).function(x), (R.T @ x[4:7])[[0, 2]]),
        (navigation.magnetometer(field).function(x), R.T @ field),
        (navigation.specific_force(9.8).function(x), R.T @ [0, 0, 9.8] + x[13:]),
        (navigation.height().function(x), x[9:10]),
        (navigation.line_of_sight(star=star).function(x), R.T @ star / 5),
        (navigation.line_of_sight(landmark=place).function(x), R.T @ away / np.linalg.norm(away)),
    ]
    for got, want in cases:
        assert np.allclose(got, want, atol=1e-12)
    for _ in range(20):
        turned = rng.uniform([-3, -1.5, -3], [3, 1.5, 3])
        assert np.allclose(roll_pitch_yaw(from_roll_pitch_yaw(*turned)), turned)


def test_what_does_not_fit_is_a_message():
    for call, said in (
        (lambda: navigation.strapdown(north=2), "north is the horizontal axis 0 or 1"),
        (lambda: navigation.line_of_sight(), "give one of them"),
        (lambda: navigation.magnetometer((1.0, 2.0)), "field has three components"),
        (lambda: navigation.strapdown(latitude=50.0), "a latitude is in radians"),
        (lambda: navigation.strapdown().noise(-1e-3, 0.1), "at least 0"),
        (lambda: navigation.strapdown().noise([1e-3, 1e-3], 0.1), "or 3"),
        (lambda: navigation.body_velocity(()), "axes of the body are some of 0, 1 and 2"),
        (lambda: navigation.body_velocity((5,)), "axes of the body are some of 0, 1 and 2"),
        (lambda: navigation.line_of_sight(star=(0, 0, 0)), "no zero"),
        (
            lambda: navigation.prior(
                (0, 0, 0),
                (1, 2),
                (0, 0, 0),
                attitude_std=1,
                velocity_std=1,
                position_std=1,
                gyro_bias_std=1,
                accelerometer_bias_std=1,
            ),
            "velocity has three components",
        ),
    ):
        with pytest.raises(sigmax.InputError, match=said):
            call()


@pytest.mark.slow
def test_a_heading_that_is_not_known_is_found_and_honestly_so():
    """Ninety seconds of driving with a position each three seconds, headings drawn with a deviation of 60°."""
    T, dt = 900, 0.1
    t = np.arange(T) * dt
    u = np.column_stack([0 * t, 0 * t, 0.2 * np.sin(t / 5), np.sin(t / 4), 0 * t, 0 * t + 9.80665])
    motion = navigation.strapdown()
    model = sigmax.Model(
        motion=motion, Q=motion.noise(1e-3, 0.02), sensor=navigation.satellite_position(), R=[0.25, 0.25, 0.25]
    )
    given = {"attitude_std": [*np.radians([1, 1, 60])], "velocity_std": 0.5, "position_std": 1.0,
             "gyro_bias_std": 1e-3, "accelerometer_bias_std": 0.02}  # fmt: skip
    prior = navigation.prior((0, 0, 0), (5, 0, 0), (0, 0, 0), **given)
    found = sigmax.compare(
        sigmax.studies.Study(
            name="alignment", model=model, prior=prior, steps=T, dt=dt, inputs=u,
            measured={"": np.repeat((np.arange(T) % 30 == 29)[:, None], 3, 1)}, filters={"EKF": sigmax.get("EKF")},
        ),
        runs=200,
    ).measures["EKF"]  # fmt: skip
    assert np.degrees(found.rmse.value[-1, 2]) < 3


@pytest.mark.skipif(importlib.util.find_spec("gtsam") is None, reason="the package gtsam has the data")
@pytest.mark.slow
def test_a_recorded_drive_bridges_ten_seconds_without_positions():
    from sigmax import records

    record = records.load("kitti-imu")
    filter = sigmax.get("EKF", update={"satellites": "student"})
    starts = np.arange(20.0, 450.0, 50.0)
    time, z = record.time[0], {s: np.repeat(v, len(starts), 0) for s, v in record.z.items()}
    hidden = (time > starts[:, None]) & (time <= starts[:, None] + 10)
    z["satellites"] = np.where(hidden[..., None], np.nan, z["satellites"])
    got = sigmax.run(
        filter, record.model, record.prior, z, dt=record.dt[0], inputs=record.inputs[0], keep=("mean", "fault")
    )
    assert not got.fault.any()
    fixes = record.z["satellites"][0]
    last = [np.flatnonzero(h & np.isfinite(fixes[:, 0]))[-1] for h in hidden]
    off = [np.linalg.norm(got.mean[b, k, 7:9] - fixes[k, :2]) for b, k in enumerate(last)]
    assert np.sqrt(np.square(off).mean()) < 9

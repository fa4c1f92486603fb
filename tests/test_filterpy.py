"""A script of FilterPy gives the same numbers on ours where its filter is right, and right ones where it is not."""

import numpy as np
import pytest

import sigmax
from sigmax import filterpy as ours
from sigmax.filterpy import compiled, steps
from sigmax.filterpy.compiled_calls import CompiledCall
from sigmax.native.calls import extension

N, M = 3, 2
F = np.array([[1.0, 0.1, 0.0], [0.0, 0.95, 0.1], [0.02, 0.0, 1.0]])
H = np.array([[1.0, 0.2, 0.0], [0.0, 0.3, 1.0]])
Q = np.array([[0.03, 0.01, 0.0], [0.01, 0.05, 0.01], [0.0, 0.01, 0.02]])
R = np.array([[0.2, 0.05], [0.05, 0.3]])
P0 = np.array([[1.0, 0.2, 0.1], [0.2, 0.8, 0.0], [0.1, 0.0, 0.5]])
Z = np.random.default_rng(0).normal(size=(8, M))


def bent(x, dt):
    return np.array([x[0] + dt * x[1], 0.95 * x[1] - 0.1 * np.sin(x[2]), x[2] + dt * np.cos(x[0])])


def seen(x):
    return np.array([np.hypot(x[0] - 4, x[2]), np.sin(x[1]) + x[2]])


def prepared(k):
    k.x = np.array([0.1, -0.2, 0.3]).reshape(np.shape(k.x))
    k.P, k.Q, k.R = P0.copy(), Q.copy(), R.copy()
    return k


def points(lib, which):
    if which == "Julier":
        return lib.JulierSigmaPoints(N, kappa=-1.0)
    return lib.MerweScaledSigmaPoints(N, alpha=0.6, beta=0.0 if which == "negative" else 2.0, kappa=-0.5)


@pytest.fixture(scope="module")
def theirs():
    return pytest.importorskip("filterpy.kalman", reason="FilterPy is not installed")


def close(a, b, allowed=1e-11):
    assert np.shape(a) == np.shape(b)
    assert np.abs(np.asarray(a) - np.asarray(b)).max() < allowed


def same(a, b, names):
    for name in names.split():
        close(getattr(a, name), getattr(b, name))


def linear():
    k = prepared(ours.KalmanFilter(N, M))
    k.F, k.H, k.alpha = F, H, 1.01
    return k


def unscented():
    return prepared(ours.UnscentedKalmanFilter(N, M, 0.1, seen, bent, points(ours, "negative")))


@pytest.mark.parametrize("make", [linear, unscented])
def test_a_compiled_step_is_the_step_of_numpy(make, monkeypatch):
    """With negative weights, components missing, a noise that leaves a component out; the same refusals."""
    names = "x P K S P_prior log_likelihood"

    def stepped():
        k, found = make(), []
        k.Q = np.diag([0.1, 0.0, 0.2])
        for z in [*Z, np.array([np.nan, 0.3]), None]:
            k.predict()
            k.update(z)
            found.append([np.array(getattr(k, name)) for name in names.split()])
        k.R, k.P = np.zeros((M, M)), np.zeros((N, N))
        with pytest.raises(np.linalg.LinAlgError, match="innovation is not positive definite"):
            k.update(Z[0])
        return found

    whole_steps = stepped()
    monkeypatch.setattr(CompiledCall, "__call__", lambda *given: NotImplemented)
    kept = compiled.predicting, compiled.correcting
    calls = []
    monkeypatch.setattr(steps, "predicting", lambda *shapes: calls.append(shapes) or kept[0](*shapes))
    small_parts = stepped()
    assert calls
    assert extension() is None or None not in [*map(kept[0], *zip(*calls, strict=True))]
    monkeypatch.setattr(steps, "predicting", lambda *shapes: None)
    monkeypatch.setattr(steps, "correcting", lambda *shapes: None)
    for fast, slow in zip((*whole_steps, *small_parts), (*stepped(), *stepped()), strict=True):
        for a, b in zip(fast, slow, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def test_a_large_filter_does_not_wait_for_a_compiler():
    assert compiled.predicting((30, 30), (30, 0), (30, 0), (30, 30)) is None
    k = ours.KalmanFilter(30, 1)
    k.H = np.ones((1, 30))
    k.predict()
    k.update(3.0)
    assert k.P.shape == (30, 30)


@pytest.mark.parametrize("which", ["Merwe", "negative", "Julier"])
def test_the_unscented_filter_is_filterpys(theirs, which):
    """Batch, smoothed, and every attribute of the last step; with negative weights too."""
    one, other = (
        prepared(lib.UnscentedKalmanFilter(N, M, 0.1, seen, bent, points(lib, which))) for lib in (ours, theirs)
    )
    filtered, expected = one.batch_filter(Z), other.batch_filter(Z)
    for a, b in zip(filtered, expected, strict=True):
        close(a, b)
    same(one, other, "x P x_prior P_prior x_post P_post y S SI K log_likelihood likelihood mahalanobis sigmas_f Wm Wc")
    same(one, other, "sigmas_h")
    for a, b in zip(one.rts_smoother(*filtered), other.rts_smoother(*expected), strict=True):
        close(a, b)


def test_the_linear_filter_is_filterpys(theirs):
    one, other = (prepared(lib.KalmanFilter(N, M, dim_u=1)) for lib in (ours, theirs))
    for k in (one, other):
        k.F, k.H, k.B, k.alpha = F, H, np.array([[0.1], [0.0], [0.2]]), 1.05
    rows = [None if k == 3 else z.reshape(-1, 1) for k, z in enumerate(Z)]
    us = [np.array([[float(k)]]) for k in range(len(rows))]
    filtered, expected = (k.batch_filter(rows, us=us) for k in (one, other))
    for a, b in zip(filtered, expected, strict=True):
        close(a, b)
    same(one, other, "x P x_prior P_prior y S SI K log_likelihood mahalanobis")
    for a, b in zip(one.rts_smoother(*filtered[:2]), other.rts_smoother(*expected[:2]), strict=True):
        close(a, b)
    close(one.residual_of(Z[0].reshape(-1, 1)), other.residual_of(Z[0].reshape(-1, 1)))


def test_the_extended_filter_is_filterpys(theirs):
    def jacobian(x):
        return H + 0.1 * np.cos(x[0, 0])

    def sensor(x):
        return H @ x + 0.1 * np.sin(x[0, 0])

    one, other = (prepared(lib.ExtendedKalmanFilter(N, M)) for lib in (ours, theirs))
    for k in (one, other):
        k.F = F
        for z in Z:
            k.predict()
            k.update(z.reshape(-1, 1), jacobian, sensor)
    same(one, other, "x P x_prior P_prior y S K log_likelihood mahalanobis")


def test_interacting_models_are_filterpys(theirs):
    def estimator(lib):
        filters = [prepared(lib.KalmanFilter(N, M)) for _ in range(2)]
        for k, size in zip(filters, (1.0, 30.0), strict=True):
            k.F, k.H, k.Q = F, H, Q * size
        return lib.IMMEstimator(filters, [0.6, 0.4], np.array([[0.95, 0.05], [0.1, 0.9]]))

    one, other = estimator(ours), estimator(theirs)
    for z in Z:
        for imm in (one, other):
            imm.predict()
            imm.update(z)
    same(one, other, "x P x_prior P_prior mu cbar omega likelihood")


def test_a_bank_of_filters_finds_the_right_one():
    """FilterPy's own bank sums covariances about the wrong means; here against the sum of Gaussians by hand."""
    filters = [prepared(ours.KalmanFilter(N, M)) for _ in range(2)]
    for k, size in zip(filters, (1.0, 400.0), strict=True):
        k.F, k.H, k.Q = F, H, Q * size
    bank = ours.MMAEFilterBank(filters, (0.5, 0.5), dim_x=N)
    odds = 1.0
    for z in [*Z, None]:
        bank.predict()
        bank.update(z)
        odds *= 1.0 if z is None else filters[0].likelihood / filters[1].likelihood
    close(bank.p, [odds / (1 + odds), 1 / (1 + odds)])
    x = sum(p * k.x for p, k in zip(bank.p, filters, strict=True))
    close(bank.x, x)
    close(bank.P, sum(p * (k.P + (k.x - x) @ (k.x - x).T) for p, k in zip(bank.p, filters, strict=True)))


def test_the_other_methods_of_the_linear_filter_are_filterpys(theirs):
    one, other = (prepared(lib.KalmanFilter(N, M)) for lib in (ours, theirs))
    for k in (one, other):
        k.F, k.H, k.M = F, H, np.array([[0.02, 0.0], [0.0, 0.03], [0.01, 0.0]])
    for z in Z[:4].reshape(-1, M, 1):
        for a, b in zip(one.get_prediction(), other.get_prediction(), strict=True):
            close(a, b)
        one.predict()
        other.predict()
        for a, b in zip(one.get_update(z), other.get_update(z), strict=True):
            close(a, b)
        one.update_correlated(z)
        other.update_correlated(z)
        same(one, other, "x P y S K log_likelihood")
        close(one.log_likelihood_of(z), other.log_likelihood_of(z.ravel() if z.ndim == 1 else z))
        for k in (one, other):
            k.predict()
            k.update(z)
            k.predict_steadystate()
            k.update_steadystate(z)
        same(one, other, "x P y S K x_prior P_prior log_likelihood mahalanobis")
        for k in (one, other):
            k.R = np.diag([0.2, 0.3])
            k.z = np.zeros((M, 1))
            k.update_sequential(1, z[1])
            k.update_sequential(0, z[:1])
            k.R = R.copy()
        same(one, other, "x P y K z x_post P_post")


def test_shapes_are_checked_on_demand():
    k = prepared(ours.KalmanFilter(N, M))
    k.test_matrix_dimensions(z=Z[0])
    with pytest.raises(sigmax.InputError, match=r"z must have the shape \(2,\); it has \(3,\)"):
        k.test_matrix_dimensions(z=[1, 2, 3])
    k.F = np.eye(2)
    with pytest.raises(sigmax.InputError, match=r"F must have the shape \(3, 3\)"):
        k.test_matrix_dimensions()


def test_what_is_not_there_says_what_to_take():
    with pytest.raises(ImportError, match="use KalmanFilter, which carries the factor"):
        from sigmax.filterpy import SquareRootKalmanFilter  # noqa: F401
    with pytest.raises(AttributeError, match="no attribute 'Kalman'"):
        _ = ours.Kalman


def test_a_state_known_exactly_stays_known_with_weights_of_both_signs():
    """A component without variance, under a centre of negative weight."""
    motion = lambda x, dt: np.concatenate([(F @ x)[:2], x[2:]])  # noqa: E731
    k = prepared(ours.UnscentedKalmanFilter(N, M, 0.1, lambda x: H @ x, motion, points(ours, "Julier")))
    k.P, k.Q = np.diag([1.0, 0.5, 0.0]), np.diag([0.1, 0.1, 0.0])
    for z in Z[:3]:
        k.predict()
        k.update(z)
    assert k.x[2] == 0.3
    assert not k.P[2].any()


def exact(rows):
    """The Kalman filter by its equations, on the linear model."""
    x, P = np.array([0.1, -0.2, 0.3]), P0
    for z in rows:
        x, P = F @ x, F @ P @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x, P = x + K @ (z - H @ x), P - K @ H @ P
    return x, P


def test_the_cubature_filter_is_the_kalman_filter_and_filterpys_is_not(theirs):
    one, other = (
        prepared(lib.CubatureKalmanFilter(N, M, 0.1, lambda x: H @ x, lambda x, dt: F @ x)) for lib in (ours, theirs)
    )
    for k in (one, other):
        for z in Z:
            k.predict()
            k.update(z if k is one else z.reshape(-1, 1))
    x, P = exact(Z)
    close(one.x, x)
    close(one.P, P)
    assert np.abs(other.P - P).max() > 0.01


def turned(angle):
    """A bearing from the origin and a course, the scene turned: the course wraps in every hook."""

    def motion(x, dt):
        return np.array([x[0] + dt * np.cos(x[2]), x[1] + dt * np.sin(x[2]), x[2]])

    def residual(at):
        def difference(a, b):
            d = a - b
            d[at] = (d[at] + np.pi) % (2 * np.pi) - np.pi
            return d

        return difference

    def mean(at):
        def average(sigmas, weights):
            x = weights @ sigmas
            x[at] = np.arctan2(weights @ np.sin(sigmas[:, at]), weights @ np.cos(sigmas[:, at]))
            return x

        return average

    def add(a, b):
        c = a + b
        c[2] = (c[2] + np.pi) % (2 * np.pi) - np.pi
        return c

    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    hooks = {
        "x_mean_fn": mean(2), "z_mean_fn": mean(1), "residual_x": residual(2), "residual_z": residual(1),
        "state_add": add,
    }  # fmt: skip
    sensor = lambda x: np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])])  # noqa: E731
    k = ours.CubatureKalmanFilter(3, 2, 1.0, sensor, motion, **hooks)
    k.x = add(turn @ [8.0, 1.0, 0.3], [0, 0, angle])
    k.P, k.Q, k.R = turn @ np.diag([1.0, 1.0, 0.1]) @ turn.T, np.diag([0.01, 0.01, 0.01]), np.diag([0.1, 0.01])
    for z in ([9.1, 0.1], [10.2, 0.12], [11.0, 0.15]):
        k.predict()
        k.update(add(np.r_[z, 0][[0, 2, 1]], [0, 0, angle])[[0, 2]])
    return k, turn


def test_all_hooks_are_honoured():
    """With the scene turned by half a turn course and bearing lie at ±π; the answer turns with it."""
    plain, _ = turned(0.0)
    half, turn = turned(np.pi)
    close(turn[:2, :2] @ plain.x[:2], half.x[:2], 1e-9)
    assert abs(np.exp(1j * (half.x[2] - plain.x[2] - np.pi)) - 1) < 1e-9
    close(turn @ plain.P @ turn.T, half.P, 1e-9)


def test_points_are_drawn_anew_before_every_measurement():
    """Two sensors at one moment, on a linear model: the second measurement sees what the first has left."""
    k = prepared(ours.UnscentedKalmanFilter(N, 1, 0.1, None, lambda x, dt: F @ x, points(ours, "Julier")))
    k.predict()
    k.update(Z[0, 0], R=R[0, 0], hx=lambda x: H[:1] @ x)
    k.update(Z[0, 1], R=R[1, 1], hx=lambda x: H[1:] @ x)
    once = prepared(ours.KalmanFilter(N, M))
    once.F, once.H, once.R = F, H, np.diag(np.diag(R))
    once.predict()
    once.update(Z[0])
    close(k.x, once.x[:, 0])
    close(k.P, once.P)


def test_a_missing_component_is_left_out():
    whole, part = (prepared(ours.KalmanFilter(N, M)) for _ in range(2))
    whole.F = part.F = F
    whole.H = part.H = H
    whole.predict()
    part.predict()
    whole.update(Z[0, 1], R=R[1, 1], H=H[1:])
    part.update([np.nan, Z[0, 1]])
    same(whole, part, "x P log_likelihood mahalanobis")
    part.update([np.nan, np.nan])
    same(whole, part, "x P")
    assert part.z is None


def test_functions_are_called_with_all_points_at_once_where_they_allow_it(monkeypatch):
    """The same numbers, for a function that cannot take many points and one that would answer wrongly."""
    monkeypatch.setattr(CompiledCall, "__call__", lambda *given: NotImplemented)
    shapes = []

    def together(x, dt):
        shapes.append(np.shape(x))
        return F @ x

    def alone(x, dt):
        return F @ x if x[0] < 1e9 else x

    def misled(x, dt):
        return F @ x + (np.zeros(N) if np.ndim(x) == 1 else 1.0)

    made = [prepared(ours.CubatureKalmanFilter(N, M, 0.1, lambda x: H @ x, f)) for f in (together, alone, misled)]
    for k in made:
        for z in Z[:2]:
            k.predict()
            k.update(z)
    for k in made[1:]:
        same(made[0], k, "x P")
    assert shapes == [*[(N,)] * (2 * N), (N, 2 * N), (N,), (N, 2 * N)]


def test_a_covariance_set_by_hand_is_used():
    k = prepared(ours.CubatureKalmanFilter(N, M, 0.1, lambda x: H @ x, lambda x, dt: F @ x))
    k.predict()
    k.P[0, 0] += 3.0
    want = F @ k.P @ F.T + Q
    k.predict()
    close(k.P, want)


def test_what_would_have_no_effect_is_refused():
    k = prepared(ours.UnscentedKalmanFilter(N, M, 0.1, seen, bent, points(ours, "Merwe")))
    with pytest.raises(sigmax.InputError, match="UT would have no effect"):
        k.predict(UT=lambda *a: a)
    with pytest.raises(sigmax.InputError, match="no matrix is inverted"):
        k.inv = np.linalg.pinv
    with pytest.raises(sigmax.InputError, match="z has 3 components, hx gives 2"):
        k.update([1.0, 2.0, 3.0])
    k.P = np.diag([1.0, -1.0, 1.0])
    with pytest.raises(np.linalg.LinAlgError, match="not positive semidefinite"):
        k.predict()


def straight(hx, make=ours.MerweScaledSigmaPoints):
    k = ours.UnscentedKalmanFilter(N, M, 0.5, hx, bent, make(N, 0.6, 2.0, 0.0))
    return prepared(k)


def test_a_function_that_mixes_the_points_is_called_for_each():
    # The first point but one has the largest component of all: alone it gives the same.
    calls = [lambda x: np.array([x[0] - x.max(), x[2]]), lambda x: np.array([x[0] - max(x[0], x[1], x[2]), x[2]])]
    filters = [straight(hx) for hx in calls]
    for z in Z:
        for k in filters:
            k.predict()
            k.update(z)
        np.testing.assert_allclose(filters[0].x, filters[1].x, rtol=1e-12)


def test_points_drawn_by_a_class_of_the_user_are_those_it_draws():
    class Wider(ours.MerweScaledSigmaPoints):
        def sigma_points(self, x, P):
            drawn.append(len(x))
            return x + 1.1 * (super().sigma_points(x, P) - x)

    drawn = []
    wide, plain = straight(seen, Wider), straight(seen)
    for k in (wide, plain):
        k.predict()
        k.update(Z[0])
    assert drawn
    assert np.abs(wide.P - plain.P).max() > 1e-3


@pytest.mark.parametrize("whole", [True, False])
def test_functions_given_with_a_call_are_not_kept_for_ever_and_need_no_hash(whole, monkeypatch):
    if not whole:
        monkeypatch.setattr(CompiledCall, "__call__", lambda *given: NotImplemented)

    class Sensor:
        __hash__ = None

        def see(self, x):
            return seen(x)

        __call__ = see

    sensor, k, other = Sensor(), straight(seen), straight(Sensor())
    for z in Z:
        for one in (k, other):
            one.predict()
        k.update(z, hx=lambda x: seen(x))
        k.update(z, hx=sensor.see)
        other.update(z)
        other.update(z)
    np.testing.assert_allclose(k.x, other.x, rtol=1e-12)
    assert max(len(k._calls), len(k._recent.found)) <= 8
    assert len(other._recent.found) == 2 if whole else len(other._calls) == 2


@pytest.mark.parametrize("hx", [lambda x: x[:2] * np.nan, lambda x: np.sqrt(x[:2] - 100.0)])
def test_an_expected_measurement_that_is_no_number_is_not_taken_for_a_missing_one(hx):
    k = straight(hx)
    k.predict()
    with np.errstate(invalid="ignore"), pytest.raises(sigmax.InputError, match="z is a number and what was expected"):
        k.update(Z[0])
    linear = ours.KalmanFilter(2, 1)
    linear.H, linear.B = np.array([[1.0, 0.0]]), np.eye(2)
    linear.predict(u=np.array([np.nan, 0.0]))
    with pytest.raises(sigmax.InputError, match="look at x"):
        linear.update(1.0)


def test_what_fx_gives_must_be_a_state_and_finite():
    k = straight(seen)
    k.fx = lambda x, dt: x[:2]
    with pytest.raises(sigmax.InputError, match="x has 3 components, fx gives 2"):
        k.predict()
    k.fx = lambda x, dt: x * np.inf
    with np.errstate(invalid="ignore"), pytest.raises(np.linalg.LinAlgError, match="not finite"):
        k.predict()


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("x", np.zeros(3), "x has 3 components, F the shape"),
        ("F", np.eye(3), r"F the shape \(3, 3\)"),
        ("H", np.eye(1, 3), "x has 2 components, H 3 columns"),
    ],
)
def test_a_wrong_shape_is_told_where_it_is_used(name, value, said):
    k = ours.KalmanFilter(2, 1)
    setattr(k, name, value)
    with pytest.raises(sigmax.InputError, match=said):
        k.batch_filter([1.0])


@pytest.mark.parametrize("name", ["P", "Q", "R"])
@pytest.mark.parametrize("rounding", [0.0, 1e-9])
def test_a_covariance_that_is_not_symmetric_is_refused_unless_by_rounding(name, rounding):
    k = prepared(ours.KalmanFilter(N, M))
    k.F, k.H = F, H
    entry = getattr(k, name)
    entry[0, 1] += rounding or 0.1

    def step():
        k.predict()
        k.update(Z[0])

    if rounding:
        step()
    else:
        with pytest.raises(sigmax.InputError, match=f"{name} must be symmetric"):
            step()


def test_a_bank_of_filters_shows_what_it_is_at():
    made = [prepared(ours.KalmanFilter(N, M)) for _ in range(2)]
    shown = repr(ours.IMMEstimator(made, [0.25, 0.75], [[0.9, 0.1], [0.2, 0.8]]))
    assert shown.startswith("IMMEstimator\nx = ")
    assert "mu = [0.25 0.75]" in shown
    shown = repr(ours.MMAEFilterBank(made, [0.25, 0.75], N))
    assert shown.startswith("MMAEFilterBank\nx = ")
    assert "p = [0.25 0.75]" in shown

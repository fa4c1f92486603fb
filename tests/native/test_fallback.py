"""What cannot be lowered, foreseen or not, runs on XLA with one line that says why and where."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.dependence import reading
from sigmax.engine.lowered import lowered
from sigmax.engine.vectorized import vectorized
from sigmax.native import Defect, Graph, Refused, evaluate, refusal
from sigmax.native.primitives import interpret
from sigmax.preparation.prepare import cast

PRIOR = sigmax.Gaussian([0.3, 1.0], np.eye(2))
Z = np.array([[0.2, 0.9], [0.1, 0.8], [0.3, 0.7]])


def model(sensor, motion=lambda x, dt: 0.9 * x):
    return sigmax.Model(motion=motion, sensor=sensor, Q=[0.1, 0.1], R=[0.1, 0.1])


@pytest.fixture
def broken(monkeypatch):
    """The rule of the hyperbolic sine fails as nobody foresaw."""

    def fails(*about):
        raise TypeError("nobody foresaw this")

    monkeypatch.setitem(interpret.RULES, "sinh", interpret.RULES["sinh"]._replace(function=fails))
    monkeypatch.setenv("SIGMAX_DEFECTS", "")
    monkeypatch.setattr(refusal, "_said", set())


def unforeseen(x):
    return jnp.sinh(x / 3)


def says_so(caplog):
    (line,) = {record.message for record in caplog.records}
    assert "defect of sigmax in the operation 'sinh'" in line
    assert "TypeError: nobody foresaw this" in line
    assert "test_fallback.py, line" in line
    caplog.clear()


def test_a_defect_of_the_lowering_is_one_line_and_xla(broken, caplog, tmp_path):
    made = model(unforeseen)
    with caplog.at_level(logging.WARNING, logger="sigmax"):
        wanted = sigmax.run("EKF", made, PRIOR, Z, backend="xla")
        assert not caplog.records
        result = sigmax.run("EKF", made, PRIOR, Z)
        live = sigmax.Live("EKF", made, PRIOR)
        for z in Z:
            live.step(z, 1.0)
        (rows,) = vectorized(unforeseen, Z)
    says_so(caplog)
    assert np.array_equal(result.mean, wanted.mean)
    np.testing.assert_allclose(live.mean, wanted.mean[-1], rtol=1e-12)
    np.testing.assert_allclose(rows, np.sinh(Z / 3), rtol=1e-14)
    with pytest.raises(sigmax.InputError, match=r"defect of sigmax in the operation 'sinh'.*test_fallback.py, line"):
        sigmax.run("EKF", made, PRIOR, Z, backend="native")
    with pytest.raises(sigmax.InputError, match=r"cannot be exported: a defect of sigmax"):
        sigmax.export_c("EKF", made, PRIOR, tmp_path / "c", name="f")


def test_what_cannot_be_analysed_is_taken_to_read_everything(broken, caplog):
    with caplog.at_level(logging.WARNING, logger="sigmax"):
        read = reading(unforeseen, 2)
    says_so(caplog)
    assert read.nonlinear == 0b11
    assert read.sampled_rows([False, False]) == (0, 1)


def test_a_defect_is_an_error_where_it_is_asked_for(broken, monkeypatch):
    monkeypatch.setenv("SIGMAX_DEFECTS", "raise")
    with pytest.raises(TypeError, match="nobody foresaw"):
        sigmax.run("EKF", model(unforeseen), PRIOR, Z)


def test_an_error_of_the_models_own_is_told_as_it_is(monkeypatch, caplog):
    monkeypatch.setenv("SIGMAX_DEFECTS", "")
    calls = []

    def sensor(x):
        calls.append(None)
        if len(calls) > 1:
            raise ZeroDivisionError("mine")
        return x

    with pytest.raises(ZeroDivisionError, match="mine"):
        sigmax.run("EKF", model(sensor), PRIOR, Z)
    assert not caplog.records


def whiles(x):
    return jax.lax.while_loop(lambda y: y.sum() < 3, lambda y: y + 1, x)


def whiles_of_each(x):
    return jax.vmap(lambda a: jax.lax.while_loop(lambda y: y < 3, lambda y: y + 1, a))(x)


KEY = jax.random.key(0)


@pytest.mark.parametrize(
    ("sensor", "names"),
    [
        (whiles, "'while'"),
        (whiles_of_each, "'while'"),
        (lambda x: jax.scipy.special.expi(x + 1), "'while'"),
        (lambda x: x.astype(jnp.float32).astype(float), "type float32"),
        (lambda x: jnp.linalg.eigvalsh(jnp.outer(x, x)), "eigh"),
        (lambda x: jnp.sort(x)[::-1], "'sort'"),
        (lambda x: jnp.fft.fft(x).real, "complex128"),
    ],
)
def test_what_is_refused_names_operation_and_line_and_can_be_analysed(sensor, names):
    g = Graph()
    with pytest.raises(Refused, match=rf"{names}.*test_fallback.py, line") as refused:
        evaluate(g, jax.make_jaxpr(sensor)(jnp.ones(2)), [g.inputs("given", (2,))])
    assert not isinstance(refused.value, Defect)
    read = reading(sensor, 2)
    points = jnp.array([[0.3, 0.4, 0.5], [1.0, 1.1, 0.2]])
    made = jnp.stack([read.line(points[:, i]) for i in range(3)], 1)
    np.testing.assert_allclose(made, jax.vmap(sensor, 1, 1)(points), rtol=1e-15)


@pytest.mark.parametrize("sensor", [whiles, lambda x: x + jax.random.normal(KEY, (2,))])
def test_sigma_points_of_what_cannot_be_analysed_are_those_of_xla(sensor):
    results = [sigmax.run("UKF", model(sensor), PRIOR, Z, backend=b).mean for b in (None, "xla")]
    np.testing.assert_allclose(results[0], results[1], rtol=1e-12)


def test_many_states_are_lowered_and_too_many_are_refused_soon(monkeypatch):
    def program(n, part):
        one = sigmax.Model(motion=lambda x, dt: 0.99 * x, sensor=lambda x: x[:2], Q=[0.1] * n, R=[0.1] * 2)
        return lowered(sigmax.get("EKF"), cast(one, np.float64), 0, np.float64).program(*part)

    assert program(60, ("correct", "", 2)).operations < 25_000
    monkeypatch.setattr(interpret, "_LARGEST", 9_000)
    with pytest.raises(Refused, match="more than 9,000 scalar operations"):
        program(61, ("predict",))

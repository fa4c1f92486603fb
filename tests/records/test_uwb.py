"""On real ranges a bias in the model is worth what it was found to be worth."""

import numpy as np
import pytest
from benchmarks.uwb import DATA, hanyang, labyrinth, plaza, score

import sigmax


def loaded(make, where):
    try:
        return make(where)
    except (OSError, StopIteration, sigmax.InputError) as error:
        pytest.skip(f"the record is not here ({error or where}); SIGMAX_DATA names the folder that holds it")


@pytest.mark.parametrize("name", ["EKF", "TSEKF"])
def test_labyrinth(name):
    """Without a bias 0.150 m, with the known one 0.07 m, with one that is estimated within a centimetre of that."""
    run = loaded(labyrinth, DATA / "labyrinth_uwb")
    errors = {label: score(name, run, model) for label, model in run.models.items()}
    assert errors["no bias"][0] == pytest.approx(0.150, abs=0.005)
    assert errors["0.12 m, known"][0] < 0.075
    assert errors["bias"][0] < 0.08
    assert errors["bias"][1] == pytest.approx(1.0, abs=0.15) != errors["no bias"][1]
    result = errors["bias"][2]
    assert result.bias == ("range_offset",)
    assert result.bias_mean[-1, 0] == pytest.approx(0.12, abs=0.03)


def test_hanyang():
    """Each anchor its own offset, heard at its own times."""
    run = loaded(hanyang, DATA / "hanyang_uwb")
    without, with_bias = (score("EKF", run, run.models[label]) for label in ("no bias", "bias"))
    assert with_bias[0] < 0.75 * without[0]
    assert abs(with_bias[1] - 1) < abs(without[1] - 1)
    heard = sum(np.isfinite(z).sum() for z in run.z.values())
    assert with_bias[2].dof.sum() == heard == 8364


def test_the_scale_of_the_ranges_of_plaza():
    """The scale as a bias linearised about 1 is as good as the scale as a component of the state."""
    run = loaded(plaza, 1)
    record = sigmax.records.load("plaza1")
    state = sigmax.run("EKF", record.model, record.prior, record.z, dt=record.dt, inputs=record.inputs)
    error = np.sqrt(((state.mean[0, :, :2] - run.truth) ** 2).sum(1).mean())
    got = score("EKF", run, run.models["bias"])
    assert got[0] < error * 1.02
    assert 1 + got[2].bias_mean[-1, 0] == pytest.approx(state.mean[0, -1, 3], abs=2e-3)

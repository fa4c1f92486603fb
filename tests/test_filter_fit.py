"""Parameters of a filter by the likelihood of several records: all combinations tried, one record refused."""

import numpy as np
import pytest

import sigmax
from sigmax import InputError
from sigmax.running import fit_filter

MODEL = sigmax.Model(motion=lambda x, dt: 0.9 * x, sensor=lambda x: x + 0.4 * x**2, Q=[0.2], R=[0.05])
PRIOR = sigmax.Gaussian([1.0], [1.0])


def records(B, T=12, seed=0):
    rng = np.random.default_rng(seed)
    x, z = 1 + rng.standard_normal(B), []
    for _ in range(T):
        x = 0.9 * x + np.sqrt(0.2) * rng.standard_normal(B)
        z.append(x + 0.4 * x**2 + np.sqrt(0.05) * rng.standard_normal(B))
    return np.stack(z, -1)[..., None]


def test_it_takes_what_all_records_together_like_best():
    z, grid = records(5), {"alpha": [0.3, 1.0], "beta": [0.0, 2.0]}
    z[3, 8:] = np.nan  # a shorter one
    found = fit_filter("SRUKF", grid, MODEL, PRIOR, z)
    sums = {
        (a, b): sum(
            float(sigmax.run(sigmax.get("SRUKF", alpha=a, beta=b), MODEL, PRIOR, one).log_likelihood) for one in z
        )
        for a in grid["alpha"]
        for b in grid["beta"]
    }
    assert tuple(found.parameters.values()) == max(sums, key=sums.get)
    assert found.log_likelihood == pytest.approx(max(sums.values()), rel=1e-10)
    np.testing.assert_allclose(found.by_record.sum(1), list(sums.values()), rtol=1e-10)
    assert found.filter == sigmax.get("SRUKF", **found.parameters)
    assert [tuple(one.values()) for one in found.tried] == list(sums)


def test_a_combination_that_fails_is_not_taken():
    z = records(3)
    z[1, 4] = np.inf
    with pytest.raises(InputError, match="fails in a step"):
        fit_filter("GHKF", {"order": [3, 5]}, MODEL, PRIOR, z)


@pytest.mark.parametrize(
    ("name", "grid", "z", "message"),
    [
        ("SRUKF", {"alpha": [0.5, 1.0]}, records(1), "give several records"),
        ("SRUKF", {"alpha": [0.5, 1.0]}, records(2)[0], "a single record may by chance"),
        ("SRUKF", {"alpha": []}, records(2), "grid must hold values"),
        ("SRUKF", {"alhpa": [1.0]}, records(2), "did you mean 'alpha'|alpha"),
    ],
)
def test_what_cannot_be_chosen_from_is_refused(name, grid, z, message):
    with pytest.raises(InputError, match=message):
        fit_filter(name, grid, MODEL, PRIOR, z)

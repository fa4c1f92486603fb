"""A batch block by block is the batch in one call."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.running import run_in_blocks

B, T = 7, 4
rng = np.random.default_rng(2)
MODEL = sigmax.Model(
    motion=lambda x, dt, u: x + dt * jnp.sin(x) + u[0],
    sensor={"a": lambda x: x[:1], "b": lambda x: x},
    Q=[0.1, 0.2],
    R={"a": [0.5], "b": [0.5, 0.4]},
)
Z = {"a": rng.normal(size=(B, T, 1)), "b": rng.normal(size=(B, T, 2))}
PRIOR = sigmax.Gaussian([0.0, 1.0], [1.0, 1.0])
ALL = dict(dt=0.5, inputs=rng.normal(size=(T, 1)))
# What may be one for each track, or the same for all.
WAYS = {
    "measurements": {},
    "one sensor the same for all": dict(z={"a": Z["a"][0], "b": Z["b"]}),
    "only the prior": dict(
        z={s: v[0] for s, v in Z.items()}, prior=sigmax.Gaussian(rng.normal(size=(B, 2)), np.eye(2))
    ),
    "prior's covariance": dict(prior=sigmax.Gaussian([0.0, 1.0], np.eye(2) * np.arange(1, B + 1)[:, None, None])),
    "intervals": dict(dt=rng.uniform(0.1, 1, size=(B, T))),
    "times": dict(dt=None, t=rng.uniform(0.1, 1, size=(B, T)).cumsum(1), t0=np.zeros(B)),
    "inputs": dict(inputs=rng.normal(size=(B, T, 1))),
    "variances": dict(R={"a": rng.uniform(1, 2, size=(B, T, 1))}),
    "covariances": dict(R={"b": np.eye(2) * rng.uniform(1, 2, size=(B, T, 1, 1))}),
    "covariances the same for all": dict(R={"b": np.eye(2) * rng.uniform(1, 2, size=(T, 1, 1))}),
    "variances the same for all": dict(R={"b": rng.uniform(1, 2, size=(T, 2))}),
    "update first": dict(update_first=True),
    "parts": dict(keep=("mean", "nis")),
}


@pytest.mark.parametrize("way", WAYS)
def test_blocks_are_the_batch(way):
    given = dict(prior=PRIOR, z=Z) | ALL | WAYS[way]
    whole = sigmax.run("SRCKFB", MODEL, **given)
    found = list(run_in_blocks("SRCKFB", MODEL, tracks=3, **given))
    assert [tracks for tracks, _ in found] == [slice(0, 3), slice(3, 6), slice(6, 7)]
    for tracks, part in found:
        for name in given.get("keep", ("mean", "cov", "nis", "time", "log_likelihood")):
            np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[tracks])


def test_what_makes_no_sense_is_refused_before_anything_is_filtered():
    given = dict(prior=PRIOR, z=Z) | ALL
    for changed, error, words in (
        (dict(tracks=0), InputError, "1 or more"),
        (dict(tracks="many"), InputError, "1 or more"),
        (dict(z={s: v[0] for s, v in Z.items()}), InputError, "one track"),
        (dict(inputs=np.zeros((B + 1, T, 1))), InputError, "differ in size"),
        (dict(prior=[0.0, 1.0]), InputError, "Gaussian"),
        (dict(kep=("mean",)), TypeError, "kep"),
    ):
        with pytest.raises(error, match=words):
            run_in_blocks("SRCKFB", MODEL, **given | changed)


def test_files_count_tracks_on(tmp_path):
    pandas = pytest.importorskip("pandas")
    for tracks, part in run_in_blocks("SRCKFB", MODEL, PRIOR, Z, **ALL, tracks=3):
        part.to_parquet(tmp_path / f"{tracks.start}.parquet", first=tracks.start)
    table = pandas.read_parquet(tmp_path)
    assert sorted(table["track"].unique()) == list(range(B))
    assert len(table) == B * T

"""What results show of themselves: tables, pictures and lines, held against mean and cov over all spaces."""

import itertools
import re
from base64 import b64decode
from dataclasses import replace
from html import unescape

import jax
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import xarray
from pyarrow import parquet

import sigmax
from sigmax.fitting import Fit
from sigmax.modelling.components import components
from sigmax.modelling.units import units_of
from sigmax.models import part
from sigmax.preparation.layout import Layout
from sigmax.running import Result, Smoothed
from sigmax.spaces import SPACES
from sigmax.studies import Comparison
from tests.laws.test_curved import identity

T0 = np.datetime64("2024-02-28T23:59:58.123456789")
SHAPES = list(itertools.product([None, 3], ["seconds", "instants", "tracks of their own"], [np.float64, np.float32]))

# What takes seconds for each: all in the slow suite.
SOME = [pytest.param(n, marks=[pytest.mark.slow] * (n not in ("circle", "direction", "pose2"))) for n in SPACES]


def point(rng, space):
    """Some points of a space (40, size)."""
    d = np.moveaxis(rng.normal(size=(40, space.dim)), -1, 0)
    x = np.repeat(identity(space)[:, None], 40, 1)
    return np.moveaxis(np.asarray(space.add(x, d)), 0, -1)


def made(name, batch=None, times="seconds", dtype=np.float64, bias=(), bias_first=False, modes=(), seed=0):
    """A result of random numbers on a space, as a run would leave it, T = 7."""
    rng, T, space = np.random.default_rng(seed), 7, SPACES[name]
    lead = (T,) if batch is None else (batch, T)
    spelt = [sigmax.angle("s0")] if name == "circle" else ["s0"] if name == "line" else [part("s", space)]
    own = components("state", spelt, None, "Q")
    n, d, p = own.space.size, own.space.dim, len(bias)
    x = np.resize(point(rng, own.space), (*lead, n))
    b = rng.normal(size=(*lead, p))
    S = np.tril(rng.normal(size=(*lead, d + p, d + p)))
    fault = rng.choice([0, 0, 0, 4, -2, 2], size=lead).astype(np.int8)
    dt = np.broadcast_to(rng.uniform(0.1, 2, T), lead)
    dof = rng.integers(0, 3, lead)
    nis = np.where(dof > 0, rng.chisquare(2, lead), np.nan)
    stored = None
    if times != "seconds":
        dt = rng.uniform(0.1, 2, lead) if times != "instants" else dt
        stored = T0.astype(np.int64) + np.round(np.cumsum(dt, -1) * 1e9).astype(np.int64)
    units = units_of(None if own.space.flat else {own.numbers[0]: "furlong"}, {}, own, bias)
    layout = Layout(
        own.numbers, own.space, batch is not None, False, bias, bias_first, modes=modes, weights=(("", None),),
        filter="EKF", named_deviations=own.deviations, units=units, dated=stored is not None,
    )  # fmt: skip
    behind = np.log(rng.dirichlet(np.ones(max(len(modes), 1)), lead))
    return Result(
        layout, np.concatenate([b, x] if bias_first else [x, b], -1).astype(dtype), S.astype(dtype), fault,
        behind.astype(dtype) if modes else None, None, nis.astype(dtype), -nis.astype(dtype), dof,
        np.zeros(lead[:-1], dtype)[()], stored_dt=dt, stored_time=stored,
    )  # fmt: skip


def variants(name):
    for k, (batch, times, dtype) in enumerate(SHAPES):
        more = {"bias": ("b0", "b1"), "bias_first": k % 2 == 0} if k % 3 == 0 else {}
        yield made(name, batch, times, dtype, modes=("cruise", "turn") if k % 3 == 1 else (), seed=k, **more)


def flat(a, result):
    """(B · T, …) of (…, T, …)."""
    return np.asarray(a).reshape(-1, *np.shape(a)[1 + result.layout.batched :])


@pytest.mark.parametrize("name", SPACES)
def test_a_frame_says_what_mean_and_cov_say(name):
    for r in variants(name):
        f = r.to_frame()
        deviation = np.sqrt(np.einsum("...ii->...i", flat(r.cov, r).astype(float)))
        for i, n in enumerate(r.state):
            np.testing.assert_array_equal(f[n], flat(r.mean, r)[:, i])
        for i, n in enumerate(r.layout.named_deviations):
            np.testing.assert_allclose(
                f[f"{n}_std"], deviation[:, i], rtol=1e-5 if r.mean.dtype == np.float32 else 1e-12
            )
        for i, n in enumerate(r.bias):
            np.testing.assert_array_equal(f[n], flat(r.bias_mean, r)[:, i])
            np.testing.assert_allclose(f[f"{n}_std"] ** 2, flat(r.bias_cov, r)[:, i, i], rtol=1e-5)
        for k, mode in enumerate(r.modes):
            np.testing.assert_array_equal(f[f"probability_{mode}"], flat(r.probability, r)[:, k])
        for n in ("nis", "dof", "fault"):
            np.testing.assert_array_equal(f[n], flat(getattr(r, n), r))
        np.testing.assert_array_equal(f.index.get_level_values("time").to_numpy(), flat(r.time, r))
        assert len(f.columns) == r.mean.shape[-1] + len(r.layout.named_deviations) + 2 * len(r.bias) + len(r.modes) + 4
        assert f.attrs["units"] == {c: u for c, u in expected_units(r).items() if u}


def expected_units(r):
    """By the space alone: turns are in radians."""
    turns = [
        t for s, _, _ in r.layout.space.parts() for t in (s.periodic if s.flat else [i < s.turns for i in range(s.dim)])
    ]
    found = {f"{n}_std": "rad" if t else "" for n, t in zip(r.layout.named_deviations, turns, strict=True)}
    found |= {n: found.get(f"{n}_std", "") for n in r.state}
    if not r.layout.space.flat:
        found |= {n: "furlong" for n in (r.state[0], f"{r.state[0]}_std") if n in found}
    return found | ({} if r.layout.dated else {"time": "s"})


@pytest.mark.parametrize("name", SPACES)
def test_parquet_and_xarray_keep_numbers_times_and_units(name, tmp_path):
    for k, r in enumerate(variants(name)):
        f, path = r.to_frame(), tmp_path / f"{k}.parquet"
        r.to_parquet(path)
        back = pd.read_parquet(path).set_index(list(f.index.names))
        if r.layout.dated:
            assert parquet.read_schema(path).field("time").type.tz == "UTC"
            back.index = pd.MultiIndex.from_arrays([back.index.get_level_values(n) for n in back.index.names])
        for c in f:
            assert back[c].dtype == f[c].dtype
            np.testing.assert_array_equal(back[c], f[c])
        time = (
            pd.DatetimeIndex(back.index.get_level_values("time")) if r.layout.dated else back.index.get_level_values(-1)
        )
        time = time.tz_localize(None) if r.layout.dated else time
        np.testing.assert_array_equal(time.to_numpy(), flat(r.time, r))
        units = {x.name: x.metadata[b"unit"].decode() for x in parquet.read_schema(path)}
        x = r.to_xarray()
        for c in f:
            assert units[c] == x[c].attrs.get("units", "") == f.attrs["units"].get(c, "")
            np.testing.assert_array_equal(flat(x[c].to_numpy(), r), f[c])
            assert x[c].dims[-1] == ("step" if r.layout.batched and k % 6 >= 4 else "time")
        np.testing.assert_array_equal(np.broadcast_to(x["time"], r.time.shape), r.time)
        if not r.layout.dated:  # of the format that needs no other package, whose integers are too short for instants
            x.to_netcdf(tmp_path / f"{k}.nc", engine="scipy")
            with xarray.open_dataset(tmp_path / f"{k}.nc", engine="scipy") as again:
                assert again[r.state[0]].attrs == x[r.state[0]].attrs
                assert all(np.array_equal(again[n], x[n], equal_nan=x[n].dtype.kind == "f") for n in x.variables)
        d = len(r.layout.named_deviations)
        np.testing.assert_allclose(x["cov"].to_numpy()[..., :d, :d], r.cov, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(x["cov"].to_numpy()[..., d:, d:], r.bias_cov, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", SOME)
def test_bands_of_numbers_are_their_deviations_to_first_order(name):
    """Held against draws of the deviation, which know nothing of a derivative."""
    from sigmax.results.presentation import series

    r = made(name, batch=2, seed=5)
    r = replace(r, stored_factor=r.stored_factor * 1e-4)
    spread, space = series(r, 1).spread, r.layout.space
    e = np.random.default_rng(1).normal(size=(space.dim, 40_000))
    for t in (0, 6):
        x = np.repeat(r.mean[1, t][:, None], e.shape[1], 1)
        drawn = np.asarray(space.add(x, r.factor[1, t] @ e)) - x
        drawn = np.where(abs(drawn) > 3, 0, drawn)  # an angle beyond π
        got = np.array([spread[n][0, t] for n in r.state])
        np.testing.assert_allclose(got, drawn.std(1), rtol=0.03, atol=1e-9)


@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("library", ["plotly", "matplotlib"])
def test_every_result_can_be_drawn(name, library):
    for r in list(variants(name))[::5]:
        figure = r.plot(library=library, track=r.layout.batched * 2)
        if library == "plotly":
            lines = {d.y.tobytes() for d in figure.data}
            own = r.mean[2] if r.layout.batched else r.mean
            turning = [n for s, at, _ in r.layout.space.parts() if s.flat for n in r.state[at] if any(s.periodic)]
            for i, n in enumerate(r.state):
                assert n in turning or own[:, i].tobytes() in lines
        else:
            plt.close(figure)


BROKEN = (
    lambda r: r,
    lambda r: replace(r, stored_mean=None),
    lambda r: replace(r, stored_factor=None),
    lambda r: replace(r, stored_fault=None, stored_nis=None),
    lambda r: replace(r, stored_count=None, stored_dt=None, stored_time=None),
    lambda r: replace(r, stored_mean=r.stored_mean * np.nan, stored_factor=r.stored_factor * np.nan),
    lambda r: replace(r, stored_fault=np.full_like(r.stored_fault, 6), stored_nis=np.full_like(r.stored_nis, np.inf)),
    lambda r: replace(r, stored_count=np.zeros_like(r.stored_count), stored_nis=r.stored_nis * np.nan),
    lambda r: jax.tree.map(lambda a: None, r),
    lambda r: jax.tree.map(lambda a: object(), r),
    lambda r: jax.tree.map(lambda a: a[:0], r) if r.layout.batched else r,
    lambda r: replace(r, layout=r.layout._replace(units=())),
    lambda r: Smoothed(r.layout, r.stored_mean, r.stored_factor, r.stored_fault, r.stored_modes),
)  # fmt: skip


@pytest.mark.parametrize("name", SPACES)
def test_every_result_says_what_it_is(name):
    for r in variants(name):
        for broken in BROKEN:
            shown = repr(broken(r))
            assert shown.startswith(("Result of EKF", "Smoothed of EKF"))
            assert len(shown.splitlines()) < 40
    seen = []
    jax.jit(lambda r: seen.append(repr(r)))(made(name))
    assert "being traced" in seen[0]


def test_a_repr_has_the_numbers():
    r = made("line", batch=3, bias=("drift",), bias_first=True, seed=3)
    lines = {
        a.strip(): b.strip() for a, b in (re.split(r"  +", s.strip(), maxsplit=1) for s in repr(r).splitlines()[1:])
    }
    heard = r.dof > 0
    assert float(lines["NIS"].split()[0]) == pytest.approx(r.nis[heard].mean(), rel=0.01)
    assert float(lines["NIS"].split(", ")[1].split()[0]) == pytest.approx(r.dof[heard].mean(), rel=0.01)
    assert lines["missing"].startswith(f"{(~heard).sum()} steps")
    assert lines["faults"].startswith(f"{(r.fault != 0).sum()} steps not sound")
    assert f"sensor not finite in {(r.fault == 4).sum()}" in lines["faults"]
    for name, mean, std in (("s0", r.mean, r.std), ("drift", r.bias_mean, r.bias_std)):
        value, _, deviation = lines[name].split()[:3]
        assert float(deviation) == pytest.approx(std[0, -1, 0], rel=0.06)
        assert abs(float(value) - mean[0, -1, 0]) < 0.06 * std[0, -1, 0]


def test_nothing_in_a_name_is_run():
    bad = "<script>alert(1)</script>"
    r = made("line")
    r = replace(r, layout=r.layout._replace(state=(bad,), named_deviations=(bad,), units=((bad, bad),), filter=bad))
    html = r._repr_html_()
    picture = b64decode(re.search('base64,([^"]+)', html)[1]).decode()
    assert "<script" not in html
    assert bad in unescape(html)
    assert "<script" not in picture
    assert "<script" not in "".join(str(t) for t in (r.plot().layout, *(d.name for d in r.plot().data)))


def test_what_cannot_be_shown_is_refused_in_words(monkeypatch):
    r, line = made("product", batch=3), made("line")
    for call, said in (
        (lambda: r.plot(track=3), "track must be a number from 0 to 2"),
        (lambda: r.plot(library="bokeh"), "unknown library 'bokeh'"),
        (lambda: r.plot(path=("a", "b")), "unknown component 'a'"),
        (lambda: r.plot(path="ab"), "path must be two names"),
        (lambda: replace(r, stored_mean=None).to_frame(), "mean was not kept"),
        (lambda: replace(line, layout=line.layout._replace(state=("nis",))).to_frame(), "called .'nis'."),
    ):
        with pytest.raises(sigmax.InputError, match=said):
            call()
    for package, call in (
        ("plotly", r.plot),
        ("matplotlib", lambda: r.plot(library="matplotlib")),
        ("pandas", r.to_frame),
        ("pyarrow", lambda: r.to_parquet("x")),
        ("xarray", r.to_xarray),
    ):
        with monkeypatch.context() as m:
            for loaded in [k for k in __import__("sys").modules if k.split(".")[0] == package]:
                m.setitem(__import__("sys").modules, loaded, None)
            m.setitem(__import__("sys").modules, package, None)
            with pytest.raises(sigmax.InputError, match=f"pip install {package}"):
                call()
    with monkeypatch.context() as m:
        m.setitem(__import__("sys").modules, "matplotlib.figure", None)
        assert "pip install matplotlib" in r._repr_html_()


# Compilers take seconds for each.
QUICK, MORE = ("SRCKFB", "EKF(update=student)"), ("UKF(members=5)", "CKF, of sensors and modes", *sigmax.names())


def by_name(name):
    stem, _, option = name.removesuffix(")").partition("(")
    return sigmax.get(stem, **({"members": 5} if "members" in option else {"update": "student"} if option else {}))


def runs(name):
    """Results of a filter on a record with gaps, a step that fails, unequal steps, with a bias or modes."""
    name, _, several = name.partition(", ")
    filter, rng = by_name(name), np.random.default_rng(0)
    step, cv = sigmax.motions.constant_velocity(), sigmax.sensors.position()
    more = {"bias": sigmax.Bias(sensor=np.eye(2), prior=sigmax.Gaussian([0.0, 0.0], [4.0, 4.0]))}
    prior, z = sigmax.Gaussian([0.0, 0.0, 1.0, -1.0], [9.0, 9.0, 1.0, 1.0]), rng.normal(size=(2, 9, 2)) * 3
    z[:, 3], z[1, 5, 0], z[0, 7] = np.nan, np.nan, np.inf
    biased = name.startswith(("TS", "MTS"))
    model = sigmax.Model(motion=step, sensor=cv, Q=step.noise(0.1), R=[4.0, 4.0], **(more if biased else {}))
    for given in (z[0], z):
        yield model, sigmax.run(filter, model, prior, given, t=T0 + np.arange(9) ** 2 * np.timedelta64(1, "s"), t0=T0)
    if several:
        both = {
            "range": sigmax.sensors.range_only(origin=(50.0, 0.0)),
            "bearing": sigmax.sensors.bearing(origin=(0.0, 60.0)),
        }
        model = sigmax.Model(motion=step, sensor=both, Q=step.noise(0.1), R={"range": [4.0], "bearing": [0.01]})
        heard = {"range": 50 + z[0, :, :1], "bearing": z[0, :, 1:] / 30}
        yield model, sigmax.run(filter, model, prior, heard, dt=rng.uniform(0.1, 2, 9), dtype="float32")
        calm = sigmax.Model(motion=step, sensor=cv, Q=step.noise(0.01), R=[4.0, 4.0])
        wild = sigmax.Model(motion=step, sensor=cv, Q=step.noise(9.0), R=[4.0, 4.0])
        model = sigmax.imm({"calm": calm, "wild": wild}, sojourn=[30, 10])
        yield model, sigmax.run(filter, model, prior, z)


@pytest.mark.parametrize(
    "name", [*QUICK, *(pytest.param(n, marks=pytest.mark.slow) for n in MORE if n not in QUICK and n != "KF")]
)
def test_what_runs_leave_is_shown_as_it_is(name):
    for model, r in runs(name):
        again = sigmax.smooth(by_name(name.partition(", ")[0]), model, r)
        for one in (r, again):
            f, kind = one.to_frame(), type(one).__name__
            std = np.sqrt(np.einsum("...ii->...i", flat(one.cov, one)))
            for i, n in enumerate(one.state):
                np.testing.assert_array_equal(f[n], flat(one.mean, one)[:, i])
                np.testing.assert_allclose(f[f"{n}_std"], std[:, i], rtol=1e-5)
                assert f.attrs["units"][n] == ("m" if i < 2 else "m/s")
            for k, mode in enumerate(one.modes):
                np.testing.assert_array_equal(f[f"probability_{mode}"], flat(one.probability, one)[:, k])
            np.testing.assert_array_equal(f.index.get_level_values("time"), flat(one.time, one))
            first, *lines = repr(one).splitlines()
            said = dict(re.split(r"  +", line.strip(), maxsplit=1) for line in lines)
            assert first.startswith(f"{kind} of {re.match('[A-Z]+', name)[0]}")
            assert said["faults"].startswith("none" if one.ok.all() else f"{(one.fault != 0).sum()} step")
            assert ("honest" in said.get("NIS", "")) == (kind == "Result" and not one.modes and "(" not in name)
            assert len(one.plot(track=0).data) >= 3 * len(one.state)
            assert one._repr_html_().count("<img") == 1


@pytest.mark.parametrize("name", sigmax.names())
def test_filters_say_what_they_are_made_of(name):
    shown = repr(sigmax.get(name))
    assert shown.startswith(f"{name}: prediction ")
    assert "form " in shown


def test_models_priors_and_fits_say_what_they_are():
    s = sigmax.builtin("radar-ct")
    assert repr(s.model) == (
        "Model(state (north [m], east [m], speed [m/s], course [rad], turn_rate [rad/s]); "
        "sensor (range, azimuth [rad], radial_velocity))"
    )
    P = np.array([[4.0, 0.1], [0.1, 0.01]])
    assert repr(sigmax.Gaussian([10.0, 3.0], P)) == "Gaussian(10.0 ± 2.0, 3.00 ± 0.10, correlated)"
    assert repr(sigmax.Gaussian(np.ones((3, 1)), [4.0])) == "Gaussian(3 tracks, the first: 1.0 ± 2.0)"
    assert repr(sigmax.Gaussian([1.0, 0, 0, 0], np.eye(3))).startswith("Gaussian(1, 0, 0, 0; deviations ± 1")
    jax.jit(lambda x: repr(sigmax.Gaussian(x, np.eye(2))) and x)(np.zeros(2))
    fit = Fit(
        {"q": np.array(0.5), "r": np.array([1.0, 2.0])},
        {"q": np.array(0.1), "r": np.array([0.2, np.nan])},
        -3.5,
        True,
        "",
        7,
    )
    assert repr(fit).splitlines()[1:3] == ["  q               0.50 ± 0.10", "  r               1.00 ± 0.20, 2 ± nan"]
    study = sigmax.studies.load_studies("single-beacon")[0]
    none = Comparison(
        study, 1, 10, {"EKF": sigmax.get("EKF")}, 0, {}, {"EKF": "no"}, {}, None, {}, None, None, "", {}, {}, (), 0.0
    )
    assert "EKF         could not be run: no" in repr(none)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"units": {"z": "m"}}, "unknown component 'z'"),
        ({"units": {"x": 3}}, "the unit of 'x' must be text"),
        ({"units": ["m"]}, "texts by name"),
    ],
)
def test_units_are_checked(given, said):
    with pytest.raises(sigmax.InputError, match=said):
        sigmax.Model(
            motion=sigmax.motions.unicycle(), sensor=sigmax.sensors.position(), Q=np.ones(3), R=[1.0, 1.0], **given
        )


def test_a_path_is_drawn_of_places_alone():
    """Not of the x and y of a quaternion."""
    drawn = {
        n: made(n).plot(library="matplotlib").axes[0] for n in ("rotation", "direction", "pose2", "pose3", "product")
    }
    labels = {n: (ax.get_xlabel(), ax.get_ylabel()) for n, ax in drawn.items()}
    for ax in drawn.values():
        plt.close(ax.figure)
    assert labels == {
        "rotation": ("", "s.w [furlong]"),
        "direction": ("", "s.x [furlong]"),
        "pose2": ("s.x", "s.y"),
        "pose3": ("s.x", "s.y"),
        "product": ("", "s.0 [furlong]"),
    }

"""The order in which the plots of a scan are handed in changes nothing."""

import numpy as np
import pytest

from sigmax.tracking import Modes, Scan, Tracker, gnn, jpda, mht, nearest, pda, single_plot, two_point
from tests.tracking.worlds import NOISE, cycle, model


def clutter(seed, scans=10):
    """Many plots to a gate, so that tracks begin and fight for plots in every scan."""
    rng = np.random.default_rng(seed)
    return [rng.uniform(-60, 60, (rng.integers(8, 20), 2)) + NOISE * rng.normal(size=2) for _ in range(scans)]


@pytest.mark.parametrize("initiate", [single_plot(40.0), two_point(40.0, 7.0)], ids=["single_plot", "two_point"])
@pytest.mark.parametrize("associate", [nearest, gnn, pda, jpda, mht()], ids=["nearest", "gnn", "pda", "jpda", "mht"])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.one_in(3)
def test_a_permutation_of_plots_changes_nothing(associate, initiate, seed):
    c = cycle(3.0, associate=associate, initiate=initiate)
    plots, rng = clutter(seed), np.random.default_rng(seed)
    orders = [rng.permutation(len(z)) for z in plots]
    plain = Tracker(c).run(Scan(2.0 * k, "", z) for k, z in enumerate(plots))
    turned = Tracker(c).run(Scan(2.0 * k, "", z[o]) for k, (z, o) in enumerate(zip(plots, orders, strict=True)))
    assert sum(len(t.id) for t in plain) > 20
    for one, other, order in zip(plain, turned, orders, strict=True):
        for name in ("id", "mean", "cov", "existence", "confirmed", "ended", "nis"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
        # What is told is the place in the scan as it was handed in.
        np.testing.assert_array_equal(one.plot, np.append(order, -1)[other.plot])


def test_hypotheses_and_modes_go_together():
    """Two modes: the branches of MHT mix within themselves, and with plots that are plain it is GNN."""
    both = Modes([("EKF", model(0.1)), ("EKF", model(10.0))], sojourn=[60.0, 20.0])
    rng = np.random.default_rng(3)
    path = np.cumsum(np.stack([np.full(20, 40.0), np.where(np.arange(20) < 10, 0.0, 30.0)], 1), 0)
    scans = [Scan(2.0 * k, "", x + NOISE * rng.normal(size=(1, 2))) for k, x in enumerate(path)]
    one, other = (Tracker(cycle(1e-3, associate=a, modes=both)).run(scans) for a in (mht(), gnn))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.id, b.id)
        np.testing.assert_allclose(a.mean, b.mean, atol=1e-9)
        np.testing.assert_allclose(a.mode, b.mode, atol=1e-9)
    assert max(t.mode[:, 1].max(initial=0) for t in one) > 0.5

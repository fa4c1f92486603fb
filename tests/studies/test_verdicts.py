"""A verdict is a promise: right at every number of runs, never turned into its opposite by more of them."""

import io
import re

import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console
from scipy.stats import binomtest

import sigmax
from sigmax.cli.compare import comparison_table
from sigmax.reports.comparison import Word, page, standings, verdict
from sigmax.reports.comparison.figures import curve_figures
from sigmax.reports.comparison.judgement import Honesty, judged, loses
from sigmax.reports.comparison.trade import trade_figure
from sigmax.reports.shares import share_bounds
from sigmax.studies import compare, load_studies
from sigmax.studies.measures import measures
from sigmax.studies.sums import Estimated, summed
from tests.studies.problems import linear, scalar

SIZES = (64, 100, 400, 2000)
# The upper quartiles of chi-square laws with 1, 2 and 4 degrees of freedom, from a printed table: 50 % and 95 %.
TABLE = {1: (0.455, 3.841), 2: (1.386, 5.991), 4: (3.357, 9.488)}


def test_bounds_of_shares_are_those_of_clopper_and_pearson():
    for count, runs in ((0, 10), (3, 10), (10, 10), (1, 500), (250, 500)):
        low, high = share_bounds(np.array(count), runs, 0.005)
        theirs = binomtest(count, runs).proportion_ci(0.99, "exact")
        np.testing.assert_allclose([low, high], theirs, atol=1e-12)


def claimed(rng, ratio, d, runs=2000, steps=20):
    """Squared errors (runs, steps, d) in units of what is claimed: correlated over time, their variance `ratio`."""
    e = rng.standard_normal((runs, steps, d))
    for t in range(1, steps):
        e[:, t] = 0.9 * e[:, t - 1] + np.sqrt(1 - 0.9**2) * e[:, t]
    return np.broadcast_to(ratio, (d,)) * e**2


def judgement(squares, runs):
    return verdict_of(squares, runs).honesty


def verdict_of(squares, runs):
    """Of the first runs, counted here by the table."""
    part = squares[:runs]
    d = part.shape[-1]
    nees = part.sum(-1)
    outside = np.array(
        [np.concatenate([(nees > TABLE[d][k]).sum(0)[:, None], (part > TABLE[1][k]).sum(0)], axis=1) for k in range(2)]
    )
    far = int((nees.mean(1) > 4 * d).sum())
    degrees = np.tile([d, *[1] * d], (part.shape[1], 1))
    return judged(outside, far, runs, degrees)


def settled(found):
    """The verdicts among these, none against another."""
    known = {honesty for honesty in found if honesty is not Honesty.UNKNOWN}
    assert len(known) <= 1, found
    return known.pop() if known else Honesty.UNKNOWN


@pytest.mark.parametrize("seed", range(10))
def test_more_runs_never_turn_a_verdict_into_its_opposite(seed):
    rng = np.random.default_rng(seed)
    final = {}
    for ratio in (0.1, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3, 1.7, 2.0, 2.5, 4.0, 60.0):
        for d in (1, 2, 4):
            squares = claimed(rng, ratio, d)
            final[ratio, d] = settled([judgement(squares, runs) for runs in SIZES])
    for d in (1, 2, 4):
        assert final[1.0, d] is Honesty.SOUND
        assert final[0.1, d] is Honesty.CAUTIOUS
        assert final[60.0, d] is final[4.0, d] is Honesty.OPTIMISTIC


@pytest.mark.parametrize("seed", range(10))
def test_the_worse_a_filter_the_more_it_is_flagged(seed):
    """A few runs far off inflate every mean and its error; they must not hide a filter from judgement."""
    rng = np.random.default_rng(100 + seed)
    squares = claimed(rng, [3.0, 1.0, 1.0, 1.0], 4)
    assert judgement(squares, 2000) is Honesty.OPTIMISTIC
    for share, factor in ((0.01, 1e3), (0.05, 1e30), (0.3, 1e160), (0.9, np.inf)):
        worse = squares.copy()
        worse[rng.random(len(worse)) < share] *= factor
        assert judgement(worse, 2000) is Honesty.OPTIMISTIC
    # One component that is claimed too well is seen behind three that are claimed too badly.
    assert judgement(claimed(rng, [5.0, 0.5, 0.5, 0.5], 4), 2000) is Honesty.OPTIMISTIC
    # Long tails are no caution: most errors are small, some very large.
    tails = claimed(rng, 1.0, 1) * np.where(rng.random((2000, 1, 1)) < 0.08, 10.0, 0.2)
    assert settled([judgement(tails, runs) for runs in SIZES]) is not Honesty.CAUTIOUS


def test_the_share_outside_is_one_quantity_whatever_the_verdict_rests_on():
    """The average over time for the whole state or one component; runs far off are counted apart."""
    rng = np.random.default_rng(8)
    rested_on = set()
    late = np.r_[np.ones(19), 6.0][:, None]
    wild = np.where(rng.random((2000, 1, 1)) < 0.25, 30.0, 0.5)
    for factor in (1.0, 0.1, 9.0, late, wild, np.array([1.0, 5.0])):
        squares = claimed(rng, 1.0, 2) * factor
        found = verdict_of(squares, 2000)
        shares = [np.mean(squares.sum(-1) > TABLE[2][1]), *np.mean(squares > TABLE[1][1], axis=(0, 1))]
        assert found.outside == pytest.approx(shares[found.worst])
        assert found.outside >= 0.6 * max(shares)
        assert found.far == np.mean(squares.sum(-1).mean(1) > 8)
        rested_on.add("far" if found.facet is None else "step" if found.step is not None else "average")
    assert rested_on == {"far", "step", "average"}


def test_assertions_are_wrong_less_often_than_they_say():
    """Just inside a limit the opposite is said about never: here by 400 studies of a filter at the limit."""
    rng = np.random.default_rng(5)
    wrong = 0
    for _ in range(400):
        at_limit = claimed(rng, 1.95, 1, runs=100, steps=10)
        wrong += judgement(at_limit, 100) in (Honesty.OPTIMISTIC, Honesty.CAUTIOUS)
    assert wrong == 0


def test_lost_runs_are_judged_against_the_filter_that_loses_fewest():
    assert loses(np.array([0, 0]), 64) == [None, None]
    assert loses(np.array([0, 0, 400]), 2000) == [False, False, True]
    # Where the measurement does not tell, all lose: the best of them is no worse for it.
    assert loses(np.array([600, 620, 1990]), 2000) == [False, False, True]
    assert loses(np.array([1999, 2000]), 2000) == [True, True]
    for seed in range(10):
        rng = np.random.default_rng(seed)
        for share in (0.0, 0.01, 0.03, 0.05, 0.2):
            lost = rng.random((2000, 2)) < [0.0, share]
            said = {loses(lost[:runs].sum(0), runs)[1] for runs in SIZES} - {None}
            assert len(said) <= 1


def words(study, sizes, seed, **more):
    """The verdict of each filter by number of runs."""
    return [{s.name: s.word for s in standings(compare(study, runs=n, seed=seed, **more))} for n in sizes]


def assert_never_opposite(found):
    for name in found[0]:
        known = {one[name] for one in found} - {Word.UNKNOWN}
        assert len(known) <= 1, (name, found)
    return found[-1]


def test_a_real_study_keeps_its_verdicts():
    study = load_studies("stepanov-scalar")[3]
    last = assert_never_opposite(words(study, (64, 100, 2000), 1, particles=0))
    assert last["EKF"] is last["CKF"] is Word.OPTIMISTIC
    assert last["PF"] is last["UKF"] is Word.SOUND
    headline, sentences = verdict(compare(study, runs=2000, particles=0))
    assert not headline.startswith("Take EKF")
    assert any(s.startswith("Avoid EKF: ") for s in sentences)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 11))
def test_real_studies_keep_their_verdicts_over_ten_seeds(seed):
    for study in (load_studies("single-beacon")[0], *load_studies("stepanov-scalar")):
        last = assert_never_opposite(words(study, (64, 100, 2000), seed, particles=0))
        if study.name in ("single-beacon", "stepanov-B", "stepanov-D"):
            assert last["EKF"] is Word.OPTIMISTIC


def test_one_beacon_with_a_hundred_runs_flags_the_extended_filter():
    (study,) = load_studies("single-beacon")
    c = compare(study, ["EKF", "UKF"], runs=100, particles=0)
    found = {s.name: s for s in standings(c)}
    assert found["EKF"].word is Word.OPTIMISTIC
    assert found["UKF"].word is Word.UNKNOWN
    assert 200 <= found["UKF"].needed <= 2000
    headline, sentences = verdict(c)
    assert headline.startswith(f"100 runs are too few for a verdict: about {found['UKF'].needed:,} would tell")
    assert any("UKF: whether it can be believed is not known from 100 runs" in s for s in sentences)
    # As many runs as it asks for are enough, and sooner known is only whom to avoid.
    assert verdict(compare(study, ["EKF", "UKF"], runs=found["UKF"].needed, particles=0))[0].startswith("Take UKF")
    early = compare(study, ["EKF", "UKF"], runs=20, particles=0)
    found = {s.name: s for s in standings(early)}
    assert found["EKF"].needed < found["UKF"].needed
    assert found["EKF"].then is Word.OPTIMISTIC
    assert f"(--runs {found['UKF'].needed})" in verdict(early)[0]


@pytest.mark.parametrize("width", [24, 32, 40, 60, 72, 80, 100, 200])
@pytest.mark.parametrize("name", ["EKF", "PF with quite a long name of its own"])
def test_no_word_of_a_verdict_is_cut_in_any_terminal(width, name):
    c = compare(scalar(), ["EKF"], runs=64)
    (one,) = standings(c)
    c = c._replace(sums={name: c.sums["EKF"]})
    found = [one._replace(name=name, word=word, distance=1234.5, lost=64) for word in Word]
    console = Console(width=width, file=io.StringIO())
    console.print(comparison_table(c, found, width))
    shown = console.file.getvalue()
    for word in Word:
        assert word.value in shown
    assert "…" not in shown
    assert name.split()[0] in shown


def test_consistency_is_not_judged_where_it_cannot_be_asked():
    asked = {
        "": (linear(), linear(start=[1.0, 0.0], estimate="drawn"), linear(nature=linear().model)),
        "same truth": (linear(start=[1.0, 0.0]),),
        "without the noise": (linear(nature=sigmax.studies.undisturbed(linear().model)),),
    }
    for words_of_it, studies in asked.items():
        for study in studies:
            assert words_of_it in study.unasked
            assert bool(study.unasked) == bool(words_of_it)
    (study,) = load_studies("sobolev-cost")
    c = compare(study, ["EKF", "SRCKFB", "SRECKFB"], runs=512)
    found = standings(c)
    assert {s.word for s in found} == {Word.NOT_JUDGED}
    headline, sentences = verdict(c)
    assert headline.startswith("Take ")
    assert not any("Avoid" in s for s in sentences)
    assert any("is not judged: all runs begin with the same truth" in s for s in sentences)
    assert "is not judged" in page([c])


def test_a_filter_that_claims_too_much_from_the_first_step_on_is_not_sound():
    """One range tells no direction: the extended filter is sure of what it has not seen."""

    def motion(x, dt):
        return x

    def beacon(x):
        return jnp.hypot(x[0], x[1])[None]

    model = sigmax.Model(motion=motion, sensor=beacon, Q=[1e-4, 1e-4], R=[0.01])
    study = sigmax.studies.Study(name="ranges", model=model, prior=sigmax.Gaussian([3.0, 0.0], [25.0, 25.0]), steps=30)
    c = compare(study, ["EKF"], runs=256)
    assert np.median(c.measures["EKF"].nees.value) > 10
    assert standings(c)[0].word in (Word.OPTIMISTIC, Word.LOSSY)
    assert verdict(c)[0].startswith("None of these filters can be trusted")


def with_one_that_is_lost(c):
    """The same comparison, its second filter off by 1e81 and claiming more than that."""
    T, n, B = c.study.steps, c.study.model.size, 256
    rng = np.random.default_rng(0)
    truth = rng.standard_normal((B, T, n))
    mean = truth + 1e81 * rng.standard_normal((B, T, n))
    factor = np.broadcast_to(6e81 * np.eye(n), (B, T, n, n))
    found = Estimated(mean, factor, np.zeros((B, T), int), np.ones((B, T)), np.ones((B, T), int))
    sums = summed(found, truth, None, c.by)
    name = list(c.measures)[1]
    return c._replace(sums=c.sums | {name: sums}, measures=c.measures | {name: measures(sums)}), name


def test_a_filter_that_is_lost_spoils_neither_table_nor_pictures_and_does_not_look_harmless():
    c, name = with_one_that_is_lost(compare(scalar(), runs=256))
    assert float(np.median(c.measures[name].nees.value)) < 0.05
    found = standings(c)
    lost = next(s for s in found if s.name == name)
    assert lost.word is Word.LOSSY
    assert lost.lost == 256
    html = page([c])
    assert "256 of 256" in html
    assert "&gt; 1000" in html or "> 1000" in html
    left = re.sub(r'<script id="\w+" type="application/gzip">[^<]*', "", html)
    assert "e+8" not in left, left[left.index("e+8") - 200 : left.index("e+8") + 50]
    for figure in curve_figures(c).values():
        if figure["layout"]["yaxis"].get("type") == "log":
            low, high = figure["layout"]["yaxis"]["range"]
            assert high - low < 6
        assert any("(lost 256 of 256)" in trace["name"] for trace in figure["data"])
    assert [trace["name"] for trace in trade_figure(c, found)["data"]] == ["EKF"]
    assert f"Avoid {name}: it loses 256 of 256 runs" in " ".join(verdict(c)[1])


def test_a_cautious_filter_can_be_used_and_is_told_what_to_change():
    """Half of the noise of the motion is not there."""
    calm = scalar()
    model = sigmax.Model(motion=calm.model.motion, sensor=calm.model.sensors[""], Q=[0.4], R=[0.4])
    study = scalar(model=model, nature=sigmax.Model(motion=model.motion, sensor=model.sensors[""], Q=[0.02], R=[0.02]))
    c = compare(study, ["PF"], runs=1000)
    assert [s.word for s in standings(c)] == [Word.CAUTIOUS]
    headline, sentences = verdict(c)
    assert headline.startswith("Take PF")
    assert "too cautious" in headline
    assert any("Lower Q or R" in s for s in sentences)
    assert 'class="verdict open"' in page([c])

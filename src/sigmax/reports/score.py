"""What a trial is worth, in numbers."""

from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from scipy.special import chdtr, chdtri, ndtri

from sigmax.algebra.factor import Diagonal
from sigmax.modelling.noise import takes
from sigmax.models import Model, SwitchingModel
from sigmax.records import Outcome, Record
from sigmax.reports.component_estimates import component_estimates, row_of
from sigmax.reports.shares import outside_if, ratio_bounds, share_bounds
from sigmax.reports.weight_counts import WeightCounts, judged_nis, least_weights, refused, weight_counts
from sigmax.running import Fault, Result

# The probability that a Gaussian is more than 4 σ off, and the share of steps of which so much is too much.
_FOUR_SIGMA, _OFTEN = 6.33e-5, 1e-3
# What is said of tails is wrong with this probability.
_MISS = 1e-3
# Correlation of the size of a miss with the one before that is worth telling.
_TOGETHER = 0.2


@dataclass(frozen=True)
class Score:
    """The numbers of one trial, over all real steps of all tracks.

    Attributes:
        name: of the trial as it was written.
        label: the trial for tables.
        rmse_position_m: None where there is no truth of the position.
        rmse: by component, in SI, where there is truth.
        mean_nis: over the steps with a measurement.
        expected_nis: the mean number of measured components in such a step: what an honest filter shows.
        nis_bounds: where 95 of 100 honest filters lie.
        nis_ratio: between what the real variance of the misses lies, in units of the claimed one, with 99 %.
        components: number of measured components in all steps.
        beyond: number of steps whose miss is as improbable as one of 4 σ.
        kurtosis: of the misses, whatever their size: 3 for a Gaussian.
        heavy: whether the misses surely have longer tails than those of a Gaussian.
        stretches: correlation of the size of a miss with that of the one before, None where it may be small.
        measurements: number of steps with a measurement.
        log_likelihood: of all tracks together.
        faults: number of steps that were not sound.
        first_fault: the first of them in words.
        weighed: by sensor, where the filter weighs its measurements.
        modes: by name, the share of all steps, where the model has several.
        constants: mean and standard deviation at the end of components without noise and of the bias; of a single
            track only.
        seconds: the run.
        compile_seconds: the compilation before it, None where it is part of `seconds`.
        failure: why there are no numbers at all.
    """

    name: str
    label: str
    rmse_position_m: float | None = None
    rmse: dict[str, float] | None = None
    mean_nis: float | None = None
    expected_nis: float | None = None
    nis_bounds: tuple[float, float] | None = None
    nis_ratio: tuple[float, float] | None = None
    components: int = 0
    beyond: int = 0
    kurtosis: float | None = None
    heavy: bool = False
    stretches: float | None = None
    measurements: int = 0
    log_likelihood: float | None = None
    faults: int = 0
    first_fault: str = ""
    weighed: dict[str, WeightCounts] = field(default_factory=dict)
    modes: dict[str, float] = field(default_factory=dict)
    constants: dict[str, tuple[float, float]] | None = None
    seconds: float | None = None
    compile_seconds: float | None = None
    failure: str = ""


def score(record: Record, outcome: Outcome) -> Score:
    """The numbers of a trial on its record."""
    name, label = outcome.trial.name, record.label(outcome.trial)
    result = outcome.result
    if result is None:
        return Score(name, label, failure=outcome.failure)
    real = record.real
    rows = list(component_estimates(record, result))[: record.model.dim]
    error = np.stack([row.error[real] for row in rows], -1)
    known = ~np.isnan(error).all(0)
    rmse = {row.name: rms(error[:, i]) for i, row in enumerate(rows) if known[i]}
    place = [row_of(record, k) for k in record.position]
    dof = result.dof[real]
    heard = dof > 0
    nis, least = judged_nis(result), least_weights(record, result)
    count, total = int(heard.sum()), int(dof.sum())
    bounds = (float(chdtri(total, 0.975)) / count, float(chdtri(total, 0.025)) / count) if count else None
    faults, first = _faults(record, result)
    return Score(
        name=name,
        label=label,
        rmse_position_m=rms(np.sqrt((error[:, place] ** 2).sum(1))) if place and known[place].all() else None,
        rmse={str(n): value for n, value in rmse.items()},
        mean_nis=float(nis[real][heard].mean()) if count else None,
        expected_nis=total / count if count else None,
        nis_bounds=bounds,
        measurements=count,
        components=total,
        **misses(record.real, nis, result.dof, refused(least)),
        log_likelihood=float(np.sum(result.log_likelihood)),
        faults=faults,
        first_fault=first,
        weighed=weight_counts(least),
        modes=dict(zip(result.modes, result.probability[real].mean(0).tolist(), strict=True)) if result.modes else {},
        constants=_constants(record, result),
        seconds=outcome.seconds,
        compile_seconds=outcome.compile_seconds,
    )


def misses(real: np.ndarray, nis: np.ndarray, dof: np.ndarray, refused: np.ndarray | None = None) -> dict[str, Any]:
    """What the NIS says beyond its mean, as fields of a `Score`: of tails, and of misses that come in stretches.

    Args:
        real: which steps are not padding (B, T).
        nis: (B, T), NaN where nothing was measured.
        dof: degrees of freedom (B, T).
        refused: steps whose measurements a gate refused (B, T): they have no NIS, and count as large misses in a row.
    """
    heard = (dof > 0) & real
    nis, dof = nis[heard].astype(float), dof[heard].astype(float)
    N = len(nis)
    if not N or not np.isfinite(nis).all():
        return {}
    ratio = nis.sum() / dof.sum()
    beyond = int(np.count_nonzero(nis > chdtri(dof, _FOUR_SIGMA)))
    often, _ = share_bounds(np.array(beyond), N, _MISS)
    # As many near the middle as if the variances were half as large, though on the whole they are not: few large ones.
    _, outer = share_bounds(np.array(np.count_nonzero(nis > chdtri(dof, 0.5))), N, _MISS)
    narrow = outer < outside_if(0.5, 0.5, dof).mean() and ratio_bounds(nis.sum(), dof.sum(), _MISS)[0] > 0.5
    size = np.full(real.shape, np.nan)
    size[heard] = np.clip(ndtri(chdtr(dof, nis)), -3.0, 3.0)
    if refused is not None:
        size[refused & real & ~heard] = 3.0
    if ratio < 1:
        # Misses that are all smaller than claimed are alike without lasting.
        size -= np.nanmean(size)
    pairs = size[:, 1:] * size[:, :-1]
    pairs = pairs[np.isfinite(pairs)]
    total = np.nansum(size**2)  # 0 where all are alike, such as measurements that the model expects exactly
    together = float(pairs.sum() / total) if total > 0 else 0.0
    return {
        "nis_ratio": ratio_bounds(float(nis.sum()), float(dof.sum()), 0.005),
        "beyond": beyond,
        "kurtosis": float(3 * ((nis / ratio) ** 2).mean() / (dof * (dof + 2)).mean()) if ratio > 0 else None,
        "heavy": bool(often > _OFTEN or narrow),
        "stretches": together if together - 3.3 / np.sqrt(N) > _TOGETHER else None,
    }


def rms(values: np.ndarray) -> float:
    """The root of the mean square, over what is known."""
    return float(np.sqrt(np.nanmean(values**2)))


def _faults(record: Record, result: Result) -> tuple[int, str]:
    places = np.argwhere((result.fault > 0) & record.real)
    if not len(places):
        return 0, ""
    # The earliest step counts, whatever its track.
    track, step = places[np.lexsort((places[:, 0], places[:, 1]))[0]]
    cause = Fault(int(result.fault[track, step])).message
    which = f"track {record.tracks[track]}, " if len(record.tracks) > 1 else ""
    return len(places), f"{which}step {step} (t = {record.time[track, step]:.6g} s): {cause}"


def _constants(record: Record, result: Result) -> dict[str, tuple[float, float]]:
    """What a single track found out about components that its motion leaves without noise, and about the bias."""
    if len(record.tracks) > 1:
        return {}
    u = None if record.inputs is None else record.inputs[0, 0]
    Q = _noise_of(record.model, np.atleast_2d(record.prior.mean)[0], u)
    moving = set(np.flatnonzero(Q != 0).tolist())
    known = enumerate(component_estimates(record, result))
    return {one.name: (float(one.mean[0, -1]), float(one.deviation[0, -1])) for i, one in known if i not in moving}


def _noise_of(model: Model, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    """The diagonal of Q over a short interval, at a state and inputs that it may depend on; of modes the largest."""
    if isinstance(model, SwitchingModel):
        found = np.zeros(model.dim)
        for mode in model.models:
            own = _noise_of(mode, x[[model.state.index(name) for name in mode.state]], u)
            at = [model.deviations.index(name) for name in mode.deviations]
            found[at] = np.maximum(found[at], own)
        return found
    Q = model.Q
    if isinstance(Q, Diagonal):
        return np.asarray(Q.entries)
    if callable(Q):
        given = (x, np.asarray(1e-3), *(() if u is None else (u,)))
        count = takes(Q, "Q", (1, 2, 3))
        # Compiled as a whole: operation by operation takes ten times as long.
        Q = jax.jit(Q)(*(given[1:2] if count == 1 else given[:count]))
    value = np.asarray(Q)
    return value if value.ndim == 1 else np.diagonal(value)

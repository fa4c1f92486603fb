"""Results in words, and as what tables and pictures take."""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import is_traced
from sigmax.spaces import Flat, Space
from sigmax.steps.adaptive_noises import scales
from sigmax.steps.step import Fault
from sigmax.views import words
from sigmax.views.series import Series

# Components that a line each is spent on.
_SHOWN = 12


def series(result: Any, track: int | None = None) -> Series:
    """A result as tables and pictures take it: all tracks, or one of them.

    Raises:
        InputError: for a result that is being traced, one without means, and a track that there is not.
    """
    if is_traced(result):
        raise InputError("this result is being traced (jax.jit, jax.grad); its numbers are known when that is over")
    layout = result.layout
    tracks = _tracks(layout.batched, len(result.mean) if layout.batched else 1, track)

    def laid(array: Any) -> np.ndarray:
        a = np.asarray(array)
        a = a if layout.batched else a[None]
        return (a[:, None] if _moment(result) else a)[tracks]

    state, bias = layout.state, layout.bias
    numbers = dict(_by_name(state, laid(result.mean))) | dict(_by_name(bias, laid(result.bias_mean)))
    deviations: dict[str, np.ndarray] = {}
    spread: dict[str, np.ndarray] = {}
    if result.stored_factor is not None:
        deviations = dict(_by_name(layout.named_deviations, laid(result.std))) | dict(
            _by_name(bias, laid(result.bias_std))
        )
        spread = deviations if track is None or layout.space.flat else _spread(result, laid, bias, deviations)
    steps = {name: getattr(result, f"stored_{name}", None) for name in ("nis", "count", "log_likelihood", "fault")}
    renamed = {"count": "dof"}
    modes, noises = {}, {}
    if layout.noises.size and result.stored_modes is not None:
        noises = scales(layout.noises, laid(result.stored_modes))
    if layout.modes and result.stored_modes is not None:
        modes = dict(_by_name(layout.modes, laid(result.probability)))
    return Series(
        title=heading(result),
        batched=layout.batched and track is None,
        time=laid(np.broadcast_to(result.time, result.mean.shape[:-1])),
        numbers=numbers,
        deviations=deviations,
        spread=spread,
        angles=frozenset(_angles(layout)),
        places=frozenset(_places(layout)),
        steps={renamed.get(name, name): laid(a) for name, a in steps.items() if a is not None},
        modes=modes,
        units=dict(layout.units),
        noises=noises,
    )


def _tracks(batched: bool, count: int, track: int | None) -> slice:
    if track is None:
        return slice(None)
    if isinstance(track, bool) or not isinstance(track, int | np.integer) or not 0 <= track < count:
        raise InputError(f"track must be a number from 0 to {count - 1}; it is {track!r}")
    return slice(track, track + 1)


def _moment(result: Any) -> bool:
    """Whether there is no axis of time."""
    return bool(np.ndim(result.stored_mean) == 1 + result.layout.batched)


def _by_name(names: Any, values: np.ndarray) -> Any:
    return ((str(name), values[..., i]) for i, name in enumerate(names))


def _angles(layout: Any) -> list[str]:
    return [
        str(name)
        for space, at, _ in layout.space.parts()
        if space.flat
        for name, turns in zip(layout.state[at], space.periodic, strict=True)
        if turns
    ]


def _places(layout: Any) -> list[str]:
    """Numbers of parts that do more than turn."""
    parts = [(space, at) for space, at, _ in layout.space.parts() if space.turns < space.dim]
    return [str(name) for _, at in parts for name in layout.state[at]]


def _spread(result: Any, laid: Any, bias: Any, deviations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Standard deviations of the numbers of a curved state: the covariance is taken along ∂(x ⊞ δ)/∂δ at 0."""
    x, S = laid(result.mean), laid(result.factor)
    made = np.asarray(_along(result.layout.space)(x.reshape(-1, x.shape[-1]), S.reshape(-1, *S.shape[-2:])))
    return dict(_by_name(result.layout.state, made.reshape(x.shape))) | {str(b): deviations[str(b)] for b in bias}


@lru_cache(maxsize=32)
def _along(space: Space) -> Any:
    def one(x: jax.Array, S: jax.Array) -> jax.Array:
        slope = jax.jacfwd(lambda d: space.add(x, d))(jnp.zeros(space.dim, x.dtype))
        return jnp.sqrt(((slope @ S) ** 2).sum(-1))

    return jax.jit(jax.vmap(one))


def heading(result: Any) -> str:
    """What a result is, of which filter, and how long."""
    kind, layout = type(result).__name__, result.layout
    said = f"{kind} of {layout.filter or 'a filter'}"
    stored = (result.stored_fault, result.stored_mean, getattr(result, "stored_nis", None), result.stored_factor)
    known = next((a for a in stored if isinstance(a, np.ndarray | jax.Array)), None)
    if known is None or known.ndim < 1 + layout.batched or _moment(result):
        return said
    size = words.counted(known.shape[layout.batched], "step")
    if layout.batched:
        size = f"{words.counted(len(known), 'track')} of {size}"
    return f"{said}: {size}"


def rows(result: Any) -> words.Rows:
    """What there is to say of a result: times, NIS, faults, modes, and the last state of its first track."""
    if not _readable(result):
        return [("numbers", "not known: it is being traced")]
    layout = result.layout
    found = []
    if result.stored_time is not None or result.stored_dt is not None:
        time = np.asarray(result.time)
        found.append(("time", words.span(time)) if time.size else ("time", "none"))
    if getattr(result, "stored_nis", None) is not None and result.stored_count is not None:
        found.append(("NIS", _nis(result)))
        missing = int((np.asarray(result.stored_count) == 0).sum())
        if missing and not layout.from_information:  # where a count of 0 may be of what begins the estimate
            found.append(("missing", f"{words.counted(missing, 'step')} without a measurement"))
    if getattr(result, "stored_total", None) is not None:
        total = np.asarray(result.stored_total)
        found.append(("log-likelihood", f"{float(total.sum()):,.6g}{' of all tracks' if layout.batched else ''}"))
    if result.stored_fault is not None:
        found.append(("faults", _faults(np.asarray(result.stored_fault))))
    for part, stored in (("mean", result.stored_mean), ("factor", result.stored_factor)):
        if stored is None:
            found.append((part, "not kept"))
    return [*found, *_last(result)]


def _readable(result: Any) -> bool:
    known = np.ndarray | np.generic | jax.Array | float | int
    return all(isinstance(leaf, known) and not is_traced(leaf) for leaf in jax.tree.leaves(result))


def _nis(result: Any) -> str:
    nis, dof = np.asarray(result.stored_nis, float), np.asarray(result.stored_count)
    heard = (dof > 0) & np.isfinite(nis)
    steps = int(heard.sum())
    if not steps:
        return "nothing was measured"
    total, mean = int(dof[heard].sum()), nis[heard].mean()
    said = f"{mean:.3g} on average, {total / steps:.3g} expected"
    if judged(result):
        from scipy.special import chdtri  # a fifth of the time of importing this package

        # 95 of 100 records of an honest filter.
        low, high = (chdtri(total, q) / steps for q in (0.975, 0.025))
        said += f" ({low:.3g} to {high:.3g} for 95 of 100 honest filters)"
    return said


def judged(result: Any) -> bool:
    """Whether an honest filter's NIS is chi-square: of one mode, whose measurements nothing weighs."""
    layout = result.layout
    return bool(layout.weights) and not layout.modes and all(weight is None for _, weight in layout.weights)


def _faults(fault: np.ndarray) -> str:
    numbers, counts = np.unique(fault[fault != 0], return_counts=True)
    if not len(numbers):
        return "none"
    kinds: Counter[str] = Counter()
    for number, count in zip(numbers, counts, strict=True):
        kinds[Fault(int(number)).name.lower().replace("_", " ")] += int(count)
    said = ", ".join(f"{kind} in {count:,}" for kind, count in kinds.most_common())
    return f"{words.counted(int(counts.sum()), 'step')} not sound: {said}; see faults()"


def _last(result: Any) -> words.Rows:
    """The last state, and before it the modes."""
    layout, mean = result.layout, result.stored_mean
    if mean is None or 0 in mean.shape:
        return []
    at = (0,) * layout.batched + (-1,) * (not _moment(result))
    S = None if result.stored_factor is None else np.asarray(result.stored_factor[at])
    std = None if S is None else np.sqrt((S * S).sum(-1))
    modes: words.Rows = []
    if layout.modes and result.stored_modes is not None:
        modes = [probabilities(layout.modes, np.exp(np.asarray(result.stored_modes[at])[-len(layout.modes) :]))]
    if layout.noises.size and result.stored_modes is not None:
        modes = [noises_found(scales(layout.noises, np.asarray(result.stored_modes[at])))]
    said = "of track 0" if layout.batched else "± one standard deviation"
    return [*modes, ("last state", said), *estimates(layout, np.asarray(mean[at]), std)]


def probabilities(modes: Sequence[str], p: np.ndarray) -> tuple[str, str]:
    """A line of the probabilities of modes (M,)."""
    return "modes", ", ".join(f"{name} {v:.3g}" for name, v in zip(modes, p, strict=True))


def noises_found(found: Mapping[str, Any]) -> tuple[str, str]:
    """A line of the numbers by which variances of noises are multiplied, by name."""
    return "noises", ", ".join(f"{name} {float(v):.3g}" for name, v in found.items())


def estimates(layout: Any, mean: np.ndarray, std: np.ndarray | None) -> words.Rows:
    """A mean and standard deviations of state and bias, as stored, number by number; of curved parts side by side."""
    units = dict(layout.units)
    parts = [(layout.state, layout.named_deviations, space, at, to, 0) for space, at, to in layout.space.parts()]
    p = len(layout.bias)
    parts.append((layout.bias, layout.bias, Flat((False,) * p), slice(0, p), slice(0, p), 1))
    found: list[tuple[str, str]] = []
    for numbers, deviations, space, at, to, which in parts:
        x = mean[layout.numbers[which]][at]
        S = None if std is None else std[layout.deviations[which]][to]
        for i, name in enumerate(numbers[at]):
            deviation = None if S is None or not space.flat else float(S[i])
            found.append((str(name), words.measured(float(x[i]), deviation, units.get(name, ""))))
        if S is not None and not space.flat:
            found += [
                (f"{n} (deviation)", words.spread(float(v), units.get(n, "")))
                for n, v in zip(deviations[to], S, strict=True)
            ]
    shown = [(f"  {name}", said) for name, said in found[:_SHOWN]]
    return shown if len(found) <= _SHOWN else [*shown, ("  …", f"{len(found) - _SHOWN} more")]

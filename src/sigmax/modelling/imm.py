"""Interacting multiple models: what a user says of modes and of how they change, checked."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.filters import Filter, get
from sigmax.modelling.checks import is_traced, numbers
from sigmax.modelling.model import Model
from sigmax.modelling.switching import Entries, Rates, SwitchingModel, parts_by_name
from sigmax.tracing import traceable


def imm(
    modes: Mapping[str, Any],
    *,
    transition: Any = None,
    sojourn: Any = None,
    initial: Any = None,
    entry: Mapping[str, tuple[float, float]] | None = None,
) -> SwitchingModel:
    """Models that take turns, for a filter of interacting multiple models (Blom and Bar-Shalom 1988).

    It stands where a model does: `sigmax.run("SRCKF", sigmax.imm({"cruise": cruise, "turn": turn}, sojourn=[60, 10]),
    …)`. The beliefs of the modes are mixed before each motion, and each runs its own filter.

    Args:
        modes: a model by name, or a pair of a model and the filter that this mode takes in the place of the run's.
            They measure the same; their states may differ: components are the same where their names are.
        transition: probabilities (M, M) from a mode (row) to another (column) at each step, however long it is, or a
            function of dt that gives them. Without any transition a target stays in its mode.
        sojourn: seconds that a target stays in each mode on average, after which it takes any other, in the place of
            a transition: right for steps of any length. By name or in the order of the modes.
        initial: probabilities of the modes at the prior, by name or in their order. Without it the shares of time that
            the chain spends in each, and equal ones where it has none.
        entry: mean and variance by component: how a component that is not in every mode begins in one that has it.

    Returns:
        The model, whose state has the components of all modes.

    Raises:
        InputError: where the modes do not fit each other, or the numbers are no probabilities.
    """
    pairs = _pairs(modes)
    names, M = list(pairs), len(pairs)
    if transition is not None and sojourn is not None:
        raise InputError("transition and sojourn both say how modes change: give one of them")
    rates = None
    if sojourn is not None:
        rates, settled = _rates(_by_mode("sojourn", sojourn, names))
    elif transition is None:
        transition, settled = np.eye(M), np.full(M, 1 / M)
    elif callable(transition):
        transition = traceable(transition)
        # What a function of dt gives is seen at a second.
        settled = _settled(_stochastic("transition(1.0)", numbers("transition(1.0)", transition(jnp.asarray(1.0))), M))
    else:
        transition = _stochastic("transition", numbers("transition", transition), M)
        settled = _settled(transition)
    if initial is not None:
        settled = _by_mode("initial", initial, names)
        if not is_traced(settled) and not ((settled >= 0).all() and abs(settled.sum() - 1) < 1e-9):
            raise InputError(f"initial must be probabilities of {names} that sum to 1; they are {settled.tolist()}")
    entries = _entries(entry, [m for m, _ in pairs.values()])
    return SwitchingModel(pairs, transition, rates, settled, entries)


def _pairs(modes: Any) -> dict[str, tuple[Model, Any]]:
    if not isinstance(modes, Mapping) or not modes:
        raise InputError('modes must be models by name, imm({"cruise": model, "turn": (model, filter)}, …)')
    pairs = {}
    for name, given in modes.items():
        model, filter = given if isinstance(given, tuple) and len(given) == 2 else (given, None)
        if not isinstance(name, str) or not isinstance(model, Model) or isinstance(model, SwitchingModel):
            raise InputError(
                f"a mode is a sigmax.Model, or a pair of it and a filter, by name; {name!r} is {type(model).__name__}"
            )
        if model.bias is not None or model.fusion is not None:
            what = "a bias: write it into the state by sigmax.models.augment" if model.bias else "fused sensors"
            raise InputError(f"the mode {name!r} has {what}; modes know states and sensors alone")
        if filter is not None and not isinstance(filter, Filter | str):
            raise InputError(f"the filter of the mode {name!r} must be a name or a filter, not {type(filter).__name__}")
        pairs[name] = model, get(filter) if isinstance(filter, str) else filter
    (first, model), *others = ((name, m) for name, (m, _) in pairs.items())
    for name, other in others:
        if (list(other.sensors), other.measured) != (list(model.sensors), model.measured):
            raise InputError(
                f"all modes must measure the same: {name!r} has {other.measurement}, {first!r} {model.measurement}"
            )
    return pairs


def _by_mode(what: str, given: Any, names: Sequence[str]) -> Any:
    if isinstance(given, Mapping):
        for name in given:
            if name not in names:
                raise unknown("mode", name, names)
        missing = [name for name in names if name not in given]
        if missing:
            raise InputError(f"{what} has no entry for the modes {missing}")
        given = [given[name] for name in names]
    value = numbers(what, given)
    if value.shape != (len(names),):
        raise InputError(f"{what} must be {len(names)} numbers, one for each of {list(names)}; it has {value.shape}")
    return value


def _rates(times: Any) -> tuple[Rates, Any]:
    """The chain that stays so long in each mode and then takes any other, and its shares of time."""
    if not is_traced(times) and not ((times > 0).all() and np.isfinite(times).all()):
        raise InputError(f"sojourn must be positive seconds; it is {times.tolist()}: without changes leave it out")
    array: Any = jnp if is_traced(times) else np
    M = len(times)
    # Similar to a symmetric matrix, as the chain is the same backwards: D^½ A D^-½, D the shares of time.
    share, root = times / times.sum(), array.sqrt(times)
    A = array.ones((M, M)) / (root[:, None] * root[None]) / max(M - 1, 1)
    symmetric = A * (1 - np.eye(M)) - array.diag(1 / times) * (M > 1)
    values, vectors = array.linalg.eigh(symmetric)
    return Rates(vectors / root[:, None], values, vectors.T * root[None]), share


def _stochastic(what: str, P: Any, M: int) -> Any:
    if P.shape != (M, M):
        raise InputError(f"{what} must have the shape {(M, M)}, from row to column; it has {P.shape}")
    if not is_traced(P) and not ((P >= 0).all() and (abs(P.sum(1) - 1) < 1e-9).all()):
        raise InputError(f"each row of {what} must be probabilities that sum to 1; it is {np.asarray(P).tolist()}")
    return P


def _settled(P: Any) -> Any:
    """The shares of time of a chain; equal ones where they depend on where it began."""
    M = len(P)
    if is_traced(P):
        return np.full(M, 1 / M)
    _, s, right = np.linalg.svd(np.asarray(P, float).T - np.eye(M))
    alone = M > 1 and s[-2] > 1e-9
    share = np.abs(right[-1]) if alone else np.ones(M)
    return share / share.sum()


def _entries(entry: Any, models: Sequence[Model]) -> Entries:
    common = set.intersection(*(set(parts_by_name(m.components)) for m in models))
    parts = {label: part for m in models for label, part in parts_by_name(m.components).items()}
    partial = [label for label in parts if label not in common]
    given = dict(entry or {})
    for name, value in given.items():
        if name not in partial:
            raise InputError(f"entry names {name!r}, and what is not in every mode is {partial}")
        if not parts[name][2].flat:
            raise InputError(f"{name!r} turns or points, and has to be in every mode")
        shape = numbers(f"entry[{name!r}]", value).shape
        if shape != (2,):
            raise InputError(f"entry[{name!r}] must be a mean and a variance; it has the shape {shape}")
    missing = [label for label in partial if label not in given]
    if missing:
        raise InputError(
            f"{missing} are not in every mode: say by entry={{{missing[0]!r}: (mean, variance)}} how they begin"
        )
    made = tuple((name, *(_scalar(v) for v in given[name])) for name in partial)
    bad = [name for name, _, variance in made if not is_traced(variance) and not variance >= 0]
    if bad:
        raise InputError(f"entry must be a mean and a variance of at least 0; that of {bad[0]!r} is below")
    return made


def _scalar(value: Any) -> Any:
    return value if is_traced(value) else np.asarray(value, float)

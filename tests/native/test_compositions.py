"""Random functions give in C what they give in JAX, and read what the dependence analysis says they read."""

import warnings
from collections import Counter
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sigmax.dependence import reading
from tests.native.compositions import SIZES, composition, function, source, whole
from tests.native.judge import points, reference, traced, verdicts

jax.config.update("jax_enable_x64", True)
# Compiled in one program; a compiler takes longer over many short ones.
TOGETHER = 50
ROWS = points(sum(SIZES))


def written(seeds: range, dtype: Any) -> Iterator[tuple[int, Any]]:
    """Traced functions with their seeds; what JAX itself cannot trace, such as some derivatives, is left out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for seed in seeds:
            try:
                yield seed, traced(whole(function(composition(seed)), seed), SIZES, dtype)
            except (NotImplementedError, TypeError, ValueError):
                continue


def fuzzed(seeds: range, dtype: Any) -> tuple[list[str], Counter[str]]:
    """What is wrong, with the text of each function, and how many were judged, refused and left out."""
    wrong, tally = [], Counter[str]()
    for first in range(seeds.start, seeds.stop, TOGETHER):
        part = dict(written(range(first, min(first + TOGETHER, seeds.stop)), dtype))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = verdicts(list(part.values()), ROWS)
        for seed, verdict in zip(part, found, strict=True):
            tally["refused" if verdict.refused else "judged"] += 1
            tally["numbers judged, in per cent"] += 0 if verdict.refused else round(100 * verdict.judged)
            if verdict.wrong:
                text, said = shortest(seed, dtype)
                wrong.append(f"seed {seed}, {np.dtype(dtype)}, use {seed % 3}: {said}\n{text}")
    tally["left out"] = len(seeds) - tally["judged"] - tally["refused"]
    tally["numbers judged, in per cent"] //= max(tally["judged"], 1)
    return wrong, tally


def shortest(seed: int, dtype: Any) -> tuple[str, str]:
    """The text of a function that is wrong, without the statements that it is wrong without, and what is wrong."""
    lines = [line.strip() for line in composition(seed).splitlines()[1:-1]]

    def said(lines: list[str]) -> str:
        try:
            closed = traced(whole(function(source(lines)), seed), SIZES, dtype)
            return verdicts([closed], ROWS)[0].wrong
        except (NameError, NotImplementedError, TypeError, ValueError):
            return ""

    for line in list(reversed(lines)):
        without = [other for other in lines if other != line]
        if without and said(without):
            lines = without
    return source(lines), said(lines) or "only beside other functions"


def accepted(wrong: list[str], tally: Counter[str]) -> None:
    print(dict(tally))
    assert not wrong, f"{len(wrong)} wrong\n" + "\n".join(wrong[:20])
    # Else the law would be kept by saying nothing.
    assert tally["refused"] < 0.3 * sum(tally[k] for k in ("judged", "refused", "left out"))
    assert tally["numbers judged, in per cent"] > 80


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_random_functions_give_in_c_what_they_give_in_jax(dtype):
    accepted(*fuzzed(range(100) if dtype == np.float64 else range(100, 200), dtype))


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("part", range(5))
def test_many_random_functions_give_in_c_what_they_give_in_jax(part, dtype):
    first = 100_000 + 2000 * part + (1000 if dtype == np.float32 else 0)
    accepted(*fuzzed(range(first, first + 1000), dtype))
    # Thousands of compiled operations that nothing else needs.
    jax.clear_caches()


def misread(seed: int) -> str:
    """What is wrong in what a function is said to read, found by moving one component at a time."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        f = function(composition(seed))
        flat = whole(f, 0)
        closed = traced(flat, SIZES, np.float64)
        read = reading(flat, SIZES[0], (jax.ShapeDtypeStruct((SIZES[1],), jnp.float64),))
        start = ROWS[:4, : SIZES[0]]
        at, u = np.repeat(start, 3, 0), np.tile(ROWS[5, SIZES[0] :], (12, 1))
        for j in range(SIZES[0]):
            moved = at.copy()
            moved[:, j] += np.tile([0.0, 0.37, 0.74], 4)
            y = reference(closed, [moved, u])
            value = y.value.reshape(4, 3, -1)
            first, second = value[:, 1] - value[:, 0], value[:, 2] - value[:, 1]
            allowed = 1e-12 + 4 * y.tolerance.reshape(4, 3, -1).max((0, 1))
            known = np.isfinite(value).all((0, 1)) & y.sure.reshape(4, 3, -1).all((0, 1))
            for i in np.flatnonzero(known):
                masks = read.masks[read.results[i].index]
                if not masks.reads >> j & 1 and np.abs([first[:, i], second[:, i]]).max() > 0:
                    return f"component {i} is said not to read x[{j}]\n{composition(seed)}"
                # Where it enters as a straight line, a step has the same effect wherever it is made.
                steps = np.concatenate([first[:, i], second[:, i]])
                if not masks.nonlinear >> j & 1 and np.ptp(steps) > allowed[i]:
                    return f"component {i} is said to be straight in x[{j}]\n{composition(seed)}"
    return ""


def test_a_function_reads_no_more_than_it_is_said_to_and_is_as_straight():
    wrong = [text for text in map(misread, range(20)) if text]
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_many_functions_read_no_more_than_they_are_said_to_and_are_as_straight():
    wrong = [text for text in map(misread, range(1000, 2000)) if text]
    assert not wrong, "\n".join(wrong[:20])

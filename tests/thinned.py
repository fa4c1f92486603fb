"""Long lists of cases: some in the quick suite, all in the slow one."""

from collections.abc import Iterable
from typing import Any

import pytest


def thinned(cases: Iterable[Any], every: int, start: int = 0) -> list[Any]:
    """The cases for `parametrize`; all but each `every`-th from `start` on are slow."""
    marked = []
    for k, case in enumerate(cases):
        values = case if isinstance(case, tuple) else (case,)
        marked.append(pytest.param(*values, marks=[pytest.mark.slow] * (k % every != start)))
    return marked

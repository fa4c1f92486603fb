"""A noise of the motion that a filter finds as it goes."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sigmax.errors import InputError


@dataclass(frozen=True)
class AdaptiveQ:
    """Q of the model times a number that the last measurements say, or a number for each group of components.

    Attributes:
        memory: how many measurements are remembered, at least 2.
        groups: names of components of the state (deviations, on curved spaces) that share a number; their rows of the
            root of Q are multiplied by its square root. None for one number for all of Q.
    """

    memory: float = 100.0
    groups: tuple[tuple[str, ...], ...] | None = None

    def __post_init__(self) -> None:
        check_memory(self.memory)
        if self.groups is None:
            return
        each = self.groups if isinstance(self.groups, tuple) else None
        if not each or not all(isinstance(g, tuple) and g and all(isinstance(n, str) for n in g) for g in each):
            raise InputError(
                f"groups are names of components, such as [('x', 'vx'), ('y', 'vy')]; it is {self.groups!r}"
            )
        named = [name for group in each for name in group]
        if len(set(named)) < len(named):
            raise InputError(f"a component belongs to one group of an adaptive Q; these are {self.groups!r}")

    def __str__(self) -> str:
        groups = "" if self.groups is None else ", " + ", ".join("+".join(group) for group in self.groups)
        return f"adaptive({self.memory:g}{groups})"


def adaptive_Q(memory: float = 100.0, groups: Sequence[Sequence[str]] | None = None) -> AdaptiveQ:
    """Q found as a filter goes, for `sigmax.get(name, Q=…)`: the number of largest likelihood of the last innovations.

    Raises:
        InputError: for a memory that is no number of at least 2, or groups that are no names.
    """
    if groups is not None:
        try:
            groups = tuple((g,) if isinstance(g, str) else tuple(map(str, g)) for g in groups)
        except TypeError:
            raise InputError(
                f"groups are names of components, such as [('x', 'vx'), ('y', 'vy')]; it is {groups!r}"
            ) from None
    return AdaptiveQ(memory, groups)


def named_Q(Q: AdaptiveQ | str | None) -> AdaptiveQ | None:
    """An adaptive Q by its name: "adaptive", "adaptive(200)".

    Raises:
        InputError: for anything else.
    """
    if Q is None or isinstance(Q, AdaptiveQ):
        return Q
    found = _NAMED.fullmatch(Q.strip()) if isinstance(Q, str) else None
    if found is None:
        raise InputError(
            f"Q of a filter is 'adaptive', 'adaptive(MEASUREMENTS)' or sigmax.filters.adaptive_Q(…); it is {Q!r}"
        )
    try:
        return AdaptiveQ() if found[1] is None else AdaptiveQ(float(found[1]))
    except ValueError:
        raise InputError(f"the memory of an adaptive Q is a number of measurements; it is {found[1]!r}") from None


def check_memory(memory: Any) -> None:
    """Refuse a number of measurements that nothing can be averaged over.

    Raises:
        InputError: for what is no number of at least 2.
    """
    if isinstance(memory, bool) or not isinstance(memory, int | float) or not 2 <= memory < math.inf:
        raise InputError(f"the memory of an adaptive noise is a number of measurements, at least 2; it is {memory!r}")


_NAMED = re.compile(r"adaptive(?:\(([^()]*)\))?")

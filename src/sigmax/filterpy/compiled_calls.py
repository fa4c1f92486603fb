"""Half-steps as compiled calls: found again by what is in them, compiled anew where that has changed."""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sigmax.engine.backend import natively
from sigmax.engine.vectorized import bound
from sigmax.errors import InputError
from sigmax.filterpy.calls import is_same
from sigmax.filterpy.watch import watched
from sigmax.native import Refused, Unavailable
from sigmax.native.calls import extension
from sigmax.native.refusal import say_once
from sigmax.tracing import check_alike, traceable

# Multiplications, about: beyond it NumPy is quick enough, and compiling takes longer than seconds.
LARGEST = 2500


class CompiledCall:
    """A half-step compiled when it is first called, and again when what it watches has changed.

    Args:
        build: gives the function of arrays to be compiled.
        watching: the user's functions in it, and arrays.
        kind: of its results.
        points: how many points go through them.
        calls: of the same arguments, the functions with what they are called with, so that they can be compared with
            what was traced from them.
    """

    def __init__(
        self,
        build: Callable[[], Any],
        watching: Sequence[Any],
        kind: type[Any],
        points: int = 0,
        calls: Callable[..., Any] = lambda *given: (),
    ) -> None:
        self._build, self._watching, self._kind, self._points, self._check = build, watching, kind, points, calls
        self._calls: dict[Any, Any] = {}
        self._last: Any = _not_so
        self._unchanged: Callable[[], bool] | None = None

    def __call__(self, *given: Any) -> Any:
        """Its result, NotImplemented where it cannot be had so."""
        if self._unchanged is None or not self._unchanged():
            self._calls.clear()
            self._last, self._unchanged = _not_so, watched(*self._watching)
        made = self._last(*given)
        if made is not NotImplemented:
            return made
        key = tuple(a.shape if type(a) is np.ndarray else () for a in given)
        if key not in self._calls:
            self._calls[key] = self._compiled(given, key)
        self._last = self._calls[key]
        return self._last(*given)

    def _compiled(self, given: Sequence[Any], shapes: Any) -> Any:
        rows = max((shape[0] for shape in shapes if shape), default=0)
        numbers = all(isinstance(a, float | int) or (type(a) is np.ndarray and a.dtype == float) for a in given)
        if not numbers or rows * rows * (self._points + 2 * rows) > LARGEST or extension() is None:
            return _not_so
        try:
            for function, arguments in self._check(*given):
                check_alike(traceable(function), [[np.asarray(a, float) for a in arguments]])
            with natively():
                return bound(self._build(), shapes, self._kind)
        except (Refused, Unavailable, InputError) as error:
            name = getattr(self._watching[0], "__name__", "a function") if self._watching else "a step"
            say_once(f"{name} runs as it is, not compiled: {error}")
        except Exception:  # what the function itself raises is raised where it is called
            return _not_so
        return _not_so


class Recent:
    """The half-steps that a filter compiled last; a copy of the filter begins without any.

    Attributes:
        last: what was called last and its half-step, by kind.
        found: the latest of all.
    """

    __slots__ = ("found", "last")

    def __init__(self) -> None:
        self.last: dict[bool, tuple[Any, Any]] = dict.fromkeys((True, False), ((None,), None))
        self.found: deque[tuple[Any, Any, CompiledCall]] = deque(maxlen=8)

    def __reduce__(self) -> Any:
        return Recent, ()

    def compiled(self, kind: Any, now: tuple[Any, ...], make: Callable[[], CompiledCall]) -> CompiledCall:
        """The half-step of a kind with these functions and arrays: one that is known, or another."""
        for other, before, known in self.found:
            if other == kind and all(map(is_same, now, before)):
                return known
        self.found.append((kind, now, make()))
        return self.found[-1][2]


def _not_so(*given: Any) -> Any:
    return NotImplemented

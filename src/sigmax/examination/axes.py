"""Other axes that vectors and attitudes may have been written down in: NED for ENU, a quaternion's scalar last."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np

from sigmax.examination.envelope import Envelope, component_names, input_names
from sigmax.examination.record_data import Alternative, RecordData
from sigmax.spaces import Direction, Rotation

Change = Callable[[RecordData], RecordData]
# Conventions with a name: which component stands in each place, and with which sign.
_NAMED = {
    ((1, 0, 2), (1, 1, -1)): "north, east, down against east, north, up",
    ((0, 1, 2), (1, -1, -1)): "forward, left, up against forward, right, down",
    ((0, 1), (-1, -1)): "the other way round",
    ((1, 0), (1, -1)): "a quarter turn",
    ((1, 0), (-1, 1)): "a quarter turn",
}
# What may be otherwise with curved parts, how it is mended, in which order and with which signs.
_OTHERWISE = {
    Rotation: (
        ("is a quaternion with its scalar last; the model has it first", "put it first", (3, 0, 1, 2), (1, 1, 1, 1)),
        ("is the inverse turn, world to body for body to world", "take its inverse", (0, 1, 2, 3), (1, -1, -1, -1)),
    ),
    Direction: (("points the other way", "take its negative", (0, 1, 2), (-1, -1, -1)),),
}


def of_axes(family: Envelope) -> Iterator[Alternative]:
    """Vectors among the inputs, and lengths and attitudes of the sensors, in other axes."""
    names = input_names(family.plain, family.driven)
    for places in vectors([p.at for p in family.parameters if p.kind == "input rotation"]):
        yield from _of_vector([names[i] for i in places], places, _inputs)
    for s, m in family.sizes:
        own = component_names(family.plain, s, m)
        pairs = [p.at for p in family.parameters if p.kind == "rotation" and p.sensor == s]
        for places in vectors(pairs):
            for a in _of_vector([own[i] for i in places], places, _values(s)):
                yield replace(a, sensor=s)
        yield from _of_attitudes(family, s)


def vectors(pairs: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """Vectors of two components and of three, from pairs of neighbours that are components of one."""
    found = list[tuple[int, ...]]()
    for i, j in pairs:
        if found and found[-1][-1] == i and len(found[-1]) == 2:
            found[-1] = (*found[-1], j)
        else:
            found.append((i, j))
    return found


def _of_vector(names: Sequence[str], places: tuple[int, ...], changed: Callable[..., Change]) -> Iterator[Alternative]:
    """All axes but those of one other sign, or of two neighbours exchanged, which have kinds of their own."""
    k = len(places)
    every = [
        (order, signs)
        for order in permutations(range(k))
        for signs in product((1, -1), repeat=k)
        if not _has_its_own_kind(order, signs)
    ]
    where = ", ".join(names)
    for order, signs in every:
        now = ", ".join(f"{'−' if c < 0 else ''}{names[i]}" for i, c in zip(order, signs, strict=True))
        known = f" ({_NAMED[order, signs]})" if (order, signs) in _NAMED else ""
        yield Alternative(
            "axes",
            where,
            f"the axes of {where} are not those of the model{known}",
            f"give ({now})",
            changed(places, order, signs),
            cost=2.0 + float(np.log(len(every))),
        )


def _has_its_own_kind(order: tuple[int, ...], signs: tuple[int, ...]) -> bool:
    """Whether nothing changes, or one sign, or two neighbours."""
    moved = [i for i, j in enumerate(order) if i != j]
    if not moved:
        return sum(signs) >= len(signs) - 2
    return min(signs) > 0 and len(moved) == 2 and moved[1] - moved[0] == 1


def _inputs(places: tuple[int, ...], order: tuple[int, ...], signs: tuple[int, ...]) -> Change:
    return lambda r: replace(r, u=_other(r.u, places, order, signs))


def _values(s: str) -> Callable[..., Change]:
    def changed(places: tuple[int, ...], order: tuple[int, ...], signs: tuple[int, ...]) -> Change:
        return lambda r: replace(r, z=r.z | {s: _other(r.z[s], places, order, signs)})

    return changed


def _other(a: np.ndarray, places: Sequence[int], order: Sequence[int], signs: Sequence[int]) -> np.ndarray:
    """Columns (T, k), those at `places` taken from others of them, with signs."""
    made = a.copy()
    made[:, list(places)] = a[:, [places[i] for i in order]] * np.array(signs)
    return made


def _of_attitudes(family: Envelope, s: str) -> Iterator[Alternative]:
    """A sensor's quaternions with the scalar last, or of the inverse turn, and its directions the other way."""
    own = family.plain.measured[s]
    if own is None:
        return
    for space, at, _ in own.space.parts():
        whole = tuple(range(at.start, at.stop))
        where = ", ".join(f"{s}.{n}" if s else n for n in own.numbers[at])
        for cause, mend, order, signs in _OTHERWISE.get(type(space), ()):
            change = _values(s)(whole, order, signs)
            yield Alternative("convention", where, f"{where}: it {cause}", mend, change, sensor=s)

"""What has been summed so far, on disk: a study that was stopped goes on where it stopped."""

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sigmax.leftovers import clear_leftovers, part_of
from sigmax.signals import undone_by_signal
from sigmax.studies.bound import Information
from sigmax.studies.sums import Sums
from sigmax.studies.work import Done

FILE = "sums.npz"


class Totals(NamedTuple):
    """Sums over the runs from the first on.

    Attributes:
        blocks: how many blocks of runs they are of.
        escaped: runs of which the truth escaped.
        all: by filter, over all of these.
        pieces: how many pieces of runs the optimum was found for.
        paired: by filter and for the optimum, over those.
        told: for the bound.
    """

    blocks: int
    escaped: int
    all: Mapping[str, Sums]
    pieces: int
    paired: Mapping[str, Sums]
    told: Information | None


NOTHING = Totals(0, 0, {}, 0, {}, None)


def add(totals: Totals, done: Done) -> Totals:
    """The totals with one block more."""
    told = done.told if totals.told is None else totals.told if done.told is None else totals.told.plus(done.told)
    return totals._replace(
        blocks=totals.blocks + 1,
        escaped=totals.escaped + done.escaped,
        all=_plus(totals.all, done.sums),
        told=told,
    )


def add_paired(totals: Totals, sums: Mapping[str, Sums]) -> Totals:
    """The totals with one piece more for which the optimum was found."""
    return totals._replace(pieces=totals.pieces + 1, paired=_plus(totals.paired, sums))


def _plus(before: Mapping[str, Sums], more: Mapping[str, Sums]) -> dict[str, Sums]:
    return {**before, **{name: before[name].plus(s) if name in before else s for name, s in more.items()}}


def store(path: Path, totals: Totals, settings: Mapping[str, Any]) -> None:
    """Write the totals with what they depend on; the file is replaced at once or not at all."""
    arrays: dict[str, np.ndarray] = {}
    for kind in ("all", "paired"):
        for name, s in getattr(totals, kind).items():
            arrays |= {f"{kind}/{name}/{field}": value for field, value in s._asdict().items()}
    if totals.told is not None:
        arrays |= {f"told/{field}": value for field, value in totals.told._asdict().items()}
    about = {"settings": settings, "blocks": totals.blocks, "escaped": totals.escaped, "pieces": totals.pieces}
    path.parent.mkdir(parents=True, exist_ok=True)
    clear_leftovers(path)
    part = part_of(path)
    with undone_by_signal(partial(part.unlink, missing_ok=True)):
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, about=np.array(json.dumps(about)), **arrays)
        part.replace(path)


def restore(path: Path, settings: Mapping[str, Any], like: Mapping[str, Sums], size: int) -> tuple[Totals, str]:
    """The totals of a file that was made with the same settings, and why they are not used where they are not.

    Args:
        path: of the file; where there is none there is nothing, and nothing to say.
        settings: what the sums depend on.
        like: sums of some runs, by filter, which those of the file must resemble.
        size: runs of a block.
    """
    if not path.exists():
        return NOTHING, ""
    try:
        totals, theirs = _read(path)
    except Exception as error:  # whatever reading a damaged archive may raise
        return NOTHING, f"{path.name} is damaged ({type(error).__name__}), so this study begins anew"
    if theirs != json.loads(json.dumps(settings)):
        return NOTHING, f"{path.name} is of another study, of other settings or another version; this one begins anew"
    if not _resembles(totals, like, size):
        return NOTHING, f"{path.name} does not hold the sums of this study, which begins anew"
    return totals, ""


def _read(path: Path) -> tuple[Totals, Any]:
    found: dict[str, dict[str, dict[str, np.ndarray]]] = {"all": {}, "paired": {}}
    told: dict[str, np.ndarray] = {}
    with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
        about = json.loads(str(file["about"]))
        for key in file.files:
            kind, _, rest = key.partition("/")
            if kind == "told":
                told[rest] = file[key]
            elif kind in found:
                name, _, field = rest.rpartition("/")
                found[kind].setdefault(name, {})[field] = file[key]
    return Totals(
        int(about["blocks"]),
        int(about["escaped"]),
        {name: Sums(**fields) for name, fields in found["all"].items()},
        int(about["pieces"]),
        {name: Sums(**fields) for name, fields in found["paired"].items()},
        Information(**told) if told else None,
    ), about["settings"]


def _resembles(totals: Totals, like: Mapping[str, Sums], size: int) -> bool:
    """Whether sums have the shapes of this study's, and are of as many runs as they should be."""
    if totals.all.keys() != like.keys() or totals.blocks < 1:
        return False
    pattern = next(iter(like.values()))
    for s in (*totals.all.values(), *totals.paired.values()):
        if any(np.shape(a) != np.shape(b) or a.dtype.kind != b.dtype.kind for a, b in zip(s, pattern, strict=True)):
            return False
    return all(int(s.runs) + totals.escaped == totals.blocks * size for s in totals.all.values())

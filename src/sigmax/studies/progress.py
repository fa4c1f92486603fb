"""What has been summed so far, on disk: a study that was stopped goes on where it stopped."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sigmax.studies.bound import Information
from sigmax.studies.sums import Sums
from sigmax.studies.work import CHECK, OPTIMUM, Done

FILE = "sums.npz"


class Totals(NamedTuple):
    """Sums over the blocks from the first on.

    Attributes:
        blocks: how many blocks they are of.
        escaped: runs of which the truth escaped.
        all: by filter, over all of these.
        paired: by filter and for the optimum, over the blocks in which the optimum was computed.
        told: for the bound.
    """

    blocks: int
    escaped: int
    all: Mapping[str, Sums]
    paired: Mapping[str, Sums]
    told: Information | None


NOTHING = Totals(0, 0, {}, {}, None)


def add(totals: Totals, done: Done) -> Totals:
    """The totals with one block more."""
    sums, told = done.sums, done.told
    return Totals(
        totals.blocks + 1,
        totals.escaped + done.escaped,
        _plus(totals.all, {name: s for name, s in sums.items() if name not in (OPTIMUM, CHECK)}),
        _plus(totals.paired, sums) if OPTIMUM in sums else totals.paired,
        told if totals.told is None else totals.told if told is None else totals.told.plus(told),
    )


def _plus(before: Mapping[str, Sums], more: Mapping[str, Sums]) -> dict[str, Sums]:
    return {name: before[name].plus(s) if name in before else s for name, s in more.items()}


def store(path: Path, totals: Totals, settings: Mapping[str, Any]) -> None:
    """Write the totals with what they depend on; the file is replaced at once or not at all."""
    arrays: dict[str, np.ndarray] = {}
    for kind in ("all", "paired"):
        for name, s in getattr(totals, kind).items():
            arrays |= {f"{kind}/{name}/{field}": value for field, value in s._asdict().items()}
    if totals.told is not None:
        arrays |= {f"told/{field}": value for field, value in totals.told._asdict().items()}
    about = json.dumps({"settings": settings, "blocks": totals.blocks, "escaped": totals.escaped})
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with part.open("wb") as file:
        np.savez(file, allow_pickle=False, about=np.array(about), **arrays)
    part.replace(path)


def restore(path: Path, settings: Mapping[str, Any]) -> Totals:
    """The totals of a file that was made with the same settings; nothing where there is none."""
    try:
        with np.load(path) as file:
            about = json.loads(str(file["about"]))
            if about["settings"] != json.loads(json.dumps(settings)):
                return NOTHING
            found: dict[str, dict[str, dict[str, np.ndarray]]] = {"all": {}, "paired": {}}
            told: dict[str, np.ndarray] = {}
            for key in file.files:
                kind, _, rest = key.partition("/")
                if kind == "told":
                    told[rest] = file[key]
                elif kind in found:
                    name, _, field = rest.rpartition("/")
                    found[kind].setdefault(name, {})[field] = file[key]
            return Totals(
                about["blocks"],
                about["escaped"],
                {name: Sums(**fields) for name, fields in found["all"].items()},
                {name: Sums(**fields) for name, fields in found["paired"].items()},
                Information(**told) if told else None,
            )
    except (OSError, ValueError, KeyError, TypeError, EOFError):
        # Missing, of another version, or damaged: the study begins anew.
        return NOTHING

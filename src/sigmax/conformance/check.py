"""All laws on one implementation; a law that ends in an exception is broken, and says how."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from sigmax.conformance.laws import LAWS, Law
from sigmax.conformance.task import Adapter
from sigmax.errors import unknown


@dataclass(frozen=True)
class Outcome:
    """What became of a law.

    Attributes:
        law: which.
        figure: what was measured, NaN where nothing came out, None where the law does not apply.
        note: the exception, or what the implementation does not offer.
    """

    law: Law
    figure: float | None
    note: str = ""

    @property
    def applies(self) -> bool:
        """Whether the implementation offers what the law is about."""
        return self.figure is not None

    @property
    def kept(self) -> bool:
        """Whether the figure is within what is allowed."""
        return self.figure is not None and self.figure <= self.law.allowed


def check(adapter: Adapter, laws: Iterable[str] | None = None) -> list[Outcome]:
    """Run laws, all of them unless named, against an implementation; a few seconds to a minute.

    Raises:
        InputError: for a law that there is not.
    """
    chosen = list(LAWS if laws is None else [laws] if isinstance(laws, str) else laws)
    for name in chosen:
        if name not in LAWS:
            raise unknown("law", name, LAWS)
    return [_one(adapter, LAWS[name]) for name in chosen]


def _one(adapter: Adapter, law: Law) -> Outcome:
    missing = law.needs - adapter.offers
    if missing:
        return Outcome(law, None, f"offers no {', '.join(sorted(missing))}")
    if adapter.degree < law.degree:
        return Outcome(law, None, f"exact to degree {adapter.degree}")
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return Outcome(law, float(law.measure(adapter)))
    except Exception as error:  # whatever a library raises is its answer
        said = str(error).strip().splitlines()
        return Outcome(law, float("nan"), f"{type(error).__name__}: {said[0][:100] if said else ''}")

"""A bank of filters as a filter: a sum of Gaussians that splits where a sensor bends, and merges again."""

from dataclasses import dataclass, replace

from sigmax.errors import InputError
from sigmax.filters.catalogue import get
from sigmax.filters.filter import Filter, ModeFilters

_FEWEST, _MOST = 3, 31
# A split makes three of one, of the nodes of Gauss and Hermite.
_PER_SPLIT = 2


@dataclass(frozen=True)
class Bank(Filter):
    """A Gaussian sum filter: members that share a belief among them; its own parts are those of a member.

    Attributes:
        member: the filter of each member.
        kept: members between measurements.
        splits: how many members a measurement may split in three; each adds two.
        bend: what a sensor may depart from its line within a member, in deviations of its noise, before that is split.
    """

    member: Filter | None = None
    kept: int = 3
    splits: int = 3
    bend: float = 0.5

    @property
    def one(self) -> Filter:
        """The filter of each member."""
        assert self.member is not None
        return self.member

    def on(self, biases: int) -> "Bank":
        """The bank as it runs on a model with so many biases."""
        return bank_of(self.one.on(biases), self)


def bank_of(member: Filter, like: Bank) -> Bank:
    """A bank of other members."""
    parts = {name: getattr(member, name) for name in ("predict", "correct", "form", "linear", "update")}
    return replace(like, member=member, **parts)


def bank(filter: Filter | str, members: int = 9, bend: float = 0.5) -> Bank:
    """A bank of filters as one filter, where the posterior of one is no Gaussian: ranges to a beacon, bearings.

    Before a measurement the members whose sensor bends most within them, by weight, are split in three along the
    direction in which it bends (nodes of Gauss and Hermite, mean and covariance kept); afterwards the lightest are
    merged until a third is left (Runnalls 2007). A Gaussian sum filter (Alspach and Sorenson 1972). The work of a
    third of the members in predictions, of all in corrections.

    Args:
        filter: that of the members, a name or a filter.
        members: while a measurement is taken, an odd number from 3 to 31.
        bend: what the sensor may depart from its line at one deviation of a member, in deviations of the noise,
            before the member is split; above 0.

    Raises:
        InputError: for a filter that cannot be a member, or numbers out of their range.
    """
    member = get(filter) if isinstance(filter, str) else filter
    if not isinstance(member, Filter) or isinstance(member, Bank | ModeFilters):
        raise InputError(f"a bank needs a filter of one belief for its members, such as 'SRCKFB'; it is {member!r}")
    whole = isinstance(members, int) and not isinstance(members, bool)
    if not whole or not _FEWEST <= members <= _MOST or members % 2 == 0:
        raise InputError(f"members of a bank are an odd number from {_FEWEST} to {_MOST}; it is {members!r}")
    if isinstance(bend, bool) or not isinstance(bend, int | float) or not bend > 0:
        raise InputError(f"bend of a bank is a number above 0, in deviations of the sensor's noise; it is {bend!r}")
    # An odd number stays, so that splits fill the rest.
    kept = members // 3 if (members - members // 3) % _PER_SPLIT == 0 else members // 3 + 1
    like = Bank(
        member.predict,
        member.correct,
        member.form,
        name=f"{member.name}, bank of {members}",
        kept=kept,
        splits=(members - kept) // _PER_SPLIT,
        bend=float(bend),
    )
    return bank_of(member, like)

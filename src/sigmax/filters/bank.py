"""A bank of filters as a filter: a sum of Gaussians that splits where a sensor bends, and merges again."""

from dataclasses import dataclass

from sigmax.errors import InputError
from sigmax.filters.filter import Filter, ModeFilters

# Fewer than three between measurements lose what a split has found: worse than one filter with a single beacon.
_FEWEST_KEPT, _FEWEST, _MOST = 3, 5, 31


@dataclass(frozen=True, repr=False)
class Bank(Filter):
    """A Gaussian sum filter: members that share a belief among them; its parts are those of each member.

    Attributes:
        kept: members between measurements.
        splits: how many members a measurement may split in three; each adds two.
        bend: what a sensor may depart from its line within a member, in deviations of its noise, before that is split.
    """

    kept: int = 3
    splits: int = 3
    bend: float = 0.5

    @property
    def member(self) -> Filter:
        """The filter of each member."""
        return Filter(self.predict, self.correct, self.form, self.name, self.linear, self.update)


def bank_of(member: Filter, members: int, bend: float = 0.5) -> Bank:
    """A bank of so many members while a measurement is taken.

    Raises:
        InputError: for a filter that cannot be a member, or numbers out of their range.
    """
    if not isinstance(member, Filter) or isinstance(member, Bank | ModeFilters):
        what = member.name if isinstance(member, Filter) else repr(member)
        raise InputError(f"a bank needs a filter of one belief for its members, such as 'SRCKFB'; it is {what}")
    if member.consider:
        raise InputError(
            f"members of a bank differ in what they know; {member.name} holds {member.consider[0]} for all"
        )
    if member.Q is not None:
        raise InputError(f"members of a bank would each find a Q of their own; {member.name} adapts it: leave that out")
    if isinstance(members, bool) or not isinstance(members, int) or not _FEWEST <= members <= _MOST or members % 2 == 0:
        raise InputError(f"members of a bank are an odd number from {_FEWEST} to {_MOST}; it is {members!r}")
    if isinstance(bend, bool) or not isinstance(bend, int | float) or not bend > 0:
        raise InputError(f"bend of a bank is a number above 0, in deviations of the sensor's noise; it is {bend!r}")
    # A split makes three of one; an odd number is kept, so that splits fill the rest.
    kept = max(_FEWEST_KEPT, (2 * members // 5 + 1) // 2 * 2 - 1)
    name = f"{member.name[:-1]}, " if member.name.endswith(")") else f"{member.name}("
    return Bank(
        member.predict,
        member.correct,
        member.form,
        name=f"{name}members={members})",
        linear=member.linear,
        update=member.update,
        kept=kept,
        splits=(members - kept) // 2,
        bend=float(bend),
    )


def of_one_belief(filter: Filter) -> Filter:
    """The filter itself; that of the members of a bank, which is smoothed as one belief: they merge on the way."""
    return filter.member if isinstance(filter, Bank) else filter

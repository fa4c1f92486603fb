"""One other reading of a record as a whole."""

from collections.abc import Callable
from dataclasses import dataclass

from sigmax.examination.envelope_runs import RecordData


@dataclass(frozen=True)
class Alternative:
    """One of them.

    Attributes:
        kind: "degrees", "units", "sign", "turned", "convention", "swap", "axes", "time units", "prior" or "manoeuvre".
        where: what is changed.
        cause: in words.
        mend: what to do.
        change: of the record.
        jacobian: added to the log-likelihood of changed values, which is that of the values as they came.
        factor: what the values are multiplied by; 0 where they are changed in another way.
        sensor: whose values are read in another way; None for anything else.
        cost: what it costs in log-likelihood for the choice among them.
    """

    kind: str
    where: str
    cause: str
    mend: str
    change: Callable[[RecordData], RecordData]
    jacobian: float = 0.0
    factor: float = 0.0
    sensor: str | None = None
    cost: float = 2.0

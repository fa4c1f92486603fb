"""What stations tell each other of a measurement: information, and the message that carries it."""

import json
from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import finite, numbers, symmetric_semidefinite

FORMAT = "sigmax contribution 1"


class Contribution(NamedTuple):
    """What one measurement adds, (i, I): in the space of the measurement or in that of the state.

    Measurement: I = R⁻¹, i = R⁻¹ (z − a). State: I = Hᵀ R⁻¹ H, i = Hᵀ R⁻¹ ν, linearised at a, state and bias
    in the order of `components`; the paper's i is i + I a. Either adds up over stations.

    Attributes:
        space: "measurement" or "state".
        sensor: its name.
        components: what the rows of i are.
        about: a, what i is counted from.
        vector: i.
        matrix: I; rows of what was not seen are 0.
        square: (z − a)ᵀ R⁻¹ (z − a), and 0 for the state.
        volume: log |R| of what was seen, and 0 for the state.
        seen: how many components of the measurement were seen.
        time: seconds, as the sender counts them; only carried along.
    """

    space: str
    sensor: str
    components: tuple[str, ...]
    about: np.ndarray
    vector: np.ndarray
    matrix: np.ndarray
    square: float
    volume: float
    seen: int
    time: float | None = None

    def to_json(self) -> str:
        """The message: one JSON object, its numbers exact."""
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in self._asdict().items()}
        return json.dumps({"format": FORMAT, **plain, "components": list(map(str, self.components))})

    @classmethod
    def from_json(cls, text: str | bytes) -> "Contribution":
        """The contribution of a message.

        Raises:
            InputError: where it is none.
        """
        try:
            given = json.loads(text)
        except (ValueError, TypeError) as error:
            raise InputError(f"this is no message of the format {FORMAT!r}: {error}") from error
        if not isinstance(given, dict) or given.pop("format", None) != FORMAT:
            raise InputError(f"this message is not of the format {FORMAT!r}")
        given = {"time": None} | given
        wrong = sorted(given.keys() ^ set(cls._fields))
        if wrong:
            raise InputError(f"a message of the format {FORMAT!r} has the fields {list(cls._fields)}; see {wrong}")
        return cls(**_checked(given))


def _checked(given: dict[str, Any]) -> dict[str, Any]:
    """The fields of a message, each of its kind.

    Raises:
        InputError: naming the field that is not.
    """
    if given["space"] not in ("measurement", "state"):
        raise InputError(f'space of a contribution is "measurement" or "state"; this one has {given["space"]!r}')
    if not isinstance(given["sensor"], str):
        raise InputError(f"sensor of a contribution is a name; this one has {given['sensor']!r}")
    names = given["components"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f"components of a contribution are a list of names; this one has {names!r}")
    n = len(names)
    shapes = {"about": (n,), "vector": (n,), "matrix": (n, n), "square": (), "volume": (), "seen": ()}
    if given["time"] is not None:
        shapes["time"] = ()
    made = {field: numbers(f"{field} of a contribution", given[field]) for field in shapes}
    for field, shape in shapes.items():
        if made[field].shape != shape:
            raise InputError(
                f"{field} of a contribution to {n} components must have the shape {shape}; it has {made[field].shape}"
            )
        finite(f"{field} of a contribution", made[field])
    symmetric_semidefinite("matrix of a contribution", made["matrix"])
    counted = int(made["seen"])
    if given["space"] == "measurement":
        # In units of its own rows: a range and an angle may be known to 1e8 times each other's precision.
        own = np.sqrt(np.diagonal(made["matrix"]))
        rows = own > 0
        counted = int(rows.sum())
        scaled = made["matrix"][np.ix_(rows, rows)] / np.outer(own[rows], own[rows])
        if np.linalg.matrix_rank(scaled, hermitian=True) < counted:
            raise InputError("matrix of a contribution of a measurement is R⁻¹ and must have an inverse")
    if made["seen"] != counted or counted < 0:
        raise InputError(f"seen of a contribution must count what was measured; it is {given['seen']!r}")
    plain = {field: float(made[field]) for field in ("square", "volume", "time") if field in made}
    return given | made | plain | {"components": tuple(names), "seen": counted}

"""Errors for people: what was given, what was expected, how to mend it."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Something given to the library does not fit; the message says what to change."""


class FoldingWarning(UserWarning):
    """Sigma points lie so far apart that angles or rotations come back from the other side."""


class BendingWarning(UserWarning):
    """A bank has too few members for what a sensor bends within the prior."""


def _known(names: list[str]) -> str:
    return f"known: {', '.join(map(repr, names))}" if any(names) else "none here has a name"


def unknown(kind: str, name: object, known: Iterable[str]) -> InputError:
    """The error for a name that is not known, with the nearest ones that are."""
    names = sorted(known)
    folded = {n.casefold(): n for n in names}
    asked = str(name).casefold()
    # Letters in the wrong order are the likeliest slip; after that, the nearest spelling.
    near = difflib.get_close_matches(asked, folded, n=4, cutoff=0.5)
    anagrams = [n for n in folded if sorted(n) == sorted(asked)]
    near = list(dict.fromkeys([*anagrams, *near]))
    hint = f"did you mean {' or '.join(folded[n] for n in near[:3])}?" if near else _known(names)
    return InputError(f"unknown {kind} {name!r}; {hint}")


# Packages of the extra `app`.
APP = ("cloudpickle", "joblib", "matplotlib", "orjson", "pandas", "pyarrow", "pydantic", "rich", "tomlkit", "typer")


def without_app(what: str, error: ModuleNotFoundError) -> str | None:
    """What to install where the core alone is installed; None where something else is missing."""
    package = (error.name or "").partition(".")[0]
    if package not in APP:
        return None
    return f"{what} needs {package}, which is not part of a core install: pip install 'sigmax[app]'"

"""Changes in a TOML file that leave everything else as it was written."""

from collections.abc import Sequence
from typing import Any

import tomlkit
from tomlkit.items import InlineTable, Item

from sigmax.errors import InputError
from sigmax.files.units import parts_of_quantity

Path = Sequence[str | int]


def scaled(given: Any, factor: float) -> Any:
    """A quantity such as "30 m" or 30 times a factor, to four digits, in its own unit."""
    if isinstance(given, str):
        value, unit = parts_of_quantity(given)
        return f"{value * factor:.4g}{f' {unit}' if unit else ''}"
    return float(f"{given * factor:.4g}")


class Document:
    """A TOML text whose values can be changed; comments and order stay."""

    def __init__(self, text: str) -> None:
        self._doc = tomlkit.parse(text)

    @property
    def text(self) -> str:
        """As it stands now."""
        return tomlkit.dumps(self._doc)

    @text.setter
    def text(self, text: str) -> None:
        self._doc = tomlkit.parse(text)

    def get(self, at: Path) -> Any:
        """The plain value at a path of keys and places."""
        found: Any = self._doc
        for key in at:
            found = found[key]
        return found.unwrap() if hasattr(found, "unwrap") else found

    def put(self, at: Path, value: Any, reason: str) -> None:
        """Set a value, and say why behind its line, after what stands there already."""
        above = self._parents(at)
        above[-1][at[-1]] = _inline(value)
        # An inline table has one line for all that is in it.
        depth = max(i for i, parent in enumerate(above) if not isinstance(parent, InlineTable))
        _say(above[depth][at[depth]], reason)

    def add(self, at: Path, table: dict[str, Any], reason: str) -> None:
        """A new table at the end, with the reason above its keys."""
        made = tomlkit.table()
        made.add(tomlkit.comment(_plain(reason)))
        for key, value in table.items():
            made.add(key, _inline(value))
        group = self._doc.get(at[0])
        if group is None:
            group = tomlkit.table(is_super_table=True)
            self._doc.add(tomlkit.nl())
            self._doc.add(str(at[0]), group)
        group.add(str(at[1]), made)

    def _parents(self, at: Path) -> list[Any]:
        found: list[Any] = [self._doc]
        for key in at[:-1]:
            try:
                found.append(found[-1][key])
            except (KeyError, IndexError, TypeError):
                raise InputError(f"{'.'.join(map(str, at))} is written in a way that is not understood") from None
        return found


def _inline(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    made = tomlkit.inline_table()
    made.update(value)
    return made


def _plain(reason: str) -> str:
    return " ".join(reason.split())


def _say(line: Item, reason: str) -> None:
    before = line.trivia.comment.lstrip("# ").strip()
    line.comment(_plain(reason) if not before else f"{before}; {_plain(reason)}" if reason not in before else before)

"""Descriptions that a command leaves beside those that it read, such as NAME-corrected.toml."""

from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.markup import escape

from sigmax.corrections.correct import Correction
from sigmax.errors import InputError
from sigmax.records import load


class Beside(NamedTuple):
    """What the descriptions of one command are called.

    Attributes:
        done: what was done to them, the end of their name: "corrected".
        command: of sigmax, "doctor".
    """

    done: str
    command: str

    @property
    def mark(self) -> str:
        """The first words of such a description; only a file with them is written over."""
        return f"# {self.done.capitalize()} by sigmax {self.command} from"

    def target(self, name: str) -> Path:
        """Where the description goes.

        Raises:
            InputError: for a record without a description, and where something else stands there.
        """
        path = Path(name)
        if path.suffix.casefold() != ".toml":
            raise InputError(f"--write changes a description in TOML; {name} is built in and has none")
        target = path.with_name(f"{path.stem}-{self.done}{path.suffix}")
        if target.exists() and not target.read_text(encoding="utf-8", errors="replace").startswith(self.mark):
            raise InputError(f"{target} was not written by sigmax {self.command}: move it away")
        return target

    def write(self, path: Path, target: Path, correction: Correction, errors: Console, hint: str = "") -> None:
        """Write what was changed of the description at `path`; say so, and what is to be done by hand.

        Args:
            path: of the description.
            target: of the new one.
            correction: its text.
            errors: where it is said.
            hint: what to do with the new description, behind its path.
        """
        if correction.changed:
            target.write_text(
                f"{self.mark} {path.name}; what was changed says so.\n{correction.text}", encoding="utf-8"
            )
            load(str(target))
            errors.print(escape(f"written: {target}{hint}"), highlight=False, soft_wrap=True)
        else:
            errors.print("no file was written", highlight=False)
        for sentence in correction.left:
            errors.print(escape(sentence), highlight=False, soft_wrap=True)

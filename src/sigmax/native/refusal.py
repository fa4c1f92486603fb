"""What cannot be lowered, with the line of the model it came from."""

import traceback
from pathlib import Path
from typing import Any

import jax

# Lines of these are not the user's.
_INSIDE = (str(Path(jax.__file__).parent), str(Path(__file__).parents[1]), "<frozen")


class Refused(Exception):
    """A step holds something that the lowering does not cover.

    Args:
        what: in words.
        where: the line of the model it came from, as far as it is known.
    """

    def __init__(self, what: str, where: str = "") -> None:
        super().__init__(what)
        self.what, self.where = what, where

    def __str__(self) -> str:
        return f"{self.what}{f' ({self.where})' if self.where else ''}"


def line_of(equation: Any) -> str:
    """The innermost line outside the libraries that an equation came from, or nothing."""
    found = getattr(equation.source_info, "traceback", None)
    for frame in getattr(found, "frames", ()):
        if not frame.file_name.startswith(_INSIDE):
            return f"{Path(frame.file_name).name}, line {frame.line_num}, in {frame.function_name}"
    return ""


def user_line(error: BaseException) -> str:
    """The innermost line outside the libraries that an exception passed, or nothing."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if not frame.filename.startswith(_INSIDE):
            return f"{Path(frame.filename).name}, line {frame.lineno}, in {frame.name}"
    return ""

"""What cannot be lowered, with the line of the model it came from."""

import logging
import os
import sysconfig
import traceback
from pathlib import Path
from typing import Any, Self

import jax
import numpy as np

# Lines of these are not the user's.
_INSIDE = (*(str(Path(file).parent) for file in (jax.__file__, np.__file__)), str(Path(__file__).parents[1]), "<frozen")
_LIBRARY = sysconfig.get_paths()["stdlib"]


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


class Defect(Refused):
    """The lowering itself failed where it should have refused: a fault of this library, not of the model."""

    @classmethod
    def of(cls, what: str, error: BaseException, where: str = "") -> Self:
        """From the exception by which it failed."""
        said = " ".join(str(error).split())[:200]
        return cls(f"a defect of sigmax in {what}, please report it: {type(error).__name__}: {said}", where)


def defects_raised() -> bool:
    """Whether a defect is to be raised as it is, as the tests of this library want it: SIGMAX_DEFECTS=raise."""
    return os.environ.get("SIGMAX_DEFECTS") == "raise"


_said: set[str] = set()


def say_once(line: str) -> None:
    """A line of warning on the channel of this library, the same one only once."""
    if line not in _said:
        _said.add(line)
        logging.getLogger("sigmax").warning("%s", line)


def _is_users(file: str) -> bool:
    return not file.startswith(_INSIDE) and (not file.startswith(_LIBRARY) or "-packages" in file)


def line_of(equation: Any) -> str:
    """The innermost line outside the libraries that an equation came from, or nothing."""
    found = getattr(equation.source_info, "traceback", None)
    for frame in getattr(found, "frames", ()):
        if _is_users(frame.file_name):
            return f"{Path(frame.file_name).name}, line {frame.line_num}, in {frame.function_name}"
    return ""


def line_here() -> str:
    """The innermost line outside the libraries that is being run, or nothing."""
    return _innermost(traceback.extract_stack())


def user_line(error: BaseException) -> str:
    """The innermost line outside the libraries that an exception passed, or nothing."""
    return _innermost(traceback.extract_tb(error.__traceback__))


def _innermost(frames: traceback.StackSummary) -> str:
    users = [frame for frame in reversed(frames) if _is_users(frame.filename)]
    # What is installed is not the user's to mend.
    own = [frame for frame in users if "-packages" not in frame.filename] or users
    return f"{Path(own[0].filename).name}, line {own[0].lineno}, in {own[0].name}" if own else ""

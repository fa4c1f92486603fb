"""What cannot be lowered, with the line of the model it came from."""

from typing import Any

_INSIDE = ("/jax/", "/jaxlib/", "/sigmax/", "<frozen")


class Refused(Exception):
    """A step holds something that the lowering does not cover; the message says what and where."""


def line_of(equation: Any) -> str:
    """The innermost line outside the libraries that an equation came from, or nothing."""
    traceback = getattr(equation.source_info, "traceback", None)
    for frame in getattr(traceback, "frames", ()):
        file = frame.file_name.replace("\\", "/")
        if not any(part in file for part in _INSIDE):
            return f" ({file.rsplit('/', 1)[-1]}, line {frame.line_num}, in {frame.function_name})"
    return ""

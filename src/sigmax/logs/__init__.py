"""Log files of devices as tables, each format by the package that is kept for it."""

from sigmax.logs.formats import FORMATS, Format, format_of
from sigmax.logs.read import Log, read_log

__all__ = ["FORMATS", "Format", "Log", "format_of", "read_log"]

"""Filters written out as source code for other machines."""

from sigmax.export.folder import Exported, export_c

__all__ = ["Exported", "export_c"]

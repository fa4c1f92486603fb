"""Data files inside the PyPI package gtsam, which is found but never imported: importing it takes seconds."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sigmax.errors import InputError


def gtsam_data(record: str, file: str, read: Callable[[Path], Any]) -> Any:
    """What `read` makes of a data file of gtsam.

    Args:
        record: the name of the record that wants it, for messages.
        file: its name in the package's folder of data.
        read: takes a path.

    Raises:
        InputError: where the package is missing, or has no such file or another one.
    """
    package = importlib.util.find_spec("gtsam")
    if package is None or not package.submodule_search_locations:
        raise InputError(f"{record} needs the data inside the package gtsam: pip install 'sigmax[plaza]'")
    path = Path(package.submodule_search_locations[0]) / "Data" / file
    try:
        return read(path)
    except (OSError, ValueError) as error:
        raise InputError(
            f"the gtsam that is installed has no readable {file} ({error}): pip install 'sigmax[plaza]'"
        ) from error

"""`sigmax terrain`."""

from collections.abc import Sequence
from pathlib import Path

from sigmax.cli.track import track_record
from sigmax.records.maps import elevation
from sigmax.records.terrain import middle, terrain


def fly(map: str, filters: Sequence[str], out: Path | None, method: str, flights: int, seed: int) -> None:
    """Read the map, fly over it, and track that.

    Raises:
        InputError: for a map that cannot be read, and whatever else does not fit.
    """
    track_record(terrain(middle(elevation(map, method)), Path(map).stem, seed, flights), filters, out)

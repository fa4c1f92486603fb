"""`sigmax serve`."""

import asyncio
import sys
from pathlib import Path

from sigmax.serving import Checkpoint, Feed, Service, serve
from sigmax.serving.ends import parse_end
from sigmax.serving.server import checked_limits


def serve_plots(
    description: Path,
    filter: str | None,
    source: str,
    sink: str,
    checkpoint: Path | None,
    max_line: int,
    quiet: float | None,
    tentative: bool,
) -> None:
    """Serve until the end of the input or a signal; messages for people go to standard error.

    Raises:
        InputError: for whatever does not fit, before any plot is taken.
    """
    ends = parse_end(source, "--from"), parse_end(sink, "--to")
    feed = Feed(description, filter)
    turn = max((p for p in feed.periods.values() if p is not None), default=0.0)
    limits = checked_limits(max_line, max(1.0, 1.5 * turn) if quiet is None else quiet)
    kept = None if checkpoint is None else Checkpoint(checkpoint, feed.digest)
    if kept is not None and kept.beyond:
        _tell(
            f"the journal is damaged: what follows the damage, {kept.torn} bytes with {kept.beyond} whole lines, is "
            f"not used; the journal as it was is kept in {checkpoint} as damaged-…"
        )
    elif kept is not None and kept.torn:
        _tell(f"the journal ended within a line that was never acknowledged; its {kept.torn} bytes are dropped")
    service = Service(feed, kept, tentative=tentative)
    if kept is not None and service.counts["taken"]:
        _tell(f"resumed after {service.counts['taken']} lines")
    asyncio.run(serve(service, *ends, limits, _tell))
    if kept is not None:
        kept.close()
    counts = ", ".join(f"{n} {what}" for what, n in sorted(service.counts.items()) if n)
    scans = ", ".join(f"{n} {what}" for what, n in sorted(service.tracker.counts.items()) if n)
    _tell(f"lines: {counts or 'none'}; scans: {scans or 'none'}")


def _tell(message: str) -> None:
    print(f"sigmax serve: {message}", file=sys.stderr, flush=True)

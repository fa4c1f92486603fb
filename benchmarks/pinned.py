"""Filters with this library on the cores that the process was given, as it is told; see yardsticks.py.

python benchmarks/pinned.py MEASUREMENTS TRACKS CALLS

Reads lines "batch SRCKFB" or "live SRCKFB" and answers each with the seconds of the best of some calls.
"""

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))


def main(measurements: str, tracks: int, calls: int) -> None:
    import numpy as np

    from contenders.sigmax import alone

    z = np.fromfile(measurements).reshape(tracks, -1, 3)
    for line in sys.stdin:
        what, filter = line.split()
        seconds = []
        for _ in range(calls):
            run = alone(filter, z if what == "batch" else z[0])
            start = time.perf_counter()
            run()
            seconds.append(time.perf_counter() - start)
        print(min(seconds), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))

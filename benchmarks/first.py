"""A fresh process: import one library, filter one track, filter it again; the seconds go to stdout as JSON.

python benchmarks/first.py sigmax
"""

import json
import sys
import time
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))


def main(library: str) -> None:
    import numpy as np

    from scenario import record

    z = record(1).z[0]
    seconds = {}

    def lap(name: str) -> None:
        nonlocal start
        now = time.perf_counter()
        seconds[name], start = now - start, now

    start = time.perf_counter()
    module = import_module(f"contenders.{library}")
    if library == "sigmax":
        import_module("sigmax.running.run")  # otherwise loaded when it is first asked for
    lap("import")
    entry = (module.offline if hasattr(module, "offline") else module.live)(z)[0]
    if library in ("sigmax", "dynamax"):
        import jax.numpy as jnp

        jnp.zeros(3).block_until_ready()
    lap("set-up")
    mean = np.asarray(entry.run().mean)
    lap("first run")
    entry.run()
    lap("second run")
    print(json.dumps({"filter": entry.name, "last": mean[-1].tolist(), **seconds}))


if __name__ == "__main__":
    main(sys.argv[1])

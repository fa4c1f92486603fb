"""Stone Soup's own tutorials, as they are and with sigmax's predictor and updater in the place of its Kalman filters.

    pip download --no-deps --no-binary :all: stonesoup==1.9.1 && tar xzf stonesoup-1.9.1.tar.gz
    python benchmarks/soup_tutorials.py stonesoup-1.9.1

Each tutorial is run twice with the same random numbers, in a process of its own. The table says how far the states of
all its tracks lie apart at most, in deviations that its own filter claims.
"""

import argparse
import itertools
import json
import os
import random
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from stonesoup.types.base import Type

TUTORIALS = {
    "01_KalmanFilterTutorial": "the Kalman filter",
    "02_ExtendedKalmanFilterTutorial": "the extended filter",
    "03_UnscentedKalmanFilterTutorial": "the unscented filter",
    "05_DataAssociation-Clutter": "nearest neighbour in clutter",
    "06_DataAssociation-MultiTargetTutorial": "two targets, global nearest neighbour",
    "07_PDATutorial": "probabilistic data association",
    "08_JPDATutorial": "joint probabilistic data association",
    "09_Initiators_&_Deleters": "initiators and deleters",
    "10_Simulation_&_Tracking_Components": "a whole tracker on a simulation",
}


IMPORT = re.compile(r"^from stonesoup\.(?:predictor|updater)\.kalman import .+$", re.MULTILINE)


def components() -> dict[str, Any]:
    """Components of sigmax by the names of those that the tutorials import."""
    import sigmax
    from sigmax.stonesoup import SigmaxPredictor, SigmaxUpdater

    def filter(name: str, n: int, given: dict[str, float]) -> Any:
        # Its unscented filter has alpha = 1/2, beta = 2 and kappa = 3 - n unless it is told.
        return sigmax.get("UKF", **{"alpha": 0.5, "beta": 2.0, "kappa": 3 - n} | given) if name == "UKF" else name

    def predictor(name: str) -> Any:
        return lambda model: SigmaxPredictor(model, filter=filter(name, model.ndim_state, {}))

    def updater(name: str) -> Any:
        return lambda model, **given: SigmaxUpdater(model, filter=filter(name, model.ndim_state, given))

    made: dict[str, Any] = {}
    for kind, name in (("Kalman", "KF"), ("ExtendedKalman", "EKF"), ("UnscentedKalman", "UKF")):
        made |= {f"{kind}Predictor": predictor(name), f"{kind}Updater": updater(name)}
    return made


def states(tutorial: Path, swapped: bool) -> list[list[Any]]:
    """Means and deviations of all states of all tracks that a tutorial ends with."""
    os.environ["MPLBACKEND"] = "Agg"
    text = tutorial.read_text(encoding="utf-8")
    left: dict[str, Any] = {"__name__": "__main__"}
    if swapped:
        text, left = IMPORT.sub("", text), left | components()
    # Things in sets come in the order in which they were made, not in that of their addresses.
    made_so_far = itertools.count()
    Type.__hash__ = lambda self: self.__dict__.setdefault("_made_as", next(made_so_far))
    # After the imports, some of which draw random numbers.
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002 - the generator that the tutorials draw from
    exec(compile(text, str(tutorial), "exec"), left)
    found = left.get("all_tracks") or left.get("tracks") or {left["track"]}
    made = []
    for track in found:
        rows = [(np.ravel(s.state_vector).astype(float), np.sqrt(np.diag(s.covar))) for s in track.states]
        made.append([[mean.tolist(), deviation.tolist()] for mean, deviation in rows])
    return sorted(made, key=lambda rows: (len(rows), rows[-1][0]))


def run(tutorial: Path, swapped: bool) -> list[list[Any]]:
    """The same from a process of its own."""
    command = [sys.executable, __file__, str(tutorial), "--one", *(["--swapped"] if swapped else [])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{tutorial.name} failed{' on sigmax' if swapped else ''}:\n{done.stderr[-2000:]}")
    made: list[list[Any]] = json.loads(done.stdout.splitlines()[-1])
    return made


def main() -> None:
    """A row for each tutorial."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, help="Stone Soup's source, with docs/tutorials")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--swapped", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(states(given.source, given.swapped)))
        return
    print("| tutorial | | tracks | states | apart, in deviations |")
    print("|---|---|--:|--:|--:|")
    for name, what in TUTORIALS.items():
        path = given.source / "docs" / "tutorials" / f"{name}.py"
        theirs, ours = run(path, False), run(path, True)
        if list(map(len, theirs)) != list(map(len, ours)):
            print(f"| {name} | {what} | {len(theirs)} and {len(ours)} | | other tracks |", flush=True)
            continue
        pairs = [pair for a, b in zip(theirs, ours, strict=True) for pair in zip(a, b, strict=True)]
        apart = max(np.abs((np.subtract(b[0], a[0])) / np.maximum(a[1], 1e-300)).max() for a, b in pairs)
        print(f"| {name} | {what} | {len(ours)} | {len(pairs)} | {apart:.0e} |", flush=True)


if __name__ == "__main__":
    main()

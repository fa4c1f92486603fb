"""A run of a study kept whole: truth, measurements, and what each filter made of them."""

from typing import NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.spaces import errors
from sigmax.studies.simulate import cut, draw
from sigmax.studies.work import Work, estimate


class SingleRun(NamedTuple):
    """One run of a study.

    Attributes:
        run: its number, from 1.
        truth: (T, n).
        z: measurements by sensor (T, m), NaN where there was none.
        mean: estimates by filter (T, n), angles within half a turn of the truth.
        std: what each filter claims (T, n).
    """

    run: int
    truth: np.ndarray
    z: dict[str, np.ndarray]
    mean: dict[str, np.ndarray]
    std: dict[str, np.ndarray]


def single_run(work: Work, run: int) -> SingleRun:
    """A run by its number, with the same draws as among all others.

    Raises:
        InputError: where its truth escaped, so that there is nothing to be shown.
    """
    study = work.study
    drawn = draw(study, work.seed, (run - 1) // study.block, work.backend)
    at = (run - 1) % study.block
    drawn = cut(drawn, at, at + 1)
    if not drawn.kept[0]:
        raise InputError(f"{study.name}: the truth of run {run} escaped beyond {study.reach}; show another")
    mean, std = {}, {}
    for name in work.filters:
        found = estimate(work, name, drawn)
        mean[name] = drawn.truth[0] + errors(study.model.space, found.mean, drawn.truth)[0]
        std[name] = np.sqrt((found.factor[0] ** 2).sum(-1))
    return SingleRun(run, drawn.truth[0], {s: z[0] for s, z in drawn.z.items()}, mean, std)

"""Scalar operations of a step of each filter of a study, as the native engine lowers it: no machine matters.

python benchmarks/operations.py [STUDY] [FILTER …]     without filters those of the study, sobolev-cost without a study

Prediction, correction by all sensors, both, and both divided by the EKF's. Nothing is compiled or run. Processors do
several of these at a time, so that times follow them roughly.
"""

import sys

import numpy as np

from sigmax.engine.lowered import lowered
from sigmax.filters import get
from sigmax.preparation.prepare import Prepared, prepare
from sigmax.studies import Study, load_studies
from sigmax.studies.load import parsed_filters
from sigmax.studies.simulate import sizes


def operations(ready: Prepared) -> tuple[int, int]:
    """Of the prediction and of the correction by all sensors."""
    low = lowered(ready.filter, ready.model, 0 if ready.u is None else ready.u.shape[-1], "float64")
    corrected = sum(low.program("correct", sensor, z.shape[-1]).operations for sensor, z in ready.z.items())
    return low.program("predict").operations, corrected


def main(study: Study, asked: list[str]) -> None:
    """Print the table, line by line."""
    z = {s: np.zeros((1, m)) for s, m in sizes(study).items()}
    u = None if study.inputs is None else np.asarray(study.inputs)[:1]
    filters = {"EKF": get("EKF"), **(parsed_filters(asked, study) if asked else study.filters)}
    print("| filter | predict | correct | both | / EKF |\n|-|-:|-:|-:|-:|")
    whole: dict[str, int] = {}
    for name, filter in filters.items():
        model, prior = study.model_and_prior(study.prior.mean[None])
        ready = prepare(filter, model, prior, z if study.model.several else z[""], 1.0, u, "float64")
        predict, correct = operations(ready)
        whole[name] = predict + correct
        print(f"| {name} | {predict} | {correct} | {whole[name]} | {whole[name] / whole['EKF']:.2f} |", flush=True)


if __name__ == "__main__":
    named, *rest = sys.argv[1:] or ["sobolev-cost"]
    (one,) = load_studies(named)
    main(one, rest)

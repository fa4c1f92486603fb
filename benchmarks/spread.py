"""Which spread of points the likelihood of records takes, and how often it is one that folds.

python benchmarks/spread.py [RECORDS]     512 unless said; about a minute

Sobolev's radar with P0 as printed, SRUKFB with beta = 2, kappa = -2 and alpha from 0.05 to 1. Points of the course fold
at half a turn, alpha 0.2 to 0.3, and runs are lost. How often records, alone and in groups, take these.
"""

import sys
import warnings

import numpy as np

import sigmax
from sigmax.errors import FoldingWarning
from sigmax.running import fit_filter
from sigmax.studies import load_studies
from sigmax.studies.simulate import draw

ALPHAS = (0.05, 0.1, 0.15, 0.2, 0.225, 0.25, 0.275, 0.3, 0.35, 0.45, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


def main(records: int) -> None:
    """Print the sums over all records, then the shares."""
    warnings.simplefilter("ignore", FoldingWarning)
    (study,) = load_studies("sobolev-spread", {"p0": "literal"})
    z = np.concatenate([draw(study, 1, block).z[""] for block in range(-(-records // study.block))])[:records]
    grid = {"alpha": ALPHAS, "beta": [2.0], "kappa": [-2.0]}
    prior = sigmax.Gaussian(study.prior.mean, study.prior.cov)
    found = fit_filter("SRUKFB", grid, study.model, prior, z, dt=study.dt)
    print("alpha                    ", "  ".join(f"{a:g}" for a in ALPHAS))
    print("median log-likelihood    ", "  ".join(f"{v:.0f}" for v in np.median(found.by_record, axis=1)))
    print(f"taken by all {records} records: alpha {found.parameters['alpha']:g}")
    folds = np.array([0.2 <= a <= 0.3 for a in ALPHAS])
    rng = np.random.default_rng(0)
    for group in (1, 2, 3, 5, 10):
        picked = np.stack([rng.choice(records, group, replace=False) for _ in range(10_000)])
        best = found.by_record[:, picked].sum(-1).argmax(0)
        share = folds[best].mean()
        print(f"{group:2} records: {share:.2%} take an alpha of 0.2 to 0.3")
    alone = folds[found.by_record.argmax(0)].mean()
    print(f"each record once: {alone:.1%} ± {np.sqrt(alone * (1 - alone) / records):.1%}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 512)

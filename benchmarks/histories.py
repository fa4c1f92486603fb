"""The smoother of models that take turns, against the sum over all histories of modes.

python benchmarks/histories.py --write docs/modes.md
"""

import itertools
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import typer
from rich.console import Console
from rich.progress import track

import sigmax
from report import Section, markdown, show, write

RUNS, STEPS = 200, 9
CHANGE, INITIAL = np.array([[0.95, 0.05], [0.1, 0.9]]), np.array([0.6, 0.4])
F = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
H = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]])
Q = [q * np.kron(np.eye(2), [[1 / 3, 1 / 2], [1 / 2, 1]]) for q in (0.01, 10.0)]
PRIOR = sigmax.Gaussian([0.0, 1.0, 0.0, 1.0], [1.0] * 4)
BEGIN, END = "<!-- histories: written by histories.py -->", "<!-- end of histories -->"

inv = np.linalg.inv


class Smoothed(NamedTuple):
    """Means (B, T, n), covariances (B, T, n, n), probabilities of the second mode (B, T)."""

    mean: np.ndarray
    cov: np.ndarray
    wild: np.ndarray


def simulated() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States, modes and measurements."""
    rng = np.random.default_rng(1)
    states, modes, z = np.empty((RUNS, STEPS, 4)), np.empty((RUNS, STEPS), int), np.empty((RUNS, STEPS, 2))
    for b in range(RUNS):
        mode, x = rng.choice(2, p=INITIAL), rng.multivariate_normal(PRIOR.mean, PRIOR.cov)
        for k in range(STEPS):
            mode = rng.choice(2, p=CHANGE[mode])
            x = rng.multivariate_normal(F @ x, Q[mode])
            states[b, k], modes[b, k], z[b, k] = x, mode, H @ x + rng.normal(size=2)
    return states, modes, z


def moments(weights: np.ndarray, means: np.ndarray, covs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of mixtures: weights (M, …), means (M, …, n), covariances (M, …, n, n)."""
    mean = (weights[..., None] * means).sum(0)
    d = means - mean
    return mean, (weights[..., None, None] * (covs + d[..., :, None] * d[..., None, :])).sum(0)


def exact(z: np.ndarray) -> Smoothed:
    """A Kalman smoother for each sequence of modes, all runs at once, weighed by what it says of them."""
    logs, means, covs = [], [], []
    sequences = list(itertools.product(range(2), repeat=STEPS))
    for modes in track(sequences, "histories"):
        prior = np.log((INITIAL @ CHANGE)[modes[0]]) + sum(np.log(CHANGE[a, b]) for a, b in itertools.pairwise(modes))
        x, P, log = np.tile(PRIOR.mean, (len(z), 1)), PRIOR.cov, np.full(len(z), prior)
        seen, expected = [], []
        for k, mode in enumerate(modes):
            x, P = x @ F.T, F @ P @ F.T + Q[mode]
            expected.append((x, P))
            S, nu = H @ P @ H.T + np.eye(2), z[:, k] - x @ H.T
            K = P @ H.T @ inv(S)
            log -= np.einsum("bi,ij,bj->b", nu, inv(S), nu) / 2 + np.linalg.slogdet(2 * np.pi * S)[1] / 2
            x, P = x + nu @ K.T, P - K @ S @ K.T
            seen.append((x, P))
        for k in range(STEPS - 2, -1, -1):
            G = seen[k][1] @ F.T @ inv(expected[k + 1][1])
            x = seen[k][0] + (seen[k + 1][0] - expected[k + 1][0]) @ G.T
            seen[k] = x, seen[k][1] + G @ (seen[k + 1][1] - expected[k + 1][1]) @ G.T
        logs.append(log)
        means.append(np.stack([x for x, _ in seen], 1))
        covs.append(np.broadcast_to(np.stack([P for _, P in seen]), (len(z), STEPS, 4, 4)))
    weights = np.exp(np.array(logs) - np.max(logs, 0))
    weights = np.repeat((weights / weights.sum(0))[..., None], STEPS, -1)
    wild = (weights * np.array(sequences)[:, None]).sum(0)
    return Smoothed(*moments(weights, np.array(means), np.array(covs)), wild)


def from_one_belief(z: np.ndarray) -> Smoothed:
    """The usual smoother: all modes before a step are smoothed from the one belief of the mode after it (Kim 1994)."""
    found = [np.empty((RUNS, STEPS, 4)), np.empty((RUNS, STEPS, 4, 4)), np.empty((RUNS, STEPS))]
    for b, record in enumerate(z):
        x, P, mu, kept = np.array([PRIOR.mean] * 2), np.array([PRIOR.cov] * 2), INITIAL, []
        for now in record:
            later = mu @ CHANGE
            mixed = [moments(mu * CHANGE[:, j] / later[j], x, P) for j in range(2)]
            x, P = np.array([F @ m for m, _ in mixed]), np.array([F @ C @ F.T + Q[j] for j, (_, C) in enumerate(mixed)])
            S, nu = H @ P @ H.T + np.eye(2), now - x @ H.T
            K = P @ H.T @ inv(S)
            likelihood = np.exp(-np.einsum("mi,mij,mj->m", nu, inv(S), nu) / 2) / np.sqrt(np.linalg.det(S))
            x, P = x + np.einsum("mij,mj->mi", K, nu), P - K @ S @ K.swapaxes(1, 2)
            mu = later * likelihood / (later @ likelihood)
            kept.append((x, P, mu))
        for k in range(STEPS - 1, -1, -1):
            if k < STEPS - 1:
                before, cov, share = kept[k]
                w = share[:, None] * CHANGE / (share @ CHANGE) * mu
                pairs_x, pairs_P = np.empty((2, 2, 4)), np.empty((2, 2, 4, 4))
                for i, j in itertools.product(range(2), repeat=2):
                    ahead = F @ cov[i] @ F.T + Q[j]
                    G = cov[i] @ F.T @ inv(ahead)
                    pairs_x[j, i], pairs_P[j, i] = (
                        before[i] + G @ (x[j] - F @ before[i]),
                        cov[i] + G @ (P[j] - ahead) @ G.T,
                    )
                mu = w.sum(1)
                x, P = moments((w / mu[:, None]).T, pairs_x, pairs_P)
            found[0][b, k], found[1][b, k] = moments(mu, x, P)
            found[2][b, k] = mu[1]
    return Smoothed(*found)


def moving(q: np.ndarray) -> sigmax.Model:
    """A mode as a model."""

    def motion(x: Any, dt: Any) -> Any:
        return jnp.asarray(F) @ x

    return sigmax.Model(motion=motion, sensor=lambda x: x[::2], Q=q, R=[1.0, 1.0])


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Put the table between the markers of a page.")] = None,
) -> None:
    """Smooth 200 simulated records of nine steps, and sum over their 512 histories; about half a minute."""
    states, modes, z = simulated()
    model = sigmax.imm({"calm": moving(Q[0]), "wild": moving(Q[1])}, transition=CHANGE, initial=INITIAL)
    ran = sigmax.run("KF", model, PRIOR, z)
    back = sigmax.smooth("KF", model, ran)
    rows = []
    for name, found in (
        ("the filter, not smoothed", Smoothed(ran.mean, ran.cov, ran.probability[..., 1])),
        ("pairs from one belief (Kim)", from_one_belief(z)),
        ("`sigmax.smooth`", Smoothed(back.mean, back.cov, back.probability[..., 1])),
        ("all histories: exact", exact(z)),
    ):
        e = states - found.mean
        nees = np.einsum("bti,btij,btj->bt", e, inv(found.cov), e).mean() / 4
        rms, wrong = np.sqrt((e[..., ::2] ** 2).sum(-1).mean()), ((found.wild - modes) ** 2).mean()
        rows.append((name, f"{rms:.3f}", f"{nees:.2f}", f"{wrong:.4f}"))
    section = Section(
        "The smoother",
        f"{RUNS} records of {STEPS} steps, two modes of the noises 0.01 and 10, deviation of a measurement 1.",
        ("smoother", "position, rmse", "NEES/4", "squared error of the probability"),
        rows,
    )
    show(section, Console())
    if page is not None:
        write(page, f"Made by `python benchmarks/histories.py --write {page}`.\n\n{markdown(section)}", BEGIN, END)


if __name__ == "__main__":
    typer.run(main)

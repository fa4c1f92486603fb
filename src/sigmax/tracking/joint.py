"""Marginal probabilities of pairs when no two tracks may share a plot."""

import numpy as np

# More sets of used plots than this at any track, and a cluster is approximated.
_MOST_SETS = 4096
_ROUNDS = 200


def marginals(track: np.ndarray, plot: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """The probability of each pair (K,) of a cluster, the joint event of pairs having the weight of exp Σ gain.

    Exact by dynamic programming over the tracks: of what went before, only the set of used plots that a later
    track could use matters. In the worst case that grows exponentially with the cluster; beyond a few thousand
    sets it gives way to loopy belief propagation.
    """
    rows = np.unique(track, return_inverse=True)[1]
    if rows.max() == 0:
        top = max(gain.max(), 0.0)
        odds = np.exp(gain - top)
        return odds / (np.exp(-top) + odds.sum())
    columns = np.unique(plot, return_inverse=True)[1]
    exact = _exact(rows, columns, gain)
    return _propagated(rows, columns, gain) if exact is None else exact


def _exact(rows: np.ndarray, columns: np.ndarray, gain: np.ndarray) -> np.ndarray | None:
    T = int(rows.max()) + 1
    pairs = [np.flatnonzero(rows == i) for i in range(T)]
    # Tracks with common plots side by side keep the sets small.
    order = sorted(range(T), key=lambda i: (columns[pairs[i]].min(), columns[pairs[i]].max()))
    pairs = [pairs[i] for i in order]
    last = {int(c): k for k, places in enumerate(pairs) for c in columns[places]}
    open_after = [sum(1 << c for c, k in last.items() if k > step) for step in range(T)]
    scale = [max(gain[places].max(), 0.0) for places in pairs]
    forward: list[dict[int, float]] = [{0: 1.0}]
    for step, places in enumerate(pairs):
        later: dict[int, float] = {}
        for used, weight in forward[-1].items():
            kept = used & open_after[step]
            later[kept] = later.get(kept, 0.0) + weight * np.exp(-scale[step])
            for k in places:
                bit = 1 << int(columns[k])
                if not used & bit:
                    kept = (used | bit) & open_after[step]
                    later[kept] = later.get(kept, 0.0) + weight * float(np.exp(gain[k] - scale[step]))
        if len(later) > _MOST_SETS:
            return None
        total = sum(later.values())
        forward.append({used: weight / total for used, weight in later.items()})
    share = np.zeros(len(gain))
    backward = {0: 1.0}
    for step in range(T - 1, -1, -1):
        before: dict[int, float] = {}
        joint = np.zeros(len(gain))
        whole = 0.0
        for used, weight in forward[step].items():
            empty = float(np.exp(-scale[step])) * backward.get(used & open_after[step], 0.0)
            behind = empty
            for k in pairs[step]:
                bit = 1 << int(columns[k])
                if not used & bit:
                    after = backward.get((used | bit) & open_after[step], 0.0)
                    value = float(np.exp(gain[k] - scale[step])) * after
                    joint[k] += weight * value
                    behind += value
            before[used] = behind
            whole += weight * behind
        share += joint / whole
        top = max(before.values())
        backward = {used: value / top for used, value in before.items()}
    return share


def _propagated(rows: np.ndarray, columns: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Loopy belief propagation; each round is a sum over tracks and one over plots."""
    odds = np.exp(np.minimum(gain, 300.0))
    back = np.ones(len(gain))
    for _ in range(_ROUNDS):
        weighed = odds * back
        there = odds / (1 + np.bincount(rows, weighed)[rows] - weighed)
        new = 1 / (1 + np.bincount(columns, there)[columns] - there)
        if np.abs(new - back).max() < 1e-9:
            back = new
            break
        back = new
    weighed = odds * back
    return weighed / (1 + np.bincount(rows, weighed)[rows])

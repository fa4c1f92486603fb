"""One branch of each family, none of them sharing a plot, of the greatest total score."""

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

# Nodes of branch and bound in one cluster, after which the best packing found so far is taken: a number of nodes, and
# not of seconds, gives the same answer on every machine. Clusters seldom need more than one.
_NODES = 2000


def best_packing(family: np.ndarray, score: np.ndarray, plots: np.ndarray, fallback: np.ndarray) -> np.ndarray:
    """Which branches (B,) the best global hypothesis takes: one of each family, no plot of a scan twice.

    Families whose best branches share no plot with that of any other are done. The others go cluster by cluster, each
    an integer program (maximum-weight set packing; Poore 1994 as multi-dimensional assignment) that HiGHS solves
    exactly. A cluster that would take too long keeps the best packing found, or else the fall-back.

    Args:
        family: of each branch (B,), 0 to F - 1, ascending.
        score: (B,); finite.
        plots: the place of each branch's plot in the last scans (B, S), -1 for none.
        fallback: branches (F,) that share no plot, one of each family in its order.

    Returns:
        Places (F,), one of each family in its order.
    """
    F = len(fallback)
    order = np.lexsort((-score, family))
    best = order[np.searchsorted(family, np.arange(F))]
    if not shared(plots[best]).any():
        return best
    scan = np.arange(plots.shape[1]) * (plots.max(initial=0) + 1)
    used = plots >= 0
    branch = np.nonzero(used)[0]
    _, item = np.unique((plots + scan)[used], return_inverse=True)
    # A plot that only one family uses binds nobody.
    users = np.unique(item * F + family[branch]) // F
    bound = np.bincount(users)[item] > 1
    branch, item = branch[bound], item[bound]
    I = int(item.max()) + 1
    graph = coo_array((np.ones(len(branch)), (family[branch], F + item)), shape=(F + I,) * 2)
    _, label = connected_components(graph, directed=False)
    chosen = best.copy()
    for cluster in np.unique(label[:F]):
        families = np.flatnonzero(label[:F] == cluster)
        if len(families) > 1 and shared(plots[best[families]]).any():
            chosen[families] = _solved(families, family, score, branch, item, fallback)
    return chosen


def shared(plots: np.ndarray) -> np.ndarray:
    """Which plots (F, S) are used more than once in their scan (S columns)."""
    column = np.sort(plots, axis=0)
    return (column[1:] == column[:-1]) & (column[1:] >= 0)


def _solved(
    families: np.ndarray,
    family: np.ndarray,
    score: np.ndarray,
    branch: np.ndarray,
    item: np.ndarray,
    fallback: np.ndarray,
) -> np.ndarray:
    members = np.flatnonzero(np.isin(family, families))
    row = np.searchsorted(families, family[members])
    own = np.isin(branch, members)
    variable = np.searchsorted(members, branch[own])
    plot = np.unique(item[own], return_inverse=True)[1]
    F, V, P = len(families), len(members), int(plot.max()) + 1
    rows, columns = np.concatenate([row, F + plot]), np.concatenate([np.arange(V), variable])
    A = csr_array((np.ones(len(rows)), (rows, columns)), shape=(F + P, V))
    least = np.concatenate([np.ones(F), np.zeros(P)])
    found = milp(
        -score[members],
        integrality=np.ones(V, int),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(A, least, np.ones(F + P)),
        options={"node_limit": _NODES, "mip_rel_gap": 0.0},
    )
    if found.x is None:
        return fallback[families]
    taken = found.x > 0.5
    chosen = np.empty(F, int)
    chosen[row[taken]] = members[taken]
    return chosen

"""All global hypotheses of tracks that share plots: which is the likeliest, and what each branch has of them."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

# Of so many sets of plots in use, the heaviest are followed. Fixed, so that every machine finds the same.
_MOST_SETS = 4096


class Found(NamedTuple):
    """What `global_hypotheses` finds.

    Attributes:
        share: the probability of each branch (B,); what a family lacks to 1 is that there is no target.
        best: place of each family's branch in the likeliest global hypothesis (F,), -1 where it has no target.
    """

    share: np.ndarray
    best: np.ndarray


def global_hypotheses(family: np.ndarray, score: np.ndarray, plots: np.ndarray, absent: np.ndarray) -> Found:
    """The sum over all global hypotheses, and the likeliest: at most one branch of each family, no plot twice.

    Families that share no plot are independent; the others go cluster by cluster, by dynamic programming over the
    families: of what went before, only the set of used plots counts that a later family could use. Exact as long as
    these sets are a few thousand; beyond, the heaviest are followed.

    Args:
        family: of each branch (B,), 0 to F - 1, ascending; each has one.
        score: log weight of each branch (B,); finite.
        plots: the place of each branch's plot in the last scans (B, S), -1 for none.
        absent: log weight of each family's not being a target (F,).
    """
    F = len(absent)
    order = np.lexsort((-score, family))
    best = order[np.searchsorted(family, np.arange(F))]
    top = np.maximum(score[best], absent)
    weight, nobody = np.exp(score - top[family]), np.exp(absent - top)
    share = weight / (np.bincount(family, weight, F) + nobody)[family]
    best = np.where(score[best] > absent, best, -1)
    scan = np.arange(plots.shape[1]) * (plots.max(initial=0) + 1)
    used = plots >= 0
    branch = np.nonzero(used)[0]
    items, item = np.unique((plots + scan)[used], return_inverse=True)
    # A plot that only one family uses binds nobody.
    users = np.unique(item * F + family[branch]) // F
    bound = (np.bincount(users, minlength=len(items)) > 1)[item]
    branch, item = branch[bound], item[bound]
    graph = coo_array((np.ones(len(branch)), (family[branch], F + item)), shape=(F + len(items),) * 2)
    _, label = connected_components(graph, directed=False)
    for cluster in np.flatnonzero(np.bincount(label[:F]) > 1):
        families = np.flatnonzero(label[:F] == cluster)
        members = np.flatnonzero(label[family] == cluster)
        own = label[family[branch]] == cluster
        masks = _masks(np.searchsorted(members, branch[own]), item[own], len(members))
        row = np.searchsorted(families, family[members])
        share[members], chosen = _summed(row, masks, score[members], absent[families])
        best[families] = np.where(chosen < 0, -1, members[chosen])
    return Found(share, best)


def _masks(branch: np.ndarray, item: np.ndarray, count: int) -> np.ndarray:
    """Sets of plots (count, words) as bits."""
    bit = np.unique(item, return_inverse=True)[1]
    masks = np.zeros((count, int(bit.max()) // 64 + 1), np.uint64)
    np.bitwise_or.at(masks, (branch, bit // 64), np.uint64(1) << (bit % 64).astype(np.uint64))
    return masks


def _summed(row: np.ndarray, masks: np.ndarray, score: np.ndarray, absent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares (B,) and the likeliest hypothesis (F,) of one cluster: forward over its families, and back."""
    F, nothing = len(absent), np.zeros((1, masks.shape[1]), np.uint64)
    members = [np.flatnonzero(row == f) for f in range(F)]
    choices = [np.concatenate([nothing, masks[m]]) for m in members]
    values = [np.concatenate([absent[f : f + 1], score[m]]) for f, m in enumerate(members)]
    weights = [np.exp(v - v.max()) for v in values]
    # What later families could still use.
    later = [nothing[0]]
    for some in choices[:0:-1]:
        later.append(later[-1] | np.bitwise_or.reduce(some))
    sets, value = nothing, np.zeros(1)
    mass: list[np.ndarray] = [np.ones(1)]
    steps, backs = [], []
    for some, v, w, open_ in zip(choices, values, weights, reversed(later), strict=True):
        i, j = np.nonzero(~(sets[:, None] & some).any(2))
        sets, to = _unique((sets[i] | some[j]) & open_)
        total = np.bincount(to, mass[-1][i] * w[j])
        if len(sets) > _MOST_SETS:
            heaviest = np.sort(np.argsort(-total, kind="stable")[:_MOST_SETS])
            place = np.full(len(sets), -1)
            place[heaviest] = np.arange(_MOST_SETS)
            sets, total, to = sets[heaviest], total[heaviest], place[to]
            i, j, to = i[to >= 0], j[to >= 0], to[to >= 0]
        reached = value[i] + v[j]
        order = np.lexsort((reached, to))
        backs.append(order[np.searchsorted(to[order], np.arange(len(sets)), side="right") - 1])
        value = reached[backs[-1]]
        mass.append(total / total.sum())
        steps.append((i, j, to))
    share, best, at = np.empty(len(row)), np.empty(F, int), 0
    ahead: np.ndarray = np.ones(1)
    for f in range(F - 1, -1, -1):
        i, j, to = steps[f]
        after = weights[f][j] * ahead[to]
        part = np.bincount(j, mass[f][i] * after, len(weights[f]))
        share[members[f]] = part[1:] / part.sum()
        ahead = np.bincount(i, after, len(mass[f]))
        ahead = ahead / ahead.max()
        chosen, at = j[backs[f][at]], i[backs[f][at]]
        best[f] = members[f][chosen - 1] if chosen else -1
    return share, best


def _unique(sets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Different sets, and which of them each is."""
    if sets.shape[1] == 1:
        found, to = np.unique(sets[:, 0], return_inverse=True)
        return found[:, None], to
    found, to = np.unique(sets, axis=0, return_inverse=True)
    return found, to.reshape(-1)

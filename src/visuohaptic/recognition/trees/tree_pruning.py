"""Cost-complexity pruning (Breiman 1984): errors + alpha * objects * leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from .tree_nodes import ClassificationTree

#: Intervals of alpha with a ratio of end to start below this are left out.
_NARROW = 1.1


def pruned(tree: ClassificationTree, alpha: float) -> ClassificationTree:
    """The smallest subtree with the lowest cost.

    Parameters
    ----------
    tree
        Unpruned tree, or a tree pruned with a smaller alpha.
    alpha
        Cost of a leaf, relative to the weight of all objects.
    """
    cut = _cut(tree, alpha * float(tree.counts[0].sum()))
    keep: list[int] = []
    stack = [0]
    while stack:
        node = stack.pop()
        keep.append(node)
        if not cut[node]:
            stack += [int(tree.right[node]), int(tree.left[node])]
    place = {node: k for k, node in enumerate(keep)}

    def renumbered(child: np.ndarray) -> np.ndarray:
        return np.array([-1 if cut[node] else place[int(child[node])] for node in keep], dtype=np.int64)

    index, leaf = np.array(keep), np.array(cut)[keep]
    return replace(
        tree,
        feature=np.where(leaf, -1, tree.feature[index]),
        threshold=np.where(leaf, 0.0, tree.threshold[index]),
        left=renumbered(tree.left),
        right=renumbered(tree.right),
        counts=tree.counts[index],
    )


def pruning_alphas(tree: ClassificationTree) -> Float[np.ndarray, "k"]:
    """Costs of a leaf at which the pruned tree changes, ascending from a small number.

    Parameters
    ----------
    tree
        Unpruned tree.
    """
    found, total = [1e-6], float(tree.counts[0].sum())
    while True:
        link = _weakest_link(tree, _cut(tree, found[-1] * total))
        if not np.isfinite(link):
            return np.array(found)
        found.append(max(link / total, found[-1]) * (1 + 1e-9))


def pruning_middles(tree: ClassificationTree) -> Float[np.ndarray, "k"]:
    """One alpha for each interval in which the pruned tree is constant: the geometric mean of its ends (Breiman 1984).

    Trees of other folds change at other alphas: a very narrow interval has no counterpart in them.

    Parameters
    ----------
    tree
        Unpruned tree.
    """
    first, *others = pruning_alphas(tree)
    ends = [first]
    for alpha in others:
        if alpha > _NARROW * ends[-1]:
            ends.append(alpha)
    return np.sqrt(np.array(ends[:-1]) * np.array(ends[1:]))


def simplest(wrong: Float[np.ndarray, "k"], count: int) -> int:
    """The last pruning whose errors are within one standard error of the lowest (Breiman 1984).

    Parameters
    ----------
    wrong
        Number of errors of each pruning, from the largest to the smallest tree.
    count
        Number of tested objects.
    """
    least = float(wrong.min())
    if least < 0:
        raise InputError("simplest", f"found {least:g} errors, expected 0 or more", field="wrong")
    return int(np.flatnonzero(wrong <= least + np.sqrt(least * (1 - least / count)))[-1])


def stratified_folds(
    number: Int[np.ndarray, "m"], folds: int, rng: np.random.Generator
) -> Int[np.ndarray, "m"]:
    """Fold of each object; every class is distributed evenly over the folds.

    Parameters
    ----------
    number
        Class of each object.
    folds
        Number of folds.
    rng
        Source of the order.
    """
    out = np.empty(len(number), dtype=np.int64)
    begin = 0
    for k in np.unique(number):
        rows = rng.permutation(np.flatnonzero(number == k))
        out[rows] = (begin + np.arange(len(rows))) % folds
        begin += len(rows)
    return out


def _cut(tree: ClassificationTree, cost: float) -> list[bool]:
    """Nodes that are leaves of the smallest subtree with the lowest cost, given that of a leaf."""
    best, cut = (_errors(tree) + cost).tolist(), [True] * len(tree.feature)
    for node, left, right in _inner(tree)[::-1]:
        below = best[left] + best[right]
        if below < best[node] - 1e-9:
            best[node], cut[node] = below, False
    return cut


def _weakest_link(tree: ClassificationTree, cut: list[bool]) -> float:
    """Smallest increase of the error per removed leaf over the inner nodes of a pruned tree; infinite at the root alone."""
    error = _errors(tree).tolist()
    leaves, below, kept = [1] * len(error), list(error), {0}
    inner = [one for one in _inner(tree) if not cut[one[0]]]
    for node, left, right in inner[::-1]:
        leaves[node], below[node] = leaves[left] + leaves[right], below[left] + below[right]
    for node, left, right in inner:
        kept |= {left, right} if node in kept else set()
    return min(((error[k] - below[k]) / (leaves[k] - 1) for k, _, _ in inner if k in kept), default=np.inf)


def _inner(tree: ClassificationTree) -> list[tuple[int, int, int]]:
    """Inner nodes with their children, which come after their parents."""
    every = zip(range(len(tree.feature)), tree.left.tolist(), tree.right.tolist(), strict=True)
    return [one for one in every if tree.feature[one[0]] >= 0]


def _errors(tree: ClassificationTree) -> Float[np.ndarray, "n"]:
    out: np.ndarray = tree.counts.sum(axis=1) - tree.counts.max(axis=1)
    return out

"""Classification trees that are exploration plans (Alt 2016, Sec. 6.3.1).

A tree is CART with Gini's index, pruned by cost complexity where cross-validation says so. Each
inner node asks one normalised stiffness feature of one side at one height. One touch with two
opposing tips measures both sides, so it answers two features. The scaling touches come first; what
was touched on the way to a node is asked again for nothing.

Symbols: n nodes, c classes, m objects, p features (height * 4 + side).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from ..files import write_text
from .data_set import HEIGHTS, SIDES, FeatureSet

__all__ = [
    "SCHEMES",
    "ClassificationTree",
    "Touch",
    "feature_name",
    "grow_tree",
    "load_tree",
    "mean_touches",
    "next_touch",
    "predict",
    "scaled_features",
    "scaling_touches",
    "train_tree",
    "tree_text",
    "walk",
]

#: How features lose their scale: Eqs. (6.4), (6.5) and by one point; see deformation.normalised.
SCHEMES = ("norm", "centre", "point")
#: A touch is a height 1 .. 16 and the axis that the tips press along, "x" or "y".
Touch = tuple[int, str]
_FORMAT = 1
_LOSSES = ("loss", "loss_sigma", "nested_loss")


@dataclass(frozen=True, slots=True, eq=False)
class ClassificationTree:
    """Nodes as arrays; the root is node 0, a leaf has feature -1."""

    classes: tuple[str, ...]
    scheme: str  #: of the features, one of SCHEMES
    feature: Int[np.ndarray, "n"]
    threshold: Float[np.ndarray, "n"]  #: left if the feature is at most this
    left: Int[np.ndarray, "n"]
    right: Int[np.ndarray, "n"]
    counts: Float[np.ndarray, "n c"]  #: training objects at the node, by class
    alpha: float = 0.0  #: pruned at this cost of a leaf
    loss: float = float("nan")  #: share classified wrongly, by cross-validation at the chosen pruning
    loss_sigma: float = float("nan")  #: its standard error
    nested_loss: float = float("nan")  #: the same with the pruning chosen without the objects judged

    @property
    def features(self) -> tuple[int, ...]:
        """Features that are asked somewhere, without repetition."""
        return tuple(int(k) for k in np.unique(self.feature[self.feature >= 0]))

    @property
    def answer(self) -> Int[np.ndarray, "n"]:
        """Most frequent class at each node."""
        return np.argmax(self.counts, axis=1)


def feature_name(feature: int) -> str:
    """``x+12`` for the side x+ at height 12 of 1 .. 16."""
    return f"{SIDES[feature % 4]}{feature // 4 + 1}"


def scaled_features(values: Float[np.ndarray, "*m 16 4"], scheme: str) -> Float[np.ndarray, "*m 64"]:
    """Features without scale of many objects; see :func:`visuohaptic.deformation.normalised`.

    With the schemes ``centre`` and ``point``, NaN stands for what was not measured.
    """
    values = np.asarray(values, dtype=float)
    flat = values.reshape(*values.shape[:-2], HEIGHTS * 4)
    if scheme == "norm":
        moved = flat - np.median(flat, axis=-1, keepdims=True)
        length = np.linalg.norm(moved, axis=-1, keepdims=True)
        out: np.ndarray = moved / np.where(length > 0, length, 1.0)
        return out
    if scheme not in SCHEMES:
        raise InputError("scheme", f"found {scheme!r}, expected one of {', '.join(SCHEMES)}")
    scale = values[..., 7, :].mean(axis=-1) if scheme == "centre" else values[..., 7, 0]
    relative: np.ndarray = flat / scale[..., None] - 1
    return relative


def scaling_touches(scheme: str) -> tuple[Touch, ...]:
    """What has to be touched before any feature has a value."""
    if scheme == "norm":
        return tuple((height, axis) for axis in "xy" for height in range(1, HEIGHTS + 1))
    return ((8, "x"), (8, "y")) if scheme == "centre" else ((8, "x"),)


def touch_of(feature: int) -> Touch:
    """The touch that measures a feature."""
    return feature // 4 + 1, SIDES[feature % 4][0]


def grow_tree(
    data: FeatureSet, *, scheme: str = "centre", alpha: float = 0.0, reuse: float = 0.1
) -> ClassificationTree:
    """Train on all objects, in milliseconds, with a pruning that is known.

    Parameters
    ----------
    data
        Candidates of the moment; see :meth:`.FeatureSet.of_classes`.
    scheme
        Of the features.
    alpha
        Cost of a leaf, as a share of all objects.
    reuse
        Share of the best split's decrease of impurity that may be given up for a feature that has
        been touched already, 0 to 1.
    """
    x, y = _predictors(data, scheme), data.number
    return _in_feature_units(replace(_prune(_grow(x, y, data.classes, scheme, reuse), alpha), alpha=alpha))


def train_tree(
    data: FeatureSet,
    *,
    scheme: str = "centre",
    reuse: float = 0.1,
    folds: int = 10,
    rng: np.random.Generator | None = None,
) -> ClassificationTree:
    """Train, prune by cross-validation, and say the loss.

    The folds are stratified. Of all prunings, the smallest tree is taken whose cross-validated
    loss is the least, and this loss is given, as in the dissertation; it is a little too good,
    because the same folds chose the pruning. ``nested_loss`` is that of the whole process: for each
    fold, pruning is chosen by the others.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    x, y = _predictors(data, scheme), data.number
    fewest = int(np.bincount(y).min())
    if not 2 <= folds <= fewest:
        raise InputError("train_tree", f"found {folds} folds, expected 2 to {fewest}, the smallest class")
    fold = _stratified(y, folds, rng)
    whole = _grow(x, y, data.classes, scheme, reuse)
    alphas = _alphas(whole)
    # Geometric middles: each stands for the interval of alphas with the same tree (Breiman 1984).
    middles = np.append(np.sqrt(alphas[:-1] * alphas[1:]), alphas[-1])
    wrong = np.zeros((folds, len(middles)))
    for k in range(folds):
        held = fold == k
        part = _grow(x[~held], y[~held], data.classes, scheme, reuse)
        for place, alpha in enumerate(middles):
            found = _decide(_prune(part, alpha), x[held])
            wrong[k, place] = np.count_nonzero(found != y[held])
    total = wrong.sum(axis=0)

    def smallest_best(losses: np.ndarray) -> int:
        return int(np.flatnonzero(losses == losses.min())[-1])

    best = smallest_best(total)
    loss = float(total[best] / len(y))
    nested = float(sum(wrong[k, smallest_best(total - wrong[k])] for k in range(folds)) / len(y))
    sigma = float(np.sqrt(max(loss * (1 - loss), 1 / len(y) / 4) / len(y)))
    alpha = float(middles[best])
    pruned = replace(_prune(whole, alpha), alpha=alpha, loss=loss, loss_sigma=sigma, nested_loss=nested)
    return _in_feature_units(pruned)


def predict(tree: ClassificationTree, values: Float[np.ndarray, "m 16 4"]) -> tuple[str, ...]:
    """Classes of objects of which every feature is known [N/m]."""
    found = _decide(tree, scaled_features(values, tree.scheme))
    return tuple(tree.classes[k] for k in found)


def next_touch(tree: ClassificationTree, measured: Float[np.ndarray, "16 4"]) -> tuple[Touch | None, int]:
    """What to touch next, and the node that was reached.

    ``measured`` has the stiffness [N/m] of what was touched and NaN elsewhere. None: it is a leaf.
    """
    known = np.isfinite(measured)
    for height, axis in scaling_touches(tree.scheme):
        column = 0 if axis == "x" else 2
        if not known[height - 1, column : column + 2].all():
            return (height, axis), 0
    values = scaled_features(measured, tree.scheme)
    node = 0
    while tree.feature[node] >= 0:
        feature = int(tree.feature[node])
        if not np.isfinite(values[feature]):
            return touch_of(feature), node
        node = int((tree.left if values[feature] <= tree.threshold[node] else tree.right)[node])
    return None, node


def walk(
    tree: ClassificationTree,
    touch: Callable[[int, str], tuple[float, float]],
    *,
    follow: Callable[[Float[np.ndarray, "16 4"]], object] | None = None,
) -> tuple[str, tuple[Touch, ...]]:
    """Explore: ``touch(height, axis)`` measures both sides [N/m]; the class and what was touched.

    ``follow`` is called before each touch, and at the end, with what was measured; see :mod:`.steps`.
    """
    measured = np.full((HEIGHTS, 4), np.nan)
    touched: list[Touch] = []
    while True:
        if follow is not None:
            follow(measured.copy())
        wanted, node = next_touch(tree, measured)
        if wanted is None:
            return tree.classes[int(tree.answer[node])], tuple(touched)
        height, axis = wanted
        column = 0 if axis == "x" else 2
        both = np.asarray(touch(height, axis), dtype=float)
        if both.shape != (2,) or not (np.isfinite(both).all() and (both > 0).all()):
            raise InputError(f"touch {axis}{height}", f"found {both}, expected two stiffnesses above 0")
        measured[height - 1, column : column + 2] = both
        touched.append(wanted)


def mean_touches(tree: ClassificationTree) -> float:
    """Touches until a leaf, in the mean over the training objects with all classes alike."""
    weight = tree.counts / tree.counts[0]
    total = 0.0

    def down(node: int, touched: frozenset[Touch]) -> None:
        nonlocal total
        if tree.feature[node] < 0:
            total += len(touched) * float(weight[node].sum())
            return
        here = touched | {touch_of(int(tree.feature[node]))}
        down(int(tree.left[node]), here)
        down(int(tree.right[node]), here)

    down(0, frozenset(scaling_touches(tree.scheme)))
    return total / len(tree.classes)


def tree_text(tree: ClassificationTree) -> str:
    """The plan in words: what to touch, in what order, and what follows."""
    first = ", ".join(f"{axis}{height}" for height, axis in scaling_touches(tree.scheme))
    lines = [f"touch {first} for the scale" if tree.scheme != "norm" else "touch all places for the scale"]

    def shown(node: int, depth: int, touched: frozenset[Touch]) -> None:
        pad = "  " * depth
        if tree.feature[node] < 0:
            share = tree.counts[node] / tree.counts[node].sum()
            best = int(np.argmax(share))
            lines.append(f"{pad}-> {tree.classes[best]} ({100 * share[best]:.0f} %)")
            return
        feature = int(tree.feature[node])
        known = touch_of(feature) in touched
        name, threshold = feature_name(feature), tree.threshold[node]
        for word, child in (("<=", tree.left), (">", tree.right)):
            lines.append(
                f"{pad}{name} {word} {threshold:.3g}" + (" (touched already)" if known and depth else "")
            )
            shown(int(child[node]), depth + 1, touched | {touch_of(feature)})

    shown(0, 0, frozenset(scaling_touches(tree.scheme)))
    return "\n".join(lines)


def save_tree(path: Path | str, tree: ClassificationTree) -> None:
    """Write JSON, whole or not at all."""
    write_text(path, json.dumps(tree_mapping(tree), indent=1) + "\n")


def tree_mapping(tree: ClassificationTree) -> dict[str, Any]:
    """Plain data of :func:`save_tree`."""
    return {
        "format": _FORMAT,
        "classes": list(tree.classes),
        "scheme": tree.scheme,
        "feature": tree.feature.tolist(),
        "threshold": tree.threshold.tolist(),
        "left": tree.left.tolist(),
        "right": tree.right.tolist(),
        "counts": tree.counts.tolist(),
        "alpha": tree.alpha,
        **{key: None if np.isnan(getattr(tree, key)) else getattr(tree, key) for key in _LOSSES},
    }


def load_tree(path: Path | str) -> ClassificationTree:
    """Read and check what :func:`save_tree` wrote.

    Raises
    ------
    InputError
        Missing, not JSON, or not a tree: each node has two later children or none.
    """
    path = Path(path)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["format"] != _FORMAT:
            raise InputError(path, f"found format {found['format']!r}, expected {_FORMAT}")
        classes = tuple(str(name) for name in found["classes"])
        integers = {key: np.array(found[key], dtype=np.int64) for key in ("feature", "left", "right")}
        threshold = np.array(found["threshold"], dtype=float)
        counts = np.array(found["counts"], dtype=float)
        alpha = float(found["alpha"])
        losses = [float("nan") if found[key] is None else float(found[key]) for key in _LOSSES]
        scheme = str(found["scheme"])
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(path, f"is no classification tree ({error})") from error
    nodes = threshold.size if threshold.ndim == 1 else 0
    place = np.arange(nodes)
    inner = integers["feature"] >= 0 if integers["feature"].ndim == 1 else np.zeros(0, dtype=bool)
    good = (
        scheme in SCHEMES
        and len(classes) > 0
        and counts.shape == (nodes, len(classes))
        and nodes > 0
        and all(array.shape == (nodes,) for array in integers.values())
        and bool((counts >= 0).all() and (counts.sum(axis=1) > 0).all())
        and bool(np.isfinite(threshold[inner]).all() and (integers["feature"] < HEIGHTS * 4).all())
    )
    for key in ("left", "right"):
        good = good and bool(((integers[key] > place) & (integers[key] < nodes))[inner].all())
    if not good:
        raise InputError(path, "is no classification tree: its arrays do not fit together")
    index = integers
    return ClassificationTree(
        classes, scheme, index["feature"], threshold, index["left"], index["right"], counts, alpha, *losses
    )


def plan_rows(tree: ClassificationTree) -> list[dict[str, Any]]:
    """Inner nodes in the order of a walk, for tables: feature, threshold, children."""
    return [
        {
            "node": int(node),
            "feature": feature_name(int(tree.feature[node])),
            "threshold": float(tree.threshold[node]),
            "left": int(tree.left[node]),
            "right": int(tree.right[node]),
        }
        for node in np.flatnonzero(tree.feature >= 0)
    ]


def _predictors(data: FeatureSet, scheme: str) -> Float[np.ndarray, "m p"]:
    """Features in which thresholds are set: logarithms of ratios, so that a threshold is as many
    percent from either side. CART's choices are the same, only the middle between two values moves."""
    x = scaled_features(data.features[..., 0], scheme)
    return x if scheme == "norm" else np.log1p(x)


def _in_feature_units(tree: ClassificationTree) -> ClassificationTree:
    return tree if tree.scheme == "norm" else replace(tree, threshold=np.expm1(tree.threshold))


def _decide(tree: ClassificationTree, x: Float[np.ndarray, "m p"]) -> Int[np.ndarray, "m"]:
    node = np.zeros(len(x), dtype=np.int64)
    row = np.arange(len(x))
    while (inner := tree.feature[node] >= 0).any():
        value = x[row, np.maximum(tree.feature[node], 0)]
        down = np.where(value <= tree.threshold[node], tree.left[node], tree.right[node])
        node = np.where(inner, down, node)
    return tree.answer[node]


def _grow(
    x: Float[np.ndarray, "m p"], y: Int[np.ndarray, "m"], classes: Sequence[str], scheme: str, reuse: float
) -> ClassificationTree:
    if not 0 <= reuse < 1:
        raise InputError("reuse", f"found {reuse}, expected 0 to less than 1")
    if reuse == 0:
        return _cart(x, y, classes, scheme)
    nodes: list[list[float]] = []  # feature, threshold, left, right
    counts: list[np.ndarray] = []

    def grow(rows: np.ndarray, touched: frozenset[Touch]) -> int:
        here = len(nodes)
        nodes.append([-1, 0.0, -1, -1])
        counts.append(np.bincount(y[rows], minlength=len(classes)).astype(float))
        if np.count_nonzero(counts[here]) < 2:
            return here
        split = _split(x[rows], y[rows], len(classes))
        known = [k for k in range(x.shape[1]) if touch_of(k) in touched]
        again = _split(x[rows][:, known], y[rows], len(classes)) if known else None
        if again is not None and split is not None and again[2] >= (1 - reuse) * split[2]:
            split = (known[again[0]], again[1], again[2])
        if split is None:
            return here
        feature, threshold, _ = split
        low = x[rows, feature] <= threshold
        below = touched | {touch_of(feature)}
        nodes[here] = [feature, threshold, grow(rows[low], below), grow(rows[~low], below)]
        return here

    grow(np.arange(len(y)), frozenset(scaling_touches(scheme)))
    table = np.array(nodes)
    index = table[:, [0, 2, 3]].astype(np.int64)
    return ClassificationTree(
        tuple(classes), scheme, index[:, 0], table[:, 1], index[:, 1], index[:, 2], np.stack(counts)
    )


def _cart(
    x: Float[np.ndarray, "m p"], y: Int[np.ndarray, "m"], classes: Sequence[str], scheme: str
) -> ClassificationTree:
    from sklearn.tree import DecisionTreeClassifier

    # Equal splits are many where objects are round: the seed makes the choice the same each time.
    inner = DecisionTreeClassifier(criterion="gini", random_state=0).fit(x, y).tree_
    share, known = inner.value[:, 0, :], np.unique(y)
    counts = np.zeros((inner.node_count, len(classes)))
    counts[:, known] = np.round(share * inner.n_node_samples[:, None])
    leaf = inner.children_left < 0
    feature = np.where(leaf, -1, inner.feature).astype(np.int64)
    threshold = np.where(leaf, 0.0, inner.threshold)
    return ClassificationTree(
        tuple(classes), scheme, feature, threshold,
        inner.children_left.astype(np.int64), inner.children_right.astype(np.int64), counts,
    )  # fmt: skip


def _split(
    x: Float[np.ndarray, "m p"], y: Int[np.ndarray, "m"], classes: int
) -> tuple[int, float, float] | None:
    """The split (6.10) with the children weighted by their objects: feature, threshold, decrease."""
    count = len(y)
    order = np.argsort(x, axis=0, kind="stable")
    ranked = np.take_along_axis(x, order, axis=0)
    below = np.cumsum(np.eye(classes)[y[order]], axis=0)[:-1]  # (m - 1, p, c)
    whole = np.bincount(y, minlength=classes).astype(float)
    size = np.arange(1, count)[:, None]
    # Sum over children of size * gini = m - sum p^2 / size.
    gain = (below**2).sum(axis=2) / size + ((whole - below) ** 2).sum(axis=2) / (count - size)
    gap = ranked[1:] - ranked[:-1]
    gain = np.where(gap > 1e-9, gain, -np.inf)
    # Of equal splits the widest gap: noise of a measurement passes it last.
    row, column = divmod(int(np.argmax(np.where(gain >= gain.max() - 1e-9, gap, -1.0))), x.shape[1])
    decrease = float(gain[row, column]) - float((whole**2).sum()) / count
    if not decrease > 1e-9:
        return None
    return column, float(0.5 * (ranked[row, column] + ranked[row + 1, column])), decrease


def _prune(tree: ClassificationTree, alpha: float) -> ClassificationTree:
    """The smallest subtree that minimises errors + alpha * objects * leaves (Breiman 1984)."""
    cost = alpha * tree.counts[0].sum()
    error = tree.counts.sum(axis=1) - tree.counts.max(axis=1)
    best = error + cost
    cut = np.ones(len(error), dtype=bool)
    for node in range(len(error) - 1, -1, -1):  # children come after their parents
        if tree.feature[node] >= 0:
            below = best[tree.left[node]] + best[tree.right[node]]
            if below < best[node] - 1e-9:
                best[node], cut[node] = below, False
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

    index = np.array(keep)
    return replace(
        tree,
        feature=np.where(cut[index], -1, tree.feature[index]),
        threshold=np.where(cut[index], 0.0, tree.threshold[index]),
        left=renumbered(tree.left),
        right=renumbered(tree.right),
        counts=tree.counts[index],
    )


def _alphas(tree: ClassificationTree) -> Float[np.ndarray, "k"]:
    """Where the pruned tree changes, ascending from a small number."""
    found = [1e-6]
    while True:
        tree = _prune(tree, found[-1])
        inner = np.flatnonzero(tree.feature >= 0)
        if not inner.size:
            return np.array(found)
        error = tree.counts.sum(axis=1) - tree.counts.max(axis=1)
        leaves, below = np.ones(len(error)), error.copy()
        for node in inner[::-1]:
            leaves[node] = leaves[tree.left[node]] + leaves[tree.right[node]]
            below[node] = below[tree.left[node]] + below[tree.right[node]]
        link = (error - below)[inner] / (leaves[inner] - 1) / tree.counts[0].sum()
        found.append(max(float(link.min()), found[-1]) * (1 + 1e-9))


def _stratified(y: Int[np.ndarray, "m"], folds: int, rng: np.random.Generator) -> Int[np.ndarray, "m"]:
    out = np.empty(len(y), dtype=np.int64)
    begin = 0
    for k in np.unique(y):
        rows = rng.permutation(np.flatnonzero(y == k))
        out[rows] = (begin + np.arange(len(rows))) % folds
        begin += len(rows)
    return out

"""Classification tree and its use as an exploration plan (Alt 2016, Sec. 6.3.1).

Each inner node tests one normalised stiffness feature of one side at one height. One touch with two
opposing tips measures both sides, and thus two features. The scaling touches come first; testing a place
again that was touched on the path to a node costs nothing.

Symbols: n nodes, c classes, m objects, p features (height * 4 + side).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...core import InputError, check_choice
from ..data.places import HEIGHTS, SIDES, Touch

#: Normalisation of the features: Eqs. (6.4), (6.5), and relative to one point; see deformation.normalised.
SCHEMES = ("norm", "centre", "point")


@dataclass(frozen=True, slots=True, eq=False)
class ClassificationTree:
    """Nodes as arrays; the root is node 0, a leaf has feature -1."""

    classes: tuple[str, ...]
    scheme: str  #: of the features, one of SCHEMES
    feature: Int[np.ndarray, "n"]
    threshold: Float[np.ndarray, "n"]  #: left child if the feature is at most this
    left: Int[np.ndarray, "n"]
    right: Int[np.ndarray, "n"]
    counts: Float[np.ndarray, "n c"]  #: training objects at the node, by class
    alpha: float = 0.0  #: cost of a leaf at which it was pruned
    loss: float = float("nan")  #: misclassification rate in cross-validation with the selected pruning
    loss_sigma: float = float("nan")  #: its standard error
    nested_loss: float = float("nan")  #: the same with the pruning selected without the tested objects

    @property
    def features(self) -> tuple[int, ...]:
        """Features that are tested at any node, without repetition."""
        return tuple(int(k) for k in np.unique(self.feature[self.feature >= 0]))

    @property
    def answer(self) -> Int[np.ndarray, "n"]:
        """Most frequent class at each node."""
        return np.argmax(self.counts, axis=1)


def feature_name(feature: int) -> str:
    """Name of a feature: ``x+12`` for the side x+ at height 12 of 1 .. 16.

    Parameters
    ----------
    feature
        height * 4 + side, both from 0.
    """
    return f"{SIDES[feature % 4]}{feature // 4 + 1}"


def scaled_features(values: Float[np.ndarray, "*m 16 4"], scheme: str) -> Float[np.ndarray, "*m 64"]:
    """Normalised features of many objects; see :func:`visuohaptic.deformation.normalised`.

    With the schemes ``centre`` and ``point``, places that were not measured are NaN.

    Parameters
    ----------
    values
        Stiffness at the 16 heights and 4 sides [N/m], of any number of objects.
    scheme
        ``norm``, ``centre`` or ``point``.
    """
    values = np.asarray(values, dtype=float)
    flat = values.reshape(*values.shape[:-2], HEIGHTS * 4)
    if scheme == "norm":
        moved = flat - np.median(flat, axis=-1, keepdims=True)
        length = np.linalg.norm(moved, axis=-1, keepdims=True)
        out: np.ndarray = moved / np.where(length > 0, length, 1.0)
        return out
    check_choice("scheme", SCHEMES, scheme)
    scale = values[..., 7, :].mean(axis=-1) if scheme == "centre" else values[..., 7, 0]
    relative: np.ndarray = flat / scale[..., None] - 1
    return relative


def scaling_touches(scheme: str) -> tuple[Touch, ...]:
    """Touches that are required before any feature has a value.

    Parameters
    ----------
    scheme
        ``norm``, ``centre`` or ``point``.
    """
    if scheme == "norm":
        return tuple((height, axis) for axis in "xy" for height in range(1, HEIGHTS + 1))
    return ((8, "x"), (8, "y")) if scheme == "centre" else ((8, "x"),)


def touch_of(feature: int) -> Touch:
    """The touch that measures a feature.

    Parameters
    ----------
    feature
        height * 4 + side, both from 0.
    """
    return feature // 4 + 1, SIDES[feature % 4][0]


def predict(tree: ClassificationTree, values: Float[np.ndarray, "m 16 4"]) -> tuple[str, ...]:
    """Classes of objects with complete features.

    Parameters
    ----------
    tree
        Exploration plan.
    values
        Stiffness of m objects [N/m].
    """
    found = decide(tree, scaled_features(values, tree.scheme))
    return tuple(tree.classes[k] for k in found)


def next_touch(tree: ClassificationTree, measured: Float[np.ndarray, "16 4"]) -> tuple[Touch | None, int]:
    """Next touch, and the current node.

    Parameters
    ----------
    tree
        Exploration plan.
    measured
        Stiffness at the touched places [N/m], NaN elsewhere.

    Returns
    -------
    tuple
        The touch, or None at a leaf; and the current node.
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
    """Explore along a tree.

    Parameters
    ----------
    tree
        Exploration plan.
    touch
        Measures both sides at a height 1 .. 16 along an axis ``x`` or ``y`` [N/m].
    follow
        Called before each touch and at the end with the measurements; see :mod:`.steps`.

    Returns
    -------
    tuple
        The class, and the executed touches.
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
    """Expected number of touches until a leaf over the training objects, all classes weighted equally.

    Parameters
    ----------
    tree
        Exploration plan.
    """
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


def decide(tree: ClassificationTree, x: Float[np.ndarray, "m p"]) -> Int[np.ndarray, "m"]:
    """Answers as indices of the classes.

    Parameters
    ----------
    tree
        Tree with thresholds in the unit of ``x``.
    x
        Features of m objects.
    """
    node = np.zeros(len(x), dtype=np.int64)
    row = np.arange(len(x))
    while (inner := tree.feature[node] >= 0).any():
        value = x[row, np.maximum(tree.feature[node], 0)]
        down = np.where(value <= tree.threshold[node], tree.left[node], tree.right[node])
        node = np.where(inner, down, node)
    return tree.answer[node]

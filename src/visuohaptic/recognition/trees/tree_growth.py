"""Growing a tree: CART with Gini's index, and the smoothed classes that it learns from.

A hundred objects of a class are few where classes touch: CART puts thresholds between the objects that
happen to be there. So each class is filled up with samples from its kernel density (a smoothed bootstrap,
Silverman and Young 1987), as the planner has it, in logarithms of stiffness and before any scaling: splits
that divide only these objects and no others of their kind lose. A small fraction of the weight has samples as
an exploration would read them: where classes are apart, these alone say where in the gap the threshold
stands and which of several such features is the safest. All classes keep the weight of their objects.

Symbols: m objects, p features, c classes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..data.noise import as_measured
from ..data.places import HEIGHTS, Touch
from .tree_nodes import ClassificationTree, scaled_features, scaling_touches, touch_of

__all__ = ["SAMPLES", "grown", "predictors", "smoothed"]

#: Draws that fill up each class, and as many that are read with noise.
SAMPLES = 300
#: Fraction of the weight that is read with noise.
_READ = 0.1
#: Relative error of simulated stiffness, by place, as the planner has it.
_DISCREPANCY = 0.04
#: Dimensions in which containers of one class differ, about: sizes, bulges, wall.
_DIMENSIONS = 6
#: Smallest decrease of impurity that counts.
_MIN = 1e-9


def predictors(log_stiffness: Float[np.ndarray, "m 64"], scheme: str) -> Float[np.ndarray, "m p"]:
    """Features in which thresholds are set: logarithms of ratios.

    So a threshold is equally many percent from either side. CART's choices are the same, only the middle
    between two values moves.

    Parameters
    ----------
    log_stiffness
        Logarithms of stiffness [N/m] of m objects.
    scheme
        Of the features: ``norm``, ``centre`` or ``point``.
    """
    x = scaled_features(np.exp(log_stiffness).reshape(-1, HEIGHTS, 4), scheme)
    return x if scheme == "norm" else np.log1p(x)


def smoothed(
    log_stiffness: Float[np.ndarray, "m 64"],
    number: Int[np.ndarray, "m"],
    samples: int,
    rng: np.random.Generator,
    *,
    pose_errors: Float[np.ndarray, "m v 16 4"] | None = None,
) -> tuple[Float[np.ndarray, "k 64"], Int[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Objects and samples with their classes and weights; each class weighs as much as it has objects.

    Parameters
    ----------
    log_stiffness, number
        Objects and their classes.
    samples
        Of each class, and as many that are read with noise; 0: the objects as they are.
    rng
        Of the samples.
    pose_errors
        What wrong poses change, see :mod:`.pose_error`.
    """
    if not samples:
        return log_stiffness, number, np.ones(len(number))
    values, classes, weight = [log_stiffness], [number], [np.ones(len(number))]
    for k in np.unique(number):
        some = np.flatnonzero(number == k)
        drawn = _drawn(log_stiffness[some], samples, rng)
        near = np.arange(samples) % len(some)
        noisy = as_measured(
            _drawn(log_stiffness[some], samples, rng).reshape(-1, HEIGHTS, 4),
            rng,
            pose_errors=None if pose_errors is None else pose_errors[some[near]],
            discrepancy=_DISCREPANCY,
        )
        values += [drawn, noisy.reshape(samples, -1)]
        classes.append(np.full(2 * samples, k))
        fraction = (1 - _READ) * len(some) / (len(some) + samples)
        weight[0][some] = fraction
        weight += [np.full(samples, fraction), np.full(samples, _READ * len(some) / samples)]
    return np.concatenate(values), np.concatenate(classes), np.concatenate(weight)


def _drawn(
    log_stiffness: Float[np.ndarray, "m 64"], samples: int, rng: np.random.Generator
) -> Float[np.ndarray, "k 64"]:
    """Of one class: the objects in turn, moved towards their middle and from there by their covariance.

    So mean and covariance stay what they are (West 1993).
    """
    count = len(log_stiffness)
    middle = log_stiffness.mean(axis=0)
    away = log_stiffness - middle
    _, size, axes = np.linalg.svd(away / np.sqrt(count), full_matrices=False)
    size = np.where(size > 1e-6 * size.max(), size, 0.0)
    step = rng.standard_normal((samples, len(size))) @ (size[:, None] * axes)
    # Silverman's rule, of the class's own spread: 0.6 for a hundred objects.
    width = min((4 / (_DIMENSIONS + 2) / count) ** (1 / (_DIMENSIONS + 4)), 1.0)
    out: np.ndarray = middle + np.sqrt(1 - width**2) * away[np.arange(samples) % count] + width * step
    return out


def grown(
    x: Float[np.ndarray, "m p"],
    number: Int[np.ndarray, "m"],
    weight: Float[np.ndarray, "m"],
    classes: Sequence[str],
    scheme: str,
    reuse: float,
    *,
    alpha: float = 0.0,
) -> ClassificationTree:
    """Split until no split lowers the impurity; thresholds are in the unit of ``x``.

    With the ``alpha`` of a pruning that follows, nodes with fewer errors than one leaf costs stay leaves:
    they would be cut anyway.

    Parameters
    ----------
    x
        Features of m objects.
    number
        Class of each object.
    weight
        Of each object.
    classes
        Names of the classes.
    scheme
        Of the features.
    reuse
        Fraction of the best decrease of impurity that may be given up for a place that is touched already.
    alpha
        Cost of a leaf, relative to the weight of all objects.
    """
    from ._tree_kernels import best_splits, partition_order

    if not 0 <= reuse < 1:
        raise InputError("reuse", f"found {reuse}, expected 0 to less than 1")
    columns = np.ascontiguousarray(x.T)
    touch = [touch_of(k) for k in range(len(columns))]
    least = max(_MIN, alpha * float(weight.sum()))
    nodes: list[list[float]] = []  # feature, threshold, left, right
    counts: list[np.ndarray] = []

    def grow(order: np.ndarray, touched: frozenset[Touch]) -> int:
        here, rows = len(nodes), order[0]
        nodes.append([-1, 0.0, -1, -1])
        counts.append(np.bincount(number[rows], weight[rows], minlength=len(classes)))
        if counts[here].sum() - counts[here].max() <= least:
            return here
        decrease, threshold, gap = best_splits(order, columns, number, weight, len(classes))
        best = float(decrease.max())
        if not best > _MIN:
            return here
        if reuse:
            again = np.where([one in touched for one in touch], decrease, -1.0)
            if again.max() >= (1 - reuse) * best:
                decrease, best = again, float(again.max())
        # Of equal splits the widest gap: noise of a measurement passes it last.
        feature = int(np.argmax(np.where(decrease >= best - _MIN, gap, -1.0)))
        left = columns[feature] <= threshold[feature]
        both = partition_order(order, left, int(np.count_nonzero(left[rows])))
        below = touched | {touch[feature]}
        nodes[here] = [feature, threshold[feature], grow(both[0], below), grow(both[1], below)]
        return here

    grow(np.argsort(columns, axis=1).astype(np.int32), frozenset(scaling_touches(scheme)))
    table = np.array(nodes)
    index = table[:, [0, 2, 3]].astype(np.int64)
    return ClassificationTree(
        tuple(classes), scheme, index[:, 0], table[:, 1], index[:, 1], index[:, 2], np.stack(counts)
    )

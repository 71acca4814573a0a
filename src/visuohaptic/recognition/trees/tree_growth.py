"""Growth of a tree: CART with the Gini index on smoothed classes.

A hundred objects of a class are few if classes are adjacent: CART places thresholds between the individual training
objects. Each class is therefore augmented with samples from its kernel density (a smoothed bootstrap,
Silverman and Young 1987), like in the planner, in logarithms of stiffness and before normalisation: splits
that fit only the training objects are then inferior. A small fraction of the weight belongs to samples with the noise of
an exploration: if classes are separated, only these determine the position of the threshold in the gap,
and which of several such features is most robust. All classes keep the weight of their objects.

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

#: Number of samples added to each class, and of additional samples with measurement noise.
SAMPLES = 300
#: Fraction of the weight that belongs to the samples with noise.
_READ = 0.1
#: Relative error of simulated stiffness, by place, as in the planner.
_DISCREPANCY = 0.04
#: Approximate number of dimensions in which containers of one class differ: sizes, bulges, wall.
_DIMENSIONS = 6
#: Minimum decrease of impurity of a split.
_MIN = 1e-9


def predictors(log_stiffness: Float[np.ndarray, "m 64"], scheme: str) -> Float[np.ndarray, "m p"]:
    """Features to which thresholds are applied: logarithms of ratios.

    A threshold then has the same relative distance from either side. The splits selected by CART are the same, only
    the midpoint between two values changes.

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
    """Objects and samples with their classes and weights; the weight of a class is its number of objects.

    Parameters
    ----------
    log_stiffness, number
        Objects and their classes.
    samples
        Number of samples of each class, and of additional samples with noise; 0: the objects alone.
    rng
        Source of the samples.
    pose_errors
        Effect of pose errors, see :mod:`.pose_error`.
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
    """Samples of one class: each object in turn, shrunk towards the mean, plus noise with the covariance of the class.

    This preserves mean and covariance (West 1993).
    """
    count = len(log_stiffness)
    middle = log_stiffness.mean(axis=0)
    away = log_stiffness - middle
    _, size, axes = np.linalg.svd(away / np.sqrt(count), full_matrices=False)
    size = np.where(size > 1e-6 * size.max(), size, 0.0)
    step = rng.standard_normal((samples, len(size))) @ (size[:, None] * axes)
    # Silverman's rule, relative to the standard deviation of the class: 0.6 for a hundred objects.
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

    Given the ``alpha`` of a subsequent pruning, nodes with fewer errors than the cost of a leaf are not split:
    they would be pruned anyway.

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
        Fraction of the best decrease of impurity that may be given up for a place that was already touched.
    alpha
        Cost of a leaf, relative to the weight of all objects.
    """
    from ._tree_kernels import best_splits

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
        # Among equal splits, the widest gap is the most robust to measurement noise.
        feature = int(np.argmax(np.where(decrease >= best - _MIN, gap, -1.0)))
        left = (columns[feature] <= threshold[feature])[order]
        below = touched | {touch[feature]}
        low, high = (grow(order[side].reshape(len(order), -1), below) for side in (left, ~left))
        nodes[here] = [feature, threshold[feature], low, high]
        return here

    grow(np.argsort(columns, axis=1).astype(np.int32), frozenset(scaling_touches(scheme)))
    table = np.array(nodes)
    index = table[:, [0, 2, 3]].astype(np.int64)
    return ClassificationTree(
        tuple(classes), scheme, index[:, 0], table[:, 1], index[:, 1], index[:, 2], np.stack(counts)
    )

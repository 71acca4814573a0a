"""Training of classification trees that are exploration plans (Alt 2016, Sec. 6.3.1).

CART with the Gini index on smoothed classes (:mod:`.tree_growth`), with cost-complexity pruning selected by
cross-validation (:mod:`.tree_pruning`). Data structure and traversal: :mod:`.tree_nodes`;
files: :mod:`.tree_file`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ..data.data_set import FeatureSet
from .tree_growth import SAMPLES, grown, predictors, smoothed
from .tree_nodes import (
    ClassificationTree,
    decide,
)
from .tree_pruning import pruned, pruning_middles, simplest, stratified_folds


def train_tree(
    data: FeatureSet,
    *,
    scheme: str = "centre",
    alpha: float | None = None,
    reuse: float = 0.1,
    folds: int = 10,
    samples: int = SAMPLES,
    rng: np.random.Generator | None = None,
) -> ClassificationTree:
    """Train a tree, prune it by cross-validation, and estimate its loss.

    The folds are stratified; samples are generated from the objects of the other folds, and only objects are
    tested. Among all prunings, the smallest tree is selected whose cross-validated loss is at most one
    standard error above the minimum (Breiman 1984), and its loss is returned. ``nested_loss`` is that of the
    whole procedure: for each fold, the pruning is selected on the others.

    Parameters
    ----------
    data
        Current candidates; see :meth:`.FeatureSet.of_classes`.
    scheme
        Of the features: ``norm``, ``centre`` or ``point``.
    alpha
        Cost of a leaf, as a fraction of all objects, if known: replaces the cross-validation and takes milliseconds.
    reuse
        Fraction of the best split's decrease of impurity that may be given up for a feature at a place that was already
        touched, 0 to 1.
    folds
        Number of folds of the cross-validation; at most the number of objects of the smallest class.
    samples
        Number of samples added to each class; 0 is plain CART on the objects alone.
    rng
        Source of folds and samples.

    Raises
    ------
    InputError
        More folds than objects of a class, or a stiffness that is not finite and positive.
    """
    values, number = _log_stiffness(data, samples), data.number
    rng = np.random.default_rng(0) if rng is None else rng
    if alpha is not None:
        whole = _grow(values, data, scheme, reuse, samples, rng, alpha=alpha)
        return _in_feature_units(replace(pruned(whole, alpha), alpha=alpha))
    fewest = int(np.bincount(number).min())
    if not 2 <= folds <= fewest:
        raise InputError("train_tree", f"found {folds} folds, expected 2 to {fewest}, the smallest class")
    fold = stratified_folds(number, folds, rng)
    whole = _grow(values, data, scheme, reuse, samples, rng)
    # The last pruning is the root alone, even in a fold whose classes are further apart than those of the whole set.
    middles = np.append(pruning_middles(whole), 1.0)
    x = predictors(values, scheme)
    wrong = np.zeros((folds, len(middles)))
    for k in range(folds):
        held = fold == k
        part = _grow(values[~held], data.take(~held), scheme, reuse, samples, rng)
        for place, cost in enumerate(middles):
            found = decide(pruned(part, float(cost)), x[held])
            wrong[k, place] = np.count_nonzero(found != number[held])
    total = wrong.sum(axis=0)
    best = simplest(total, len(data))
    loss = float(total[best] / len(data))
    others = [simplest(total - wrong[k], int(np.count_nonzero(fold != k))) for k in range(folds)]
    nested = float(wrong[np.arange(folds), others].sum() / len(data))
    sigma = float(np.sqrt(max(loss * (1 - loss), 1 / len(data) / 4) / len(data)))
    alpha = float(middles[best])
    return _in_feature_units(
        replace(pruned(whole, alpha), alpha=alpha, loss=loss, loss_sigma=sigma, nested_loss=nested)
    )


def _log_stiffness(data: FeatureSet, samples: int) -> Float[np.ndarray, "m 64"]:
    if samples < 0:
        raise InputError("samples", f"found {samples}, expected 0 or more")
    stiffness = data.features[..., 0].reshape(len(data), -1)
    if not (np.isfinite(stiffness).all() and (stiffness > 0).all()):
        raise InputError("features", "found stiffness that is not finite and above 0")
    return np.log(stiffness)


def _grow(
    values: Float[np.ndarray, "m 64"],
    data: FeatureSet,
    scheme: str,
    reuse: float,
    samples: int,
    rng: np.random.Generator,
    *,
    alpha: float = 0.0,
) -> ClassificationTree:
    more, number, weight = smoothed(values, data.number, samples, rng, pose_errors=data.pose_errors)
    return grown(predictors(more, scheme), number, weight, data.classes, scheme, reuse, alpha=alpha)


def _in_feature_units(tree: ClassificationTree) -> ClassificationTree:
    return tree if tree.scheme == "norm" else replace(tree, threshold=np.expm1(tree.threshold))

"""Splits and prunings of classification trees (:mod:`.tree_growth`, :mod:`.tree_pruning`).

Symbols: p features, k objects of a node, n nodes.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel


@kernel
def best_splits(
    order: np.ndarray, values: np.ndarray, number: np.ndarray, weight: np.ndarray, classes: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decrease of impurity, threshold and gap of the best split of each feature.

    ``order`` (p, k) contains the objects of the node sorted by each feature, ``values`` (p, all) the
    features. The decrease is weight * gini of the node minus the sum over its children. Among equal
    splits of one feature, the one in the widest gap is selected; -1 if no split is possible.
    """
    features, count = order.shape
    whole = np.zeros(classes)
    for place in range(count):
        row = order[0, place]
        whole[number[row]] += weight[row]
    total, square = 0.0, 0.0
    for k in range(classes):
        total += whole[k]
        square += whole[k] * whole[k]
    decrease = np.full(features, -1.0)
    threshold, widest = np.zeros(features), np.zeros(features)
    below = np.zeros(classes)
    for f in range(features):
        below[:] = 0.0
        # Sums of squares of the weights by class, kept up to date in place.
        low, squares_low, squares_high = 0.0, 0.0, square
        for place in range(count - 1):
            row = order[f, place]
            w, c = weight[row], number[row]
            above = whole[c] - below[c]
            squares_low += w * (2 * below[c] + w)
            squares_high += w * (w - 2 * above)
            below[c] += w
            low += w
            here = values[f, row]
            gap = values[f, order[f, place + 1]] - here
            if gap <= 1e-9:
                continue
            gain = squares_low / low + squares_high / (total - low) - square / total
            if gain > decrease[f] + 1e-9 or (gain >= decrease[f] - 1e-9 and gap > widest[f]):
                decrease[f] = max(gain, decrease[f])
                threshold[f], widest[f] = here + 0.5 * gap, gap
    return decrease, threshold, widest

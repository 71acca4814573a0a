"""Stiffness features of four classes and their decision tree (Fig. 6.7).

Features over the height (x+ solid, y+ dashed), bars: standard deviation in a class; crosses: features and
thresholds of the tree next to it (simulated features, as in the dissertation).
"""

from __future__ import annotations

from itertools import product

from ...recognition import SIDES, train_tree
from ...recognition.trees.tree_nodes import feature_name, scaled_features
from ...recognition.trees.tree_plots import plot_tree
from .._features import DISTINCT, grouped, training_features
from ..output import Columns, Output


def run(out: Output) -> None:
    """Train on four classes and draw.

    Parameters
    ----------
    out
        Receives the tables ``features`` and ``nodes``, picture ``tree``, and the comparisons; its seed and size are used.
    """
    data = grouped(training_features(out), DISTINCT)
    tree = train_tree(data, rng=out.rng(), folds=6 if out.quick else 10)
    out.drawn("tree", lambda path: plot_tree(path, tree, data))
    x = scaled_features(data.features[..., 0], tree.scheme).reshape(len(data), 16, 4)
    rows = Columns("class height side mean deviation")
    for (k, name), height, side in product(enumerate(data.classes), range(16), (0, 2)):
        values = x[data.number == k, height, side]
        rows.add(name, height + 1, SIDES[side], float(values.mean()), float(values.std()))
    out.table("features", rows)
    nodes = [
        (feature_name(int(f)), float(t)) for f, t in zip(tree.feature, tree.threshold, strict=True) if f >= 0
    ]
    out.table("nodes", {"feature": [name for name, _ in nodes], "threshold": [t for _, t in nodes]})
    out.compare(
        "cross-validated loss", 100 * tree.loss, "%", note="of similar subsets: 0.0 to 1.2 (Table 6.1)"
    )
    out.compare("inner nodes", len(nodes), note="the printed tree separates the cup by x+14 first")

"""Decision trees trained with subsets of classes (Table 6.1).

Cross-validated loss of nine trees and the printed values (simulated features, as in the dissertation).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...recognition import feature_name, train_tree
from ...report.style import COLOURS, draw_axes
from .._features import CONFUSABLE, FIVE, training_features
from ..output import Columns, Output
from ..worlds.virtual_containers import GROUPS

#: Number -> classes, scheme, printed loss [%], printed count of different features.
TREES: dict[int, tuple[tuple[str, ...], str, float, int]] = {
    1: (("cup", "cup-rim"), "centre", 0.0, 1),
    2: (("bottle", "elliptic"), "centre", 0.0, 2),
    3: (("bottle", "elliptic"), "point", 2.9, 3),
    4: (("bottle", "cup", "elliptic"), "centre", 0.5, 3),
    5: (("bottle", "cup", "elliptic"), "point", 2.7, 4),
    6: (FIVE, "norm", 2.9, 7),
    7: (FIVE, "centre", 1.2, 6),
    8: (FIVE, "point", 3.7, 9),
    9: (CONFUSABLE, "centre", 0.8, 2),
}
#: The elliptic bottles are one class where they are not distinguished.
ELLIPTIC = {"elliptic": GROUPS["elliptic"]}
#: Number of random partitions into folds; the loss is the mean.
REPEATS = 5
_NAMES = {"centre": "(6.5), two touches", "point": "one point", "norm": "(6.4), all"}


def run(out: Output) -> None:
    """Train all nine.

    Parameters
    ----------
    out
        Receives the table ``trees``, picture ``losses``, and the comparisons; its seed and size are used.
    """
    data = training_features(out)
    rows = Columns(
        "tree classes feature loss_percent sigma_percent printed_percent nodes features printed_features selected"
    )
    for number, (classes, scheme, printed, count) in TREES.items():
        chosen = data.of_classes(classes, ELLIPTIC if number != 9 else {})
        rng, (folds, repeats) = out.rng(number), (3, 1) if out.quick else (10, REPEATS)
        trees = [train_tree(chosen, scheme=scheme, rng=rng, folds=folds) for _ in range(repeats)]
        tree, loss = trees[0], 100 * float(np.mean([one.loss for one in trees]))
        used = [int(f) for f in tree.feature if f >= 0]
        text = "; ".join(f"{feature_name(int(f))} [{t:.2f}]"
                         for f, t in zip(tree.feature, tree.threshold, strict=True) if f >= 0)  # fmt: skip
        rows.add(number, ", ".join(classes), _NAMES[scheme], loss, 100 * tree.loss_sigma, printed,
                 len(used), len(tree.features), count, text)  # fmt: skip
        out.compare(f"tree {number}: loss", loss, "%", dissertation=printed,
                    note=f"{', '.join(classes)}; {_NAMES[scheme]}; {len(chosen)} variants, {len(used)} nodes")  # fmt: skip
    out.table("trees", rows)

    def draw(axes: Any) -> None:
        for shift, key, colour, label in ((-0.2, "loss_percent", "blue", "ours"),
                                          (0.2, "printed_percent", "grey", "dissertation")):  # fmt: skip
            bars = None
            if key == "loss_percent":  # a loss is not negative
                bars = [
                    [min(s, v) for s, v in zip(rows["sigma_percent"], rows[key], strict=True)],
                    rows["sigma_percent"],
                ]
            axes.bar(
                [n + shift for n in rows["tree"]],
                rows[key],
                0.38,
                color=COLOURS[colour],
                label=label,
                yerr=bars,
            )
        axes.set(xlabel="tree", ylabel="loss [%]", xticks=rows["tree"])
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)

    out.picture("losses", draw_axes(1, 1, draw, size=(7.0, 3.8)))

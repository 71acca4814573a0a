"""Correlation between feature vectors of different classes (Fig. 6.6).

Mean normalised cross-correlation of simulated features; 1 means the same stiffness profile.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...recognition.trees.tree_plots import class_correlation, plot_correlation
from .._features import CONFUSABLE, training_features
from ..output import Output


def run(out: Output) -> None:
    """Correlate all classes.

    Parameters
    ----------
    out
        Receives the table ``correlation``, picture ``correlation``, and the comparisons; its seed and size are used.
    """
    data = training_features(out)
    data = data.take(np.array([label != "cut-bottle" for label in data.label]))
    values = class_correlation(data)
    out.drawn("correlation", lambda path: plot_correlation(path, data))
    columns: dict[str, Any] = {"class": list(data.classes)}
    columns |= {name: values[:, k] for k, name in enumerate(data.classes)}
    out.table("correlation", columns)
    own = np.diag(values)
    out.compare("correlation within a class, mean", float(own.mean()))
    between = values[~np.eye(len(values), dtype=bool)]
    out.compare("correlation between classes, mean", float(between.mean()))
    chosen = [data.classes.index(name) for name in CONFUSABLE]
    three = values[np.ix_(chosen, chosen)][~np.eye(3, dtype=bool)]
    out.compare("correlation among elliptic bottles, mean", float(three.mean()),
                note="printed: objects with more subtle differences cannot be distinguished")  # fmt: skip

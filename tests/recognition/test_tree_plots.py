from __future__ import annotations

from pathlib import Path

import numpy as np

from visuohaptic.recognition.trees import class_correlation, plot_correlation, plot_tree, train_tree

from .worlds import synthetic


def test_classes_are_most_like_themselves(tmp_path: Path) -> None:
    data = synthetic(10)
    found = class_correlation(data)
    np.testing.assert_allclose(found, found.T)
    assert (found.max(axis=0) == np.diag(found)).all()
    plot_correlation(tmp_path / "classes.png", data)
    plot_tree(tmp_path / "tree.png", train_tree(data), data)
    plot_tree(tmp_path / "alone.svg", train_tree(data))
    assert all((tmp_path / name).stat().st_size > 5000 for name in ("classes.png", "tree.png", "alone.svg"))

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from visuohaptic.core import InputError
from visuohaptic.recognition import HapticClassifier, TouchReading
from visuohaptic.recognition.trees import (
    class_correlation,
    plot_correlation,
    plot_tree,
    train_tree,
    tree_plots,
)

from .worlds import synthetic


def test_classes_are_most_like_themselves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    save = tree_plots.save_figure
    monkeypatch.setattr(
        tree_plots, "save_figure", lambda path, made: (figures.append(made), save(path, made))
    )
    data = synthetic(10)
    found = class_correlation(data)
    np.testing.assert_allclose(found, found.T)
    assert (found.max(axis=0) == np.diag(found)).all()
    assert (np.abs(found) <= 1.0).all()
    assert (np.diag(found) > 0.5).all()
    plot_correlation(tmp_path / "classes.png", data)
    middle = (len(data.classes) - 1) / 2
    told = figures[0].axes[0].texts
    assert np.mean([text.get_position() for text in told], axis=0) == pytest.approx([middle, middle])
    for text in told:
        column, row = map(round, text.get_position())
        assert float(text.get_text()) == pytest.approx(found[row, column], abs=0.0051)
    tree = train_tree(data)
    plot_tree(tmp_path / "tree.png", tree, data)
    plot_tree(tmp_path / "alone.svg", tree)
    assert all((tmp_path / name).stat().st_size > 5000 for name in ("classes.png", "tree.png", "alone.svg"))

    whole, alone = figures[1].axes, figures[2].axes
    leaves, inner = np.flatnonzero(tree.feature < 0), np.flatnonzero(tree.feature >= 0)
    share = tree.counts[leaves].max(axis=1) / tree.counts[leaves].sum(axis=1)
    expected = {
        f"{tree.classes[tree.answer[leaf]]}\n{100 * part:.0f} %"
        for leaf, part in zip(leaves, share, strict=True)
    }
    for axes in (whole[1], *alone):
        assert expected == {text.get_text() for text in axes.texts if "%" in text.get_text()}
        sides = [(line.get_xdata()[1] - line.get_xdata()[0]) > 0 for line in axes.lines]
        assert sides == [False, True] * len(inner)  # no more to the left
        assert all(np.diff(line.get_ydata()) == -1 for line in axes.lines)  # each one level below its parent
    crosses = [(*line.get_xdata(), *line.get_ydata()) for line in whole[0].lines if line.get_marker() == "x"]
    assert crosses == [(tree.feature[node] // 4 + 1, tree.threshold[node]) for node in inner]
    assert len(whole[0].containers) == 2 * len(data.classes)


def test_a_classifier_of_curves_alone_has_no_tree_to_draw(tmp_path: Path) -> None:
    touches = [TouchReading.of_stiffness(8, "x", [level] * 2) for level in (2e3, 9e3)]
    fitted = HapticClassifier().fit(touches, ["cup", "bottle"]).fitted()
    with pytest.raises(InputError, match="found no tree"):
        plot_tree(tmp_path / "tree.png", fitted.tree)

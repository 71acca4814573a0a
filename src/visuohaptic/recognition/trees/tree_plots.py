"""Plots of trees and features, like figures 6.6 and 6.7 of Alt 2016."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import InputError
from ...core.files import literal, new_figure, save_figure
from ..data import HEIGHTS, FeatureSet
from .tree_nodes import ClassificationTree, feature_name, scaled_features


def class_correlation(data: FeatureSet) -> Float[np.ndarray, "c c"]:
    """Mean normalised cross-correlation of the features of two classes (Fig. 6.6).

    Parameters
    ----------
    data
        Training objects.
    """
    x = scaled_features(data.features[..., 0], "centre")
    x = x - x.mean(axis=1, keepdims=True)
    x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300)
    fraction = np.eye(len(data.classes))[data.number]
    mean = fraction.T @ x / fraction.sum(axis=0)[:, None]
    out: np.ndarray = mean @ mean.T
    return out


def plot_tree(path: Path | str, tree: ClassificationTree | None, data: FeatureSet | None = None) -> None:
    """Plot a tree and, given its training objects, the features with standard deviations and thresholds (Fig. 6.7).

    Parameters
    ----------
    path
        Figure to write.
    tree
        Exploration plan; a classifier of curves alone has none.
    data
        Its training objects.

    Raises
    ------
    InputError
        There is no tree.

    Examples
    --------
    >>> from visuohaptic.recognition.trees import train_tree
    >>> stiffness, width = np.full((6, 16, 4), 8e3), np.full((6, 16, 2), 0.06)
    >>> stiffness[:3, 12:] = 5e2  # cups are soft at their upper end
    >>> data = FeatureSet.of_stiffness(stiffness, width, ["cup"] * 3 + ["bottle"] * 3)
    >>> plot_tree("tree.png", train_tree(data, folds=3), data)
    """
    if tree is None:
        problem = "found no tree: curves alone train none, stiffness at all heights does"
        raise InputError("plot_tree", problem, remedy="fit a FeatureSet")
    wide = data is not None
    figure, axes = new_figure(1, 2 if wide else 1, size=(12 if wide else 7, 5.5), layout="constrained")
    _draw_tree(axes[-1], tree)
    if data is not None:
        _draw_features(axes[0], tree, data)
    save_figure(path, figure)


def plot_correlation(path: Path | str, data: FeatureSet) -> None:
    """Plot the similarity of classes (Fig. 6.6).

    Parameters
    ----------
    path
        Figure to write.
    data
        Training objects.
    """
    figure, (axes,) = new_figure(1, 1, size=(6.5, 5.5), layout="constrained")
    values = class_correlation(data)
    shown = axes.imshow(values, vmin=-1, vmax=1, cmap="RdBu_r")
    names = [literal(name) for name in data.classes]
    axes.set_xticks(range(len(values)), names, rotation=45, ha="right")
    axes.set_yticks(range(len(values)), names)
    for row, line in enumerate(values):
        for column, value in enumerate(line):
            ink = "white" if abs(value) > 0.7 else "black"
            axes.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=7, color=ink)
    figure.colorbar(shown, ax=axes, label="correlation")
    save_figure(path, figure)


def _draw_tree(axes: Any, tree: ClassificationTree) -> None:
    place: dict[int, tuple[float, int]] = {}
    leaves = 0

    def put(node: int, depth: int) -> float:
        nonlocal leaves
        if tree.feature[node] < 0:
            x = float(leaves)
            leaves += 1
        else:
            x = 0.5 * (put(int(tree.left[node]), depth + 1) + put(int(tree.right[node]), depth + 1))
        place[node] = (x, -depth)
        return x

    put(0, 0)
    for node, (x, y) in place.items():
        if tree.feature[node] < 0:
            fraction = tree.counts[node] / tree.counts[node].sum()
            best = int(np.argmax(fraction))
            text, face = f"{literal(tree.classes[best])}\n{100 * fraction[best]:.0f} %", f"C{best}"
        else:
            text, face = f"{feature_name(int(tree.feature[node]))}", "white"
            for child, sign in ((int(tree.left[node]), "≤"), (int(tree.right[node]), ">")):
                to = place[child]
                axes.plot([x, to[0]], [y, to[1]], color="0.6", lw=1, zorder=1)
                axes.text(
                    0.5 * (x + to[0]), 0.5 * (y + to[1]), f"{sign} {tree.threshold[node]:.2g}",
                    ha="center", va="center", fontsize=7, backgroundcolor="white", zorder=2,
                )  # fmt: skip
        axes.text(
            x, y, text, ha="center", va="center", fontsize=8, zorder=3,
            bbox={"boxstyle": "round", "facecolor": face, "edgecolor": "0.4", "alpha": 0.9},
        )  # fmt: skip
    axes.set_axis_off()
    axes.margins(0.12)
    if np.isfinite(tree.loss):
        axes.set_title(f"cross-validated loss {100 * tree.loss:.1f} %")


def _draw_features(axes: Any, tree: ClassificationTree, data: FeatureSet) -> None:
    x = scaled_features(data.features[..., 0], tree.scheme).reshape(len(data), HEIGHTS, 4)
    height = np.arange(1, HEIGHTS + 1)
    for k, name in enumerate(data.classes):
        some = x[data.number == k]
        for column, style in ((0, "-"), (2, "--")):
            axes.errorbar(
                height + 0.06 * k, some[:, :, column].mean(axis=0), some[:, :, column].std(axis=0),
                color=f"C{k}", ls=style, lw=1, capsize=2, label=literal(name) if column == 0 else None,
            )  # fmt: skip
    for node in np.flatnonzero(tree.feature >= 0):
        feature = int(tree.feature[node])
        axes.plot(feature // 4 + 1, tree.threshold[node], "kx", ms=9, mew=2)
        axes.annotate(
            feature_name(feature), (feature // 4 + 1, tree.threshold[node]), (-8, 0), ha="right", va="center",
            textcoords="offset points", fontsize=8, bbox={"facecolor": "white", "lw": 0, "alpha": 0.8, "pad": 0.5},
        )  # fmt: skip
    axes.set(xlabel="height (solid x+, dashed y+)", ylabel="feature without scale [1]")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)

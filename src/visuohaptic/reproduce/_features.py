"""Training features of many variants of each class, computed once for all experiments that use them (Sec. 6.4.1)."""

from __future__ import annotations

import numpy as np

from ..core.errors import VisuohapticError
from ..deformation import class_names, draw_variant, linear_features, mesh_container
from ..recognition.data.data_set import FeatureSet, load_feature_set, save_feature_set
from .output import Output
from .worlds.virtual_containers import GROUPS, description

FIVE = ("bottle", "cup", "cup-rim", "elliptic", "smoothie")
CONFUSABLE = ("cien", "isana", "cleaner")
#: Four relatively distinct classes.
DISTINCT = ("bottle", "cup", "elliptic", "smoothie")
VARIANTS = 100


def training_features(out: Output) -> FeatureSet:
    """Linear features of open containers, read from the shared folder if available.

    Parameters
    ----------
    out
        Its seed, size and shared folder.
    """
    variants = 6 if out.quick else VARIANTS
    path = out.shared / f"features-{variants}-{out.seed}.npz"
    if path.is_file():
        return load_feature_set(path)
    features, widths, labels, names = [], [], [], []
    for name in (*class_names(), "cut-bottle"):
        base = description(name)
        for number in range(variants):
            try:
                found = linear_features(mesh_container(draw_variant(base, number, out.seed), around=36))
            except VisuohapticError:
                continue  # a wall that would intersect itself
            points = found.points_m
            features.append(found.values)
            widths.append(np.linalg.norm(points[:, ::2, :2] - points[:, 1::2, :2], axis=2))
            labels.append(name)
            names.append(f"{name}-{number}")
    data = FeatureSet(np.stack(features), np.stack(widths), tuple(labels), tuple(names))
    save_feature_set(path, data)
    return data


def grouped(data: FeatureSet, classes: tuple[str, ...]) -> FeatureSet:
    """Features of some classes; the elliptic bottles are one class, cups and the cut bottle another, as in Table 6.2.

    Parameters
    ----------
    data
        All classes.
    classes
        Names to keep.
    """
    return data.of_classes(classes, GROUPS)

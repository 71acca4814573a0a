"""Classification trees as JSON files, text and table rows."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from ...core import InputError, from_dict, to_dict
from ...core.files import load_json
from ..data.places import HEIGHTS, Touch
from .tree_nodes import SCHEMES, ClassificationTree, feature_name, scaling_touches, touch_of

_FORMAT = 1


def tree_text(tree: ClassificationTree) -> str:
    """Text of the exploration plan: touches in order, thresholds and resulting classes.

    Parameters
    ----------
    tree
        Exploration plan.
    """
    first = ", ".join(f"{axis}{height}" for height, axis in scaling_touches(tree.scheme))
    lines = [f"touch {first} for the scale" if tree.scheme != "norm" else "touch all places for the scale"]

    def shown(node: int, depth: int, touched: frozenset[Touch]) -> None:
        pad = "  " * depth
        if tree.feature[node] < 0:
            fraction = tree.counts[node] / tree.counts[node].sum()
            best = int(np.argmax(fraction))
            lines.append(f"{pad}-> {tree.classes[best]} ({100 * fraction[best]:.0f} %)")
            return
        feature = int(tree.feature[node])
        known = touch_of(feature) in touched
        name, threshold = feature_name(feature), tree.threshold[node]
        for word, child in (("<=", tree.left), (">", tree.right)):
            lines.append(
                f"{pad}{name} {word} {threshold:.3g}" + (" (touched already)" if known and depth else "")
            )
            shown(int(child[node]), depth + 1, touched | {touch_of(feature)})

    shown(0, 0, frozenset(scaling_touches(tree.scheme)))
    return "\n".join(lines)


def tree_mapping(tree: ClassificationTree) -> dict[str, Any]:
    """JSON-compatible dictionary of a tree, as :func:`load_tree` reads it.

    Parameters
    ----------
    tree
        Exploration plan.
    """
    return {"format": _FORMAT, **to_dict(tree)}


def load_tree(path: Path | str) -> ClassificationTree:
    """Read and validate a tree, see :func:`tree_mapping`.

    Parameters
    ----------
    path
        JSON file.

    Raises
    ------
    InputError
        The file is missing, not JSON, or not a tree: each node has two children with higher indices, or none.
    """
    names = [field.name for field in fields(ClassificationTree)]

    def parsed(found: Any) -> ClassificationTree:
        return from_dict(ClassificationTree, {name: found[name] for name in names}, where=path)

    tree = load_json(path, "a classification tree", parsed, version=_FORMAT)
    nodes = tree.threshold.size
    place, children = np.arange(nodes), (tree.left, tree.right)
    inner = tree.feature >= 0
    good = (
        tree.scheme in SCHEMES
        and len(tree.classes) > 0
        and tree.counts.shape == (nodes, len(tree.classes))
        and nodes > 0
        and all(array.shape == (nodes,) for array in (tree.feature, *children))
        and bool((tree.counts >= 0).all() and (tree.counts.sum(axis=1) > 0).all())
        and bool(np.isfinite(tree.threshold[inner]).all() and (tree.feature < HEIGHTS * 4).all())
        and all(bool(((child > place) & (child < nodes))[inner].all()) for child in children)
    )
    if not good:
        raise InputError(path, "is not a classification tree: the shapes of its arrays are inconsistent")
    return tree


def plan_rows(tree: ClassificationTree) -> list[dict[str, Any]]:
    """Inner nodes in order of traversal, as table rows: feature, threshold, children.

    Parameters
    ----------
    tree
        Exploration plan.
    """
    return [
        {
            "node": int(node),
            "feature": feature_name(int(tree.feature[node])),
            "threshold": float(tree.threshold[node]),
            "left": int(tree.left[node]),
            "right": int(tree.right[node]),
        }
        for node in np.flatnonzero(tree.feature >= 0)
    ]

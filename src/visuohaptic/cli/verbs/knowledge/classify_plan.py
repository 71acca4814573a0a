"""``visuohaptic classify plan``: show the planned touches in their order.

reads   a tree of `classify train`
writes  the plan to stdout; with --plot, a plot of the tree and the features, like figure 6.7

x+12 is side x+ at height 12 of 16, counted from the foot. A touch there also measures x-12.

example: visuohaptic classify plan tree.json --plot tree.png
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import recognition
from ....core.files.plain_json import picked
from ....recognition import trees


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("tree", Path, "tree.json of classify train")
    add("--plot", Path, "plot to write")


def run(args: Any) -> dict[str, Any]:
    """Show; returns the mapping that ``--json`` prints."""
    found = recognition.load_classifier(args.tree)
    tree = found.required_tree()
    if args.plot and found.data is not None:
        trees.plot_tree(args.plot, tree, found.data.of_classes(tree.classes, found.groups))
    args.report(recognition.tree_text(tree))
    return {
        **picked(tree, "classes scheme loss"),
        "scaling": [f"{axis}{height}" for height, axis in recognition.scaling_touches(tree.scheme)],
        "mean_touches": recognition.mean_touches(tree),
        "nodes": trees.plan_rows(tree),
    }

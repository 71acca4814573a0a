"""``visuohaptic classify train``: a tree, and a planner, from features of known objects."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..errors import InputError

__all__ = ["EPILOG", "HELP", "add_arguments", "run"]

HELP = "Train a classification tree, which is an exploration plan, and a planner of touches."
EPILOG = """\
reads   a folder of objects build, or the .npz file of an earlier training
writes  the tree as JSON, and beside it the training objects as NPZ; with --plot figure 6.7

example: visuohaptic classify train --objects objects --classes bottle,cup,elliptic --out tree.json
         visuohaptic classify train --objects objects --group elliptic=isana,cien,cleaner --out tree.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("--objects", type=Path, required=True, help="folder of objects build, or .npz")
    parser.add_argument("--out", type=Path, required=True, help="tree to write, .json")
    parser.add_argument("--classes", help="candidates, with commas; all by default")
    parser.add_argument(
        "--group",
        action="append",
        default=[],
        metavar="NAME=CLASS,CLASS",
        help="classes that are answered by one name; may be repeated",
    )
    parser.add_argument("--scheme", choices=("norm", "centre", "point"), default="centre", help="of scaling")
    parser.add_argument(
        "--reuse", type=float, default=0.1, help="how much to prefer what was touched already, 0..1"
    )
    parser.add_argument("--seed", type=int, default=0, help="of folds and calibration")
    parser.add_argument("--plot", type=Path, help="picture of the tree and the features")


def run(args: Any) -> dict[str, Any]:
    """Train and write; the mapping is what ``--json`` prints."""
    import time

    import numpy as np

    from ..recognition import load_feature_set, mean_touches, train_tree, tree_text
    from ..recognition.bayes import fit_model
    from ..recognition.calibration import calibrate
    from ..recognition.classifier_file import Classifier, save_classifier
    from ..recognition.tree import feature_name
    from ..recognition.tree_plots import plot_tree

    if args.out.suffix != ".json":
        raise InputError("--out", f"found {args.out.name!r}, expected a name with .json")
    groups = dict(_group(text) for text in args.group)
    data = load_feature_set(args.objects)
    named = {member: name for name, members in groups.items() for member in members}
    if unknown := sorted(set(named) - set(data.classes)):
        raise InputError("--group", f"found {unknown[0]!r}, expected one of {', '.join(data.classes)}")
    known = dict.fromkeys(named.get(name, name) for name in data.classes)
    wanted = [text.strip() for text in args.classes.split(",")] if args.classes else list(known)
    if bad := [name for name in wanted if name not in known]:
        raise InputError("--classes", f"found {bad[0]!r}, expected one of {', '.join(known)}")
    used = data.take(np.array([named.get(name, name) in wanted for name in data.label]))
    groups = {name: members for name, members in groups.items() if name in wanted}
    candidates = used.of_classes(wanted, groups)
    begin = time.perf_counter()
    fewest = int(np.bincount(candidates.number).min())
    if fewest < 3:
        raise InputError(args.objects, f"a class has {fewest} objects, expected at least 3")
    tree = train_tree(
        candidates,
        scheme=args.scheme,
        reuse=args.reuse,
        folds=min(10, fewest),
        rng=np.random.default_rng(args.seed),
    )
    model = calibrate(fit_model(used, groups), used, np.random.default_rng(args.seed), explorations=150)
    save_classifier(args.out, Classifier(tree, used, groups, model.temperature, model.unknown_from))
    if args.plot:
        plot_tree(args.plot, tree, candidates)
    args.report(tree_text(tree))
    return {
        "out": str(args.out),
        "classes": list(tree.classes),
        "objects": len(candidates),
        "loss": tree.loss,
        "loss_sigma": tree.loss_sigma,
        "nested_loss": tree.nested_loss,
        "nodes": int(np.count_nonzero(tree.feature >= 0)),
        "features": [feature_name(k) for k in tree.features],
        "mean_touches": mean_touches(tree),
        "temperature": model.temperature,
        "unknown_from": model.unknown_from,
        "seconds": time.perf_counter() - begin,
    }


def _group(text: str) -> tuple[str, tuple[str, ...]]:
    name, separator, members = text.partition("=")
    found = tuple(member.strip() for member in members.split(",") if member.strip())
    if not separator or not name.strip() or not found:
        raise InputError("--group", f"found {text!r}, expected NAME=CLASS,CLASS")
    return name.strip(), found

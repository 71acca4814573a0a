"""Table 6.1: cross-validated losses of nine trees on our data set.

python -m benchmarks recog_trees                      builds 50 variants of the shipped classes itself
python -m benchmarks.recog_trees --objects FOLDER     a build of 50-100 variants per class, or the NPZ of recog_table62
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from visuohaptic.deformation.maps import BuildPlan, build, plan_jobs
from visuohaptic.deformation.shapes import class_names
from visuohaptic.recognition.data import FeatureSet, load_feature_set, read_build
from visuohaptic.recognition.trees import feature_name, mean_touches, train_tree
from visuohaptic.reproduce.worlds import virtual_containers as world

from .harness import cpu_seconds

#: The elliptic bottles of the table form one class where they are not distinguished.
GROUPS = {"elliptic": world.GROUPS["elliptic"]}
FIVE = ("bottle", "cup", "cup-rim", "elliptic", "smoothie")
#: Tree -> classes, scheme of scaling, printed loss [%].
TREES: dict[int, tuple[tuple[str, ...], str, float]] = {
    1: (("cup", "cup-rim"), "centre", 0.0),
    2: (("bottle", "elliptic"), "centre", 0.0),
    3: (("bottle", "elliptic"), "point", 2.9),
    4: (("bottle", "cup", "elliptic"), "centre", 0.5),
    5: (("bottle", "cup", "elliptic"), "point", 2.7),
    6: (FIVE, "norm", 2.9),
    7: (FIVE, "centre", 1.2),
    8: (FIVE, "point", 3.7),
    9: (("cien", "isana", "cleaner"), "centre", 0.8),
}
#: The folds are drawn this often; the loss is the mean.
REPEATS = 5


def training_set(folder: Path, variants: int, *, cut_bottle: bool = True) -> Any:
    """Features of ``variants`` of each class from ``objects build``, kept in the folder."""
    names = (*class_names(), *(("cut-bottle",) if cut_bottle else ()))
    entries = [{"class": name, "variants": variants} for name in names]
    plan = BuildPlan.model_validate({"classes": entries, "band": False})
    build(plan_jobs(plan, [world.description(name) for name in names]), folder)
    return read_build(folder)


def run() -> list[dict[str, Any]]:
    """All nine, on 50 variants a class."""
    with TemporaryDirectory() as folder:
        return table(training_set(folder, 50, cut_bottle=False))


def table(data: FeatureSet, groups: dict[str, Any] | None = None) -> list[dict[str, Any]]:
    """Rows of the table."""
    rows: list[dict[str, Any]] = []
    for number, (classes, scheme, printed) in TREES.items():
        chosen = data.of_classes(classes, GROUPS if groups is None else groups)
        trees = [
            train_tree(chosen, scheme=scheme, rng=np.random.default_rng(repeat)) for repeat in range(REPEATS)
        ]
        tree = trees[0]
        splits = [
            f"{feature_name(int(tree.feature[k]))} [{tree.threshold[k]:.2f}]"
            for k in np.flatnonzero(tree.feature >= 0)
        ]
        rows.append(
            {
                "name": f"tree {number}: loss",
                "ours": 100 * float(np.mean([one.loss for one in trees])),
                "unit": "%",
                "floor": printed,
                "aim": printed / 2,
                "higher_is_better": False,
                "note": f"nested {100 * np.mean([one.nested_loss for one in trees]):.2f} %; {', '.join(classes)}; {scheme}; {len(chosen)} objects; "
                f"{mean_touches(tree):.1f} touches; {'; '.join(splits)}",
            }
        )
    five = data.of_classes(FIVE, GROUPS if groups is None else groups)
    rows.append(
        {
            "name": "training again with a pruning that is known",
            "ours": 1e3 * cpu_seconds(lambda: train_tree(five, alpha=0.002), repeats=3),
            "unit": "ms CPU",
            "note": f"{len(five)} objects of five classes",
        }
    )
    return rows


def main() -> None:
    """Table of an existing build."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recog_trees", description=__doc__)
    parser.add_argument("--objects", type=Path, required=True)
    parser.add_argument("--alone", action="store_true", help="elliptic is its own class only")
    args = parser.parse_args()
    for row in table(load_feature_set(args.objects), {} if args.alone else None):
        print(f"{row['name']:20s} {row['ours']:.2f} {row['unit']}  floor {row.get('floor')}  {row['note']}")


if __name__ == "__main__":
    main()

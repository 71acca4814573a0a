"""``visuohaptic classify train``: train a classification tree and a touch planner.

reads   a folder of `objects build`, or the .npz file of an earlier training;
        or a CSV file of measured curves: label, height (1..16) or at (0..1), side (x+, x-, y+, y-), force_N,
        deformation_m, and optionally object, curve, width_m; with --objects the simulated classes are the prior;
        or a folder of published compressions (parameters.csv, displacements.csv, forces.csv): its materials are the classes;
        or, with --states, a container: a built-in class or a .yaml file
writes  the tree as JSON, and the training objects as NPZ next to it; with --plot, figure 6.7;
        or, with --states, a model of the container open, closed and filled, for `classify run --state`.
        Large deformations are simulated for it, about one second per variant, state and place

example: visuohaptic classify train --objects objects --classes bottle,cup,elliptic --out tree.json
         visuohaptic classify train --objects objects --group elliptic=isana,cien,cleaner --out tree.json
         visuohaptic classify train squeezes.csv --out mine.json
         visuohaptic classify train --objects objects --tune --out tuned.json
         visuohaptic classify train --states isana --fill 0.5 --places y+4,y+8 --variants 3 --out state.json
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import deformation, recognition
from ....core.errors import InputError
from ....core.files.plain_json import picked
from ....recognition import touch, trees
from ..._workers import add_worker_arguments, chosen_workers


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("curves", Path, "CSV file of curves of known objects, or folder of compressions", nargs="?")
    add("--objects", Path, "folder of objects build, or .npz")
    add("--states", str, "learn the states of this container instead", metavar="CONTAINER")
    add("--out", Path, "tree or states to write, .json", required=True)
    add("--classes", str, "classes to use, separated by commas (all)")
    add("--group", list, "classes to report under one name; may be repeated", metavar="NAME=CLASS,CLASS")
    add("--scheme", "centre", "scaling of the features", choices=("norm", "centre", "point"))
    add("--reuse", 0.1, "preference for features that are already measured, 0..1")
    add("--tune", bool, "choose --scheme and --reuse by cross-validation (with --objects)")
    add_worker_arguments(add)
    add("--seed", 0, "seed of folds and calibration")
    add("--plot", Path, "plot of the tree and the features to write")
    states = add.group("with --states")
    states(
        "--fill",
        list,
        "fill level of a closed state, 0..1; may be repeated",
        type=float,
        low=0,
        high=1,
        above=True,
    )
    states("--places", "y+4,y+6,y+8,y+10", "places to consider, side and height (y+4,y+6,y+8,y+10)")
    states("--variants", 8, "random variants of wall and modulus, each with 10 %% (8)", low=3, high=1000)


def run(args: Any) -> dict[str, Any]:
    """Train and write; returns the mapping that ``--json`` prints."""
    if args.out.suffix != ".json":
        raise InputError("--out", f"found {args.out.name!r}, expected a name with .json")
    if (args.objects is None and args.curves is None) == (args.states is None):
        raise InputError(
            "classify train",
            "found no training data, expected a CSV file of curves, --objects or both, or --states",
        )
    if args.tune and (args.objects is None or args.curves is not None):
        raise InputError("--tune", "expected --objects alone: curves have no tree to tune")
    if args.curves is not None:
        return _curves(args)
    return _objects(args) if args.states is None else _states(args)


def _states(args: Any) -> dict[str, Any]:
    import numpy as np

    states: dict[str, deformation.Contents | None] = {"open": None, "closed": deformation.Contents()}
    states |= {f"closed, {100 * fill:g} % full": deformation.Contents(fill=fill) for fill in args.fill}
    places = [place.strip() for place in args.places.split(",")]
    curves = touch.simulate_state_curves(
        deformation.load_container(args.states).middle(),
        states,
        places,
        variants=args.variants,
        seed=args.seed,
        workers=chosen_workers(args),
    )
    model = touch.fit_state_model(curves, np.random.default_rng(args.seed))
    touch.save_state_model(args.out, model)
    ranked = dict(zip(model.places, model.accuracy.tolist(), strict=True))
    args.report("\n".join(f"{place}: {100 * fraction:.0f} % correct" for place, fraction in ranked.items()))
    return {"out": str(args.out), "states": list(model.states), "places": ranked}


def _curves(args: Any) -> dict[str, Any]:
    if args.curves.is_dir():
        squeezed = tuple(one.squeezed() for one in recognition.read_compressions(args.curves))
    else:
        squeezed = recognition.read_squeezed(args.curves)
    simulated, _, groups = _chosen(args) if args.objects is not None else (None, None, None)
    classifier = recognition.HapticClassifier(args.scheme, args.reuse).fit(
        squeezed, groups=groups, simulated=simulated, seed=args.seed, workers=chosen_workers(args)
    )
    classifier.save(args.out)
    answers = classifier.model().answers[:-1]
    count = sum(len(one.readings) for one in squeezed)
    args.report(f"touches: {count}, objects: {len(squeezed)}, classes: {', '.join(answers)}")
    return {"out": str(args.out), "classes": list(answers), "objects": len(squeezed), "touches": count}


def _objects(args: Any) -> dict[str, Any]:
    import time

    import numpy as np

    used, candidates, groups = _chosen(args)
    begin = time.perf_counter()
    classifier = recognition.HapticClassifier(args.scheme, args.reuse)
    train = classifier.tune if args.tune else classifier.fit
    train(used, groups=groups, seed=args.seed, workers=chosen_workers(args))
    classifier.save(args.out)
    tree, model = classifier.fitted().required_tree(), classifier.model()
    if args.plot:
        trees.plot_tree(args.plot, tree, candidates)
    args.report(recognition.tree_text(tree))
    return {
        "out": str(args.out),
        "objects": len(candidates),
        **picked(classifier, "scheme reuse"),
        **picked(tree, "classes loss loss_sigma nested_loss"),
        "nodes": int(np.count_nonzero(tree.feature >= 0)),
        "features": [recognition.feature_name(k) for k in tree.features],
        "mean_touches": recognition.mean_touches(tree),
        **picked(model, "temperature unknown_log_odds"),
        "seconds": time.perf_counter() - begin,
    }


def _chosen(args: Any) -> tuple[recognition.FeatureSet, recognition.FeatureSet, dict[str, tuple[str, ...]]]:
    """Objects of the requested classes by their own names and by those of their groups, and the groups."""
    import numpy as np

    groups = dict(_group(text) for text in args.group)
    data = recognition.load_feature_set(args.objects)
    named = {member: name for name, members in groups.items() for member in members}
    if unknown := sorted(set(named) - set(data.classes)):
        raise InputError("--group", f"found {unknown[0]!r}, expected one of {', '.join(data.classes)}")
    known = dict.fromkeys(named.get(name, name) for name in data.classes)
    requested = [text.strip() for text in args.classes.split(",")] if args.classes else list(known)
    if bad := [name for name in requested if name not in known]:
        raise InputError("--classes", f"found {bad[0]!r}, expected one of {', '.join(known)}")
    used = data.take(np.array([named.get(name, name) in requested for name in data.label]))
    groups = {name: members for name, members in groups.items() if name in requested}
    return used, used.of_classes(requested, groups), groups


def _group(text: str) -> tuple[str, tuple[str, ...]]:
    name, separator, members = text.partition("=")
    found = tuple(member.strip() for member in members.split(",") if member.strip())
    if not separator or not name.strip() or not found:
        raise InputError("--group", f"found {text!r}, expected NAME=CLASS,CLASS")
    return name.strip(), found

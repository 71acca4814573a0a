"""Table 6.2 in simulation: nine unseen objects and eight unknown ones, explored by tree and planner.

``python -m benchmarks.recog_table62 --draws 50 --variants 100 --out results/recog`` is the whole
campaign, about an hour on one core; ``run()`` is a slice of it. Objects of the training and of the
test have different elements, see ``experiments.virtual_containers``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from visuohaptic.experiments import virtual_containers as world
from visuohaptic.recognition import (
    HapticModel,
    ModelSettings,
    believe,
    calibrate,
    calibration_error,
    explore,
    fit_model,
    grow_tree,
    load_feature_set,
    save_feature_set,
    train_tree,
    walk,
)

FIVE = ("bottle", "cup", "cup-rim", "elliptic", "smoothie")
_NAMED = {member: name for name, members in world.GROUPS.items() for member in members}
CONFUSABLE = ("cien", "isana", "cleaner")


def run() -> list[dict[str, Any]]:
    """A slice: few variants, few draws."""
    with TemporaryDirectory() as folder:
        return campaign(Path(folder), draws=4, variants=40)


def campaign(
    folder: Path, *, draws: int, variants: int, seed: int = 2016, width: bool = True
) -> list[dict[str, Any]]:
    """Rows of the table; training data and draws are kept in the folder."""
    data = _data(folder, variants)
    objects = _objects(folder, draws, seed)
    settings = ModelSettings(use_width=width)
    rng = np.random.default_rng(5)
    model = calibrate(fit_model(data, world.GROUPS, settings=settings), data, rng)
    three = data.of_classes(CONFUSABLE)
    model9 = calibrate(fit_model(three, settings=settings), three, rng)
    five = data.of_classes(FIVE, world.GROUPS)
    tree, tree9 = train_tree(five), train_tree(three)
    plain = grow_tree(five, reuse=0.0, alpha=tree.alpha)
    right: dict[str, list[bool]] = {"tree": [], "planner": []}
    touches: dict[str, list[int]] = {"tree": [], "cart": [], "planner": [], "sure": []}
    doubt: list[tuple[float, bool]] = []
    fixed_doubt: list[tuple[float, bool]] = []
    for (name, draw), thing in _varied(folder, draws, seed).items():
        rng = np.random.default_rng([seed, draw, len(name), 1])
        found = explore(model, world.explore(thing, rng), rng=rng, least_touches=2)
        doubt += _confidences(model, found.readings, _NAMED.get(name, name))
    ellipses: dict[str, list[bool]] = {"tree": [], "planner": []}
    rejected: dict[str, list[bool]] = {"known": [], "unknown": []}
    by_object: dict[str, list[str]] = {}
    for (name, draw), thing in objects.items():
        rng = np.random.default_rng([seed, draw, len(name)])
        touch = world.explore(thing, rng)
        found = explore(model, touch, rng=rng, least_touches=2)
        by_object.setdefault(name, []).append(found.answer)
        truth = world.REAL.get(name)
        rejected["known" if truth else "unknown"].append(found.answer == "unknown")
        if truth is None:
            continue
        right["planner"].append(found.answer == truth)
        touches["planner"].append(len(found.readings))
        fixed_doubt += _confidences(model, found.readings, truth)
        answer, touched = walk(tree, world.both_sides(touch))
        right["tree"].append(answer == truth)
        touches["tree"].append(len(touched))
        touches["cart"].append(len(walk(plain, world.both_sides(touch))[1]))
        if name in CONFUSABLE:
            ellipses["tree"].append(walk(tree9, world.both_sides(touch))[0] == name)
            ellipses["planner"].append(explore(model9, touch, rng=rng).answer == name)
    nine = {key: np.array(found).reshape(draws, len(world.REAL)).sum(axis=1) for key, found in right.items()}
    confidence, hit = (np.array(part, dtype=float) for part in zip(*doubt, strict=True))
    fixed = [np.array(part, dtype=float) for part in zip(*fixed_doubt, strict=True)]
    note = f"{draws} draws, {variants} variants a class, {'with' if width else 'without'} widths"
    fewer = float(np.mean(touches["planner"]) / np.mean(touches["tree"]))
    rows = [
        _row("tree: draws with 8 of 9 objects right", np.mean(nine["tree"] >= 8), 0.9, None, note),
        _row("planner: draws with 9 of 9 objects right", np.mean(nine["planner"] == 9), None, 0.95, note),
        _row("planner: objects right", np.mean(right["planner"]), None, None, note),
        _row("tree: objects right", np.mean(right["tree"]), None, None, note),
        _row("elliptic bottles: tree", np.mean(ellipses["tree"]), None, None, note),
        _row("elliptic bottles: planner", np.mean(ellipses["planner"]), 0.8, 0.95, note),
        _row("unknown objects rejected", np.mean(rejected["unknown"]), 0.9, 0.97, note),
        _row("known objects rejected", np.mean(rejected["known"]), 0.05, None, note, higher=False),
        _row("touches: planner by tree", fewer, 1.0, 0.7, f"{np.mean(touches['planner']):.2f} by "
             f"{np.mean(touches['tree']):.2f}; plain CART {np.mean(touches['cart']):.2f}", higher=False),
        _row("expected calibration error", calibration_error(confidence, hit), 0.05, 0.02,
             f"{note}; after each touch, objects drawn like the prior", higher=False),
        _row("expected calibration error on the nine alone", calibration_error(*fixed), None, None, note),
    ]  # fmt: skip
    counts = {name: {a: found.count(a) for a in sorted(set(found))} for name, found in by_object.items()}
    print(json.dumps(counts, indent=1))
    return rows


def _row(
    name: str, value: Any, floor: float | None, aim: float | None, note: str, *, higher: bool = True
) -> dict[str, Any]:
    return {
        "name": name, "ours": float(value), "unit": "1", "floor": floor, "aim": aim,
        "higher_is_better": higher, "note": note,
    }  # fmt: skip


def _confidences(model: HapticModel, readings: Any, truth: str) -> list[tuple[float, bool]]:
    out = []
    for count in range(1, len(readings) + 1):
        # Among the candidates, as all of these objects are.
        share = believe(model, readings[:count]).probability[:-1]
        share = share / share.sum()
        best = int(np.argmax(share))
        out.append((float(share[best]), model.answers[best] == truth))
    return out


def _data(folder: Path, variants: int) -> Any:
    kept = folder / f"training-{variants}.npz"
    if not kept.is_file():
        save_feature_set(kept, world.training_set(folder / "objects", variants))
    return load_feature_set(kept)


def _objects(folder: Path, draws: int, seed: int) -> dict[tuple[str, int], world.RealObject]:
    wanted = [(name, draw) for draw in range(draws) for name in (*world.REAL, *world.UNKNOWN)]
    return _drawn(folder / f"real-{seed}.npz", wanted, seed, varied=False)


def _varied(folder: Path, draws: int, seed: int) -> dict[tuple[str, int], world.RealObject]:
    """Other containers of the classes: every answer as often, as the prior has it."""
    wanted = []
    for answer in FIVE:
        members = world.GROUPS.get(answer, (answer,))
        wanted += [(members[draw % len(members)], 1 + draw) for draw in range(draws)]
    return _drawn(folder / f"varied-{seed}.npz", wanted, seed, varied=True)


def _drawn(
    kept: Path, wanted: list[tuple[str, int]], seed: int, *, varied: bool
) -> dict[tuple[str, int], world.RealObject]:
    found: dict[tuple[str, int], world.RealObject] = {}
    if kept.is_file():
        with np.load(kept, allow_pickle=False) as old:
            for name, draw, k, width in zip(old["n"], old["d"], old["k"], old["w"], strict=True):
                found[str(name), int(draw)] = world.RealObject(str(name), k, width)
    for name, draw in wanted:
        if (name, draw) not in found:
            found[name, draw] = world.real_draw(name, draw, seed, varied=varied)
    things = list(found.items())
    np.savez(
        kept,
        n=np.array([key[0] for key, _ in things]),
        d=np.array([key[1] for key, _ in things]),
        k=np.array([thing.stiffness_N_per_m for _, thing in things]),
        w=np.array([thing.width_m for _, thing in things]),
    )
    return {key: found[key] for key in wanted}


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recog_table62", description=__doc__)
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--variants", type=int, default=100)
    parser.add_argument("--seed", type=int, default=2016)
    parser.add_argument("--no-width", action="store_true", help="stiffness alone")
    parser.add_argument("--out", type=Path, default=Path("results/recog"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows = campaign(
        args.out, draws=args.draws, variants=args.variants, seed=args.seed, width=not args.no_width
    )
    for row in rows:
        print(f"{row['name']:45s} {row['ours']:.4g}  floor {row['floor']}  aim {row['aim']}  {row['note']}")


if __name__ == "__main__":
    main()

"""Table 6.2 in simulation: nine unseen objects and eight of unknown classes, explored by tree and planner.

``python -m benchmarks.recog_table62 --draws 50 --variants 100 --out results/recog`` is the whole
campaign and prints recognition rates and numbers of touches: 7 min of CPU time for the training objects and 20 s for a draw, so
25 min. Results are kept in the folder line by line: an interrupted run is continued, and more draws are added to existing ones.
With ``--no-width`` the same objects are explored by stiffness alone. ``run()`` is a slice. Objects of the
training and of the test have different elements, see ``experiments.virtual_containers``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from visuohaptic.recognition.data import HEIGHTS, load_feature_set, save_feature_set
from visuohaptic.recognition.touch import (
    UNKNOWN,
    HapticModel,
    ModelSettings,
    calibrate,
    explore,
    fit_model,
    update_belief,
)
from visuohaptic.recognition.trees import train_tree, walk
from visuohaptic.reproduce.worlds import virtual_containers as world

from ._forecasts import calibration_error, chance_note
from ._journal import Journal
from .recog_trees import training_set

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
    """Rows of the table; training data, draws and results are kept in the folder.

    Of the nine and of the unknown there are two kinds of draws: "same", always the same container with other
    errors, as in Table 6.2, and "other", another container of its class each time.
    """
    data = _data(folder, variants)
    settings = ModelSettings(use_width=width)
    rng = np.random.default_rng(5)
    model = calibrate(fit_model(data, world.GROUPS, settings=settings), data, rng)
    three = data.of_classes(CONFUSABLE)
    model9 = calibrate(fit_model(three, settings=settings), three, rng)
    five = data.of_classes(FIVE, world.GROUPS)
    tree, tree9 = train_tree(five), train_tree(three)
    plain = train_tree(five, reuse=0.0, alpha=tree.alpha, samples=0)

    def judge(name: str, draw: int, thing: world.RealObject, salt: int) -> dict[str, Any]:
        rng = np.random.default_rng([seed, draw, len(name), salt])
        touch = world.explore_container(thing, rng)
        found = explore(model, touch, rng=rng, min_touches=2)
        out: dict[str, Any] = {"planner": found.answer, "touches": len(found.readings)}
        out["touches_95"] = _touches_until(model, found.readings, 0.95)
        out["early"] = update_belief(model, found.readings[: out["touches_95"]]).answer
        truth = world.REAL.get(name, _NAMED.get(name))
        if truth is None:
            return out
        out["doubt"] = _confidences(model, found.readings, truth)
        answer, touched = walk(tree, world.both_sides(touch))
        out |= {"tree": answer, "tree_touches": len(touched)}
        out["cart_touches"] = len(walk(plain, world.both_sides(touch))[1])
        if name in CONFUSABLE:
            out["tree9"] = walk(tree9, world.both_sides(touch))[0]
            out["planner9"] = explore(model9, touch, rng=rng).answer
        return out

    made = Journal(
        folder / f"objects-{seed}.jsonl", {"study": "table 6.2 objects with heights", "seed": seed}
    )
    # Another model is another campaign: results must not be mixed.
    sums = [round(float(part.sum()), 6) for part in (model.mean, model.covariance, model9.covariance)]
    about = {"study": "table 6.2", "seed": seed, "variants": variants, "width": width, "model": sums}
    calibrated = [
        [one.temperature, one.unknown_log_odds, one.tail, one.correlation] for one in (model, model9)
    ]
    sign = hashlib.sha256(json.dumps([about, calibrated]).encode()).hexdigest()[:8]
    judged = Journal(folder / f"judged-{seed}-{variants}-{'width' if width else 'plain'}-{sign}.jsonl", about)
    for draw in range(draws):
        for kind, name in _things(draw):
            key = f"{kind} {name} {draw}"
            if key not in judged:
                judged.put(key, judge(name, draw, _object(made, kind, name, draw, seed), kind == "same"))
    return _rows(judged.rows, draws, f"{variants} variants a class, {'with' if width else 'without'} widths")


def _things(draw: int) -> list[tuple[str, str]]:
    """What one draw has: the nine twice, the unknown, and the trained classes that are not of the nine."""
    same = [("same", name) for name in (*world.REAL, *world.UNKNOWN)]
    return same + [("other", name) for name in (*world.REAL, "elliptic")]


def _object(made: Journal, kind: str, name: str, draw: int, seed: int) -> world.RealObject:
    key = f"{kind} {name} {draw}"
    if key not in made:
        thing = world.sample_real_object(name, draw + (kind == "other"), seed, varied=kind == "other")
        made.put(
            key,
            {
                "k": [float(f"{k:.6g}") for k in thing.stiffness_N_per_m.ravel()],
                "w": [float(f"{w:.6g}") for w in thing.width_m.ravel()],
                "h": float(f"{thing.height_m:.6g}"),
            },
        )
    row = made.rows[key]
    return world.RealObject(
        name, np.reshape(row["k"], (HEIGHTS, 4)), np.reshape(row["w"], (HEIGHTS, 2)), row["h"]
    )


def _rows(found: dict[str, Any], draws: int, about: str) -> list[dict[str, Any]]:
    def column(kind: str, key: str, names: Any = tuple(world.REAL)) -> np.ndarray:
        """Results by draw and name."""
        return np.array([[found[f"{kind} {name} {draw}"][key] for name in names] for draw in range(draws)])

    truth = np.array(list(world.REAL.values()))
    nine = {
        (kind, key): (column(kind, key) == truth).sum(axis=1)
        for kind in ("same", "other")
        for key in ("tree", "planner", "early")
    }
    strange = column("same", "planner", tuple(world.UNKNOWN)) == UNKNOWN
    known = column("same", "planner") == UNKNOWN
    known_other = column("other", "planner") == UNKNOWN
    touches = {
        key: column("same", key).mean() for key in ("touches", "touches_95", "tree_touches", "cart_touches")
    }
    # Every answer as often, as the prior has it.
    doubt = [
        pair
        for draw in range(draws)
        for answer in FIVE
        for pair in found[f"other {_member(answer, draw)} {draw}"]["doubt"]
    ]
    fixed = [
        pair for draw in range(draws) for name in world.REAL for pair in found[f"same {name} {draw}"]["doubt"]
    ]
    note = f"{draws} draws, {about}"
    other = f"{note}; another container in each draw"
    fewer = touches["touches_95"] / touches["tree_touches"]
    rows = [
        _row("tree: draws with 8 of 9 objects right", np.mean(nine["same", "tree"] >= 8), 0.9, None, note),
        _row("tree: draws with 8 of 9 right, other", np.mean(nine["other", "tree"] >= 8), None, None, other),
        _row("planner: draws with 9 of 9 objects right", np.mean(nine["same", "planner"] == 9), None, 0.95, note),
        _row("planner: draws with 9 of 9 right, other", np.mean(nine["other", "planner"] == 9), None, None, other),
        _row("planner: objects right", np.mean(nine["same", "planner"] / 9), None, None, note),
        _row("planner: objects right, other", np.mean(nine["other", "planner"] / 9), None, None, other),
        _row("planner: objects right at 95 % already", np.mean(nine["same", "early"] / 9), None, None, note),
        _row("tree: objects right", np.mean(nine["same", "tree"] / 9), None, None, note),
        _row("tree: objects right, other", np.mean(nine["other", "tree"] / 9), None, None, other),
        _row("elliptic bottles: tree", np.mean(column("same", "tree9", CONFUSABLE) == CONFUSABLE), None, None, note),
        _row("elliptic bottles: planner", np.mean(column("same", "planner9", CONFUSABLE) == CONFUSABLE), 0.8, 0.95,
             note),
        _row("unknown objects rejected", np.mean(strange), 0.9, 0.97, note),
        _row("known objects rejected", np.mean(known), 0.05, None, note, higher=False),
        _row("known objects rejected, other", np.mean(known_other), 0.05, None, other, higher=False),
        _row("touches to 95 %: planner by tree", fewer, 1.0, 0.7,
             f"{touches['touches_95']:.2f} by {touches['tree_touches']:.2f}; plain CART "
             f"{touches['cart_touches']:.2f}; planner until it stops {touches['touches']:.2f}", higher=False),
        _row("expected calibration error", _calibration(doubt), 0.05, 0.02,
             f"{other}, answers drawn like the prior; after each touch; {_chance(doubt)}", higher=False),
        _row("expected calibration error on the nine alone", _calibration(fixed), None, None, f"{note}; {_chance(fixed)}"),
    ]  # fmt: skip
    counts = {
        name: {a: said.count(a) for a in sorted(set(said))}
        for name in (*world.REAL, *world.UNKNOWN)
        if (said := [found[f"same {name} {draw}"]["planner"] for draw in range(draws)])
    }
    print(json.dumps(counts))
    return rows


def _member(answer: str, draw: int) -> str:
    members = world.GROUPS.get(answer, (answer,))
    return str(members[draw % len(members)])


def _calibration(doubt: list[Any]) -> float:
    confidence, hit = (np.array(part, dtype=float) for part in zip(*doubt, strict=True))
    return calibration_error(confidence, hit)


def _chance(doubt: list[Any]) -> str:
    return chance_note(np.array([confidence for confidence, _ in doubt]))


def _touches_until(model: HapticModel, readings: Any, confidence: float) -> int:
    """Number of touches until this confidence; all touches if it was not reached."""
    for count in range(2, len(readings)):
        if update_belief(model, readings[:count]).probability.max() >= confidence:
            return count
    return len(readings)


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
        fraction = update_belief(model, readings[:count]).probability[:-1]
        fraction = fraction / fraction.sum()
        best = int(np.argmax(fraction))
        out.append((float(fraction[best]), model.answers[best] == truth))
    return out


def _data(folder: Path, variants: int) -> Any:
    kept = folder / f"training-{variants}.npz"
    if not kept.is_file():
        save_feature_set(kept, training_set(folder / "objects", variants))
    return load_feature_set(kept)


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

"""Published grasps of an iCub hand (Soh, Su and Demiris, 2012), classified by the library and by its peers.

    python -m benchmarks.icub_grasps --data ../shared/data/deformation/icub_grasp --report out.json
                                      prints the accuracy by number of learned trials, and the coverage of the 90 % band

Each of 130 grasps closes five fingers around one of nine objects, or none; a finger has twelve pressure cells, and the hand nine
joint encoders. An adapter converts each finger into two touches: the finger stands for a height, its mean and maximum pressure
for the stiffness of two sides, and its joint for the width, all in units of the hand. ``full_coke`` is left out, as its authors
advise.

Each trial is left out in turn (the nth trial of all objects at a time); or only a few trials of each object are learned. The
peers get the same numbers, scaled to unit standard deviation. They always answer with one of the ten objects: compared with them,
the library knows, too, that each grasp is of one of these; a second figure is with its unknown class, and a third is the fraction
of grasps of an object that was not learned that it calls unknown. The band: a grasp of a known object is predicted from the other
grasps of the object; the figure is the fraction of its readings inside the declared 90 % band.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from visuohaptic.core.files import write_text
from visuohaptic.recognition import UNKNOWN, HapticClassifier, SqueezedObject, TouchReading
from visuohaptic.recognition.touch import evidence, update_belief

from ._shell_readings import peer_models
from .transparency import data_folder

#: Fingers that stand for heights, and the two joints that close each of them (of nine; ring and little finger share one).
HEIGHTS, JOINTS = (2, 5, 8, 11, 14), ((1, 2), (3, 4), (5, 6), (7, 8), (7, 8))
#: Slices at the end of a grasp that are averaged, and lines of a slice.
LAST, LINES = 5, 7
#: Resting value of a pressure cell, which falls when it is pressed; joints are angles [deg].
REST, OFFSET_deg, TURN_deg = 255.0, 60.0, 300.0
#: Default folder of the grasps.
DATA = data_folder().parents[1] / "deformation" / "icub_grasp"
#: Trials of each object that are learned.
LEARNED = (2, 3, 6, 12)


def read_grasp(path: Path) -> tuple[TouchReading, ...]:
    """Touches of one grasp."""
    lines = path.read_text(encoding="utf-8").splitlines()[1:]
    rows = [np.array(line.split(), dtype=float) for line in lines if line.strip()]
    slices = [rows[k : k + LINES] for k in range(0, len(rows) - LINES + 1, LINES)][-LAST:]
    joint = np.median([one[0] for one in slices], axis=0)
    cells = REST - np.mean([one[2:] for one in slices], axis=0)
    spread = np.std([one[2:] for one in slices], axis=0).max(axis=1)
    out = []
    for finger, height in enumerate(HEIGHTS):
        pressure = np.array([cells[finger].mean(), cells[finger].max()])
        for axis, number in zip("xy", JOINTS[finger], strict=True):
            sigma = float(max(spread[finger] / pressure.min(), 0.02))
            width = (OFFSET_deg + float(joint[number])) / TURN_deg
            out.append(TouchReading.of_stiffness(height, axis, 100 * pressure, sigma, width))
    return tuple(out)


def read_grasps(folder: Path) -> dict[str, list[tuple[TouchReading, ...]]]:
    """Object -> its grasps in the order of their numbers."""
    found: dict[str, dict[int, tuple[TouchReading, ...]]] = {}
    for path in folder.rglob("*.txt"):
        name, _, number = path.stem.rpartition("_")
        if number.isdigit() and name != "full_coke":
            found.setdefault(name, {})[int(number)] = read_grasp(path)
    return {name: [one[k] for k in sorted(one)] for name, one in sorted(found.items())}


def fold(grasps: dict[str, list[tuple[TouchReading, ...]]], trial: int, learned: int) -> dict[str, Any]:
    """One trial of each object is tested, the next few are learned."""
    count = min(len(one) for one in grasps.values())
    training = [(trial + 1 + k) % count for k in range(min(learned, count - 1))]
    squeezed = [SqueezedObject(name, f"{name}/{k}", grasps[name][k]) for name in grasps for k in training]
    classifier = HapticClassifier().fit(squeezed)
    model = classifier.model()
    closed = classifier.model(prior=dict.fromkeys(grasps, 1.0) | {UNKNOWN: 0.0})
    answers, among, inside = [], [], []
    for name, one in grasps.items():
        answers.append(update_belief(model, one[trial]).answer)
        among.append(update_belief(closed, one[trial]).answer)
        place, value, noise = evidence(model, one[trial])
        inside += list(inside_band(model, model.answers.index(name), place, value, noise))
    table = np.array([_features(one.readings) for one in squeezed])
    asked = np.array([_features(one[trial]) for one in grasps.values()])
    labels = [one.label for one in squeezed]
    peers = {
        name: [str(said) for said in peer.fit(table, labels).predict(asked)]
        for name, peer in peer_models(neighbours=1 if learned < 3 else 3).items()
    }
    return {
        "truth": list(grasps), "answers": answers, "among": among,
        "inside": float(np.mean(inside)), "peers": peers,
    }  # fmt: skip


def called_unknown(grasps: dict[str, list[tuple[TouchReading, ...]]], trial: int, learned: int) -> float:
    """Fraction of the objects that are called unknown if each is left out of the learned ones in turn."""
    count = min(len(one) for one in grasps.values())
    training = [(trial + 1 + k) % count for k in range(min(learned, count - 1))]
    answers = []
    for left_out, one in grasps.items():
        others = [SqueezedObject(name, f"{name}/{k}", grasps[name][k]) for name in grasps for k in training]
        model = HapticClassifier().fit([each for each in others if each.label != left_out]).model()
        answers.append(update_belief(model, one[trial]).answer)
    return answers.count(UNKNOWN) / len(answers)


def inside_band(
    model: Any, answer: int, place: np.ndarray, value: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Whether readings are between the 5 % and 95 % quantiles of the mixture of a class."""
    rows = model.answer_of == answer
    weight = np.exp(model.log_prior[rows])
    sigma = np.sqrt(np.diagonal(model.covariance[rows], axis1=1, axis2=2)[:, place] + noise)
    below = (weight / weight.sum()) @ norm.cdf((value - model.mean[rows][:, place]) / sigma)
    return (below > 0.05) & (below < 0.95)


def _features(readings: Sequence[TouchReading]) -> list[float]:
    return [
        float(np.log(value))
        for one in readings
        for value in (*(side.i_N_per_m for side in one.sides if side), one.width_m)
    ]


def figures(rows: dict[int, list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Accuracy by number of learned trials, and the band."""
    out = []
    for learned, folds in rows.items():
        truth = [name for one in folds for name in one["truth"]]
        said, among = ([name for one in folds for name in one[key]] for key in ("answers", "among"))
        right, right_among = (
            float(np.mean([a == b for a, b in zip(each, truth, strict=True)])) for each in (said, among)
        )
        peers = {
            peer: float(
                np.mean(
                    [a == b for one in folds for a, b in zip(one["peers"][peer], one["truth"], strict=True)]
                )
            )
            for peer in folds[0]["peers"]
        }
        best = max(peers, key=lambda name: peers[name])
        note = f"{len(truth)} grasps; " + ", ".join(f"{name} {value:.3f}" for name, value in peers.items())
        for name, ours, more in (
            (f"iCub, {learned} trials of each object learned: right", right_among, ""),
            (f"iCub, {learned} trials, unknown class: right", right, f"; called unknown {said.count(UNKNOWN) / len(said):.3f}"),
        ):  # fmt: skip
            out.append(
                {
                    "name": name, "ours": ours, "unit": "1", "floor": peers[best], "aim": None,
                    "peer": peers[best], "peer_name": best, "note": note + more,
                }
            )  # fmt: skip
        out.append(
            {
                "name": f"iCub, {learned} trials: readings in the 90 % band",
                "ours": float(np.mean([one["inside"] for one in folds])),
                "unit": "1",
                "floor": None,
                "aim": 0.9,
                "note": "of grasps that were not learned",
            }
        )
    return out  # fmt: skip


def campaign(folder: Path, learned: Sequence[int] = LEARNED, trials: int = 13) -> list[dict[str, Any]]:
    """Figures of the published grasps."""
    grasps = read_grasps(folder)
    if not grasps:
        raise SystemExit(f"{folder}: has no grasps")
    rows = figures({few: [fold(grasps, trial, few) for trial in range(trials)] for few in learned})
    for few in learned:
        found = [called_unknown(grasps, trial, few) for trial in range(0, trials, 4)]
        rows.append(
            {"name": f"iCub, {few} trials, object not learned: called unknown", "ours": float(np.mean(found)),
             "unit": "1", "floor": None, "aim": None, "note": f"{len(found) * len(grasps)} grasps"}
        )  # fmt: skip
    return rows


def run() -> list[dict[str, Any]]:
    """A slice: three trials left out, two and twelve of each object learned."""
    return campaign(DATA, (2, 12), 3) if DATA.is_dir() else []


def main() -> None:
    """Run the whole comparison."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.icub_grasps",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the grasps")
    parser.add_argument("--report", type=Path, help="JSON with all figures")
    arguments = parser.parse_args()
    rows = campaign(arguments.data)
    for row in rows:
        print(f"{row['name']:58s} {row['ours']:7.3f}  {row['note']}")
    if arguments.report:
        write_text(arguments.report, json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()

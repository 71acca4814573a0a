"""Published compressions of 3-D printed shells (GCS), of six materials, learned by the library and by its peers.

    python -m benchmarks.gcs_compressions --seeds closed --count 5 --report out.json

Prints are axially compressed between plates, see :mod:`visuohaptic.recognition.data.compressions`. No shell model of the library
applies: materials are learned from the readings of a few prints each. In each draw 30 % of the designs are held out, with all
their prints. Asked are the material of a held-out print and, given its material and its other readings, its largest displacement.

The peers get the logarithms of the same readings, scaled to unit standard deviation. They always answer with one of the materials:
compared with them, the library knows, too, that each print is of one of these; a second figure is with its unknown class, and a
third is the fraction of prints of a material that was not learned that it calls unknown. The displacement of the peers is by
ordinary least squares for each material, and by a random forest. Odd seeds are closed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from visuohaptic.core.files import write_text
from visuohaptic.recognition import UNKNOWN, Compression, HapticClassifier, HapticModel, read_compressions
from visuohaptic.recognition.data.compressions import DISPLACEMENT
from visuohaptic.recognition.touch import evidence, update_belief
from visuohaptic.recognition.touch.unknown_class import FIRST_WIDTH

from ._seeds import add_seeds, seeds_of
from ._shell_readings import peer_models
from .icub_grasps import inside_band
from .transparency import data_folder

#: Default folder of the compressions.
DATA = data_folder().parents[1] / "deformation" / "gcs"
#: Prints of each material that are learned, and that are asked.
LEARNED, ASKED = (5, 20, 80), 40
#: Fraction of the designs that are held out.
HELD_OUT = 0.3
#: Index of the feature that stands for the displacement.
WAY = FIRST_WIDTH + 2 * (DISPLACEMENT - 1)

Prints = dict[str, list[Compression]]


def split(prints: Sequence[Compression], seed: int) -> tuple[Prints, Prints]:
    """Material -> its prints in random order, of the designs that may be learned and of those that are held out."""
    rng = np.random.default_rng([seed, 41])
    designs = list(dict.fromkeys(one.design for one in prints))
    held = {designs[k] for k in rng.permutation(len(designs))[: int(HELD_OUT * len(designs))]}
    learned: Prints = {}
    asked: Prints = {}
    for k in rng.permutation(len(prints)):
        one = prints[k]
        (asked if one.design in held else learned).setdefault(one.material, []).append(one)
    return dict(sorted(learned.items())), dict(sorted(asked.items()))


def forecast(model: HapticModel, answer: int, one: Compression, *, given: bool) -> tuple[float, float, float]:
    """Median of the displacement of a print of this class [m], its quantile of the measured one, and a width of its 90 % band.

    ``given`` its other readings, or not. The width is relative to the median.
    """
    place, value, noise = evidence(model, one.readings())
    asked, rest = np.flatnonzero(place == WAY), np.flatnonzero(place != WAY) if given else np.zeros(0, int)
    rows = np.flatnonzero(model.answer_of == answer)
    mean, sigma, log = np.empty((3, len(rows)))
    for k, row in enumerate(rows):
        covariance = model.covariance[row][np.ix_(place, place)] + np.diag(noise)
        away = value - model.mean[row][place]
        gain = np.linalg.solve(covariance[np.ix_(rest, rest)], covariance[np.ix_(rest, asked)])[:, 0]
        mean[k] = model.mean[row][WAY] + gain @ away[rest]
        sigma[k] = np.sqrt(covariance[asked[0], asked[0]] - gain @ covariance[rest, asked[0]])
        inner = covariance[np.ix_(rest, rest)]
        log[k] = model.log_prior[row] - 0.5 * (
            np.linalg.slogdet(inner)[1] + away[rest] @ np.linalg.solve(inner, away[rest])
        )
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    ends = float((mean - 8 * sigma).min()), float((mean + 8 * sigma).max())
    low, middle, high = (
        np.exp(brentq(lambda y, level=level: weight @ ndtr((y - mean) / sigma) - level, *ends))
        for level in (0.05, 0.5, 0.95)
    )
    quantile = weight @ ndtr((value[asked[0]] - mean) / sigma)
    return float(middle), float(quantile), float((high - low) / middle)


def features(one: Compression) -> list[float]:
    """Logarithms of the readings, of the displacement first."""
    out = [one.displacement_m, one.thickness_m, one.mass_kg / one.height_m, one.height_m]
    sides = [side for touch in one.readings()[3:] for side in touch.sides if side]
    return np.log(out + [side.i_N_per_m for side in sides]).tolist()


def fold(prints: Sequence[Compression], seed: int, learned: int, asked: int = ASKED) -> dict[str, Any]:
    """Answers and forecasts of the prints of held-out designs of one draw."""
    known, held = split(prints, seed)
    training = [one for its in known.values() for one in its[:learned]]
    testing = [one for its in held.values() for one in its[:asked]]
    classifier = HapticClassifier().fit([one.squeezed() for one in training])
    model = classifier.model()
    closed = classifier.model(prior=dict.fromkeys(known, 1.0) | {UNKNOWN: 0.0})
    table, questions = (np.array([features(one) for one in some]) for some in (training, testing))
    labels = [one.material for one in training]
    out: dict[str, Any] = {
        "truth": [one.material for one in testing],
        "measured": np.exp(questions[:, 0]).tolist(),
    }
    out["answers"] = [update_belief(model, one.readings()).answer for one in testing]
    out["among"] = [update_belief(closed, one.readings()).answer for one in testing]
    out["inside"] = [
        np.mean(inside_band(model, model.answers.index(one.material), *evidence(model, one.readings())))
        for one in testing
    ]
    for name, given in (("alone", False), ("given", True)):
        out[name] = [forecast(model, model.answers.index(one.material), one, given=given) for one in testing]
    out["peers"] = {
        name: [str(said) for said in peer.fit(table, labels).predict(questions)]
        for name, peer in peer_models().items()
    }
    out["regressions"] = regressions(table, labels, questions, out["truth"])
    return out


def regressions(
    table: np.ndarray, labels: Sequence[str], asked: np.ndarray, truth: Sequence[str]
) -> dict[str, list[float]]:
    """Displacements [m] by the peers, given the material and the other readings."""
    from sklearn.ensemble import RandomForestRegressor
    from sklearn.linear_model import LinearRegression

    found = {"least squares": np.empty(len(asked)), "RF": np.empty(len(asked))}
    for material in set(truth):
        mine, its = np.array(labels) == material, np.array(truth) == material
        for name, peer in (
            ("least squares", LinearRegression()),
            ("RF", RandomForestRegressor(100, random_state=0)),
        ):
            found[name][its] = peer.fit(table[mine, 1:], table[mine, 0]).predict(asked[its, 1:])
    return {name: np.exp(value).tolist() for name, value in found.items()}


def called_unknown(prints: Sequence[Compression], seed: int, learned: int, asked: int = 10) -> float:
    """Fraction of prints that are called unknown if their material is left out of the learned ones."""
    known, held = split(prints, seed)
    answers = []
    for left_out in known:
        others = [one.squeezed() for name, its in known.items() if name != left_out for one in its[:learned]]
        model = HapticClassifier().fit(others).model()
        answers += [update_belief(model, one.readings()).answer for one in held[left_out][:asked]]
    return answers.count(UNKNOWN) / len(answers)


def figures(learned: int, folds: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Accuracy, bands and errors of the displacement if so many prints of each material are learned."""
    truth, said, among = (
        np.array([x for one in folds for x in one[key]]) for key in ("truth", "answers", "among")
    )
    peers = {
        peer: float(np.mean(np.array([x for one in folds for x in one["peers"][peer]]) == truth))
        for peer in folds[0]["peers"]
    }
    best = max(peers, key=lambda name: peers[name])
    label = f"GCS, {learned} prints of each material"
    one_of = {
        "name": f"{label}: material right", "ours": float(np.mean(among == truth)), "unit": "1", "floor": peers[best],
        "aim": None, "peer": peers[best], "peer_name": best,
        "note": f"{len(truth)} prints; " + ", ".join(f"{name} {value:.3f}" for name, value in peers.items()),
    }  # fmt: skip
    out = [one_of]
    out.append(
        {"name": f"{label}, unknown class: right", "ours": float(np.mean(said == truth)), "unit": "1", "floor": None,
         "aim": None, "note": f"called unknown {np.mean(said == UNKNOWN):.3f}"}
    )  # fmt: skip
    inside = float(np.mean([x for one in folds for x in one["inside"]]))
    bands = {"all readings": (inside, "given the material")}
    for key, name in (("alone", "displacement"), ("given", "displacement, given the other readings")):
        _, quantile, width = np.array([x for one in folds for x in one[key]]).T
        good = float(np.mean((quantile > 0.05) & (quantile < 0.95)))
        bands[name] = (good, f"median width {np.median(width):.2f} of the displacement")
    out += [
        {"name": f"{label}: {name} in the 90 % band", "ours": value, "unit": "1", "floor": None, "aim": 0.9, "note": note}
        for name, (value, note) in bands.items()
    ]  # fmt: skip
    measured = np.array([x for one in folds for x in one["measured"]])
    ours = np.array([x[0] for one in folds for x in one["given"]])
    errors = {
        peer: float(
            np.median(
                np.abs(np.log([x for one in folds for x in one["regressions"][peer]]) - np.log(measured))
            )
        )
        for peer in folds[0]["regressions"]
    }
    least = min(errors, key=lambda name: errors[name])
    out.append(
        {"name": f"{label}: median relative error of the displacement",
         "ours": float(np.median(np.abs(np.log(ours / measured)))), "unit": "1", "floor": None, "aim": None,
         "peer": errors[least], "peer_name": least, "higher_is_better": False,
         "note": ", ".join(f"{name} {value:.3f}" for name, value in errors.items())}
    )  # fmt: skip
    return out


def campaign(
    folder: Path, seeds: Sequence[int], learned: Sequence[int] = LEARNED, asked: int = ASKED
) -> list[dict[str, Any]]:
    """Figures of some draws."""
    prints = read_compressions(folder)
    out = []
    for few in learned:
        out += figures(few, [fold(prints, seed, few, asked) for seed in seeds])
        found = [called_unknown(prints, seed, few) for seed in seeds[:2]]
        out.append(
            {"name": f"GCS, {few} prints of each material, material not learned: called unknown",
             "ours": float(np.mean(found)), "unit": "1", "floor": None, "aim": None, "note": f"{len(found)} draws"}
        )  # fmt: skip
        print(f"compressions: {few} prints learned", flush=True)
    return out


def run() -> list[dict[str, Any]]:
    """A slice: one draw, twenty prints of each material learned."""
    return campaign(DATA, [0], (20,), 10) if DATA.is_dir() else []


def main() -> None:
    """Run the whole comparison."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gcs_compressions",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_seeds(parser, 5, "draws")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the compressions")
    parser.add_argument("--learned", type=int, nargs="+", default=LEARNED, help="prints of each material")
    parser.add_argument("--report", type=Path, help="JSON with all figures")
    arguments = parser.parse_args()
    seeds = seeds_of(arguments.seeds, arguments.count, arguments.first)
    rows = campaign(arguments.data, seeds, arguments.learned)
    for row in rows:
        print(f"{row['name']:78s} {row['ours']:7.3f}  {row['note']}")
    if arguments.report:
        write_text(arguments.report, json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()

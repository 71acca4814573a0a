"""Recognition of the objects of ``tests/worlds/shell_touches.py`` by the library and by its peers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tests.worlds.shell_bodies import CLASSES
from tests.worlds.shell_touches import TouchedObject, squeezed_objects

from visuohaptic.core import InputError
from visuohaptic.core.resources import one_blas_thread
from visuohaptic.deformation.maps import BuildPlan, build, plan_jobs
from visuohaptic.deformation.shapes import ContainerDescription
from visuohaptic.recognition import (
    UNKNOWN,
    FeatureSet,
    HapticClassifier,
    TouchReading,
    fit_curve,
    load_feature_set,
    read_build,
    save_feature_set,
    walk,
)
from visuohaptic.recognition.touch import update_belief

from ._forecasts import calibration_error, chance_note

#: Touches at most, and objects of a class that the classifier is trained on.
MAX_TOUCHES, VARIANTS = 10, 30
#: Objects and curves of each of an afternoon of squeezing.
FEW_OBJECTS, FEW_CURVES = 6, 5
AXES = "xy"


def train(cache: Path, variants: int = VARIANTS) -> HapticClassifier:
    """A classifier of the classes, built and fitted as by a user: from descriptions with ranges."""
    kept = cache / f"training-heights-{variants}.npz"
    if not kept.exists():
        found = [
            ContainerDescription.model_validate({"name": name, **given}) for name, given in CLASSES.items()
        ]
        entries = [{"class": one.name, "variants": variants} for one in found]
        plan = BuildPlan.model_validate({"classes": entries, "band": False})
        build(plan_jobs(plan, found), cache / f"build-{variants}")
        save_feature_set(kept, read_build(cache / f"build-{variants}"))
    return HapticClassifier().fit(load_feature_set(kept))


def touch_of(
    thing: TouchedObject, height: int, axis: str, rng: np.random.Generator, sides: Sequence[int] = (0, 1)
) -> TouchReading:
    """Reading of one touch by the library; None for a side without a detected contact."""
    first = 2 * AXES.index(axis)
    read: list[Any] = [None, None]
    for side in sides:
        try:
            read[side] = fit_curve(*thing.curve(height, first + side, rng))
        except InputError:
            continue
    width = thing.width(height, AXES.index(axis), rng)
    return TouchReading(height, axis, (read[0], read[1]), width, thing.height_m)


def explore_object(
    classifier: HapticClassifier,
    touch: Callable[[int, str], TouchReading],
    *,
    use_width: bool,
    order: Sequence[tuple[int, str]] | None = None,
) -> tuple[Any, list[TouchReading]]:
    """Touch until the classifier is confident: where it proposes, or in a given order."""
    readings: list[TouchReading] = []
    found = classifier.predict(readings, use_width=use_width)
    while not (readings and found.confident) and len(readings) < MAX_TOUCHES:
        place = found.next_touch if order is None else order[len(readings)]
        if place is None:
            break
        readings.append(touch(*place))
        found = classifier.predict(readings, use_width=use_width)
    return found, readings


def _answers(
    classifier: HapticClassifier, readings: Sequence[TouchReading], *, use_width: bool
) -> list[tuple[str, float]]:
    """Answer and confidence after each touch."""
    model = classifier.model(use_width=use_width)
    found = [update_belief(model, readings[: k + 1]) for k in range(len(readings))]
    return [(one.answer, one.confidence) for one in found]


def touches_at_accuracy(rows: Sequence[dict[str, Any]], accuracy: float) -> float:
    """Mean number of planned touches at the lowest confidence, in percent, at which this fraction is right.

    Where the accuracy is never reached, that of the whole explorations.
    """
    for percent in range(1, 100):
        stop = [
            next(
                (k for k, (_, sure) in enumerate(row["path"]) if 100 * sure >= percent), len(row["path"]) - 1
            )
            for row in rows
        ]
        right = [row["path"][k][0] == row["class"] for k, row in zip(stop, rows, strict=True)]
        if np.mean(right) >= accuracy - 1e-9:
            return float(np.mean(stop)) + 1
    return float(np.mean([row["touches"] for row in rows]))


@one_blas_thread()
def known_row(
    classifier: HapticClassifier, thing: TouchedObject, seed: int, *, use_width: bool
) -> dict[str, Any]:
    """One object of a trained class: planner, random order, tree and peers."""
    rng = np.random.default_rng([seed, 30])

    def touch(height: int, axis: str) -> TouchReading:
        return touch_of(thing, height, axis, np.random.default_rng([seed, 31, height, AXES.index(axis)]))

    found, readings = explore_object(classifier, touch, use_width=use_width)
    order = [(int(k) // 2 + 1, AXES[int(k) % 2]) for k in rng.permutation(32)]
    by_chance, chance_readings = explore_object(classifier, touch, use_width=use_width, order=order)

    tree_answer, tree_touches = walk(
        classifier.fitted().tree, lambda height, axis: both_sides(touch(height, axis))
    )
    return {
        "class": thing.name,
        "answer": found.answer,
        "confidence": found.confidence,
        "touches": len(readings),
        "path": _answers(classifier, readings, use_width=use_width),
        "random": by_chance.answer,
        "random_touches": len(chance_readings),
        "tree": tree_answer,
        "tree_touches": len(tree_touches),
        "peers": peers_on(classifier.fitted().data, readings, use_width=use_width),
    }


def unknown_row(
    classifier: HapticClassifier, thing: TouchedObject, seed: int, *, use_width: bool
) -> dict[str, Any]:
    """One object of no trained class."""

    def touch(height: int, axis: str) -> TouchReading:
        return touch_of(thing, height, axis, np.random.default_rng([seed, 32, height, AXES.index(axis)]))

    found, readings = explore_object(classifier, touch, use_width=use_width)
    return {
        "kind": thing.name,
        "answer": found.answer,
        "confidence": found.confidence,
        "touches": len(readings),
    }


#: Relative difference of repeated squeezes of one place; by hand, no widths are measured.
SCATTER = {"machine": 0.0, "by hand": 0.1}


@one_blas_thread()
def few_row(seed: int, cache: Path | None) -> dict[str, Any]:
    """Six objects learned from five curves each, and tested with five others; squeezed by a machine and by hand."""
    squeezed = squeezed_objects(seed, FEW_OBJECTS, FEW_CURVES, cache)
    names = [thing.name for thing, _places in squeezed[:FEW_OBJECTS]]
    row: dict[str, Any] = {"objects": names}
    for condition, scatter in SCATTER.items():
        rng = np.random.default_rng([seed, 33])
        sessions = [
            [
                _scattered(touch_of(thing, height, AXES[side // 2], rng, (side % 2,)), scatter, rng)
                for height, side in places
            ]
            for thing, places in squeezed
        ]
        row[condition] = _few_answers(names, sessions[:FEW_OBJECTS], sessions[FEW_OBJECTS:])
    return row


def _scattered(touch: TouchReading, scatter: float, rng: np.random.Generator) -> TouchReading:
    """The touch as by hand: no width is known, and its stiffness differs at random from that of another touch of the place."""
    if not scatter:
        return touch
    factor = rng.lognormal(0, scatter)
    first, second = (side and replace(side, i_N_per_m=factor * side.i_N_per_m) for side in touch.sides)
    return TouchReading(touch.height, touch.axis, (first, second))


def _few_answers(
    names: Sequence[str],
    learned: Sequence[Sequence[TouchReading]],
    asked: Sequence[Sequence[TouchReading]],
) -> dict[str, Any]:
    """Answers of the library and of its peers."""
    labels = [name for name, curves in zip(names, learned, strict=True) for _ in curves]
    curves: Any = [curve for session in learned for curve in session]
    row: dict[str, Any] = {"answers": None, "confidence": None}
    try:
        classifier = HapticClassifier().fit(curves, labels)
        found = [classifier.predict(session) for session in asked]
        row |= {"answers": [one.answer for one in found], "confidence": [one.confidence for one in found]}
    except (InputError, TypeError, AttributeError) as error:
        row["reason"] = f"{type(error).__name__}: {error}"[:200]
    trained = np.array([_curve_features(curve) for curve in curves])
    known = np.isfinite(trained).all(axis=0)
    test = [np.array([_curve_features(curve) for curve in session])[:, known] for session in asked]
    trained = trained[:, known]
    row["peers"] = {
        name: _voted(model, trained, labels, test) for name, model in peer_models(neighbours=1).items()
    }
    return row


def _curve_features(curve: TouchReading) -> list[float]:
    side = 0 if curve.sides[0] is not None else 1
    stiffness = max(both_sides(curve))
    return [
        curve.height / 16,
        float(AXES.index(curve.axis)),
        float(side),
        np.log(stiffness),
        np.log(curve.width_m),
        np.log(curve.object_height_m),
    ]


def _voted(model: Any, trained: np.ndarray, labels: Sequence[str], test: Sequence[Any]) -> list[str]:
    model.fit(trained, labels)
    score = [np.log(np.maximum(model.predict_proba(np.array(one)), 1e-6)).sum(axis=0) for one in test]
    return [str(model.classes_[int(np.argmax(one))]) for one in score]


def both_sides(reading: TouchReading) -> tuple[float, float]:
    """Stiffness [N/m] of both sides; a missing side is replaced by the other, two missing ones by the highest measurable stiffness."""
    read = [math.nan if one is None else one.i_N_per_m for one in reading.sides]
    values = [value for value in read if math.isfinite(value)] or [1e6]
    first, second = (value if math.isfinite(value) else values[0] for value in read)
    return first, second


def peer_models(neighbours: int = 3) -> dict[str, Any]:
    """Standard classifiers, on features of unit standard deviation."""
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
    from sklearn.ensemble import RandomForestClassifier
    from sklearn.gaussian_process import GaussianProcessClassifier
    from sklearn.gaussian_process.kernels import RBF
    from sklearn.naive_bayes import GaussianNB
    from sklearn.neighbors import KNeighborsClassifier
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    models = {
        "RF": RandomForestClassifier(100, random_state=0),
        "GNB": GaussianNB(),
        "kNN": KNeighborsClassifier(neighbours),
        "LDA": LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto"),
        "GP": GaussianProcessClassifier(4.0 * RBF(1.5), optimizer=None),
    }
    return {name: make_pipeline(StandardScaler(), model) for name, model in models.items()}


def peers_on(data: FeatureSet, readings: Sequence[TouchReading], *, use_width: bool) -> dict[str, str]:
    """Results of the peers, trained on the same objects at the touched places."""
    columns, row = [], []
    for reading in readings:
        first, level = 2 * AXES.index(reading.axis), reading.height - 1
        columns.append(np.log(data.features[:, level, first : first + 2, 0]))
        row += list(np.log(both_sides(reading)))
        if use_width:
            columns.append(np.log(data.width_m[:, level, [AXES.index(reading.axis)]]))
            row.append(float(np.log(reading.width_m)))
    if use_width and data.height_m is not None:
        columns.append(np.log(data.height_m)[:, None])
        row.append(float(np.log(readings[0].object_height_m)))
    table = np.concatenate(columns, axis=1)
    return {
        name: str(model.fit(table, data.label).predict([row])[0]) for name, model in peer_models().items()
    }


def reading_figures(
    rows: Sequence[dict[str, Any]], label: str, limits: Sequence[tuple[float, float]]
) -> list[dict]:
    """Right, false unknown and calibration of one condition, and touches."""
    right = np.array([row["answer"] == row["class"] for row in rows])
    unknown = np.mean([row["answer"] == UNKNOWN for row in rows])
    confidence = np.array([row["confidence"] for row in rows])
    peers = {name: np.mean([row["peers"][name] == row["class"] for row in rows]) for name in rows[0]["peers"]}
    best = max(peers, key=lambda name: peers[name])
    wrong = ", ".join(
        f"{row['class']} as {row['answer']} {row['confidence']:.2f}"
        for row, hit in zip(rows, right, strict=True)
        if not hit
    )
    touches = {
        name: np.mean([row[name] for row in rows]) for name in ("touches", "random_touches", "tree_touches")
    }
    equal = {name: float(np.mean([row[name] == row["class"] for row in rows])) for name in ("random", "tree")}
    fair = touches_at_accuracy(rows, equal["tree"])
    (right_floor, right_aim), (unknown_floor, unknown_aim), (error_floor, error_aim) = limits
    return [
        {"name": f"{label}: right", "ours": float(right.mean()), "unit": "1", "floor": right_floor, "aim": right_aim,
         "peer": float(peers[best]), "peer_name": best,
         "note": f"{len(rows)} objects; " + ", ".join(f"{k} {v:.2f}" for k, v in peers.items()) + f"; wrong: {wrong or 'none'}"},
        {"name": f"{label}: false unknown", "ours": float(unknown), "unit": "1", "floor": unknown_floor, "aim": unknown_aim,
         "higher_is_better": False, "note": ""},
        {"name": f"{label}: expected calibration error", "ours": calibration_error(confidence, right), "unit": "1",
         "floor": error_floor, "aim": error_aim, "higher_is_better": False, "note": f"mean confidence {confidence.mean():.3f}; {chance_note(confidence)}"},
        {"name": f"{label}: touches by random order", "ours": float(touches["touches"] / touches["random_touches"]),
         "unit": "1", "floor": 0.75, "aim": 0.5, "higher_is_better": False,
         "note": f"{touches['touches']:.2f} by {touches['random_touches']:.2f}, right {equal['random']:.2f}"},
        {"name": f"{label}: touches by the tree, as often right", "ours": float(fair / touches["tree_touches"]),
         "unit": "1", "floor": 1.0, "aim": 0.7, "higher_is_better": False,
         "note": f"{fair:.2f} by {touches['tree_touches']:.2f}, right {equal['tree']:.2f}; to 99 % {touches['touches']:.2f}"},
    ]  # fmt: skip


def unknown_figures(rows: Sequence[dict[str, Any]], label: str, limits: tuple[float, float]) -> list[dict]:
    """Fraction of unknown objects that are reported as unknown."""
    wrong = ", ".join(
        f"{row['kind']} as {row['answer']} {row['confidence']:.2f}"
        for row in rows
        if row["answer"] != UNKNOWN
    )
    found = float(np.mean([row["answer"] == UNKNOWN for row in rows]))
    return [
        {"name": f"{label}: called unknown", "ours": found, "unit": "1", "floor": limits[0], "aim": limits[1],
         "note": f"{len(rows)} objects; wrong: {wrong or 'none'}"}
    ]  # fmt: skip


def few_figures(rows: Sequence[dict[str, Any]]) -> list[dict]:
    """Objects recognised from few curves."""
    total = [name for row in rows for name in row["objects"]]
    figures = []
    for condition in SCATTER:
        parts = [row[condition] for row in rows]
        said = [
            name
            for row, one in zip(rows, parts, strict=True)
            for name in (one["answers"] or [None] * len(row["objects"]))
        ]
        peers = {
            peer: _right([name for one in parts for name in one["peers"][peer]], total)
            for peer in parts[0]["peers"]
        }
        best = max(peers, key=lambda name: peers[name])
        reasons = sorted({one["reason"] for one in parts if "reason" in one})
        figures.append(
            {"name": f"{FEW_CURVES} curves per object, {FEW_OBJECTS} objects, {condition}: right",
             "ours": _right(said, total), "unit": "1", "floor": 0.85, "aim": 0.95, "peer": peers[best], "peer_name": best,
             "note": f"{len(total)} objects; " + ", ".join(f"{k} {v:.2f}" for k, v in peers.items()) + f"; called unknown {said.count(UNKNOWN) / len(said):.2f}" + ("; " + "; ".join(reasons) if reasons else "")}
        )  # fmt: skip
    return figures


def _right(said: Sequence[str | None], total: Sequence[str]) -> float:
    return float(np.mean([a == b for a, b in zip(said, total, strict=True)]))

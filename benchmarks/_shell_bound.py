"""Bounds for any recogniser: detection of the unknown class by stiffness alone, and explorations with the fewest touches.

``bound``: how often could stiffness alone detect that a container belongs to no trained class? Classifiers are trained with the
unknown kinds. They learn many members of each class and of each unknown kind of container, under all conditions, from readings
at fixed places; each member is classified by classifiers that were trained on others. A recogniser without examples of
the unknown kinds cannot be expected to do better. How much of this needs the examples is shown by a second kind of classifier, which
learns the members of the classes alone: a Gaussian of each class, and the fraction of its members that fit worse. Solids are
left out, because they are detected without exception. The classifiers that were shown all kinds also tell the classes apart: a
recogniser that has not seen the other theory of their walls, nor the errors of the gripper, cannot be expected to be right more often.

``orders``: how few touches could be sufficient? The shortest sequence of touches that reaches the required confidence in the
right class is searched in hindsight, with all readings and the true class known. A planner knows neither and needs more;
the ratio to random orders is the possible improvement.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tests.worlds.shell_bodies import CLASSES, OTHERS
from tests.worlds.shell_touches import CONDITIONS, TouchedObject, member

from visuohaptic.core.resources import one_blas_thread
from visuohaptic.recognition import HapticClassifier, TouchProtocol, walk
from visuohaptic.recognition.touch import update_belief
from visuohaptic.recognition.touch.bayes import TOUCHES as PLACES

from ._shell_readings import AXES, MAX_TOUCHES, both_sides, explore_object, touch_of

#: Numbers of touches, spread over heights and axes: the planner's maximum, and all.
TOUCHES = (10, 32)
#: Fraction of the members of classes that may be called unknown: the mean of the floors of the three conditions.
FALSE_UNKNOWN = (0.02 + 0.04 + 0.07) / 3
FOLDS = 6
#: Name of the classifier that was not shown the unknown kinds.
ALONE = "classes alone"


#: Beam width: explorations kept at each length.
BEAM = 6


@one_blas_thread()
def order_row(
    classifier: HapticClassifier, thing: TouchedObject, seed: int, *, use_width: bool, orders: int = 3
) -> dict[str, Any]:
    """Touches of one object of a class: the fewest in hindsight, those of random orders, and those of the tree."""
    touch = {
        (height, axis): touch_of(thing, height, axis, np.random.default_rng([seed, 31, height, AXES.index(axis)]))
        for height, axis in PLACES
    }  # fmt: skip
    model = classifier.model(use_width=use_width)
    right, beam = model.answers.index(thing.name), [frozenset[tuple[int, str]]()]
    for _ in range(MAX_TOUCHES):
        tried = {one | {place} for one in beam for place in PLACES if place not in one}
        told = {
            one: update_belief(model, [touch[place] for place in sorted(one)]).probability[right]
            for one in tried
        }
        beam = sorted(told, key=lambda one: -told[one])[:BEAM]
        if told[beam[0]] >= classifier.confidence:
            break
    rng, by_chance = np.random.default_rng([seed, 30]), []
    for _ in range(orders):
        order = [PLACES[int(k)] for k in rng.permutation(len(PLACES))]
        by_chance.append(
            len(explore_object(classifier, lambda *place: touch[place], use_width=use_width, order=order)[1])
        )
    tree_answer, tree_touches = walk(
        classifier.fitted().tree, lambda height, axis: both_sides(touch[height, axis])
    )
    return {
        "fewest": len(beam[0]), "random": float(np.mean(by_chance)), "tree": len(tree_touches),
        "tree_right": tree_answer == thing.name,
    }  # fmt: skip


def order_figures(rows: Sequence[dict[str, Any]], label: str) -> list[dict[str, Any]]:
    """The fewest touches in hindsight relative to random orders and the tree: a lower bound for any planner."""
    mean = {
        name: float(np.mean([row[name] for row in rows]))
        for name in ("fewest", "random", "tree", "tree_right")
    }
    notes = {"random": "random order", "tree": f"the tree, right {mean['tree_right']:.2f}"}
    return [
        {"name": f"{label}: fewest touches in hindsight by {'random order' if name == 'random' else 'the tree'}",
         "ours": mean["fewest"] / mean[name], "unit": "1", "floor": None, "aim": None,
         "note": f"{len(rows)} objects, {mean['fewest']:.2f} by {mean[name]:.2f} of {note}"}
        for name, note in notes.items()
    ]  # fmt: skip


@one_blas_thread()
def bound_rows(count: int, cache: Path) -> list[dict[str, Any]]:
    """Fraction of unknown containers detected, for each number of touches, condition and classifier.

    Of each unknown kind there are so many members in each condition, of each class three times as many.
    """
    members = [
        (name, condition, seed, _profile(member(name, seed, condition, cache), seed))
        for name in (CLASSES | OTHERS)
        for seed in range(0, 2 * count * (3 if name in CLASSES else 1), 2)
        for condition in CONDITIONS
    ]
    names, conditions, groups, tables = (np.array(part) for part in zip(*members, strict=True))
    known = np.isin(names, list(CLASSES))
    rows = []
    for count in TOUCHES:
        touches = np.linspace(0, 31, count).round().astype(int)
        # Of a height and an axis, two sides; every second touch is along the other axis.
        columns = np.concatenate([[2 * k, 2 * k + 1] for k in touches])
        shown = _shown(tables[:, columns], names, groups)
        scores = {peer: score for peer, (score, _answers) in shown.items()}
        if len(columns) < known.sum() / len(CLASSES):  # the covariance of fewer members is that of chance
            scores[ALONE] = _alone_scores(tables[:, columns], names, groups)
        for peer, score in scores.items():
            limit = np.quantile(score[known], 1 - FALSE_UNKNOWN)
            for condition in CONDITIONS:
                here = conditions == condition
                called = score > limit
                worst = {name: float(called[here & (names == name)].mean()) for name in OTHERS}
                rows.append({
                    "touches": count, "peer": peer, "condition": condition, "objects": int((here & ~known).sum()),
                    "called": float(called[here & ~known].mean()), "false": float(called[here & known].mean()),
                    "kinds": {name: round(value, 2) for name, value in worst.items() if value < 0.9},
                    "members": int((here & known).sum()),
                    "right": float((shown[peer][1] == names)[here & known].mean()) if peer in shown else None,
                })  # fmt: skip
        print(f"bound: {count} touches", flush=True)
    return rows


def bound_figures(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The best classifier of each number of touches and condition, and the one that knows the classes alone."""
    best: dict[tuple[int, str, str, str], dict[str, Any]] = {}
    for row in rows:
        shown = "not shown" if row["peer"] == ALONE else "shown"
        for figure in ("called", "right"):
            key = (row["touches"], row["condition"], shown, figure)
            if row[figure] is not None and (key not in best or row[figure] > best[key][figure]):
                best[key] = row
    notes = {
        "called": lambda row: (
            f"{row['objects']} containers of {len(OTHERS)} kinds, false unknown {row['false']:.2f}; "
            f"hardest: {', '.join(f'{name} {value:.2f}' for name, value in row['kinds'].items()) or 'none'}"
        ),
        "right": lambda row: f"{row['members']} members of {len(CLASSES)} classes",
    }
    return [
        {"name": f"{shown} the unknown kinds, {condition}, {count} touches: {figure}", "ours": row[figure], "unit": "1",
         "floor": None, "aim": None, "note": f"{row['peer']}, {notes[figure](row)}"}
        for (count, condition, shown, figure), row in best.items()
    ]  # fmt: skip


def _profile(thing: TouchedObject, seed: int) -> np.ndarray:
    """Logarithms of the measured stiffness at all places (64,), limited to the highest measurable stiffness."""
    out = []
    for height in range(1, 17):
        for axis in AXES:
            rng = np.random.default_rng([seed, 34, height, AXES.index(axis)])
            for side in touch_of(thing, height, axis, rng).sides:
                k = 1e6 if side is None or not np.isfinite(side.i_N_per_m) else side.i_N_per_m
                out.append(float(TouchProtocol().seen_stiffness(np.array(k))[0]))
    return np.array(out)


def _shown(
    table: np.ndarray, names: np.ndarray, groups: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Probability that each row is of the unknown class, and its class if it is of one, by classifiers trained on other seeds."""
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
    from sklearn.model_selection import GroupKFold, cross_val_predict
    from sklearn.neural_network import MLPClassifier
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    models = {
        "LDA": LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto"),
        "MLP": MLPClassifier((64,), alpha=0.3, max_iter=600, random_state=0),
    }
    kinds = np.unique(names)
    known = np.isin(kinds, list(CLASSES))
    out = {}
    for name, model in models.items():
        pipe = make_pipeline(StandardScaler(), model)
        folds = GroupKFold(min(FOLDS, len(set(groups))))
        found = cross_val_predict(pipe, table, names, groups=groups, cv=folds, method="predict_proba")
        out[name] = found[:, ~known].sum(axis=1), kinds[known][found[:, known].argmax(axis=1)]
    return out


def _alone_scores(table: np.ndarray, names: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """How badly each row fits its best class: the negative fraction of the members of the class that fit it as badly.

    The covariance of each class is shrunk (Ledoit and Wolf 2004). Members are compared with the Gaussian of the other folds.
    """
    from sklearn.covariance import LedoitWolf

    fold = np.unique(groups, return_inverse=True)[1] % FOLDS
    known, fits = np.isin(names, list(CLASSES)), []
    for name in CLASSES:
        own, square = names == name, np.empty(len(table))
        for left in (*range(FOLDS), None):
            learned = table[own] if left is None else table[own & (fold != left)]
            asked = ~known if left is None else known & (fold == left)
            mean, sigma = learned.mean(axis=0), learned.std(axis=0) + 1e-9
            found = LedoitWolf().fit((learned - mean) / sigma)
            if asked.any():
                square[asked] = found.mahalanobis((table[asked] - mean) / sigma)
        # Several members are as bad as the worst one in a sample: beyond it, the distance itself decides.
        worse = 1 - np.searchsorted(np.sort(square[own]), square) / own.sum()
        fits.append(worse - 1e-9 * square)
    return -np.max(fits, axis=0)

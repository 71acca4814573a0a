"""Haptic classifier of objects with the usual interface: fit, predict, save, load.

It consists of a classification tree, which is an exploration plan (:mod:`.trees`), and of a Gaussian model of all features of
an exploration, with an unknown class, which plans touches by their expected information (:mod:`.touch`). It learns
from objects with complete features, such as simulated ones, from a few curves at any places, or from both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import call
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..core import InputError, check_ranges, within
from ..core.map_tasks import map_tasks
from .classifier_file import Classifier, load_classifier, save_classifier
from .data import SqueezedObject, Touch, TouchReading, read_curves, read_squeezed, stiffness_grid
from .data.data_set import FeatureSet, join_feature_sets, load_feature_set
from .touch import HapticModel, ModelSettings, calibrate, fit_model, touch_gains
from .touch.belief import update_belief
from .touch.steps import contradicted_assumption
from .trees.tree import train_tree
from .trees.tree_nodes import SCHEMES, ClassificationTree, mean_touches, next_touch

#: Objects with complete features: a set, its file or the folder of a build, or several of these.
Training = FeatureSet | Path | str | Sequence[FeatureSet | Path | str]
#: Minimum number of objects of a class, for its covariance and the folds of its cross-validation; maximum number of folds.
MIN_OBJECTS, MAX_FOLDS = 3, 10
#: Preferences for places that were already touched, compared by :meth:`HapticClassifier.tune`.
REUSES = (0.0, 0.1, 0.3)


@dataclass(frozen=True, slots=True)
class TouchPrediction:
    """Class of an object given some touches, and the next touch."""

    answer: str  #: most probable class, or "unknown"; empty where nothing was touched and no prior given
    confidence: float  #: probability of the answer
    probabilities: dict[str, float]  #: of every class and of "unknown"; they sum to 1
    confident: bool  #: the requested confidence is reached
    #: height 1 .. 16 and axis with the most information per second; None if none is left
    next_touch: Touch | None
    information_nat: float  #: expected decrease of the entropy of the answer by that touch
    seconds: float  #: duration of that touch, including the motion to it
    tree_answer: str | None  #: of the classification tree; None if no leaf is reached, or without a tree
    tree_next_touch: Touch | None  #: next touch according to the tree
    contradiction: str  #: deviation with which the readings fit the most probable class; "" for none


@dataclass(slots=True)
class HapticClassifier:
    """Classifier of objects from a few touches, which recognises objects of unknown classes.

    Examples
    --------
    Cups are soft at their upper end, bottles are not:

    >>> import numpy as np
    >>> rng, height = np.random.default_rng(0), np.linspace(0, 1, 16)
    >>> top = np.repeat([500.0, 2e4], 6)
    >>> profile = 8e3 * (top[:, None] / 8e3) ** height * rng.lognormal(0, 0.1, (12, 1))
    >>> stiffness = np.repeat(profile[:, :, None], 4, axis=2)
    >>> width = np.full((12, 16, 2), 0.06) * rng.lognormal(0, 0.02, (12, 1, 1))
    >>> data = FeatureSet.of_stiffness(stiffness, width, ["cup"] * 6 + ["bottle"] * 6)
    >>> classifier = HapticClassifier().fit(data)
    >>> touch = TouchReading.of_stiffness(12, "x", stiffness[0, 11, :2], width_m=0.06)
    >>> classifier.predict([touch]).answer
    'cup'
    """

    scheme: str = "centre"  #: normalisation of the features of the tree, see :data:`.SCHEMES`
    reuse: float = (
        0.1  #: preference of the tree for places that were already touched, see :func:`.train_tree`
    )
    #: minimum probability of a confident answer
    confidence: float = field(default=0.99, metadata=within(0, 1))
    #: tree, objects and calibration, after fit or load
    trained: Classifier | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        check_ranges(self)

    def fit(
        self,
        data: Training | Sequence[TouchReading] | Sequence[SqueezedObject],
        labels: Sequence[str] | None = None,
        *,
        groups: Mapping[str, Sequence[str]] | None = None,
        simulated: Training | None = None,
        seed: int = 0,
        workers: int | str = 1,
    ) -> HapticClassifier:
        """Train tree and model, and calibrate the probabilities on objects that are left out.

        Parameters
        ----------
        data
            Objects of at least two classes, three of each: a feature set, its NPZ file, a folder of ``visuohaptic
            objects build``, or several of these. Alternatively curves: touches at any places with labels, a CSV file of them
            (see :func:`.read_squeezed`), or squeezed objects; one curve of a class is enough.
        labels
            Class of each object, or, for several sets, of each set; those of the data by default. For touches, the object
            of each touch: all touches of a label are of one object.
        groups
            Name of a group -> its classes, which share this name as their answer.
        simulated
            With curves: simulated objects, the prior of classes with few curves.
        seed
            Of folds, samples and calibration.
        workers
            See :func:`.map_tasks`: the tree and two models are three tasks.

        Returns
        -------
        HapticClassifier
            This classifier.

        Raises
        ------
        InputError
            Too few classes or objects, or incompatible sets.
        """
        groups = dict(groups or {})
        squeezed = _squeezed(data, labels)
        if squeezed:
            known = (
                Classifier(groups)
                if simulated is None
                else self._trained(_labelled(simulated, None), groups, seed, workers)
            )
            self.trained = replace(known, squeezed=squeezed, fitted={})
            self.trained.model()
        else:
            self.trained = self._trained(_labelled(cast("Training", data), labels), groups, seed, workers)
        return self

    def tune(
        self,
        data: Training,
        labels: Sequence[str] | None = None,
        *,
        groups: Mapping[str, Sequence[str]] | None = None,
        seed: int = 0,
        workers: int | str = 1,
    ) -> HapticClassifier:
        """Select ``scheme`` and ``reuse`` by the nested cross-validation of their trees, then train.

        Among the trees whose loss is within one standard error of the minimum, the one with the fewest touches is
        selected (Breiman 1984).

        Parameters
        ----------
        data, labels, groups, seed, workers
            See :meth:`fit`; each combination is a task.
        """
        used = _labelled(data, labels)
        candidates, fewest = _candidates(used, groups or {})
        choices = [(scheme, reuse) for scheme in SCHEMES for reuse in REUSES]
        train = partial(_trained_tree, candidates, min(MAX_FOLDS, fewest), seed)
        found = map_tasks(train, choices, name="classify train", workers=workers)
        trees = [tree for _, tree in sorted(found)]
        best = min(trees, key=lambda tree: tree.nested_loss)
        near = [tree.nested_loss <= best.nested_loss + best.loss_sigma for tree in trees]
        chosen = min(np.flatnonzero(near), key=lambda k: (mean_touches(trees[k]), trees[k].nested_loss))
        self.scheme, self.reuse = choices[int(chosen)]
        return self.fit(used, groups=groups, seed=seed, workers=workers)

    def _trained(
        self, used: FeatureSet, groups: Mapping[str, Sequence[str]], seed: int, workers: int | str
    ) -> Classifier:
        candidates, fewest = _candidates(used, groups)
        parts: list[Callable[[], Any]] = [
            partial(_trained_tree, candidates, min(MAX_FOLDS, fewest), seed, (self.scheme, self.reuse)),
            partial(_calibrated, used, groups, seed, use_width=True),
            partial(_calibrated, used, groups, seed, use_width=False),
        ]
        found = dict(map_tasks(call, parts, name="classify train", workers=workers))
        tree, wide, plain = found[0], found[1], found[2]
        calibration = (
            (wide.temperature, wide.unknown_log_odds, wide.tail, wide.correlation),
            (plain.temperature, plain.unknown_log_odds, plain.tail, plain.correlation),
        )
        return Classifier(groups, tree, used, (), calibration, {True: wide, False: plain})

    def model(self, *, use_width: bool = True, prior: Mapping[str, float] | None = None) -> HapticModel:
        """The Bayesian model, for :func:`.explore` and :func:`.touch_gains`.

        Parameters
        ----------
        use_width, prior
            As of :meth:`.Classifier.model`.
        """
        return self.fitted().model(use_width=use_width, prior=prior)

    def predict(
        self,
        readings: Sequence[TouchReading] | Path | str,
        *,
        use_width: bool | None = None,
        prior: Mapping[str, float] | None = None,
    ) -> TouchPrediction:
        """Posterior probabilities given some touches, and the next touch.

        Parameters
        ----------
        readings
            Touches of one object in chronological order, or a CSV file of curves, see
            :func:`.read_curves`.
        use_width
            Whether widths are evidence; by default if any was measured.
        prior
            Visual prior by class; uniform by default.
        """
        touches = read_curves(readings) if isinstance(readings, str | Path) else tuple(readings)
        if use_width is None:
            use_width = not touches or any(math.isfinite(one.width_m) for one in touches)
        model, tree = self.model(use_width=use_width, prior=prior), self.fitted().tree
        belief = update_belief(model, touches)
        gains = touch_gains(model, touches)
        best = max(gains, key=lambda touch: gains[touch][0] / gains[touch][1], default=None)
        information, seconds = (0.0, 0.0) if best is None else gains[best]
        wanted, node = (None, 0) if tree is None else next_touch(tree, stiffness_grid(touches))
        return TouchPrediction(
            belief.answer if touches or prior else "",
            belief.confidence,
            belief.as_mapping(),
            belief.confidence >= self.confidence,
            best,
            float(information),
            float(seconds),
            tree.classes[int(tree.answer[node])] if tree is not None and wanted is None else None,
            wanted,
            contradicted_assumption(model, touches),
        )

    def save(self, path: Path | str) -> None:
        """Write the tree as JSON, and the training objects to an NPZ file next to it.

        Parameters
        ----------
        path
            Path with the suffix .json; the NPZ file has the same name.
        """
        save_classifier(path, self.fitted())

    @classmethod
    def load(cls, path: Path | str) -> HapticClassifier:
        """Read a classifier written by :meth:`save` or ``visuohaptic classify train``.

        Parameters
        ----------
        path
            JSON file, with the NPZ file next to it.
        """
        trained = load_classifier(path)
        return cls(scheme=trained.tree.scheme if trained.tree else "centre", trained=trained)

    def fitted(self) -> Classifier:
        """Tree, objects and calibration.

        Raises
        ------
        InputError
            Neither fit nor load was called.
        """
        if self.trained is None:
            raise InputError("HapticClassifier", "is not trained", remedy="call fit first, or load a file")
        return self.trained


def _squeezed(data: object, labels: Sequence[str] | None) -> tuple[SqueezedObject, ...]:
    """Squeezed objects; empty if the data are complete features."""
    if isinstance(data, str | Path) and Path(data).suffix == ".csv":
        return read_squeezed(data)
    if isinstance(data, FeatureSet | str | Path) or not isinstance(data, Sequence) or not data:
        return ()
    if all(isinstance(one, SqueezedObject) for one in data):
        return tuple(data)
    if not all(isinstance(one, TouchReading) for one in data):
        return ()
    if labels is None or isinstance(labels, str) or len(labels) != len(data):
        raise InputError("labels", f"found {0 if labels is None else len(labels)}, expected {len(data)}")
    touches: dict[str, list[TouchReading]] = {}
    for label, reading in zip(labels, data, strict=True):
        touches.setdefault(str(label), []).append(reading)
    return tuple(SqueezedObject(label, label, tuple(its)) for label, its in touches.items())


def _labelled(data: Training, labels: Sequence[str] | None) -> FeatureSet:
    """One set of objects with the requested classes."""
    if isinstance(data, FeatureSet | Path | str) or not isinstance(data, Sequence):
        sets = [_loaded(data)]
        wanted = None if labels is None else [labels]
        expected = len(sets[0])
    else:
        sets = [_loaded(one) for one in data]
        wanted = (
            None if labels is None else [[label] * len(one) for label, one in zip(labels, sets, strict=False)]
        )
        expected = len(sets)
    if not sets:
        raise InputError("data", "found no feature set, expected at least one")
    if labels is not None and (isinstance(labels, str) or len(labels) != expected):
        raise InputError("labels", f"found {len(labels)}, expected {expected}")
    if wanted is not None:
        sets = [replace(one, label=tuple(map(str, its))) for one, its in zip(sets, wanted, strict=True)]
    return join_feature_sets(sets)


def _candidates(used: FeatureSet, groups: Mapping[str, Sequence[str]]) -> tuple[FeatureSet, int]:
    """Objects labelled by answer, and the size of the smallest of these classes."""
    name_of = {member: name for name, members in groups.items() for member in members}
    if foreign := sorted(set(name_of) - set(used.classes)):
        raise InputError("groups", f"found {foreign[0]!r}, expected one of {', '.join(used.classes)}")
    names = dict.fromkeys(name_of.get(label, label) for label in used.classes)
    candidates = used.of_classes(list(names), groups)
    counts = np.bincount(used.number)
    if counts.min() < MIN_OBJECTS:
        name, count = used.classes[int(counts.argmin())], int(counts.min())
        raise InputError("data", f"class {name!r} has {count} objects, expected at least {MIN_OBJECTS}")
    return candidates, int(np.bincount(candidates.number).min())


def _trained_tree(
    candidates: FeatureSet, folds: int, seed: int, choice: tuple[str, float]
) -> ClassificationTree:
    scheme, reuse = choice
    rng = np.random.default_rng(seed)
    return train_tree(candidates, scheme=scheme, reuse=reuse, folds=folds, rng=rng)


def _calibrated(
    used: FeatureSet, groups: Mapping[str, Sequence[str]], seed: int, *, use_width: bool
) -> HapticModel:
    model = fit_model(used, groups, settings=ModelSettings(use_width=use_width))
    return calibrate(model, used, np.random.default_rng(seed))


def _loaded(source: object) -> FeatureSet:
    if not isinstance(source, FeatureSet | Path | str):
        raise InputError(
            "data", f"found {type(source).__name__}, expected a feature set, a path, or touches with labels"
        )
    return source if isinstance(source, FeatureSet) else load_feature_set(source)

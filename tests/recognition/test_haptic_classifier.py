"""The public classifier: its four verbs on synthetic classes, and invalid input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.recognition import HapticClassifier
from visuohaptic.recognition.classifier_file import Classifier, load_classifier, save_classifier
from visuohaptic.recognition.data import FeatureSet, TouchReading, join_feature_sets, save_feature_set
from visuohaptic.recognition.haptic_classifier import REUSES
from visuohaptic.recognition.touch import UNKNOWN, touch_gains
from visuohaptic.recognition.trees import SCHEMES, mean_touches, train_tree

from .worlds import PROFILES, build_folder, synthetic, touch_of

TRAINING = synthetic(12, seed=0)


@pytest.fixture(scope="module")
def classifier() -> HapticClassifier:
    return HapticClassifier().fit(TRAINING)


def explored(classifier: HapticClassifier, data: FeatureSet, row: int, touches: int) -> list[TouchReading]:
    """Touches of one object, each where the classifier wants the next."""
    touch, readings = touch_of(data, row), []
    for _ in range(touches):
        wanted = classifier.predict(readings).next_touch
        assert wanted is not None
        readings.append(touch(*wanted))
    return readings


def test_objects_that_were_not_trained_are_classified(classifier: HapticClassifier) -> None:
    """One object of each class, drawn anew, at the touches that are asked for."""
    unseen = synthetic(1, seed=5)
    for row, label in enumerate(unseen.label):
        found = classifier.predict(explored(classifier, unseen, row, 3))
        assert found.answer == label
        # Three noisy touches of well separated profiles: far more probable than not.
        assert found.confidence > 0.9
        assert found.confident == (found.confidence >= classifier.confidence)
        assert set(found.probabilities) == {*PROFILES, UNKNOWN}
        assert sum(found.probabilities.values()) == pytest.approx(1.0)
        assert found.confidence == found.probabilities[label]


def test_a_foreign_object_is_unknown(classifier: HapticClassifier) -> None:
    """A hundred times as stiff as anything that was trained, and a third wider."""
    known = synthetic(1, seed=6)
    foreign = replace(known, features=100 * known.features, width_m=1.3 * known.width_m)
    assert classifier.predict(explored(classifier, foreign, 0, 3)).answer == UNKNOWN


def test_the_next_touch_tells_most_per_second(classifier: HapticClassifier) -> None:
    found = classifier.predict([])
    gains = touch_gains(classifier.model(), ())
    best = max(gain / seconds for gain, seconds in gains.values())
    assert found.information_nat / found.seconds == pytest.approx(best)
    assert not found.confident
    assert found.answer == "", "of classes that are all as probable none is the answer"
    # The tree measures its scale first.
    assert found.tree_next_touch == (8, "x")
    assert found.tree_answer is None


def test_a_prior_of_vision_moves_the_answer(classifier: HapticClassifier) -> None:
    given = classifier.predict([], prior={"rim": 0.8, "flat": 0.2})
    # Without touches the posterior is the prior, times what is left beside the unknown class (0.1 by default).
    assert given.probabilities["rim"] == pytest.approx(0.9 * 0.8, rel=1e-6)
    assert given.probabilities["soft"] == 0.0
    assert given.answer == "rim"


def test_what_is_saved_answers_the_same(classifier: HapticClassifier, tmp_path: Path) -> None:
    classifier.save(tmp_path / "touch.json")
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".npz"}
    again = HapticClassifier.load(tmp_path / "touch.json")
    readings = explored(classifier, synthetic(1, seed=7), 0, 2)
    one, other = classifier.predict(readings), again.predict(readings)
    assert one.answer == other.answer
    for name, probability in one.probabilities.items():
        assert other.probabilities[name] == pytest.approx(probability, rel=1e-3, abs=1e-6)


@pytest.mark.usefixtures("fewer_explorations")
def test_sets_files_and_builds_are_joined(tmp_path: Path) -> None:
    """Each set has its own class where labels are given; names are kept apart."""
    parts = [
        TRAINING.take(np.array([name == label for name in TRAINING.label])) for label in ("soft", "flat")
    ]
    save_feature_set(tmp_path / "flat.npz", parts[1])
    sources = [build_folder(tmp_path / "build", parts[0]), tmp_path / "flat.npz"]
    found = HapticClassifier().fit(sources, ["mine", "yours"])
    assert found.fitted().tree.classes == ("mine", "yours")
    twice = join_feature_sets([parts[0], parts[0]])
    assert len(set(twice.name)) == len(twice) == 24


@pytest.mark.parametrize("data", [np.ones((4, 5)), None, 3, [1, 2], {}])
def test_data_of_another_kind_are_named(data: Any) -> None:
    with pytest.raises(InputError, match=r"data: found \w+, expected a feature set, a path, or touches"):
        HapticClassifier().fit(data)


def test_what_cannot_be_trained_or_asked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"{tmp_path.name}: has no manifest.json"):
        HapticClassifier().fit(tmp_path)
    with pytest.raises(InputError, match=r"is not trained; .*call fit first"):
        HapticClassifier().predict([])
    with pytest.raises(InputError, match="labels: found 2, expected 36"):
        HapticClassifier().fit(TRAINING, ["a", "b"])
    with pytest.raises(InputError, match="found 1 classes, expected at least 2"):
        HapticClassifier().fit(TRAINING, ["all"] * 36)
    with pytest.raises(InputError, match="class 'few' has 2 objects, expected at least 3"):
        HapticClassifier().fit(TRAINING, ["few"] * 2 + ["many"] * 34)
    with pytest.raises(InputError, match="groups: found 'cup', expected one of flat, rim, soft"):
        HapticClassifier().fit(TRAINING, groups={"round": ["cup"]})
    with pytest.raises(InputError, match="confidence: found 2, expected 0 to 1"):
        HapticClassifier(confidence=2)
    curved = replace(TRAINING, nonlinear=True)
    with pytest.raises(InputError, match="found linear features and features from curves"):
        HapticClassifier().fit([TRAINING, curved])


@pytest.mark.usefixtures("fewer_explorations")
def test_tuning_takes_the_fewest_touches_among_the_best_trees() -> None:
    tuned = HapticClassifier().tune(TRAINING)
    tree = tuned.fitted().required_tree()
    assert tree.scheme == tuned.scheme
    losses = {}
    for scheme in SCHEMES:
        for reuse in REUSES:
            rng = np.random.default_rng(0)
            losses[scheme, reuse] = train_tree(TRAINING, scheme=scheme, reuse=reuse, rng=rng)
    best = min(losses.values(), key=lambda one: one.nested_loss)
    near = [one for one in losses.values() if one.nested_loss <= best.nested_loss + best.loss_sigma]
    assert mean_touches(tree) == pytest.approx(min(map(mean_touches, near)))
    assert losses[tuned.scheme, tuned.reuse].threshold == pytest.approx(tree.threshold)


def test_a_classifier_calibrated_without_a_correlation_is_refused_with_the_remedy(tmp_path: Path) -> None:
    """As of an earlier version."""
    path = tmp_path / "old.json"
    save_classifier(path, Classifier({}))
    card = json.loads(path.read_text())
    path.write_text(json.dumps(card | {"calibration": [one[:3] for one in card["calibration"]]}))
    with pytest.raises(
        InputError, match=r"calibration\[0\].*expected a list of 4; create one with classify train"
    ):
        load_classifier(path)

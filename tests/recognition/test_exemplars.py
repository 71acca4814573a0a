"""Density around the objects of classes that are no Gaussians, and its power besides Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from visuohaptic.recognition import UNKNOWN, HapticClassifier, SqueezedObject, TouchReading
from visuohaptic.recognition.touch import HapticModel, update_belief
from visuohaptic.recognition.touch.exemplars import SCALES, learn_exemplars, pooled_powers


def squeezed(label: str, name: int, logs: np.ndarray) -> SqueezedObject:
    """An object whose stiffness and width were read at one place."""
    side = TouchReading.of_stiffness(8, "x", np.exp(logs[:1].repeat(2)), 0.02).sides[0]
    return SqueezedObject(label, f"{label}/{name}", (TouchReading(8, "x", (side, None), np.exp(logs[1])),))


def clusters(rng: np.random.Generator, count: int) -> list[SqueezedObject]:
    """Two classes with equal means: soft thin or stiff thick ones, and soft thick or stiff thin ones."""
    out = []
    for label, sign in (("alike", 1), ("crossed", -1)):
        stiff = rng.choice((-0.5, 0.5), count)
        logs = np.column_stack([6.0 + stiff, -3.0 + 0.4 * sign * stiff]) + rng.normal(0, 0.06, (count, 2))
        out += [squeezed(label, k, one) for k, one in enumerate(logs)]
    return out


def answers(model: HapticModel, asked: list[SqueezedObject]) -> tuple[float, float, float]:
    """Fraction that is right, mean log probability of the class, and mean probability of "unknown"."""
    found = [update_belief(model, one.readings) for one in asked]
    right = np.mean([one.answer == thing.label for one, thing in zip(found, asked, strict=True)])
    log = [
        np.log(belief.as_mapping()[thing.label] + 1e-12) for belief, thing in zip(found, asked, strict=True)
    ]
    return float(right), float(np.mean(log)), float(np.mean([one.as_mapping()[UNKNOWN] for one in found]))


def test_classes_of_several_clusters_are_told_apart_by_their_objects() -> None:
    rng = np.random.default_rng(2)
    classifier = HapticClassifier().fit(clusters(rng, 12))
    closed = classifier.model(prior={"alike": 1.0, "crossed": 1.0, UNKNOWN: 0.0})
    asked = clusters(rng, 40)
    right, log, _ = answers(closed, asked)
    assert right > 0.95
    assert log > -0.25
    # Gaussians of these classes differ by the sign of a correlation, which their prior does not know.
    before = answers(replace(closed, exemplars=None), asked)
    assert before[0] < 0.9
    assert before[1] < log - 0.2


def test_objects_that_are_no_more_than_their_readings_have_no_kernels() -> None:
    """Two readings: two objects of a class are on a line, three are not."""
    for count in (2, 3):
        model = HapticClassifier().fit(clusters(np.random.default_rng(8), count)).model()
        assert (model.exemplars is None) == (count == 2)


def test_the_objects_of_the_classes_do_not_decide_whether_an_object_is_of_any_of_them() -> None:
    rng = np.random.default_rng(3)
    model = HapticClassifier().fit(clusters(rng, 6)).model()
    assert model.exemplars is not None
    asked = clusters(np.random.default_rng(4), 10)
    with_objects, without = (answers(one, asked)[2] for one in (model, replace(model, exemplars=None)))
    assert with_objects == pytest.approx(without, abs=0.02)


def test_classes_that_are_gaussian_are_known_as_well_as_by_gaussians() -> None:
    rng, log = np.random.default_rng(5), np.zeros(2)
    for _ in range(2):
        middle = np.array([[6.0, -3.0], [6.5, -2.8], [7.0, -3.1]])

        def drawn(count: int, middle: np.ndarray = middle) -> list[SqueezedObject]:
            spread = rng.normal(0, (0.25, 0.1), (3, count, 2))
            return [squeezed(f"{k}", n, middle[k] + spread[k, n]) for k in range(3) for n in range(count)]

        classifier = HapticClassifier().fit(drawn(5))
        model = classifier.model(prior={"0": 1.0, "1": 1.0, "2": 1.0, UNKNOWN: 0.0})
        asked = drawn(20)
        log += [answers(one, asked)[1] / 2 for one in (model, replace(model, exemplars=None))]
    assert log[0] > log[1] - 0.03


def test_the_density_is_the_mean_of_the_kernels_written_out_and_integrates_to_one() -> None:
    rng = np.random.default_rng(6)
    objects = [
        (np.array([64, 3]), rng.normal(0, 1, 2) @ [[1, 0], [0.99, 0.1]], np.full(2, 1e-4)) for _ in range(24)
    ]
    found = learn_exemplars(objects, np.arange(24) % 2)
    assert found.place.tolist() == [3, 64]
    assert np.count_nonzero(found.residual) == 3  # one of two correlated features is a residual
    asked = np.array([0.3, -0.2])
    own = found.residual @ asked[::-1]
    told = found.log_density(np.array([64, 3]), asked, np.full(2, 1e-4))
    assert told is not None
    for k in range(2):
        each = []
        for one in found.value[found.part == k]:
            kernel = 0.0
            for pi, weight in zip(found.component, found.weight, strict=True):
                factors = [
                    sum(
                        w * norm.pdf(own[j] - one[j], scale=s) for w, s in zip(weight[j], SCALES, strict=True)
                    )
                    for j in range(2)
                ]
                kernel += pi * np.prod(factors)
            each.append(kernel)
        # Constant factors are left out.
        wanted = np.log(np.mean(each) * 2 * np.pi * abs(np.linalg.det(found.residual)))
        assert told[k] == pytest.approx(wanted, rel=1e-9)
    assert found.component.sum() == pytest.approx(1.0)
    assert found.weight.sum(axis=2) == pytest.approx(np.ones((3, 2)))
    # Readings of other places are not judged, and one with a larger error is less decisive.
    assert found.log_density(np.array([64]), asked[:1], np.full(1, 1e-4)) is None
    narrow, wide = (
        found.log_density(np.array([64, 3]), objects[0][1], np.full(2, noise)) for noise in (1e-4, 0.5)
    )
    assert narrow is not None
    assert wide is not None
    assert narrow[0] > wide[0]


def test_an_object_that_was_left_out_is_not_among_its_kernels() -> None:
    rng = np.random.default_rng(7)
    objects = [(np.array([3, 64]), rng.normal(0, 1, 2), np.full(2, 1e-4)) for _ in range(12)]
    part = np.arange(12) % 2
    found = learn_exemplars(objects, part)
    left = found.left_out(np.arange(12))
    for k, (place, value, noise) in enumerate(objects):
        among = found.log_density(place, value, noise)
        assert among is not None
        assert left[k, 1 - part[k]] == pytest.approx(among[1 - part[k]])
        assert left[k, part[k]] < among[part[k]]


def test_the_power_is_that_of_the_density_that_knows_left_out_objects() -> None:
    part = np.arange(40) % 2
    sure = np.where(part[:, None] == np.arange(2), 0.0, -4.0)
    wrong = sure[:, ::-1]
    for bad in (wrong, np.full((40, 2), -3.0)):
        a, b = pooled_powers(sure, bad, part)
        assert a > 0.8
        assert b < 0.2
        a, b = pooled_powers(bad, sure, part)
        assert a < 0.2
        assert b > 0.8
    # A density that is too sure has a smaller power: odds of exp(8) for classes that are right in four of five.
    some = 2.0 * np.where(np.arange(40)[:, None] % 10 < 2, wrong, sure)
    _, b = pooled_powers(np.zeros((40, 2)) - 50.0, some, part)
    assert b == pytest.approx(np.log(4) / 8, abs=0.07)

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks._forecasts import calibration_by_chance, calibration_error

from visuohaptic.core import InputError
from visuohaptic.deformation.shapes import class_names, load_container
from visuohaptic.recognition.data import (
    CurveCoefficients,
    FeatureSet,
    TouchProtocol,
    TouchReading,
    fit_curve,
    join_feature_sets,
    travel_seconds,
)
from visuohaptic.recognition.touch import (
    UNKNOWN,
    HapticModel,
    ModelSettings,
    belief_of,
    calibrate,
    class_statistics,
    condition,
    contradicted_assumption,
    evidence,
    explore,
    fit_model,
    log_likelihood,
    touch_gains,
    update_belief,
    with_outline,
)
from visuohaptic.recognition.touch.belief import (
    WIDTH_VARIANCE,
    sequential_likelihood,
)
from visuohaptic.recognition.touch.calibration import (
    BLOCK,
    EXPLORATIONS,
    _explored,
    _explored_likelihoods,
    best_or_first,
    rate_of_each,
)
from visuohaptic.recognition.touch.haptic_model import PARAMETERS, RANGE_WIDENING, with_prior
from visuohaptic.recognition.touch.unknown_class import FIRST_WIDTH
from visuohaptic.recognition.touch.zeros import with_zeros
from visuohaptic.recognition.trees import mean_touches, train_tree

from .worlds import as_explored, synthetic, touch_of


@pytest.fixture(scope="module")
def model() -> HapticModel:
    return fit_model(synthetic(30))


def test_the_prior_is_believed_until_something_is_touched() -> None:
    data = synthetic(10)
    found = update_belief(with_prior(fit_model(data), {"soft": 3.0, "flat": 1.0}), ()).as_mapping()
    assert found == pytest.approx({"flat": 0.225, "rim": 0.0, "soft": 0.675, UNKNOWN: 0.1})
    with pytest.raises(InputError, match="found 'mug', expected one of"):
        with_prior(fit_model(data), {"mug": 1.0})


def test_probabilities_are_bayes_rule_written_out(model: HapticModel) -> None:
    """Beside the best known class is what is like it and unknown: as dense everywhere as it is at the limit of 1 %."""
    from scipy.stats import chi2, multivariate_normal

    touch = touch_of(synthetic(1, seed=5), 1)
    readings = (touch(8, "y"), touch(15, "x"))
    place, value, noise = evidence(model, readings)
    assert len(place) == 6
    density, best = np.zeros(len(model.answers)), (0.0, 0)
    tails: dict[int, list[float]] = {}
    for mean, spread, answer, prior in zip(
        model.mean, model.covariance, model.answer_of, model.log_prior, strict=True
    ):
        seen = spread[np.ix_(place, place)] + np.diag(noise)
        likely = np.exp(prior + multivariate_normal.logpdf(value, mean[place], seen))
        density[answer] += likely
        away = value - mean[place]
        if answer < len(model.answers) - 1:
            best = max(best, (likely, answer))
            tails.setdefault(answer, []).append(float(chi2.sf(away @ np.linalg.solve(seen, away), 6)))
    # The Gaussians of a class are equally probable.
    square = chi2.isf(np.mean(tails[best[1]]), 6)
    density[-1] += density[:-1].sum() * np.exp(0.5 * (square - chi2.isf(0.01, 6)))
    np.testing.assert_allclose(update_belief(model, readings).probability, density / density.sum(), rtol=1e-6)
    assert np.exp(model.log_prior).sum() == pytest.approx(1)


def test_an_object_of_another_height_is_of_no_class_that_feels_like_it() -> None:
    data = synthetic(30)
    rng = np.random.default_rng(1)
    # Cups of 100 mm within 5 %; what is asked for is 50 mm tall, 13 standard deviations off, and feels like one of them.
    tall = replace(data, height_m=0.1 * np.exp(rng.normal(0, 0.05, len(data))))
    touches = [touch_of(tall, 3)(8, "y"), touch_of(tall, 3)(15, "x")]
    short = [replace(one, object_height_m=0.05) for one in touches]
    model = fit_model(tall)
    assert update_belief(model, touches).answer == tall.label[3]
    assert update_belief(model, short).answer == UNKNOWN
    # Where the heights of the training objects or of this one are not known, they are no evidence.
    plain = update_belief(fit_model(data), touches)
    assert plain.answer == tall.label[3]
    assert update_belief(fit_model(data), short).answer == tall.label[3]
    unseen = [replace(one, object_height_m=np.nan) for one in touches]
    np.testing.assert_allclose(
        update_belief(model, unseen).probability,
        update_belief(fit_model(data), unseen).probability,
        atol=1e-3,
    )


def test_a_known_object_is_called_unlike_its_class_as_rarely_as_said() -> None:
    """Readings that the model itself draws: one in a hundred lies beyond the limit, where unknown is the more probable."""
    model = fit_model(synthetic(30), settings=ModelSettings(unknown_prior=1e-9))
    rng, places = np.random.default_rng(0), [(height, axis) for height in (5, 8, 11) for axis in "xy"]
    touch, count, refused = touch_of(synthetic(1), 0), 2000, 0
    place, _, noise = evidence(model, [touch(*one) for one in places])
    kept = model.answer_of < len(model.answers) - 1
    for _ in range(count):
        gaussian = int(rng.choice(np.flatnonzero(kept)))
        root = np.linalg.cholesky(model.covariance[gaussian][np.ix_(place, place)] + np.diag(noise))
        drawn = model.mean[gaussian, place] + root @ rng.standard_normal(len(place))
        refused += belief_of(model, log_likelihood(model, place, drawn, noise), len(place)).answer == UNKNOWN
    # The Gaussians of a class are almost scaled copies of each other: as many as stated, to 4 standard deviations of the count.
    assert abs(refused - 20) < 4 * np.sqrt(20)


def test_classes_may_be_all_that_there_are() -> None:
    """Without a prior probability, "unknown" has no posterior one, and a later prior cannot give it any."""
    data = synthetic(30)
    model = fit_model(data, settings=ModelSettings(unknown_prior=0.0))
    touches = [touch_of(data, 3)(height, "x") for height in (5, 9)]
    found = update_belief(model, touches).as_mapping()
    assert found[UNKNOWN] <= 0.0
    assert sum(found.values()) == pytest.approx(1.0)
    first = model.answers[0]
    assert update_belief(with_prior(model, {first: 1.0}), touches).confidence == pytest.approx(1.0)
    with pytest.raises(InputError, match=r"found 0.2 for 'unknown', expected 0: .*unknown_prior=0"):
        with_prior(model, {first: 0.8, UNKNOWN: 0.2})


def test_correlated_values_count_as_fewer_independent_ones() -> None:
    """With errors of a common correlation, a shift of all values is as unlikely as one of n / (1 + (n - 1) r) values."""
    correlation = 0.06
    model = replace(fit_model(synthetic(30)), correlation=correlation)
    for count in (1, 10, 31):
        errors = (1 - correlation) * np.eye(count) + correlation
        square = np.ones(count) @ np.linalg.solve(errors, np.ones(count))
        assert model.temperature_of(count) == pytest.approx(count / square)


def test_correlation_is_learned_from_the_outer_objects_of_each_class() -> None:
    """Profiles of one class that bend with the square of a parameter, towards the other class: the inner ones do not show it."""
    found = {}
    for bend in (0.0, 0.2):
        rng, z = np.random.default_rng(2), np.linspace(0, 1, 16)
        own = rng.uniform(-1, 1, (48, 2))
        shape, other = np.cos(3 * np.pi * z), np.repeat([0.0, 1.0], 24)[:, None]
        logs = 8.0 + 0.1 * own[:, :1] + 0.5 * own[:, 1:] * (z - 0.5)
        logs += (0.2 * other + bend * (1 - other) * own[:, 1:] ** 2) * shape
        stiffness = np.repeat(np.exp(logs)[:, :, None], 4, axis=2)
        data = FeatureSet.of_stiffness(stiffness, np.full((48, 16, 2), 0.06), ["soft"] * 24 + ["stiff"] * 24)
        model = fit_model(data, settings=ModelSettings(use_width=False))
        found[bend] = calibrate(model, data, np.random.default_rng(0), explorations=1200).correlation
    # Straight ones: hardly more than their noise. Bent ones: values of a wrong profile are worth a few of another one.
    assert found[0.0] < 0.1 < 0.3 < found[0.2]


@pytest.mark.parametrize("correlation", [0.0, 0.06])
def test_an_outline_is_evidence_with_errors_that_neighbours_share(
    model: HapticModel, correlation: float
) -> None:
    """By hand: the covariance of the errors of log radii, interpolated to the heights of the widths."""
    model = replace(model, correlation=correlation)
    touch = touch_of(synthetic(1, seed=5), 1)
    outline = np.array([[0.029, 0.0], [0.031, 0.06], [0.02, 0.1]])
    own = 0.001 / outline[:, 0]
    declared = np.outer(own, own) * np.array([[1.0, 0.5, 0.2], [0.5, 1.0, 0.5], [0.2, 0.5, 1.0]])
    z = (np.arange(1, 15) + 0.5) / 16 * 0.1
    below = np.interp(z, outline[:, 1], [0.0, 1.0, 2.0])
    share = np.maximum(0.0, 1.0 - np.abs(below[:, None] - np.arange(3)))
    width = 2.0 * np.exp(share @ np.log(outline[:, 0]))
    errors = WIDTH_VARIANCE * np.eye(14) + share @ declared @ share.T
    felt, value, noise = evidence(model, [touch(8, "y"), touch(13, "y")])
    place = np.append(FIRST_WIDTH + 2 * np.arange(1, 15), felt)
    both = np.zeros((len(place), len(place)))
    both[:14, :14], both[14:, 14:] = errors, np.diag(noise)
    at_once = belief_of(
        model, log_likelihood(model, place, np.append(np.log(width), value), both), len(place)
    ).probability
    seen = with_outline(model, outline, declared)
    found = update_belief(seen, [touch(8, "y"), touch(13, "y")])
    np.testing.assert_allclose(found.probability, at_once, rtol=1e-6)
    # Of the two of this width nothing says which it is; the third is half as wide across.
    assert update_belief(with_outline(model, 0.5 * outline, 0.1 * declared), []).answer == UNKNOWN


def test_conditioning_in_steps_is_conditioning_at_once(model: HapticModel) -> None:
    touch = touch_of(synthetic(1, seed=5), 1)
    place, value, noise = evidence(model, (touch(4, "x"), touch(9, "y")))
    mean, spread = condition(model, place, value, noise)
    # Kalman's update, one reading after the other.
    m, s = model.mean[0], model.covariance[0]
    for k, v, r in zip(place, value, noise, strict=True):
        gain = s[:, k] / (s[k, k] + r)
        m, s = m + gain * (v - m[k]), s - np.outer(gain, s[k])
    np.testing.assert_allclose(mean[0], m, atol=1e-8)
    np.testing.assert_allclose(spread[0], s, atol=1e-8)


def shared_error(readings: list[TouchReading], gain: float) -> list[TouchReading]:
    """The same touches by a gripper whose force is read too high."""
    return [
        TouchReading.of_stiffness(
            one.height, one.axis, [gain * side.i_N_per_m for side in one.sides if side], 0.02, one.width_m
        )
        for one in readings
    ]


def test_what_all_touches_share_is_no_evidence_against_a_class() -> None:
    """A gain that is 20 % high in twelve readings is one error; twelve errors of 20 % are none that could be."""
    model = fit_model(synthetic(30, spread=0.01))
    touch, rng = touch_of(synthetic(1, seed=5, spread=0.01), 1), np.random.default_rng(0)
    exact = [touch(height, axis) for height in (5, 7, 9, 11, 13, 15) for axis in "xy"]
    # Two standard deviations of the gain; the objects of the class are alike to 2 %.
    assert update_belief(model, shared_error(exact, 1.2)).as_mapping()["rim"] > 0.9
    factors = rng.permutation([1.2, 1 / 1.2] * 6)
    apart = [shared_error([one], float(factor))[0] for one, factor in zip(exact, factors, strict=True)]
    assert update_belief(model, apart).as_mapping()["rim"] < 0.1


def test_the_assumption_that_is_doubted_is_named(model: HapticModel) -> None:
    touch = touch_of(synthetic(1, seed=5, spread=1e-6), 1)
    exact = [touch(height, axis) for height in (4, 6, 8, 10, 12, 14) for axis in "xy"]
    assert contradicted_assumption(model, exact) == ""
    # All as stiff as it is one place, 1 cm, further up.
    moved = [
        TouchReading.of_stiffness(
            one.height, one.axis, [side.i_N_per_m for side in touch(one.height + 1, one.axis).sides], 0.02
        )
        for one in exact
    ]
    assert "the readings fit rim pressed" in contradicted_assumption(model, moved)
    assert "higher" in contradicted_assumption(model, moved)
    assert contradicted_assumption(model, []) == ""


def test_objects_outside_the_trained_ranges_are_known_and_others_are_not() -> None:
    """2.5 times as far from the middle as those that were trained; and a profile that no class has, of the same level."""
    data = synthetic(30)
    model = fit_model(data)
    values = data.features[..., 0], data.width_m
    middle = [np.stack([np.log(one)[data.number == k].mean(axis=0) for k in range(3)]) for one in values]
    right = []
    for row in range(0, len(data), 3):
        at = data.number[row]
        stiffness, width = (
            np.exp(its[at] + 2.5 * (np.log(one[row]) - its[at]))
            for one, its in zip(values, middle, strict=True)
        )
        features, width_m = data.features.copy(), data.width_m.copy()
        features[row, ..., 0], width_m[row] = stiffness, width
        touch = touch_of(replace(data, features=features, width_m=width_m), row)
        readings = [touch(height, axis) for height in (6, 9, 12, 15) for axis in "xy"]
        right.append(update_belief(model, readings).answer == data.label[row])
    assert np.mean(right) > 0.9
    wavy = replace(data, features=data.features * np.exp(np.sin(np.arange(16)))[:, None, None])
    touch = touch_of(wavy, 0)
    readings = [touch(height, axis) for height in (6, 9, 12, 15) for axis in "xy"]
    assert update_belief(model, readings).answer == UNKNOWN


def test_effects_of_second_order_grow_with_the_square_outside_the_ranges() -> None:
    """A class of twelve parameters with curved effects: members that vary by l times as much are as far off as declared."""
    rng = np.random.default_rng(0)
    linear, square = rng.normal(0, 0.1, (12, FIRST_WIDTH)), rng.normal(0, 0.03, (12, FIRST_WIDTH))

    def logs(scale: float, count: int) -> np.ndarray:
        u = rng.uniform(-np.sqrt(3), np.sqrt(3), (count, 12)) * scale
        return np.asarray(u @ linear + (u**2 - 1) @ square)

    trained = np.exp(8.0 + logs(1.0, 800)).reshape(-1, 16, 4)
    data = FeatureSet.of_stiffness(trained, np.full((800, 16, 2), 0.06), ["any"] * 800)
    one = class_statistics(data, ModelSettings(), TouchProtocol())["any"]
    # Twelve parameters have 24 effects; the twelve smaller ones are of second order.
    direction = np.linalg.eigh(one.within[:FIRST_WIDTH, :FIRST_WIDTH])[1][:, -24:-12]
    away = (logs(RANGE_WIDENING, 2000) @ direction).var(axis=0).sum()
    declared = RANGE_WIDENING**2 * one.within + (RANGE_WIDENING**4 - RANGE_WIDENING**2) * one.curved
    ratio = away / np.trace(direction.T @ declared[:FIRST_WIDTH, :FIRST_WIDTH] @ direction)
    # The resolution of a touch and 800 objects leave some percent; of first order alone, it would be twice that.
    assert ratio == pytest.approx(1.0, abs=0.15)
    # The shipped classes have as many free parameters on average.
    free = [len(load_container(name).free_parameters) for name in class_names()]
    assert pytest.approx(np.mean(free), rel=0.1) == PARAMETERS


def test_a_class_of_few_parameters_does_not_bend_as_another_with_grooves_does() -> None:
    """Of one class the level differs alone, of the other also each height by itself: a truth with two covariances."""
    rng = np.random.default_rng(3)
    level = rng.normal(0, 0.2, (60, 1, 1))
    grooves = rng.normal(0, 0.5, (60, 16, 1)) * (np.arange(60) >= 30)[:, None, None]
    stiffness = np.exp(8.0 + level + grooves) * np.ones((60, 16, 4))
    width = np.full((60, 16, 2), 0.06) * rng.lognormal(0, 0.02, (60, 1, 1))
    data = FeatureSet.of_stiffness(stiffness, width, ["plain"] * 30 + ["grooved"] * 30)
    learned = class_statistics(data, ModelSettings(), TouchProtocol())
    bend = np.repeat(np.resize([1.0, -1.0], 16), 4) / 8.0  # of unit length, from height to height
    found = {name: float(bend @ one.within[:64, :64] @ bend) for name, one in learned.items()}
    # 4 * 0.5^2 in grooves that go all around, known from 30 objects to 26 %; of the plain ones nothing, to what a
    # hundredth of an object lets in: 1 / 2 / 2900.
    assert found["grooved"] == pytest.approx(1.0, rel=0.6)
    assert found["plain"] < 3 * 0.5 / 2900


def test_information_is_where_classes_differ_and_costs_time(model: HapticModel) -> None:
    settings = ModelSettings(use_width=False, unknown_prior=1e-9)
    stiff = fit_model(synthetic(30), settings=settings)
    gains = touch_gains(stiff, (), samples=200, rng=np.random.default_rng(1))
    # At the foot all classes are alike; at the top "soft" differs from the others.
    assert gains[15, "x"][0] > 5 * gains[2, "x"][0]
    assert all(gain >= 0 and seconds > 0 for gain, seconds in gains.values())
    assert len(gains) == 32
    touched = touch_of(synthetic(1), 0)(15, "x")
    assert (15, "x") not in touch_gains(stiff, (touched,), samples=8)
    protocol = TouchProtocol()
    assert travel_seconds(protocol, (8, "x"), (8, "y")) == protocol.turn_s
    # Eleven places of 12 cm / 16, at the speed of the arm; the turn is made meanwhile.
    way_s = 11 * protocol.place_m / protocol.travel_m_per_s
    assert way_s > protocol.turn_s
    assert travel_seconds(protocol, (14, "x"), (3, "y")) == pytest.approx(way_s)
    assert travel_seconds(protocol, None, (3, "y")) == 0.0


def round_classes(rng: np.random.Generator) -> FeatureSet:
    """Three classes whose sides are alike all around, thirty objects each."""
    top = np.repeat([[6.0], [9.0], [8.0]], 30, axis=0)
    profile = 9.0 + (top - 9.0) * np.linspace(0, 1, 16) + rng.normal(0, 0.1, (90, 1))
    stiffness = np.repeat(np.exp(profile)[:, :, None], 4, axis=2)
    width = np.full((90, 16, 2), 0.06) * rng.lognormal(0, 0.02, (90, 1, 1))
    return FeatureSet.of_stiffness(stiffness, width, np.repeat(["soft", "rim", "middle"], 30).tolist())


def test_that_an_object_is_round_is_evidence_once_and_not_at_every_height() -> None:
    """Sides that are alike, touched a second time across: of round classes, four in five are round (Laplace's rule)."""
    data = round_classes(np.random.default_rng(0))
    model, touch = fit_model(data, settings=ModelSettings(use_width=False)), touch_of(data, 40)
    along = [touch(height, "x") for height in (4, 7, 10, 13)]
    both = [one for height in (4, 7, 10, 13) for one in (touch(height, "x"), touch(height, "y"))]
    odds = [float(np.log(found[-1] / found[:-1].sum())) for found in
            (update_belief(model, readings).probability for readings in (along, both))]  # fmt: skip
    # What is not round goes, log(5 / 4), and second readings tell noise and errors of simulation from profiles: by stiffness
    # half a nat a height at most, the logarithm of what two readings for one gain in both sides' errors. If axes differed by
    # chance at every height, each would add 1.4.
    assert odds[0] - odds[1] < np.log(5 / 4) + 4 * 0.5
    oval = np.flatnonzero(model.answer_of == 3)[1::2]  # each simulated container, round and oval
    prior = np.exp(model.log_prior)
    assert prior[oval].sum() == pytest.approx(0.1 / 5)


def test_touches_are_valued_by_the_same_samples() -> None:
    """Both axes of a round object tell as much, whatever the samples are; a thousand tell the same as 64 to a fifth."""
    model = fit_model(round_classes(np.random.default_rng(0)))
    gains = touch_gains(model, (), rng=np.random.default_rng(3))
    for height in range(1, 17):
        assert gains[height, "x"][0] == pytest.approx(gains[height, "y"][0], rel=0.02)
    many = touch_gains(model, (), samples=1000, rng=np.random.default_rng(4))
    assert gains[15, "x"][0] == pytest.approx(many[15, "x"][0], rel=0.2)


def test_known_objects_are_found_with_fewer_touches_than_the_tree(model: HapticModel) -> None:
    unseen, rng = synthetic(4, seed=77), np.random.default_rng(2)
    touches, right = [], 0
    for row in range(len(unseen)):
        found = explore(model, touch_of(unseen, row, rng=rng), samples=32, rng=rng)
        touches.append(len(found.readings))
        right += found.answer == unseen.label[row]
        assert found.belief.probability.sum() == pytest.approx(1)
        assert found.seconds > 0
    assert right >= 11  # of 12
    assert np.mean(touches) < mean_touches(train_tree(synthetic(30)))


@pytest.mark.parametrize(("confidence", "touches"), [(0.9, 16), (0.999999, 2)])
def test_an_exploration_ends_when_it_is_sure_or_out_of_touches(
    model: HapticModel, confidence: float, touches: int
) -> None:
    found = explore(
        model, touch_of(synthetic(1, seed=77), 0), confidence=confidence, max_touches=touches, samples=16
    )
    assert found.confident == (found.belief.probability.max() >= confidence)
    assert len(found.readings) == touches if not found.confident else len(found.readings) < touches
    assert found.confident == (confidence < 0.95)
    for count in range(1, len(found.readings)):  # it was not sure before
        assert update_belief(model, found.readings[:count]).probability.max() < confidence


def test_what_no_class_is_like_is_unknown(model: HapticModel) -> None:
    data = synthetic(2)
    strange = as_explored(data, np.random.default_rng(0))
    strange.features[..., 0] *= 60.0
    for row in range(len(data)):
        touch = touch_of(strange, row)
        # The soft top, 60 times as stiff, is that of "rim": only further down it is like nothing.
        assert (
            update_belief(model, [touch(height, axis) for height in (5, 8, 11, 15) for axis in "xy"]).answer
            == UNKNOWN
        )
    for row in (2, 4):  # a rim and a flat one
        assert explore(model, touch_of(strange, row), samples=16).answer == UNKNOWN


def test_the_likelihood_of_a_sequence_is_that_of_its_beginnings() -> None:
    data = synthetic(5)
    model = fit_model(data)
    touch = touch_of(data, 0)
    readings = [touch(height, "x") for height in (3, 9, 14)]
    place, value, noise = evidence(model, readings)
    ends = np.array([0, 3, 6, len(place)])
    told = sequential_likelihood(model, place, value, noise, ends)
    for end, found in zip(ends, told, strict=True):
        alone = log_likelihood(model, place[:end], value[:end], noise[:end])
        assert np.allclose(found[0], alone[0], rtol=1e-9)
    # By determinant and inverse.
    seen = model.covariance[:, place[:, None], place] + np.diag(noise)
    away = value - model.mean[:, place]
    square = np.einsum("co,cop,cp->c", away, np.linalg.inv(seen), away)
    assert told[-1, 1] == pytest.approx(square, rel=1e-6)
    assert told[-1, 0] == pytest.approx(-0.5 * square - 0.5 * np.linalg.slogdet(seen)[1], rel=1e-6)


@pytest.mark.parametrize("count", [1, BLOCK, BLOCK + 1])
def test_explorations_together_are_those_one_by_one(count: int) -> None:
    """Also across the borders of the blocks that are factorised together."""
    model, rng = fit_model(synthetic(5)), np.random.default_rng(count)
    features = model.mean.shape[1]
    place = np.array([rng.permutation(features)[:6] for _ in range(count)])
    value, noise = model.mean[0][place] + rng.normal(0, 0.3, place.shape), rng.uniform(1e-3, 0.1, place.shape)
    ends = np.array([2, 6])
    found = _explored_likelihoods(model, place, value, noise, ends)
    for k in rng.permutation(count)[:5]:
        alone = sequential_likelihood(model, place[k], value[k], noise[k], ends)
        np.testing.assert_allclose(found[k], alone, rtol=1e-9)


def test_calibration_lowers_what_is_wrong_with_confidence() -> None:
    data = synthetic(30, spread=0.4)
    plain = fit_model(data, settings=ModelSettings(use_width=False))
    warm = calibrate(plain, data, np.random.default_rng(1), explorations=80, max_touches=3)
    assert 0.5 <= warm.temperature <= 6
    assert -3 <= warm.unknown_log_odds <= 3
    # What was left out has larger residuals than a Gaussian.
    assert 1 <= warm.tail < 3
    rng = np.random.default_rng(4)
    confidence, hit = [], []
    # Half of them outside the range of the training, all by a poor pose.
    for seed, spread in ((4, 0.4), (5, 0.7)):
        objects = synthetic(25, seed=seed, spread=spread)
        unseen = as_explored(join_feature_sets([objects, objects]), rng, pose_m=0.005)
        for row in range(len(unseen)):
            touch = touch_of(unseen, row, rng=rng)
            readings = [touch(int(rng.integers(1, 17)), "xy"[int(rng.integers(2))]) for _ in range(2)]
            fraction = update_belief(warm, readings).probability[:-1]
            fraction = fraction / fraction.sum()
            confidence.append(fraction.max())
            hit.append(warm.answers[int(np.argmax(fraction))] == unseen.label[row])
    # 300 explorations in seven bins: chance alone gives about 0.05.
    assert calibration_error(np.array(confidence), np.array(hit)) < 0.12


@pytest.mark.parametrize(("widths", "freedom"), [(False, 6), (True, 9)])
def test_objects_that_are_left_out_are_explored_touch_by_touch(widths: bool, freedom: int) -> None:
    """Two sides at each of three places, and its width; each object equally often, without itself in training."""
    data = synthetic(8)
    model = fit_model(data, settings=ModelSettings(use_width=widths))
    out = np.arange(len(data)) % 4 == 0
    judged = _explored(
        model, data, np.array(data.label), out, 2 * int(out.sum()), 3, np.random.default_rng(3)
    )
    first = int(widths and data.height_m is not None)
    assert judged.likelihood.shape[:3] == (2 * out.sum(), 3, 2)
    assert judged.freedom == freedom + first
    assert np.array_equal(np.unique(judged.obj), np.flatnonzero(out))
    assert set(np.unique(judged.obj, return_counts=True)[1]) == {2}
    assert [judged.model.answers[k] for k in judged.truth] == [data.label[k] for k in judged.obj]
    assert not np.allclose(judged.model.mean, model.mean)
    # A sum of squares grows with every touch.
    assert (np.diff(judged.likelihood[:, :, 1], axis=1) > 0).all()


def test_the_simplest_candidate_is_kept_within_one_standard_error() -> None:
    """Gains of g standard errors over the first of three candidates: below 1 it is kept, above 1 the best one is taken."""
    noise = np.random.default_rng(3).standard_normal(50)
    noise = (noise - noise.mean()) / noise.std(ddof=1)
    hard = 5.0 * np.arange(50.0)  # what all candidates have in common is no error of their difference
    for gain, chosen in ((0.9, 0), (1.1, 2)):
        losses = np.stack([hard, hard + 1.0, hard - gain / np.sqrt(50) - noise])
        assert best_or_first(losses) == chosen
    assert best_or_first(np.stack([hard, hard + noise**2])) == 0


def test_calibration_keeps_the_temperature_that_few_objects_do_not_refute() -> None:
    """Ten cups that are soft at the top and ten bottles that are not: the least loss is at .7, .97 or 1, by 1e-4."""
    rng, place = np.random.default_rng(0), np.linspace(0, 1, 16)
    top = np.repeat([500.0, 2e4], 10)
    profile = 8e3 * (top[:, None] / 8e3) ** place * rng.lognormal(0, 0.1, (20, 1))
    width_m = np.full((20, 16, 2), 0.06) * rng.lognormal(0, 0.02, (20, 1, 1))
    data = FeatureSet.of_stiffness(
        np.repeat(profile[:, :, None], 4, axis=2), width_m, ["cup"] * 10 + ["bottle"] * 10
    )
    for seed in range(3):
        found = calibrate(fit_model(data), data, np.random.default_rng(seed), explorations=600)
        assert found.temperature == 1.0


def test_two_limits_together_have_the_stated_rate() -> None:
    """Of two independent statistics one in a hundred exceeds either limit; of two that agree, each."""
    rng = np.random.default_rng(5)
    margins, tails = rng.standard_normal((2, 100_000))
    for other in (tails, -margins):
        rate = rate_of_each(margins, other)
        beyond = (margins < np.quantile(margins, rate)) | (other > np.quantile(other, 1 - rate))
        assert beyond.mean() == pytest.approx(0.01, rel=0.01)
    assert rate == pytest.approx(0.01, rel=0.01)


def test_limits_of_the_calibration_hardly_depend_on_its_seed() -> None:
    """The rate beyond a quantile of N explorations has a standard error of sqrt(p (1 - p) / N)."""
    assert np.sqrt(0.01 * 0.99 / EXPLORATIONS) == pytest.approx(0.15 * 0.01, rel=0.05)
    data = synthetic(20, spread=0.4)
    plain = fit_model(data, settings=ModelSettings(use_width=False))
    found = [calibrate(plain, data, np.random.default_rng(seed), max_touches=3) for seed in range(3)]
    # A relative error of .15 of a rate that falls by e within some 1.5 nat is .2 nat.
    assert np.ptp([0.3 * one.unknown_log_odds for one in found]) < 0.8  # stated for ten touches
    assert np.ptp([one.tail for one in found]) < 0.2


def test_calibration_error_of_an_honest_and_of_a_boasting_forecaster() -> None:
    rng = np.random.default_rng(0)
    honest = rng.uniform(0.5, 1, 20_000)
    assert calibration_error(honest, rng.random(20_000) < honest) < 0.015
    assert calibration_error(np.full(20_000, 0.99), rng.random(20_000) < 0.5) == pytest.approx(
        0.49, abs=0.015
    )


def test_the_calibration_error_of_answers_by_hand() -> None:
    """Of ten bins: the first two answers lie in the last one, the third in the first."""
    found = calibration_error(np.array([0.905, 0.95, 0.04]), np.array([1.0, 0.0, 0.0]))
    assert found == pytest.approx((2 * abs((0.905 + 0.95) / 2 - 0.5) + 0.04) / 3)


def test_the_calibration_error_by_chance_is_that_of_a_binomial() -> None:
    """Of 900 forecasts of .9, one bin: |N(0, .09 / 900)| has the mean .01 sqrt(2 / pi) and the 95 % quantile .0196."""
    mean, high = calibration_by_chance(np.full(900, 0.9), draws=4000)
    assert mean == pytest.approx(
        0.01 * np.sqrt(2 / np.pi), rel=0.05
    )  # three standard errors of 4000 draws: 4 %
    assert high == pytest.approx(0.0196, rel=0.06)  # steps of 1 / 900


def test_a_touch_lasts_as_long_as_the_gripper_needs() -> None:
    """Two seconds to contact and back, and 3 mm at 5 mm/s."""
    assert TouchProtocol().touch_s == pytest.approx(2.6)


def test_the_slope_of_the_seen_stiffness_is_its_derivative() -> None:
    stiffness, step = np.array([50.0, 1e3, 2e4]), 1e-6
    low, high = (TouchProtocol().seen_stiffness(stiffness * np.exp(sign * step))[0] for sign in (-1, 1))
    np.testing.assert_allclose(
        TouchProtocol().seen_stiffness(stiffness)[1], (high - low) / (2 * step), rtol=1e-6
    )


def test_zeros_that_the_curves_show_are_those_of_the_joint_gaussian(model: HapticModel) -> None:
    """By hand: values, contacts and the zeros of both sensors are jointly Gaussian in each class."""
    stiffness, start, sigma = np.array([2e4, 3e4]), np.array([1.3e-4, 0.4e-4]), np.array([8e-5, 6e-5])
    sides = [
        CurveCoefficients(k, k, np.nan, 0.05, np.nan, c, s)
        for k, c, s in zip(stiffness, start, sigma, strict=True)
    ]
    readings = [TouchReading(8, "y", (sides[0], sides[1]))]
    found = with_zeros(model, readings)
    reach = 20.0 / stiffness
    settings = model.settings
    # d = F / k + c: an error f of the force moves c by -f / k, a relative curvature of 1 (1 cm) by 100 r^2 / 6.
    along = np.stack([-settings.zero_N / stiffness, [settings.zero_m] * 2, 100.0 * reach**2 / 6])
    seen = along.T @ along + np.diag(sigma**2)
    effect = model.nuisance[:, [2, 3]]
    for k in range(len(model.mean)):
        across = effect[k].T @ along[:2]
        gain = across @ np.linalg.inv(seen)
        np.testing.assert_allclose(found.mean[k], model.mean[k] + gain @ start, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.covariance[k], model.covariance[k] - gain @ across.T, atol=1e-12)
    # The deformation reads too high, and so the wall too soft.
    assert (found.mean <= model.mean + 1e-12).all()
    assert (found.mean[:, 28] < model.mean[:, 28]).all()


def test_a_wrong_contact_of_stiff_walls_is_no_other_class() -> None:
    """Two classes differ by a fifth of their stiffness everywhere, and a contact that is 0.1 mm wrong changes it by as much."""
    rng, right = np.random.default_rng(0), {True: 0, False: 0}
    level = np.repeat([0, 1], 40)
    shape = 4e4 * 0.8 ** level[:, None, None]
    features = np.zeros((80, 16, 4, 3))
    features[..., 0] = shape * np.exp(0.02 * rng.standard_normal((80, 1, 1)))
    labels = tuple(("stiff", "soft")[k] for k in level)
    data = FeatureSet(features, np.full((80, 16, 2), 0.06), labels, tuple(map(str, range(80))))
    model = fit_model(data, settings=ModelSettings(use_width=False, gain=0.02, unknown_prior=1e-6))
    for _ in range(60):
        kind, wrong = int(rng.integers(2)), 1e-4 * (1 if rng.random() < 0.5 else -1)
        readings = []
        for height in (4, 6, 8, 10, 12, 14):
            k = float(features[40 * kind, height - 1, 0, 0])
            d = np.arange(1, 13) / 12 * min(0.003, 20 / k)
            sides = [
                fit_curve(d + wrong + rng.normal(0, 1e-4, 12), k * d + rng.normal(0, 0.1, 12), from_contact=True)
                for _ in range(2)
            ]  # fmt: skip
            readings.append(TouchReading(height, "x", (sides[0], sides[1])))
        for told in right:
            kept = [one if told else _without_contacts(one) for one in readings]
            right[told] += update_belief(model, kept).answer == ("stiff", "soft")[kind]
    assert right[True] >= 55
    assert right[False] <= right[True] - 6


def _without_contacts(reading: TouchReading) -> TouchReading:
    first, second = (side and replace(side, contact_m=np.nan) for side in reading.sides)
    return replace(reading, sides=(first, second))

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import normalised
from visuohaptic.recognition.trees import (
    SAMPLES,
    grown,
    load_tree,
    mean_touches,
    next_touch,
    predict,
    predictors,
    pruned,
    pruning_alphas,
    scaled_features,
    scaling_touches,
    simplest,
    smoothed,
    train_tree,
    tree_mapping,
    tree_text,
    walk,
)
from visuohaptic.recognition.trees._tree_kernels import best_splits

from .worlds import synthetic, touch_of


@pytest.mark.parametrize("scheme", ["norm", "centre", "point"])
def test_features_are_those_of_the_deformation_package(scheme: str) -> None:
    values = synthetic(2).features[0, ..., 0]
    np.testing.assert_allclose(
        scaled_features(values, scheme), normalised(values, scheme).ravel(), rtol=1e-12
    )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 4), st.integers(5, 40))
def test_a_split_lowers_gini_as_much_as_scikit_learn(seed: int, classes: int, count: int) -> None:
    from sklearn.tree import DecisionTreeClassifier

    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(count, 3)), rng.integers(0, classes, count)
    y[:2] = 0, 1
    stump = DecisionTreeClassifier(max_depth=1, random_state=0).fit(x, y).tree_
    gini = stump.impurity * stump.n_node_samples
    best = gini[0] - gini[1:].sum()
    order = np.argsort(x.T, axis=1).astype(np.int32)
    decrease, threshold, gap = best_splits(order, np.ascontiguousarray(x.T), y, np.ones(count), classes)
    assert max(decrease.max(), 0.0) == pytest.approx(best, abs=1e-6)
    # The same written out: impurity of both children.
    feature = int(np.argmax(decrease))
    low = x[:, feature] <= threshold[feature]
    assert gap[feature] > 0
    left = sum(len(part) - (np.bincount(part) ** 2).sum() / len(part) for part in (y[low], y[~low]))
    whole = count - (np.bincount(y) ** 2).sum() / count
    assert decrease[feature] == pytest.approx(whole - left, abs=1e-9)


def test_weights_count_like_copies() -> None:
    rng = np.random.default_rng(0)
    x, y, weight = rng.normal(size=(30, 4)), rng.integers(0, 3, 30), rng.integers(1, 4, 30).astype(float)
    copies = np.repeat(np.arange(30), weight.astype(int))
    found = []
    for rows, fraction in ((np.arange(30), weight), (copies, np.ones(len(copies)))):
        columns = np.ascontiguousarray(x[rows].T)
        order = np.argsort(columns, axis=1).astype(np.int32)
        found.append(best_splits(order, columns, y[rows], fraction, 3)[:2])
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


def test_draws_keep_middle_spread_and_weight_of_each_class() -> None:
    data = synthetic(40)
    values = np.log(data.features[..., 0]).reshape(len(data), -1)
    more, number, weight = smoothed(values, data.number, 8000, np.random.default_rng(2))
    for k in range(3):
        own, drawn = values[data.number == k], more[number == k][40:8040]
        assert weight[number == k].sum() == pytest.approx(40)
        # 8000 samples around 40 objects in turn: means within 4 standard errors, deviations within 4 * 0.8 %.
        error = 4 * own.std(axis=0) / np.sqrt(8000)
        assert (np.abs(drawn.mean(axis=0) - own.mean(axis=0)) < error + 1e-9).all()
        np.testing.assert_allclose(drawn.std(axis=0), own.std(axis=0), rtol=0.035, atol=1e-9)
    again = smoothed(values, data.number, 0, np.random.default_rng(2))
    assert again[0] is values
    assert np.array_equal(again[2], np.ones(len(data)))


def test_known_pruning_while_growing_is_pruning_after_it() -> None:
    data = synthetic(40, spread=0.8)
    values = np.log(data.features[..., 0]).reshape(len(data), -1)
    more, number, weight = smoothed(values, data.number, 200, np.random.default_rng(1))
    x = predictors(more, "centre")
    whole = grown(x, number, weight, data.classes, "centre", 0.1)
    for alpha in (0.0, 0.001, 0.01, 0.1):
        early = pruned(grown(x, number, weight, data.classes, "centre", 0.1, alpha=alpha), alpha)
        late = pruned(whole, alpha)
        assert np.array_equal(early.feature, late.feature)
        np.testing.assert_allclose(early.threshold, late.threshold)


def test_each_alpha_prunes_to_the_least_cost_of_all_subtrees() -> None:
    data = synthetic(20, spread=0.8)
    tree = train_tree(data, alpha=0.0, samples=0)
    alphas = pruning_alphas(tree)
    assert (np.diff(alphas) > 0).all()
    total = tree.counts[0].sum()

    def cost(one, alpha: float) -> float:
        leaf = one.feature < 0
        return float(
            (one.counts.sum(axis=1) - one.counts.max(axis=1))[leaf].sum() + alpha * total * leaf.sum()
        )

    trees = [pruned(tree, float(alpha)) for alpha in (0.0, *alphas)]
    for alpha in (0.0, *alphas):
        assert cost(pruned(tree, float(alpha)), alpha) <= min(cost(one, alpha) for one in trees) + 1e-6
    assert len(pruned(tree, float(alphas[-1])).feature) == 1


def test_the_simplest_tree_within_one_standard_error() -> None:
    # 4 errors of 100: one standard error is 1.96 objects.
    assert simplest(np.array([9.0, 4, 5, 5.9, 6.5]), 100) == 3
    # Without errors there is no uncertainty.
    assert simplest(np.array([0.0, 0, 1]), 100) == 1


def test_smoothing_helps_where_classes_touch() -> None:
    """Classes that overlap: thresholds between the objects of one sample are poor ones for the next."""
    unseen = synthetic(200, seed=99, spread=1.0)
    wrong = dict.fromkeys((0, SAMPLES), 0.0)
    for seed in range(4):
        data = synthetic(30, seed=seed, spread=1.0)
        for samples in wrong:
            tree = train_tree(data, samples=samples, rng=np.random.default_rng(seed))
            wrong[samples] += np.mean(
                np.array(predict(tree, unseen.features[..., 0])) != np.array(unseen.label)
            )
    assert wrong[SAMPLES] < wrong[0]


def test_cross_validation_says_that_clear_classes_are_clear() -> None:
    data = synthetic(30)
    tree = train_tree(data, rng=np.random.default_rng(3))
    assert tree.loss <= 0.02
    assert np.count_nonzero(tree.feature >= 0) == 2
    other = synthetic(30, seed=9)
    right = np.mean([a == b for a, b in zip(predict(tree, other.features[..., 0]), other.label, strict=True)])
    assert right >= 0.95


def test_without_reuse_and_draws_it_is_the_tree_of_scikit_learn() -> None:
    from sklearn.tree import DecisionTreeClassifier

    data = synthetic(20, spread=0.6)
    x = np.log1p(scaled_features(data.features[..., 0], "centre"))
    peer = DecisionTreeClassifier(random_state=0, ccp_alpha=0.0).fit(x, data.number)
    tree = train_tree(data, alpha=0.0, reuse=0.0, samples=0)
    assert np.count_nonzero(tree.feature < 0) == peer.get_n_leaves()
    found = np.array([tree.classes.index(name) for name in predict(tree, data.features[..., 0])])
    assert np.array_equal(found, peer.predict(x))


def test_reuse_saves_touches() -> None:
    data = synthetic(60, spread=0.5)
    fresh, thrifty = train_tree(data, reuse=0.0, alpha=0.01), train_tree(data, reuse=0.3, alpha=0.01)
    assert mean_touches(thrifty) <= mean_touches(fresh)


def test_more_cost_of_a_leaf_never_makes_a_larger_tree() -> None:
    data = synthetic(25, spread=0.8)
    sizes = [len(train_tree(data, alpha=alpha).feature) for alpha in (0, 0.002, 0.01, 0.05, 1.0)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] == 1


def test_a_walk_scales_first_and_asks_only_what_it_needs() -> None:
    data = synthetic(20)
    tree = train_tree(data)
    for row in (0, 25, 45):
        touch = touch_of(data, row)
        asked = []

        def pair(height: int, axis: str, touch=touch, asked=asked) -> tuple[float, float]:
            asked.append((height, axis))
            first, second = touch(height, axis).sides
            return first.i_N_per_m, second.i_N_per_m

        answer, touched = walk(tree, pair)
        assert answer == data.label[row]
        assert tuple(asked) == touched
        assert len(set(asked)) == len(asked)
        assert touched[:2] == scaling_touches("centre")
        # The same from all values: the decision does not depend on the order of measuring.
        assert predict(tree, data.features[[row], ..., 0]) == (answer,)
        assert next_touch(tree, data.features[row, ..., 0])[0] is None


def test_a_tree_survives_its_file(tmp_path: Path) -> None:
    tree = train_tree(synthetic(12))
    (tmp_path / "tree.json").write_text(json.dumps(tree_mapping(tree)))
    again = load_tree(tmp_path / "tree.json")
    assert tree_text(again) == tree_text(tree)
    assert again.loss == tree.loss
    text = (tmp_path / "tree.json").read_text()
    rng = np.random.default_rng(0)
    # Whatever is changed: it loads as a tree that ends, or it is refused in one line.
    for _ in range(60):
        broken = json.loads(text)
        key = rng.choice(list(broken))
        broken[key] = rng.choice(np.array([None, -1, "x", [], [5, 7, 9]], dtype=object))
        (tmp_path / "broken.json").write_text(json.dumps(broken))
        with suppress(InputError):
            predict(load_tree(tmp_path / "broken.json"), synthetic(1).features[..., 0])
    for text in ("", "[]", "{}", "[" * 100_000):
        (tmp_path / "broken.json").write_text(text)
        with pytest.raises(InputError):
            load_tree(tmp_path / "broken.json")


@pytest.mark.parametrize(
    ("field", "value"),
    [("threshold", float("inf")), ("feature", 16 * 4), ("feature", 10**6), ("counts", [-1.0, 2.0, 3.0])],
)
def test_a_node_that_asks_for_what_cannot_be_touched_is_refused(
    tmp_path: Path, field: str, value: object
) -> None:
    content = tree_mapping(train_tree(synthetic(12)))
    assert content["feature"][0] >= 0
    (tmp_path / "tree.json").write_text(json.dumps(content))
    load_tree(tmp_path / "tree.json")
    content[field][0] = value
    (tmp_path / "tree.json").write_text(json.dumps(content).replace("Infinity", "1e999"))
    with pytest.raises(InputError, match=r"tree\.json: .*(finite number|is not a classification tree)"):
        load_tree(tmp_path / "tree.json")

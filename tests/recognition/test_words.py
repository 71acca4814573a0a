"""Visual words retrieve images, and geometric verification rejects false matches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks._prior_world import label, scene_with

from visuohaptic.core import InputError
from visuohaptic.recognition.visual import (
    LocalFeatures,
    WordIndex,
    agreeing_matches,
    find_features,
    nearest_words,
    train_vocabulary,
)


def _random_words(rng: np.random.Generator, pictures: int, words: int) -> list[np.ndarray]:
    return [rng.integers(0, words, rng.integers(1, 40)) for _ in range(pictures)]


def test_index_is_the_cosine_of_full_vectors() -> None:
    """The inverted index against dense tf-idf vectors, computed the long way."""
    rng = np.random.default_rng(0)
    centres = rng.uniform(0, 255, (50, 128)).astype(np.float32)
    pictures = _random_words(rng, 30, 50)
    query = rng.integers(0, 256, (25, 128)).astype(np.uint8)
    counts = np.array([np.bincount(one, minlength=50) for one in pictures])
    rarity = np.log((1 + 30) / (1 + (counts > 0).sum(axis=0)))
    dense = np.sqrt(counts) * rarity
    by_hand = np.argmin(((query[:, None].astype(float) - centres[None]) ** 2).sum(axis=2), axis=1)
    assert np.array_equal(nearest_words(query, centres), by_hand)
    q = np.sqrt(np.bincount(by_hand, minlength=50)) * rarity
    wanted = dense @ q / np.maximum(np.linalg.norm(dense, axis=1) * np.linalg.norm(q), 1e-12)
    np.testing.assert_allclose(WordIndex(centres, pictures).scores(query), wanted, atol=1e-9)


def test_vocabulary_finds_the_groups() -> None:
    rng = np.random.default_rng(1)
    groups = rng.integers(0, 200, (9, 128))
    data = np.repeat(groups, 40, axis=0) + rng.integers(0, 5, (360, 128))
    centres = train_vocabulary(data.astype(np.uint8), 9, rng)
    # Groups lie thousands of grey levels apart and are 5 wide: a group is never divided among distant words.
    label_of = nearest_words(data.astype(np.uint8), centres)
    together = [len(np.unique(label_of[k * 40 : (k + 1) * 40])) for k in range(9)]
    assert len(centres) <= 12
    assert np.mean(together) < 3
    with pytest.raises(InputError):
        train_vocabulary(np.zeros((0, 128), np.uint8), 5, rng)


def test_agreeing_matches() -> None:
    rng = np.random.default_rng(2)
    one, other = find_features(label(1)), find_features(label(2))
    seen = find_features(scene_with(label(1), rng, hardness=0.4))
    assert agreeing_matches(one, seen) > 25
    assert agreeing_matches(other, seen) < 10
    # The right descriptors at the wrong places prove nothing.
    mixed = LocalFeatures(rng.permutation(seen.points_px), seen.descriptors)
    assert agreeing_matches(one, mixed) < 10
    assert agreeing_matches(one, LocalFeatures(seen.points_px[:0], seen.descriptors[:0])) == 0
    # Nor do a mirrored picture, which is no view of a plane, and one of which all matches are of one place in it.
    assert agreeing_matches(one, one) > 100
    assert agreeing_matches(one, LocalFeatures(one.points_px * np.float32([-1, 1]), one.descriptors)) == 0
    other_way = np.repeat(other.descriptors[:1], 20, axis=0)
    assert agreeing_matches(one, LocalFeatures(other.points_px[:20], other_way)) == 0


def test_pictures_that_say_nothing() -> None:
    assert len(find_features(np.zeros((200, 300), np.uint8))) == 0
    assert len(find_features(np.zeros((5, 5), np.uint8))) == 0
    grey = label(3)
    colour = find_features(np.repeat(grey[..., None], 3, axis=2), max_features=50)
    assert len(colour) == 50
    np.testing.assert_array_equal(colour.descriptors, find_features(grey, max_features=50).descriptors)
    with pytest.raises(InputError, match="expected uint8"):
        find_features(np.zeros((50, 50)))


def test_features_of_a_large_picture_are_at_its_own_pixels() -> None:
    """Blobs at known places, in the picture and twice as large: beyond 800 px it is made smaller, and positions are enlarged."""
    rng = np.random.default_rng(5)
    centres = np.stack(np.meshgrid(np.arange(60, 700, 80), np.arange(60, 340, 80)), -1).reshape(-1, 2)
    centres = centres + rng.uniform(-8, 8, centres.shape)
    for factor in (1.0, 1.9):
        x, y = np.meshgrid(np.arange(round(720 * factor)), np.arange(round(380 * factor)))
        image = np.full(x.shape, 60.0)
        for u, v in factor * (centres + 0.5) - 0.5:
            image += 150 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * (5 * factor) ** 2))
        found = find_features(np.rint(image).astype(np.uint8))
        # OpenCV doubles pictures without regard to the middles of pixels: its positions are a quarter of a pixel off.
        scale = min(1.0, 800 / max(image.shape))
        truth = factor * (centres + 0.5) - 0.5 + 0.25 / scale
        away = np.linalg.norm(found.points_px[:, None] - truth, axis=2).min(axis=1)
        assert len(found) >= len(centres)
        assert np.median(away) < 0.15 / scale
        # Root of shares: the squares of a descriptor add up to one.
        length = np.linalg.norm(found.descriptors / 510.0, axis=1)
        np.testing.assert_allclose(length, 1.0, atol=0.02)
    assert len(find_features(np.rint(image[:15]).astype(np.uint8))) == 0


def test_a_word_is_a_mean_of_its_members_and_a_picture_of_all_words_says_nothing() -> None:
    rng = np.random.default_rng(6)
    groups = rng.integers(0, 200, (4, 128))
    data = (np.repeat(groups, [10, 20, 30, 40], axis=0) + rng.integers(-3, 4, (100, 128))).clip(0, 255)
    (mean,) = train_vocabulary(data[:10].astype(np.uint8), 1, rng)
    np.testing.assert_allclose(mean, data[:10].mean(axis=0), atol=1e-3)
    # As many words as descriptors: each is its own.
    each = train_vocabulary(data.astype(np.uint8), 1000, rng)
    assert len(each) <= 100
    few = train_vocabulary(data.astype(np.uint8), 5, rng)
    assert len(few) <= 7
    # A word of all pictures has no weight, nor has a picture without features.
    index = WordIndex(groups.astype(np.float32), [np.array([0, 1, 1]), np.array([0, 2]), np.array([0])])
    assert len(index) == 3
    np.testing.assert_allclose(index.scores(groups[:1].astype(np.uint8)), 0.0, atol=1e-12)
    np.testing.assert_allclose(index.scores(groups[:2].astype(np.uint8)), [1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(index.scores(np.zeros((0, 128), np.uint8)), 0.0, atol=1e-12)


def test_matches_need_to_be_six_of_one_homography_and_not_ambiguous() -> None:
    """Descriptors that differ all, positions by a known shift: what agrees is counted."""
    rng = np.random.default_rng(7)
    stored = LocalFeatures(
        rng.uniform(0, 300, (20, 2)).astype(np.float32), rng.integers(0, 255, (20, 128)).astype(np.uint8)
    )
    shift = np.float32([30.0, -20.0])
    for count, expected in ((20, 20), (6, 6), (5, 0)):
        seen = LocalFeatures(stored.points_px[:count] + shift, stored.descriptors[:count])
        assert agreeing_matches(stored, seen) == expected
    # Five pixels aside are within the tolerance no more: 8 of 20 are outliers.
    off = stored.points_px + shift
    off[:8] += rng.choice([-1.0, 1.0], (8, 2)).astype(np.float32) * 40
    assert agreeing_matches(stored, LocalFeatures(off, stored.descriptors)) == 12
    # A second descriptor nearly as near as the first, .75 and .85 of its distance: Lowe's ratio is .8.
    for ratio, expected in ((0.75, 20), (0.85, 0)):
        first, second = stored.descriptors.astype(float), stored.descriptors.astype(float)
        first[:, :64] += np.where(first[:, :64] < 128, 20.0, -20.0)
        second[:, 64:] += np.where(second[:, 64:] < 128, 20.0, -20.0) / ratio
        both = np.rint(np.concatenate([first, second])).astype(np.uint8)
        places = np.concatenate([stored.points_px + shift, rng.uniform(0, 300, (20, 2)).astype(np.float32)])
        assert agreeing_matches(stored, LocalFeatures(places, both)) == expected
    # Matches at one place of 4 px count once.
    near = np.repeat(stored.points_px[:7] // 4 * 4, 2, axis=0) + np.tile(
        np.float32([[-1, 0], [1, 0]]), (7, 1)
    )
    twice = LocalFeatures(near.astype(np.float32), stored.descriptors[:14])
    assert agreeing_matches(twice, LocalFeatures(twice.points_px + np.float32(40.0), twice.descriptors)) == 7


@pytest.mark.data
def test_a_real_wall_from_other_sides(data: Path) -> None:
    """Graffiti, viewed at up to 40 degrees more: known homographies say where features should be."""
    import cv2

    folder = data / "sensing" / "oxford_graf"
    images = [cv2.imread(str(folder / f"img{k}.png"), cv2.IMREAD_GRAYSCALE) for k in (1, 2, 3)]
    first, *others = (find_features(image, max_features=600) for image in images)
    for other in others:
        assert agreeing_matches(first, other) > 30

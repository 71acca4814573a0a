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
    centres = train_vocabulary(data.astype(np.uint8), 9, rng, rounds=10)
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


@pytest.mark.data
def test_a_real_wall_from_other_sides(data: Path) -> None:
    """Graffiti, viewed at up to 40 degrees more: known homographies say where features should be."""
    import cv2

    folder = data / "sensing" / "oxford_graf"
    images = [cv2.imread(str(folder / f"img{k}.png"), cv2.IMREAD_GRAYSCALE) for k in (1, 2, 3)]
    first, *others = (find_features(image, max_features=600) for image in images)
    for other in others:
        assert agreeing_matches(first, other) > 30

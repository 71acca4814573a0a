"""Matches of a stored picture: how many agree, how distinct and how exact they are, each limit from both sides."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.recognition.haptic_classifier import _candidates
from visuohaptic.recognition.visual.visual_words import LocalFeatures, agreeing_matches

RNG = np.random.default_rng(5)
PLACES = RNG.uniform(20.0, 300.0, (12, 2))
KINDS = np.eye(128, dtype=np.uint8)[:12] * np.uint8(200)


def _features(points: np.ndarray, descriptors: np.ndarray) -> LocalFeatures:
    return LocalFeatures(points.astype(np.float32), descriptors)


@pytest.mark.parametrize(("count", "found"), [(5, 0), (6, 6), (9, 9)])
def test_six_matches_of_a_plane_are_one_more_than_chance_gives(count: int, found: int) -> None:
    """Four determine a homography; the picture has moved by 30 px."""
    stored = _features(PLACES[:count], KINDS[:count])
    assert agreeing_matches(stored, _features(PLACES[:count] + 30.0, KINDS[:count])) == found


@pytest.mark.parametrize(("ratio", "distinct"), [(0.77, True), (0.83, False)])
def test_a_match_is_ambiguous_when_another_is_nearly_as_near(ratio: float, distinct: bool) -> None:
    """Each stored feature has a twin in the new picture at 100 levels, and its match is at a fraction of that."""
    match, twin = KINDS.copy(), KINDS.copy()
    match[np.arange(12), 64 + np.arange(12)] = round(100 * ratio)
    twin[np.arange(12), 96 + np.arange(12)] = 100
    seen = _features(np.vstack([PLACES + 30.0, PLACES[::-1] + 5.0]), np.vstack([match, twin]))
    assert (agreeing_matches(_features(PLACES, KINDS), seen) == 12) == distinct


@pytest.mark.parametrize(("off_px", "agrees"), [(4.5, True), (5.8, False)])
def test_a_match_five_pixels_beside_the_plane_does_not_agree(off_px: float, agrees: bool) -> None:
    """One of twelve, in the middle of the others, is moved aside."""
    angle = np.linspace(0.0, 2.0 * np.pi, 12)[:11]
    places = np.vstack([160.0 + 120.0 * np.column_stack([np.cos(angle), np.sin(angle)]), [[150.0, 170.0]]])
    seen = places + 30.0
    seen[11, 0] += off_px
    assert (agreeing_matches(_features(places, KINDS), _features(seen, KINDS)) == 12) == agrees


@pytest.mark.parametrize(("count", "enough"), [(2, False), (3, True)])
def test_three_objects_of_a_class_have_a_covariance(count: int, enough: bool) -> None:
    """Two lie on a line, and one is left out in turn."""
    number = np.repeat([0, 1], [5, count])
    used: Any = SimpleNamespace(classes=("cup", "jar"), number=number)
    used.of_classes = lambda names, groups: used
    if enough:
        assert _candidates(used, {})[1] == count
        return
    with pytest.raises(InputError, match="expected at least 3"):
        _candidates(used, {})

"""What lies behind the edge: foam, something before it, or the object behind it."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.sensing.foam.strip import covered_points, front_grey, other_surface

K = 60
SEEN = np.ones(K, dtype=bool)
NOISE = np.full(K, 0.01)
REST = np.full(K, -80.0)


def test_grey_before_the_front() -> None:
    image = np.full((100, 60), 50, np.uint8)
    image[30:90] = 160  # foam from row 90 up to the front at row 30
    image[30:50] = 170
    x = np.arange(10.0, 51.0, 10.0)
    front, up = np.column_stack([x, np.full(5, 29.5)]), np.tile([0.0, -1.0], (5, 1))
    assert front_grey(image, front, up, np.full(5, 60.0)) == pytest.approx(170.0)
    assert np.isnan(front_grey(image, front, up, np.full(5, 12.0))).all(), "no foam is left"
    assert np.isnan(front_grey(image, front - [0.0, 60.0], up, np.full(5, 60.0))).all(), "outside"


def _near(rng, run=slice(20, 35), change=0.0) -> np.ndarray:
    near = 1.0 + 0.01 * rng.standard_normal(K)
    near[run] += change
    return near


def test_an_edge_of_the_object_behind_the_foam_is_told() -> None:
    rng, one = np.random.default_rng(1), np.ones(K)
    for flipped in (40.0, -30.0):  # the other way round, or much weaker
        contrast = REST.copy()
        contrast[20:35] = flipped
        found = other_surface(_near(rng, change=-0.04), one, contrast, REST, SEEN, NOISE)
        assert np.flatnonzero(found).tolist() == list(range(20, 35))


def test_an_object_brighter_than_foam_may_touch_it() -> None:
    rng, one = np.random.default_rng(2), np.ones(K)
    contrast = REST.copy()
    contrast[20:35] = 40.0
    alarms = [other_surface(_near(rng), one, contrast, REST, SEEN, NOISE).any() for _ in range(300)]
    # Four sigmas of the mean of fifteen points, with a sigma from 45 others.
    assert np.mean(alarms) < 0.01


def test_a_shadow_on_the_foam_is_no_other_surface() -> None:
    rng, one = np.random.default_rng(3), np.ones(K)
    assert not other_surface(_near(rng, change=-0.2), one, REST, REST, SEEN, NOISE).any()


def test_a_wide_object_leaves_no_foam_to_compare_with() -> None:
    rng, one = np.random.default_rng(4), np.ones(K)
    wide = other_surface(_near(rng, slice(0, K), 0.05), one, -REST, REST, SEEN, NOISE)
    assert wide.all()


def test_covered_points_differ_from_their_neighbours() -> None:
    s = 0.003 * np.arange(K)
    grey = np.full(K, 150.0) * (1.0 + 0.2 * s / s.max())  # light changes slowly
    grey[10:14] *= 0.7
    assert np.flatnonzero(covered_points(grey, np.full(K, 150.0), s)).tolist() == [10, 11, 12, 13]


def test_a_hand_of_nearly_the_foams_grey_is_told_by_its_neighbours() -> None:
    s, rng = 0.003 * np.arange(K), np.random.default_rng(6)
    zero = 150.0 + 3.0 * rng.standard_normal(K)
    plain = [covered_points(zero + 2.0 * rng.standard_normal(K), zero, s).any() for _ in range(300)]
    assert not np.any(plain), "six sigmas of a mean"
    hand = zero + 2.0 * rng.standard_normal(K)
    hand[20:32] *= 0.93
    found = np.flatnonzero(covered_points(hand, zero, s))
    assert set(range(21, 31)) <= set(found.tolist()) <= set(range(20, 32))

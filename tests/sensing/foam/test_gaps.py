"""What is put into gaps of the front, against the front that was there."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.sensing.foam.validity import bridged, plausible

K = 60
S = 0.003 * np.arange(K)
SIGMA = np.full(K, 1e-5)
#: A plate 4 cm wide, 9 mm deep, and foam that falls off beside it by 1 / e in 6 mm.
PLATE = 0.009 * np.exp(-np.maximum(np.abs(S - 0.09) - 0.02, 0.0) / 0.006)


def _without(*points: int) -> tuple[np.ndarray, ...]:
    seen = np.ones(K, dtype=bool)
    seen[list(points)] = False
    return bridged(S, np.where(seen, PLATE, np.nan), SIGMA, seen)


def test_a_gap_on_a_flank_is_bridged_by_what_free_foam_does() -> None:
    high, low = 38, 39
    assert PLATE[high - 1] < 0.009, "a point that is on the flank with both neighbours"
    value, _, doubt, gap = _without(low)
    assert not gap
    assert value[low] == pytest.approx(PLATE[low], rel=0.02)
    line = 0.5 * (PLATE[high] + PLATE[low + 1])
    assert abs(value[low] - PLATE[low]) < doubt[low] < 0.6 * (line - PLATE[low]) + 3e-5


def test_a_gap_at_the_edge_of_a_plate_may_be_anything_between() -> None:
    edge = int(np.searchsorted(S, 0.11)) + 1
    value, _, doubt, gap = _without(edge)
    assert not gap
    assert abs(value[edge] - PLATE[edge]) < doubt[edge]


def test_a_gap_under_the_plate_is_filled_straight() -> None:
    value, _, doubt, _ = _without(28, 29)
    np.testing.assert_allclose(value[28:30], 0.009, rtol=1e-6)
    assert doubt[28:30].max() < 5e-5


def test_a_long_gap_stays_open() -> None:
    value, sigma, doubt, gap = _without(10, 11, 12)
    assert gap
    assert np.isnan(value[10:13]).all()
    assert np.isnan(sigma[10:13]).all()
    assert not doubt[10:13].any()


def test_a_deflected_end_that_is_not_seen_may_hide_anything() -> None:
    plate, seen = np.full(K, 0.004), np.ones(K, dtype=bool)
    seen[-1] = False
    assert bridged(S, plate, SIGMA, seen)[3]
    assert bridged(S, plate, SIGMA, seen[::-1].copy())[3]
    assert not bridged(S, 0 * plate, SIGMA, seen)[3]


def test_a_doubtful_point_is_used_between_its_neighbours_only() -> None:
    good = np.ones(K, dtype=bool)
    good[[20, 40]] = False
    delta = PLATE.copy()
    delta[40] += 0.002
    assert np.flatnonzero(plausible(S, delta, SIGMA, good, ~good)).tolist() == [20]


#: An edge of 90 degrees that comes in by 15 mm at point 30, and a circle of 5 cm by 8 mm, in free foam.
EDGE = np.maximum(0.015 - np.abs(S - S[30]), 0.0)
CIRCLE = np.maximum(0.008 - 0.05 + np.sqrt(np.maximum(0.05**2 - (S - S[30]) ** 2, 0.0)), 0.0)


@pytest.mark.parametrize("front", [EDGE, CIRCLE])
@pytest.mark.parametrize("missing", [(30,), (30, 31), (29, 30)])
def test_a_tip_that_was_not_seen_is_not_cut_off(front: np.ndarray, missing: tuple[int, ...]) -> None:
    seen = np.ones(K, dtype=bool)
    seen[list(missing)] = False
    value, _, doubt, gap = bridged(S, np.where(seen, front, np.nan), SIGMA, seen)
    assert not gap
    at = list(missing)
    line = np.interp(S[at], S[seen], front[seen])
    assert (np.abs(value[at] - front[at]) <= doubt[at]).all()
    assert (np.abs(value[at] - front[at]) < 0.6 * np.abs(line - front[at]) + 2e-5).all(), "better than a line"


def test_a_doubtful_tip_is_used_where_its_flanks_lead_to() -> None:
    good = np.ones(K, dtype=bool)
    good[[29, 30]] = False
    higher = EDGE.copy()
    higher[30] += 0.003
    assert plausible(S, EDGE, SIGMA, good, ~good)[29:31].all()
    assert plausible(S, higher, SIGMA, good, ~good)[29:31].tolist() == [True, False]

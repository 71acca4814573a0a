"""What foam, robot and lens cannot do is found; what they can do is not."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.sensing.foam.validity import (
    FocusWatch,
    OnsetWatch,
    rest_offset,
    roughness,
    thicker_than_at_rest,
)

K = 60
SIGMA = np.full(K, 2e-5)
SEEN = np.ones(K, dtype=bool)


def _dent(depth_m: float) -> np.ndarray:
    """A cylinder of 2 cm radius, points 3 mm apart."""
    y = 0.003 * (np.arange(K) - K / 2)
    return np.maximum(depth_m - 0.02 + np.sqrt(np.maximum(4e-4 - y**2, 0.0)), 0.0)


def test_a_push_is_followed_and_a_hand_is_not() -> None:
    watch = OnsetWatch(K, 0.1)
    for i in range(10):  # 0.8 mm per frame is 0.024 m/s
        assert not watch.check(i / 30, _dent(8e-4 * i), SIGMA, SEEN).any()
    hand = _dent(7.2e-3).copy()
    hand[5:15] = 0.010  # 0.3 m/s
    for i in range(10, 16):
        suspect = watch.check(i / 30, hand, SIGMA, SEEN)
        assert suspect[6:14].all()
        assert not suspect[20:].any()
    assert not watch.check(16 / 30, _dent(7.2e-3), SIGMA, SEEN).any(), "the hand has gone"


def test_release_may_be_sudden() -> None:
    watch = OnsetWatch(K, 0.1)
    for i in range(10):
        watch.check(i / 30, _dent(8e-4 * i), SIGMA, SEEN)
    assert not watch.check(10 / 30, np.zeros(K), SIGMA, SEEN).any()


def test_a_pause_leaves_time_for_a_deep_push() -> None:
    watch = OnsetWatch(K, 0.1)
    watch.check(0.0, np.zeros(K), SIGMA, SEEN)
    assert not watch.check(0.2, _dent(0.01), SIGMA, SEEN).any()


def test_scatter_is_measured_beside_a_contact() -> None:
    rng = np.random.default_rng(3)
    values = [roughness(_dent(0.008) + SIGMA * rng.standard_normal(K), SIGMA, SEEN) for _ in range(200)]
    # Of 56 fourth differences the dent's two kinks change ten; a median of 56 scatters by 17 %.
    assert np.mean(values) == pytest.approx(1.0, abs=0.35)
    rough = [roughness(_dent(0.008) + 5 * SIGMA * rng.standard_normal(K), SIGMA, SEEN) for _ in range(50)]
    assert np.mean(rough) == pytest.approx(5.0, rel=0.2)


def test_rest_offset_is_zero_with_a_contact_and_finds_a_shift() -> None:
    rng = np.random.default_rng(4)
    noise = SIGMA * rng.standard_normal(K)
    assert abs(rest_offset(_dent(0.008) + noise, SIGMA, SEEN)) < 2e-5
    assert rest_offset(_dent(0.008) + 3e-4 + noise, SIGMA, SEEN) == pytest.approx(3e-4, abs=2e-5)
    assert rest_offset(_dent(0.008) - 3e-4 + noise, SIGMA, SEEN) == pytest.approx(-3e-4, abs=2e-5)


def test_foam_is_never_thicker_than_at_rest() -> None:
    delta = np.zeros(K)
    delta[7] = -0.001
    assert np.flatnonzero(thicker_than_at_rest(delta, SIGMA, 0.02)).tolist() == [7]


def test_focus_that_changes_is_told_until_it_rests() -> None:
    watch = FocusWatch()
    assert [watch.changing(b) for b in (1.0, 1.02, 1.5, 1.9, 1.95, float("nan"), 1.97)] == [
        False, False, True, True, False, False, False,
    ]  # fmt: skip

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.core import BaseState, Motion, Reason
from visuohaptic.sensing.scene import EgoMotionFilter, Obstacle, ObstacleMemory, ObstacleMemorySettings

STEP_m = 0.002


def seen(proximity_m, *, at_border=False, valid=True):
    mask = np.zeros((4, 4), np.uint8)
    reason = Reason.OK if valid else Reason.DRIFTED
    return Obstacle(mask, 2, valid, reason, proximity_m, 0.0005, 0.01, at_border)


def moved(ahead_m, turn_rad=0.0):
    return Motion(0.0, True, Reason.OK, np.array([ahead_m, 0.0]), turn_rad, np.eye(3) * 1e-8)


FREE = seen(math.inf)


def approach(readings, memory=None, step_m=STEP_m, turn_rad=0.0):
    memory = memory or ObstacleMemory(blind_m=0.07)
    return [memory.update(reading, moved(step_m, turn_rad)) for reading in readings]


def test_what_is_seen_is_passed_on_untouched():
    readings = [seen(0.14 - STEP_m * i) for i in range(30)]
    assert approach(readings) == readings


def test_an_obstacle_that_leaves_the_strip_comes_nearer_by_the_way_driven():
    readings = [seen(0.08 - STEP_m * i) for i in range(5)] + [FREE] * 30
    told = approach(readings)
    np.testing.assert_allclose([o.proximity_m for o in told[:35]], 0.08 - STEP_m * np.arange(35), atol=1e-12)
    assert told[-1].remembered
    assert told[-1].at_border
    assert told[-1].proximity_sigma_m > told[4].proximity_sigma_m


def test_its_far_parts_do_not_push_it_back():
    told = approach([seen(0.08), seen(0.07, at_border=True), *[seen(0.118)] * 10])
    np.testing.assert_allclose(told[-1].proximity_m, 0.07 - 10 * STEP_m, atol=1e-12)


def test_at_the_border_it_may_be_nearer_than_it_looks():
    told = approach([seen(0.072), *[seen(0.071, at_border=True)] * 20])
    np.testing.assert_allclose(told[-1].proximity_m, 0.072 - 20 * STEP_m, atol=1e-12)


def test_what_is_not_where_it_should_be_in_view_is_forgotten():
    settings = ObstacleMemorySettings(forget_frames=8)
    told = approach([seen(0.20), *[FREE] * 9], ObstacleMemory(0.07, settings))
    assert math.isfinite(told[8].proximity_m)
    assert math.isinf(told[9].proximity_m)
    behind = approach([seen(0.20), *[seen(0.40)] * 9], ObstacleMemory(0.07, settings))
    assert behind[-1].proximity_m == pytest.approx(0.40)


def test_what_was_not_touched_was_not_there():
    told = approach([seen(0.02, at_border=True), *[FREE] * 40])
    assert told[15].proximity_m == 0.0
    assert math.isinf(told[-1].proximity_m)


def test_a_turn_leaves_it_aside():
    told = approach([seen(0.10), *[FREE] * 10], step_m=0.0, turn_rad=0.05)
    assert math.isinf(told[-1].proximity_m)


def test_a_touch_is_at_zero_and_backing_off_counts_from_there():
    memory = ObstacleMemory(0.07)
    memory.update(seen(0.05), moved(STEP_m))
    touched = memory.update(FREE, moved(STEP_m), in_contact=True)
    assert (touched.proximity_m, touched.remembered) == (0.0, True)
    back = [memory.update(FREE, moved(-STEP_m)) for _ in range(10)]
    np.testing.assert_allclose(back[-1].proximity_m, 10 * STEP_m, atol=1e-12)


@pytest.mark.parametrize("brakes", [False, True])
def test_an_obstacle_comes_nearer_while_no_source_measures_the_motion(brakes):
    """0.1 m/s, half a second without floor and odometry at 30 Hz: the true distance stays within three declared deviations.

    The platform goes on, or brakes at the 1 m/s2 that the filter of its motion declares as one deviation.
    """
    ego, memory, dt = EgoMotionFilter(), ObstacleMemory(0.07), 1 / 30
    near = ahead = 0.12
    told, x, speed = FREE, 0.0, 0.1
    for k in range(1, 40):
        unread = k >= 25
        speed = max(speed - dt, 0.0) if brakes and unread else speed
        x += speed * dt * (k > 1)
        ahead = near - x
        state = None if unread else BaseState(k * dt, x, 0.0, 0.0, speed, 0.0)
        motion = ego.update(k * dt, odometry=state)
        assert motion.valid == (1 < k < 25)
        told = memory.update(seen(ahead) if k < 15 else FREE, motion)
    assert told.remembered
    assert told.proximity_m < near - 0.1 * 22 * dt  # nearer than where it was last known
    assert abs(told.proximity_m - ahead) < 3.0 * told.proximity_sigma_m
    assert 0.01 < told.proximity_sigma_m < 0.5 * 1.0 * (15 * dt) ** 2  # the way of 1 m/s2 all the time
    again = memory.update(FREE, ego.update(39 * dt))  # no time has passed
    assert (again.proximity_m, again.proximity_sigma_m) == (told.proximity_m, told.proximity_sigma_m)


@pytest.mark.parametrize("reading", [seen(math.nan, valid=False), seen(0.3, valid=False)])
def test_a_reading_that_is_not_valid_stays_so(reading):
    told = approach([seen(0.08), reading])
    assert not told[-1].valid
    assert told[-1] is reading

"""Drift of odometry is corrected by straight walls, for contacts with known true positions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.core import Primitive, PrimitiveKind
from visuohaptic.navigation.mapping import HapticContact
from visuohaptic.tasks.mobile.touch_map._straight_walls import WallDriftCorrection, correct_by_walls

SQUARE = math.radians(4.0)


def wall_contact(pose: tuple[float, float, float], tilt_rad: float = 0.0) -> HapticContact:
    """A line square to the way, but for a tilt, at the origin of frame F."""
    y = np.linspace(-0.15, 0.15, 31)
    points = np.column_stack([-math.tan(tilt_rad) * y, y])
    line = Primitive(PrimitiveKind.LINE, np.array([0.0, 0.0, 0.5 * math.pi + tilt_rad]), np.eye(3), 1.0)
    return HapticContact(line, points, pose)


def around(
    turn_rad: float, bias: float
) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """True and told poses: three contacts on each of four walls and the first wall again, heading drifting."""
    corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
    true = []
    for side in (0, 1, 2, 3, 0):
        (x0, y0), (x1, y1) = corners[side], corners[(side + 1) % 4]
        for fraction in (0.2, 0.5, 0.8):
            x, y = x0 + fraction * (x1 - x0), y0 + fraction * (y1 - y0)
            c, s = math.cos(turn_rad), math.sin(turn_rad)
            true.append((c * x - s * y, s * x + c * y, turn_rad + (side - 1) * 0.5 * math.pi))
    told = [true[0]]
    for number in range(1, len(true)):
        (ax, ay, _), (bx, by, heading) = true[number - 1], true[number]
        c, s = math.cos(bias * (number - 0.5)), math.sin(bias * (number - 0.5))
        dx, dy = bx - ax, by - ay
        told.append((told[-1][0] + c * dx - s * dy, told[-1][1] + s * dx + c * dy, heading + bias * number))
    return list(zip(true, told, strict=True))


@pytest.mark.parametrize("turn_rad", [0.0, 0.4])
def test_a_drifting_heading_is_held_by_the_walls(turn_rad: float) -> None:
    walls, worst, odometry = WallDriftCorrection(SQUARE), 0.0, 0.0
    for true, told in around(turn_rad, math.radians(0.25)):
        x, y, heading = walls.corrected(wall_contact(told)).T_map_foam
        worst = max(worst, math.dist((x, y), true[:2]))
        odometry = max(odometry, math.dist(told[:2], true[:2]))
        assert math.remainder(heading - true[2], 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    # The drift is even on every way here, so half before and half after is exact.
    assert odometry > 0.05
    assert worst < 1e-6


def test_a_wall_touched_again_is_where_it_was() -> None:
    walls = WallDriftCorrection(SQUARE)
    walls.corrected(wall_contact((1.0, 0.0, 0.0)))
    again = walls.corrected(wall_contact((1.05, 0.3, 0.0)))
    assert again.T_map_foam == pytest.approx((1.0, 0.3, 0.0))
    behind = walls.corrected(wall_contact((1.3, 0.3, 0.0)))
    assert behind.T_map_foam[0] == pytest.approx(1.25)  # another wall, moved with the robot only


def test_a_wall_at_an_angle_of_its_own_turns_nothing() -> None:
    walls = WallDriftCorrection(SQUARE)
    walls.corrected(wall_contact((1.0, 0.0, 0.0)))
    slanted = walls.corrected(wall_contact((1.0, 1.0, 0.0), tilt_rad=math.radians(20.0)))
    assert slanted.T_map_foam == pytest.approx((1.0, 1.0, 0.0))


def test_what_gives_way_or_is_small_moves_nothing() -> None:
    walls = WallDriftCorrection(SQUARE)
    walls.corrected(wall_contact((1.0, 0.0, 0.0)))
    one = wall_contact((1.05, 0.3, 0.02))
    moved = HapticContact(one.primitive, one.points_foam_m, one.T_map_foam, 1.0, True)
    small = HapticContact(one.primitive, one.points_foam_m[14:17], one.T_map_foam)
    for contact in (moved, small):
        assert WallDriftCorrection(SQUARE).corrected(contact).T_map_foam == contact.T_map_foam
        assert walls.corrected(contact).T_map_foam == pytest.approx(contact.T_map_foam)


def test_between_two_walls_the_drift_is_shared_by_time() -> None:
    """The heading drifts evenly; what is too small to tell a direction is met half way."""
    bias = math.radians(2.0)
    first, last = (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)
    c, s = math.cos(0.25 * bias), math.sin(0.25 * bias)
    at = (-s, c, 0.5 * bias)  # 1 m on, by a heading that is wrong by a quarter on the way there
    c, s = math.cos(0.75 * bias), math.sin(0.75 * bias)
    end = (at[0] - s, at[1] + c, bias)
    small = wall_contact(at)
    small = HapticContact(small.primitive, small.points_foam_m[14:17], small.T_map_foam)
    told = [wall_contact(first), small, wall_contact(end)]
    placed = correct_by_walls(told, (0.0, 5.0, 10.0), SQUARE)
    assert placed[1].T_map_foam == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)
    assert placed[2].T_map_foam == pytest.approx(last, abs=1e-9)
    # One after the other, nobody knows yet.
    walls = WallDriftCorrection(SQUARE)
    assert abs([walls.corrected(contact).T_map_foam[0] for contact in told][1]) > 0.005
    assert correct_by_walls([small], (0.0,), SQUARE)[0].T_map_foam == pytest.approx(at)

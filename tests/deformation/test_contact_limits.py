"""When two walls touch: distance, rest of a narrow gap, and direction, each from both sides."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.deformation.nonlinear.self_contact import SelfContactGuard


def _touches(gap: float, rest: float, wall: float, degrees: float = 180.0) -> bool:
    """A corner of a triangle above the middle of another one, which looks at it at an angle."""
    guard = object.__new__(SelfContactGuard)
    low = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.5, 0.0]]) * 0.1
    turn = np.radians(degrees)
    high = np.array([[0.0, 0.0, 0.0], [np.cos(turn), 0.0, -np.sin(turn)], [0.0, 1.0, 0.0]]) * 0.1
    guard.faces = np.array([[0, 1, 2], [3, 4, 5]])
    guard.wall_m = np.array([wall, wall])
    guard.rest_m = np.concatenate([low, high + np.array([0.0, 0.0, rest])])
    points = np.concatenate([low, high + np.array([0.0, 0.0, gap])])
    return bool(guard._facing(points, np.array([3]), np.array([0]), np.array([gap]))[0])


@pytest.mark.parametrize(("gap", "touches"), [(0.9e-3, True), (1.1e-3, False)])
def test_thick_walls_touch_at_a_millimetre(gap: float, touches: bool) -> None:
    assert _touches(gap, 0.05, 2e-3) == touches


@pytest.mark.parametrize(("gap", "touches"), [(0.46e-3, True), (0.54e-3, False)])
def test_a_narrow_gap_is_closed_when_a_quarter_of_it_is_left(gap: float, touches: bool) -> None:
    assert _touches(gap, 2e-3, 2e-3) == touches


@pytest.mark.parametrize(("cosine", "touches"), [(-0.23, True), (-0.17, False)])
def test_walls_face_each_other_beyond_a_right_angle(cosine: float, touches: bool) -> None:
    assert _touches(0.5e-3, 0.05, 2e-3, float(np.degrees(np.arccos(cosine)))) == touches

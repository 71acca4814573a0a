"""Eq. (3.12) in plain Python, the shape of each primitive, and a room mapped by 22 contacts."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import _haptic_room
from visuohaptic.core import InputError, Primitive, PrimitiveKind
from visuohaptic.navigation.mapping import HapticContact, HapticMap, primitive_occupancy

STRIP = np.column_stack([np.zeros(11), np.linspace(-0.1, 0.1, 11)])


def primitive(kind: PrimitiveKind, *parameters: float) -> Primitive:
    return Primitive(kind, np.array(parameters), np.eye(len(parameters)), 1.0)


WALL = primitive(PrimitiveKind.LINE, 0.0, 0.0, np.pi / 2)


@pytest.mark.parametrize(
    ("shape", "inside", "outside", "silent"),
    [
        (WALL, [(0.1, 0.0), (3.0, 5.0)], [(-0.1, 0.0), (-2.0, 3.0)], []),
        (primitive(PrimitiveKind.LINE, 0.0, 0.0, -np.pi / 2), [(0.1, 0.0)], [(-0.1, 0.0)], []),
        (
            primitive(PrimitiveKind.CIRCLE, 0.2, 0.0, 0.2),
            [(0.2, 0.0), (0.35, 0.1)],
            [(-0.1, 0.0), (0.5, 0)],
            [],
        ),
        (
            primitive(PrimitiveKind.SEGMENT, 0.0, -0.1, 0.0, 0.1),
            [(0.05, 0.0), (0.19, 0.09)],
            [(-0.05, 0.0), (0.05, 0.2)],
            [(0.4, 0.0)],
        ),
        # The edge of a box that points at the robot.
        (
            primitive(PrimitiveKind.CORNER, 0.0, 0.0, np.pi / 4, -np.pi / 4),
            [(0.1, 0.0), (0.2, 0.15)],
            [(-0.1, 0.0), (0.1, 0.2)],
            [],
        ),
        # The corner of a room, from inside: edges run back on both sides.
        (
            primitive(PrimitiveKind.CORNER, 0.0, 0.0, 3 * np.pi / 4, -3 * np.pi / 4),
            [(0.1, 0.0), (-0.1, 0.2)],
            [(-0.2, 0.0)],
            [],
        ),
    ],
)
def test_what_a_primitive_stands_for(
    shape: Primitive,
    inside: list[tuple[float, float]],
    outside: list[tuple[float, float]],
    silent: list[tuple[float, float]],
) -> None:
    assert (primitive_occupancy(shape, np.array(inside)) == 1).all()
    assert (primitive_occupancy(shape, np.array(outside)) == -1).all()
    assert all(primitive_occupancy(shape, np.array(silent).reshape(-1, 2)) == 0)


@pytest.mark.parametrize("place_m", [0.0, 0.05, 20.0])
@pytest.mark.parametrize("turn_rad", [0.0, 1.0, 4.0])
def test_the_diameter_is_that_of_the_circle_on_which_points_lie(place_m: float, turn_rad: float) -> None:
    """Wherever the contact is: three points, 120 degrees apart, on a circle of 8 mm, and one inside."""
    angles = turn_rad + np.array([0.0, 2.0, 4.0]) * np.pi / 3
    points_m = np.vstack([0.004 * np.column_stack([np.cos(angles), np.sin(angles)]), [0.001, 0.0]]) + place_m
    contact = HapticContact(WALL, points_m, (0.0, 0.0, 0.0))
    assert contact.diameter_m == pytest.approx(0.008, abs=3e-7)  # OpenCV's .1 um at both ends


def test_a_limited_depth() -> None:
    values = primitive_occupancy(WALL, np.array([[-0.1, 0], [0.1, 0], [0.5, 0]]), depth_m=0.3)
    assert values.tolist() == [-1, 1, 0]


def test_the_update_as_printed() -> None:
    haptic = HapticMap.empty((-1.0, -1.0), (2.0, 2.0), 0.05)
    haptic.static[:] = np.random.default_rng(0).uniform(-1, 1, haptic.static.shape)
    before = haptic.static.copy()
    pose = (0.2, -0.1, 0.6)
    haptic.add(HapticContact(WALL, STRIP, pose, confidence=0.8))
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for row, column in np.ndindex(before.shape):
        x, y = -1 + 0.05 * (column + 0.5) - pose[0], -1 + 0.05 * (row + 0.5) - pose[1]
        place = np.array([c * x + s * y, -s * x + c * y])
        m_d = np.exp(-np.hypot(*(STRIP - place).T).min() / 0.2)  # D: the strip's contact is 0.2 m long
        trust = 0.5 * 0.8 * m_d if m_d > 0.0101 else 0.0
        if 0.0099 < m_d < 0.0101:
            continue  # on the border of what is updated at all
        m_o = 1.0 if place[0] >= 0 else -1.0
        # The smallest circle is found in float32.
        assert haptic.static[row, column] == pytest.approx(
            (1 - trust) * before[row, column] + trust * m_o, abs=1e-4
        )


def test_repeated_contacts_converge_and_are_bounded() -> None:
    haptic = HapticMap.empty((-1.0, -1.0), (2.0, 2.0))
    for _ in range(40):
        haptic.add(HapticContact(WALL, STRIP, (0.0, 0.0, 0.0)))
    assert haptic.contacts == 40
    assert np.abs(haptic.static).max() <= 1.0
    np.testing.assert_allclose(haptic.value_at(np.array([[0.02, 0.0], [-0.02, 0.0]])), [1, -1], atol=0.01)
    assert haptic.value_at(np.array([[9.0, 9.0]])).tolist() == [0.0]


def test_movable_things_have_their_own_layer() -> None:
    haptic = HapticMap.empty((-1.0, -1.0), (2.0, 2.0))
    bin_ = primitive(PrimitiveKind.CIRCLE, 0.15, 0.0, 0.15)
    tip = np.array([[0.0, 0.0], [0.01, 0.05], [0.01, -0.05]])
    haptic.add(HapticContact(bin_, tip, (0.0, 0.0, 0.0), movable=True))
    middle, front = np.array([[0.05, 0.0]]), np.array([[-0.1, 0.0]])
    column, row = ((middle[0] + 1.0) / haptic.resolution_m).astype(int)
    assert haptic.movable[row, column] > 0.2
    assert haptic.value_at(middle)[0] == 0.0, "a bin is no wall"
    assert haptic.value_at(front)[0] < 0.0, "in front of it there is room"
    assert haptic.occupancy().value_at(middle)[0] == 100


def test_a_contact_outside_the_map_changes_nothing() -> None:
    haptic = HapticMap.empty((0.0, 0.0), (1.0, 1.0))
    haptic.add(HapticContact(WALL, STRIP, (50.0, 50.0, 0.0)))
    assert not haptic.static.any()


def test_bad_input() -> None:
    with pytest.raises(InputError, match="points_foam_m"):
        HapticContact(WALL, np.zeros((0, 2)), (0, 0, 0))
    with pytest.raises(InputError, match="confidence"):
        HapticContact(WALL, STRIP, (0, 0, 0), confidence=1.5)
    with pytest.raises(InputError, match="expected at most"):
        HapticMap.empty((0, 0), (1e4, 1e4), 0.01)
    with pytest.raises(InputError, match="0 < rate"):
        HapticMap.empty((0, 0), (1, 1), rate=0.0)


def test_a_room_by_22_contacts() -> None:
    fractions = [_haptic_room.iou(*_haptic_room.explore(np.random.default_rng(seed))) for seed in range(5)]
    assert min(fractions) > 0.6
    assert np.median(fractions) > 0.75

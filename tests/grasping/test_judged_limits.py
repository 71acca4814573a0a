"""Room of the gripper, and grasps that are the same one rotated: limits from both sides."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.grasping import GripperModel, scene_points
from visuohaptic.grasping.approach import ApproachSpace, _is_free
from visuohaptic.grasping.planner import _turned


@pytest.mark.parametrize(
    ("place", "free"),
    [
        ((0.046, 0.0, -0.155), False), ((0.046, 0.0, -0.170), True),
        ((0.046, 0.0118, 0.0), False), ((0.046, 0.0122, 0.0), True),
    ],
)  # fmt: skip
def test_fingers_come_straight_over_ten_centimetres_with_two_millimetres_of_room(
    place: tuple, free: bool
) -> None:
    """A finger of radius 1 cm and length 6 cm, 4 to 5.2 cm from the middle; behind its end the way begins."""
    pose = np.eye(4)
    pose[2, 3] = 1.0
    space = ApproachSpace(np.array([place]) + pose[:3, 3], 0.0)
    gripper = GripperModel(palm_thickness_m=0.002)
    assert _is_free(space, pose, 0.08, gripper) == free


def _grasp(height_m: float = 0.1, width_m: float = 0.06, deformation_m: float = 1e-3) -> Any:
    return SimpleNamespace(
        first_m=np.array([0.0, 0.0, height_m]), width_m=width_m, deformation_m=deformation_m, force_N=10.0
    )


@pytest.mark.parametrize(
    ("other", "same"),
    [
        ({"height_m": 0.119}, True), ({"height_m": 0.121}, False), ({"width_m": 0.06 * 1.046}, True),
        ({"width_m": 0.06 * 1.056}, False), ({"deformation_m": 1.18e-3}, True), ({"deformation_m": 1.22e-3}, False),
    ],
)  # fmt: skip
def test_a_rotated_grasp_has_the_same_height_width_and_stiffness(other: dict[str, float], same: bool) -> None:
    """Within two neighbourhoods of a finger's breadth, 5 % and 20 %."""
    task: Any = SimpleNamespace(parameters=SimpleNamespace(neighbourhood_m=0.01))
    assert _turned(_grasp(), _grasp(**other), task) == same


def _triangle(side_m: float, count: int = 1) -> tuple[np.ndarray, np.ndarray]:
    corners = side_m * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, np.sqrt(0.75), 0.0]])
    return corners, np.repeat([[0, 1, 2]], count, axis=0)


@pytest.mark.parametrize(("side_m", "points"), [(0.0048, 3), (0.0052, 6)])
def test_triangles_above_five_millimetres_are_divided(side_m: float, points: int) -> None:
    """Into four, whose corners are those of the triangle and the middles of its sides."""
    found = scene_points(*_triangle(side_m), np.eye(4), np.zeros((2, 3)))
    assert len(np.unique(found.round(9), axis=0)) == points


def test_no_place_of_a_surface_is_farther_from_its_points_than_its_step() -> None:
    corners, faces = _triangle(0.3)
    found = scene_points(corners, faces, np.eye(4), np.zeros((2, 3)))
    places = np.random.default_rng(0).dirichlet(np.ones(3), 500) @ corners
    distance = np.sqrt(((places[:, None] - found) ** 2).sum(axis=2).min(axis=1))
    assert distance.max() <= 0.005 / np.sqrt(3.0)  # circumscribed circle of a triangle of 5 mm


def test_a_scene_that_would_exhaust_the_memory_is_refused() -> None:
    """A surface a thousand times, and a needle, whose divisions all cross the surroundings."""
    with pytest.raises(InputError, match="mug scene: its triangles are"):
        scene_points(*_triangle(3.0, 1000), np.eye(4), np.zeros((2, 3)), "mug scene")
    needle = np.array([[-1e12, 0.0, 0.0], [1e12, 0.0, 0.0], [0.0, 1e-9, 0.0]])
    with pytest.raises(InputError, match="expected at most 2000000"):
        scene_points(needle, np.array([[0, 1, 2]]), np.eye(4), np.zeros((2, 3)))

"""Room of the gripper, and grasps that are the same one rotated: limits from both sides."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.grasping import GripperModel
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

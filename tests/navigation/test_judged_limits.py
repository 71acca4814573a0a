"""Limits and expectations of maps, passages and plans, by geometry and by the distributions that they stand for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.core import Estimate, HapticTag, LaserScan
from visuohaptic.core.objects import Primitive, PrimitiveKind
from visuohaptic.io import OccupancyMap
from visuohaptic.navigation.mapping.map_changes import new_objects, scan_fit
from visuohaptic.navigation.mapping.mapper import OccupancyMapper
from visuohaptic.navigation.problem.passages import Passage, PassageKind, is_door_wing
from visuohaptic.navigation.problem.path_plan import Plan
from visuohaptic.navigation.problem.robot_model import RobotModel
from visuohaptic.navigation.pushing.push_model import PushModel


def _passage(kind: PassageKind, width_m: float = 0.9) -> Passage:
    return Passage("door", np.array([[0.0, 0.0], [width_m, 0.0], [width_m, 0.05], [0.0, 0.05]]), kind)


def test_an_elevator_comes_at_random_once_a_minute_and_is_waited_for_five() -> None:
    """Mean of the smaller of an exponential time and the limit, and the probability to reach the limit, by integration."""
    wait_s = np.linspace(0.0, 300.0, 200_001)
    later = np.exp(-wait_s / 60.0)
    cost = _passage(PassageKind.ELEVATOR).cost(RobotModel(0.17))
    assert cost.total_s == pytest.approx(float(np.trapezoid(later, wait_s)), rel=1e-6)
    assert cost.failure_probability == pytest.approx(float(later[-1]), rel=1e-6)
    assert cost.sigma_s == pytest.approx(60.0)


def test_a_sliding_door_is_triggered_until_it_opens() -> None:
    """It takes 4 +- 2 s; one trigger in twenty does nothing: a geometric series."""
    cost = _passage(PassageKind.DOOR_SLIDING).cost(RobotModel(0.17))
    assert cost.total_s == pytest.approx(sum(4.0 * 0.05**k for k in range(20)))
    assert cost.sigma_s == pytest.approx(2.0)


def test_a_wing_is_pushed_until_a_tenth_more_than_the_robot_is_free() -> None:
    """The angle by bisection of the width that the wing leaves, and the arc of its middle at pushing speed."""
    robot = RobotModel(0.17)
    assert math.isinf(_passage(PassageKind.DOOR_PUSH, 0.34 * 1.09).cost(robot).total_s)
    assert math.isfinite(_passage(PassageKind.DOOR_PUSH, 0.34 * 1.11).cost(robot).total_s)
    angle, (low, high) = 0.0, (0.0, 0.5 * math.pi)
    for _ in range(60):
        angle = 0.5 * (low + high)
        low, high = (angle, high) if 0.9 * (1.0 - math.cos(angle)) < 1.1 * 0.34 else (low, angle)
    cost = _passage(PassageKind.DOOR_PUSH).cost(robot)
    push_s = 0.45 * angle / robot.v_push_m_s
    assert cost.total_s * (1.0 - cost.failure_probability) == pytest.approx(robot.setup_time_s + push_s)
    assert cost.sigma_s == pytest.approx(push_s * 0.35)


@pytest.mark.parametrize(
    ("rad_per_m", "sigma", "wing"),
    [(0.75, 0.1, True), (0.65, 0.1, False), (2.0, 0.66, True), (2.0, 0.74, False)],
)
def test_a_wing_turns_by_at_least_a_radian_in_a_metre_and_a_half_and_evenly(
    rad_per_m: float, sigma: float, wing: bool
) -> None:
    """A wing of 1.4 m that is pushed at its edge turns by 0.7 rad per metre; its rotation varies by a third."""
    line = Primitive(PrimitiveKind.LINE, np.array([0.1, 0.0, 1.5]), 1e-6 * np.eye(3), 0.9)
    assert is_door_wing(HapticTag(rotation_rad_per_m=Estimate(rad_per_m, sigma), primitive=line)) == wing


def test_a_plan_is_optimal_within_the_half_per_cent_that_is_displayed() -> None:
    for gap, said in ((0.0045, "optimal"), (0.0055, "within 1 %")):
        assert Plan(True, gap=gap).answer == said


@pytest.mark.parametrize("corners", range(9, 16))
def test_a_polygon_within_two_per_cent_of_a_circle_is_a_disc(corners: int) -> None:
    """Edges and corners of a regular polygon deviate from the circle between them by half of the sagitta."""
    angle = 2.0 * math.pi * np.arange(corners) / corners
    off = 0.5 * (1.0 - math.cos(math.pi / corners))
    model = PushModel.of_footprint(0.2 * np.column_stack([np.cos(angle), np.sin(angle)]))
    assert (model.round_m > 0.0) == (off < 0.02)


def _room() -> OccupancyMap:
    """Free cells of 1 cm beside a wall at x = 0."""
    cells = np.zeros((200, 200), np.int8)
    cells[:, 0] = 100
    return OccupancyMap(cells, 0.01, (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("x_m", "count", "step_m", "objects"),
    [
        (0.115, 9, 0.01, 1),
        (0.095, 9, 0.01, 0),
        (0.5, 8, 0.01, 1),
        (0.5, 7, 0.01, 0),
        (0.5, 16, 0.055, 1),
        (0.5, 16, 0.09, 0),
    ],
)
def test_new_objects_are_ten_centimetres_from_the_walls_and_have_eight_points(
    x_m: float, count: int, step_m: float, objects: int
) -> None:
    """Points of one object are nearer than three cells of 2 cm."""
    points = np.column_stack([np.full(count, x_m), 0.2 + step_m * np.arange(count)])
    assert len(new_objects(_room(), points)) == objects


def test_a_beam_fits_a_map_within_15_cm_of_an_obstacle() -> None:
    points = np.column_stack([np.array([0.135, 0.145, 0.165, 0.175]), np.full(4, 1.0)])
    assert scan_fit(_room(), points) == pytest.approx(0.5)


def test_two_groups_of_four_points_are_one_object_within_four_cells_of_2_cm() -> None:
    """Cells are linked that have at most two cells between them."""
    for gap_m, objects in ((0.061, 1), (0.081, 0)):
        along = 0.2 + np.concatenate([0.01 * np.arange(4.0), 0.03 + gap_m + 0.01 * np.arange(4.0)])
        assert len(new_objects(_room(), np.column_stack([np.full(8, 0.5), along]))) == objects


def test_a_cell_is_free_when_two_beams_have_passed_it() -> None:
    """Bayes' rule: the odds of a beam that passes, 0.4 to 0.6, once and twice."""
    mapper = OccupancyMapper()
    mapper.add(LaserScan(0.0, np.full(360, 2.0), -np.pi, np.pi / 180), (0.0, 0.0, 0.0))
    once = math.log(0.4 / 0.6)
    grid = mapper._grid
    grid.log_odds[:] = 0.0
    row, column = grid.log_odds.shape[0] // 2, grid.log_odds.shape[1] // 2
    grid.log_odds[row, column : column + 2] = once, 2.0 * once
    cells = mapper.map().cells
    assert cells.tolist() == [[-1, 0]]

"""Simulated drives against a box: where they start, how far they go, and what is in their way, against shapes of shapely."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from visuohaptic.core import HapticTag
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import off_centre_rollouts as drives
from visuohaptic.navigation.planning.off_centre_push import _missed
from visuohaptic.navigation.planning.search import _travel_kernels, build_search_domain
from visuohaptic.navigation.planning.search._travel_kernels import UNITS
from visuohaptic.navigation.planning.search.push_ends import TRACKING_M, end_errors
from visuohaptic.navigation.planning.search.push_states import Deadline
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel
from visuohaptic.navigation.pushing.quasi_static import STEP_M

CELL_M, RADIUS_M = 0.05, 0.17
ROBOT = RobotModel(RADIUS_M)
#: 0.4 m by 0.3 m, in metres about its centre.
BOX = np.array([[-0.2, -0.15], [0.2, -0.15], [0.2, 0.15], [-0.2, 0.15]])
PLACE = np.array([3.0, 2.0])
START = np.array([1.2, 2.0])


@pytest.fixture(scope="module")
def domain():
    """A hall of 6 m by 4 m, the box in its middle."""
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    thing = MovableObject("box", BOX + PLACE, HapticTag(explored=3))
    return build_search_domain(
        PlanningProblem(OccupancyMap(cells, CELL_M), ROBOT, START, np.array([4.8, 2.0]), (thing,))
    )


def box_at(pose):
    """The box after a motion, metres about its first centre."""
    return affinity.translate(
        affinity.rotate(shapely.Polygon(BOX), pose[2], (0, 0), use_radians=True), *pose[:2]
    )


def approaches(domain, scene):
    clearance = domain.clearance_with(np.zeros((1, 2)))
    cells, costs = domain.seeds(clearance, domain.start, reach=2, block=1)
    none = np.zeros(0, np.int32)
    cost = _travel_kernels.travel_field(
        clearance, domain.radius, domain.slow, cells, costs, np.zeros((0, 0), np.int16), none, none, 0, none
    )
    return list(drives._approaches(scene, clearance, cost))


def test_drives_start_before_the_box_on_all_sides_and_end_where_they_were_told(domain):
    scene = drives.scene_of(domain, 0)
    found = approaches(domain, scene)
    angles = np.array([math.atan2(ahead[1], ahead[0]) for ahead, *_ in found])
    numbers = np.rint(angles / math.radians(15.0)).astype(int) % 24
    assert np.allclose(np.exp(1j * angles), np.exp(1j * math.radians(15.0) * numbers))
    assert set(np.bincount(numbers, minlength=24)) == {8}
    for ahead, start, cost in found:
        start_m = (start - scene.body.centre) * CELL_M
        touch = shapely.Point(start_m + 0.6 * CELL_M * ahead)
        assert shapely.Polygon(BOX).distance(touch) == pytest.approx(RADIUS_M, abs=1e-6)
        # By the grid a way is at most 8.3 % longer than the straight one; beside the box it is slower, and round it longer.
        straight_s = np.hypot(*(start_m + PLACE - START)) / ROBOT.v_max_m_s
        assert straight_s * 0.95 < domain.seconds(cost / UNITS) < 3.0 * straight_s + 4.0
    # Lateral offsets, of half the width, seen along x; beyond the corners by half a radius.
    along = [(start[1] - scene.body.centre[1]) * CELL_M for ahead, start, _ in found if ahead[0] > 0.999]
    offsets = np.array([0.85, 0.5, 0.2]) * 0.15
    expected = sorted([*offsets, *-offsets, 0.15 + 0.5 * RADIUS_M, -0.15 - 0.5 * RADIUS_M])
    assert sorted(along) == pytest.approx(expected, abs=1e-6)


def test_a_drive_is_kept_every_six_centimetres_up_to_half_a_metre_in_contact(domain):
    scene = drives.scene_of(domain, 0)
    assert scene.stand_off == pytest.approx(0.6)
    for ahead, start, _ in approaches(domain, scene)[::29]:
        ends = list(drives._rollouts_of(scene, ahead, start, 7.0))
        lengths = np.array([one.length_m for one in ends])
        assert ((np.diff(lengths) >= 0.06 - 1e-9) & (np.diff(lengths) < 0.06 + 1.5 * STEP_M)).all()
        whole_m = 0.5 + 0.6 * CELL_M
        assert whole_m - 0.06 - STEP_M < lengths[-1] < whole_m + 1e-9
        for one in ends:
            assert one.approach_s == pytest.approx(7.0)
            moved, turned = np.hypot(*one.pose[:2]), abs(one.pose[2])
            assert moved >= 0.02 or turned >= 0.08
            # The platform touches the box at the end, or the box has slid off it.
            at = (start - scene.body.centre) * CELL_M + one.length_m * ahead
            gap_m = box_at(one.pose).distance(shapely.Point(at)) - RADIUS_M
            assert gap_m > -2e-3
            assert moved < one.length_m
            back = max(one.length_m - 0.1, 0.0)
            assert (drives.retreat(one) - start) * CELL_M == pytest.approx(back * ahead)
        first = ends[0]
        # Less than the first kept length changes nothing that counts: the box is hit after 3 cm.
        assert 0.03 < first.length_m < 0.03 + 0.12


def test_the_sample_of_drives_is_limited_and_of_all_sides(domain):
    unlimited = Deadline.after(1e9)
    some = drives.rollouts(domain, 0.02, {"box"}, unlimited)
    assert 120 < len(some) <= 240
    assert len({tuple(np.round(one.direction, 6)) for one in some}) > 20
    assert some[0].scene.radius_m == pytest.approx(RADIUS_M - 0.02)
    # The robot keeps its distance where the rim, which pushes, is 2 cm inside of it.
    assert some[0].scene.stand_off == pytest.approx(0.6 + 0.02 / CELL_M)
    assert drives.rollouts(domain, 0.02, (), unlimited) == []


def test_the_box_and_the_robot_fit_where_no_wall_is(domain):
    scene = drives.scene_of(domain, 0)
    walls = shapely.box(-PLACE[0], -PLACE[1], 6.0 - PLACE[0], 4.0 - PLACE[1]).exterior.buffer(
        CELL_M, join_style="mitre"
    )
    x, y = np.meshgrid(np.linspace(-3.2, 3.2, 33), np.linspace(-2.2, 2.2, 23))
    poses = np.stack([x.ravel(), y.ravel(), np.linspace(-1.0, 1.0, x.size)], axis=1)
    gaps_m = np.array([box_at(pose).distance(walls) for pose in poses])
    inside = (np.abs(poses[:, 0]) < 2.95) & (np.abs(poses[:, 1]) < 1.95)
    fit = drives.fits(scene, poses)
    assert fit[inside & (gaps_m > 0.0)].all()
    # Points of the outline are looked up, closer to each other than cells.
    deep = np.array([box_at(pose).intersection(walls).area for pose in poses]) > 2 * CELL_M**2
    assert not fit[deep | ~inside].any()
    away_m = shapely.distance(walls, shapely.points(poses[:, :2]))
    room = drives.has_room(scene, poses[:, :2])
    assert room[inside & (away_m > RADIUS_M + 0.1 * CELL_M)].all()
    assert not room[inside & (away_m < RADIUS_M - 0.1 * CELL_M)].any()


def test_pushes_afterwards_are_those_that_walls_leave_room_for(domain):
    scene = drives.scene_of(domain, 0)
    ahead, start, _ = next(one for one in approaches(domain, scene) if one[0][0] > 0.999)
    (end, *_) = drives._rollouts_of(scene, ahead, start, 0.0)
    counts = []
    for x, y in itertools.product((0.0, 2.72), (0.0, 1.77)):
        pose = np.array([x, y, 0.0])
        counts.append(drives.contacts_after(drives.Rollout(scene, ahead, start, 0.0, end.length_m, pose)))
    free, by_y, by_x, corner = counts
    # Along a wall the faces on its side are out of reach, in the corner those of two sides.
    assert free > by_x > corner > 0
    assert free > by_y > corner


def test_a_drive_in_the_open_mostly_ends_as_it_was_simulated(domain):
    """Samples differ by friction and place only; of the shortest drives most end within 5 cm and .3 rad of the nominal pose."""
    always = Deadline.after(1e9)
    found = drives.rollouts(domain, 0.02, {"box"}, always)
    shortest = sorted(found, key=lambda one: one.length_m)[:3]
    missed = [_missed(one, always, opens=False) for one in shortest]
    assert max(missed) < 0.5
    assert _missed(shortest[0], Deadline.after(0.0), opens=False) == 1


def test_drives_keep_the_room_that_is_asked_for(domain):
    (body,) = domain.bodies
    assert body.kept_clear is body.outline
    wider = replace(body, room=3.0).kept_clear
    gap = shapely.distance(shapely.Polygon(body.outline), shapely.points(wider))
    np.testing.assert_allclose(gap, 3.0, rtol=0.01)
    assert shapely.Polygon(wider).contains(shapely.Polygon(body.outline))


def test_the_ends_of_a_push_are_those_of_its_simulation_up_to_its_whole_length(domain):
    """Of one simulation all shorter pushes are read; the longest one is its last row, and lengths between are between rows."""
    end_errors(domain, 0, 0, 20.0)
    _, reach_m, poses = domain.ends[0, 0]
    stand_off_m, ahead = domain.robot.stand_off_m, domain.bodies[0].push(0).direction
    noise = TRACKING_M * np.random.default_rng(0).standard_normal((len(poses), 2))
    count = poses.shape[1] - 1
    for row, share in ((count, 0.0), (count - 1, 0.0), (count - 2, 0.25)):
        length_m = (row + share) / count * reach_m - stand_off_m
        ends = end_errors(domain, 0, 0, length_m / CELL_M, len(poses))
        after = poses[:, min(row + 1, count)]
        expected = (1 - share) * poses[:, row] + share * after - np.array([*(length_m * ahead), 0.0])
        expected[:, :2] += noise
        np.testing.assert_allclose(ends, expected, atol=1e-12)
    assert domain.ends[0, 0][1] == pytest.approx(reach_m)

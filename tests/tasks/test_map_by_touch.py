"""Mapping by touch: decisions of the circumnavigation, contacts of explorations, a slice of a room compared with the truth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate

from visuohaptic.core import FrameSource, InputError, MobileBase
from visuohaptic.navigation.mapping import HapticMap
from visuohaptic.rigs import map_virtual_room
from visuohaptic.simulation.mobile import (
    DriftingBase,
    OdometryErrors,
    PlatformConfig,
    QuickFoam,
    QuickFrames,
    QuickWorld,
    box,
    cylinder,
    touch_room,
    wall,
)
from visuohaptic.tasks.framework import replay
from visuohaptic.tasks.mobile import ExploreOutcome, ExploreSettings, explore_obstacle
from visuohaptic.tasks.mobile.touch_map import (
    MapObservation,
    MapOutcome,
    MapSettings,
    MapState,
    TouchMapTask,
    map_by_touch,
)
from visuohaptic.tasks.mobile.touch_map._map_contacts import centring_turn_rad, contact_of


def seen_at(t_s: float, x_m: float = 0.0, heading_rad: float = 0.0, **more: Any) -> MapObservation:
    values: dict[str, Any] = {"touched": False, "explored": "", "contact": False, "face_rad": math.nan}
    return MapObservation(t_s, x_m, 0.0, heading_rad, **(values | more))


def test_left_along_right_and_straight_on_again() -> None:
    task = TouchMapTask(MapSettings(contacts=2, along_m=0.3))
    assert task.step(seen_at(0.0)).explore
    assert task.step(seen_at(1.0, explored="tagged", contact=True)).turn_rate_rad_s > 0
    assert task.state is MapState.TURN_AWAY
    assert task.step(seen_at(2.0, heading_rad=0.5 * math.pi)).speed_m_s > 0
    assert task.step(seen_at(2.5, 0.2, 0.5 * math.pi)).speed_m_s > 0
    assert task.step(seen_at(3.0, 0.35, 0.5 * math.pi)).turn_rate_rad_s < 0
    assert task.step(seen_at(4.0, 0.35, 0.0)).explore
    assert task.step(seen_at(5.0, explored="tagged", contact=True)).speed_m_s == 0.0
    assert task.ending is not None
    assert task.ending.outcome == MapOutcome.MAPPED
    assert (
        replay(task.trace(), TouchMapTask(MapSettings(contacts=2, along_m=0.3)), MapObservation)
        == task.ending
    )


@pytest.mark.parametrize(
    ("face_rad", "turn_rad"),
    [(0.5 * math.pi, 0.5 * math.pi), (0.3 * math.pi, 0.3 * math.pi), (0.0, 0.85 * math.pi)],
)
def test_it_turns_left_until_the_face_is_parallel(face_rad: float, turn_rad: float) -> None:
    task = TouchMapTask()
    task.step(seen_at(0.0))
    task.step(seen_at(1.0, explored="tagged", contact=True, face_rad=face_rad))
    assert task.step(seen_at(1.1, heading_rad=turn_rad - 0.05)).turn_rate_rad_s > 0
    assert task.step(seen_at(1.2, heading_rad=turn_rad - 0.01)).speed_m_s > 0


def test_ways_that_meet_nothing_turn_right_and_end() -> None:
    task = TouchMapTask(MapSettings(empty_drives=2))
    task.step(seen_at(0.0))
    assert task.step(seen_at(1.0, explored="nothing_found")).turn_rate_rad_s < 0
    assert task.step(seen_at(2.0, heading_rad=-0.5 * math.pi)).explore
    task.step(seen_at(3.0, explored="nothing_found"))
    assert task.ending is not None
    assert task.ending.outcome == MapOutcome.NOTHING_FOUND


def test_held_it_tries_every_way_out_and_then_says_that_it_is_stuck() -> None:
    task = TouchMapTask(MapSettings(frees=6))
    task.step(seen_at(0.0))
    task.step(seen_at(1.0, explored="tagged", contact=True))
    told = []
    while not task.ended:
        told.append(task.step(seen_at(task.trace().steps[-1].t_s + 0.5)))
    ways = [c for k, c in enumerate(told) if k == 0 or c != told[k - 1]]
    # It turned left: back the way it came, forward with the foam, turned to the right; and again, then left.
    assert [math.copysign(1.0, c.speed_m_s) if c.speed_m_s else 0.0 for c in ways[1:-1]] == [-1, 1, 0] * 2
    assert [math.copysign(1.0, c.turn_rate_rad_s) for c in ways[1:-1] if not c.speed_m_s] == [-1, 1]
    assert task.ending is not None
    assert task.ending.outcome == MapOutcome.STUCK


def test_free_again_it_ends_the_turn_that_was_held() -> None:
    task = TouchMapTask(MapSettings(stuck_s=1.0))
    task.step(seen_at(0.0))
    task.step(seen_at(1.0, explored="tagged", contact=True, face_rad=0.5 * math.pi))
    for t_s in (1.5, 2.0, 2.5, 3.0):
        told = task.step(seen_at(t_s, heading_rad=0.1))
    assert told.speed_m_s < 0
    assert task.state is MapState.COME_FREE
    told = task.step(seen_at(3.5, -0.13, 0.1))
    assert told.turn_rate_rad_s > 0
    assert task.state is MapState.TURN_AWAY
    assert task.step(seen_at(4.0, -0.13, 0.5 * math.pi)).speed_m_s > 0
    assert task.state is MapState.ALONG


def test_what_the_end_of_the_foam_met_is_met_once_more() -> None:
    task = TouchMapTask(MapSettings(contacts=2))
    task.step(seen_at(0.0))
    told = task.step(seen_at(1.0, explored="tagged", centring_turn_rad=-0.6))
    assert told.turn_rate_rad_s < 0
    assert task.once_more
    assert task.contacts == 0
    assert task.step(seen_at(2.0, heading_rad=-0.59)).explore
    # Whatever it is the second time: no third.
    assert (
        task.step(
            seen_at(3.0, heading_rad=-0.6, explored="tagged", contact=True, centring_turn_rad=0.5)
        ).turn_rate_rad_s
        > 0
    )
    assert task.contacts == 1
    assert not task.once_more


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_bottle_at_the_end_of_the_foam_is_faced(side: float) -> None:
    """Its middle is beyond the end of the strip: the foam is full before it slides, and calls it fixed."""
    world = QuickWorld([cylinder("bottle", 0.4, side * 0.16, 0.045, 0.25, mass_kg=0.5, friction=0.3)])
    foam: Any = QuickFoam(world, np.random.default_rng(0))
    settings = MapSettings(front_m=world.config.radius_m)
    found = explore_obstacle(world, QuickFrames(world), foam, FAST)
    turn = centring_turn_rad(found, world.state(), settings)
    x, y, heading = world.pose
    px, py = world.places["bottle"]
    # The near side of a bottle of 4.5 cm that is 0.3 m away is met within a tenth of a radian of its middle.
    assert turn == pytest.approx(math.atan2(py - y, px - x) - heading, abs=0.15)
    world.pose = (x, y, heading + turn)
    again = explore_obstacle(world, QuickFrames(world), foam, FAST)
    assert math.isnan(centring_turn_rad(again, world.state(), settings))
    contact = contact_of(again)
    assert contact is not None
    assert contact.movable


def test_frames_that_come_seldom_make_it_slow_not_heavy() -> None:
    """Ten frames a second: at the speeds that are safe at thirty, walls are met with 43 N and more, the limit is 20."""
    felt = []

    class Watched(QuickWorld):
        def step(self, dt_s: float) -> Any:
            found = super().step(dt_s)
            felt.append(found.strip.load_N)
            return found

    room = touch_room(66)
    x, y, heading = room.start
    config = PlatformConfig(x_m=x, y_m=y, heading_rad=heading, strip=QuickWorld([]).config.strip)
    world = Watched(room.obstacles, config)
    foam: Any = QuickFoam(world, np.random.default_rng(66))
    grid = HapticMap.empty((-0.5, -0.5), (room.size_m[0] + 1.0, room.size_m[1] + 1.0))
    source = QuickFrames(world, frame_rate_Hz=10.0)
    done = map_by_touch(world, source, foam, grid, MapSettings(contacts=2, timeout_s=100.0))
    assert done.ending.success
    assert max(felt) < 1.1 * ExploreSettings().max_force_N


def test_walls_and_middles_need_no_second_time() -> None:
    """A wall may be up to some 10 degrees oblique; more, and it is faced as well."""
    for things in (
        [wall("ahead", 0.4, 0.0, 2.0, 0.1, yaw_rad=math.radians(90.0))],
        [wall("oblique", 0.45, 0.0, 2.0, 0.1, yaw_rad=math.radians(98.0))],
        [box("leg", 0.4, 0.0, (0.02, 0.02, 0.5), fixed=True)],
    ):
        world = QuickWorld(things)
        foam: Any = QuickFoam(world, np.random.default_rng(0))
        found = explore_obstacle(world, QuickFrames(world), foam, FAST)
        assert found.touched
        assert math.isnan(centring_turn_rad(found, world.state(), MapSettings()))


def test_a_failing_sensor_and_the_time_end_it() -> None:
    task = TouchMapTask()
    task.step(seen_at(0.0))
    task.step(seen_at(1.0, explored="sensor_failed"))
    assert task.ending is not None
    assert task.ending.outcome == MapOutcome.SENSOR_FAILED
    task = TouchMapTask(MapSettings(timeout_s=10.0))
    task.step(seen_at(0.0))
    task.step(seen_at(11.0))
    assert task.ending is not None
    assert task.ending.outcome == MapOutcome.TIMED_OUT
    with pytest.raises(InputError, match="along_m: found 0"):
        MapSettings(along_m=0.0)


FAST = ExploreSettings(
    approach_m_s=0.08, push_m_s=0.04, search_m=0.4, push_m=0.04, halt_s=0.3, back_off_m=0.02, rise=1.0
)


@pytest.mark.parametrize("friction_N", [1.5, 3.0])
def test_the_quick_world_slides_at_its_friction(friction_N: float) -> None:
    """Against Coulomb's law: the foam's force while it slides is the dynamic friction, within the gain of 3 %."""
    thing = cylinder("bin", 0.35, 0.0, 0.1, 0.3, mass_kg=friction_N / 9.81 / 0.5, friction=0.5)
    world = QuickWorld([thing])
    assert isinstance(world, MobileBase)
    assert isinstance(QuickFrames(world), FrameSource)
    foam: Any = QuickFoam(world, np.random.default_rng(0), gain_sigma=0.0)
    found = explore_obstacle(world, QuickFrames(world), foam, FAST)
    assert found.outcome is ExploreOutcome.TAGGED
    assert found.tag.fixed is False
    # A frame at 4 cm/s lets the force overshoot by the slope of the foam times a millimetre.
    assert found.tag.dynamic_friction_N.value == pytest.approx(friction_N, rel=0.1)
    contact = contact_of(found)
    assert contact is not None
    assert contact.movable
    # It was pushed along x and not aside; the map's contact is at its front.
    assert world.places["bin"][0] > 0.37
    assert world.places["bin"][1] == pytest.approx(0.0, abs=1e-3)
    assert contact.T_map_foam[0] + contact.points_foam_m[:, 0].min() == pytest.approx(
        world.places["bin"][0] - 0.1, abs=0.003
    )


def test_walls_hold_and_what_is_behind_or_beside_is_not_touched() -> None:
    things = [wall("ahead", 0.5, 0.0, 2.0, 0.1, yaw_rad=0.5 * math.pi), wall("behind", -0.6, 0.0, 2.0, 0.1, yaw_rad=0.5 * math.pi),
              box("beside", 0.2, 0.4, (1.0, 0.2, 1.0), fixed=True)]  # fmt: skip
    world = QuickWorld(things)
    foam: Any = QuickFoam(world, np.random.default_rng(0))
    found = explore_obstacle(world, QuickFrames(world), foam, FAST)
    assert world.last_touched == "ahead"
    assert found.tag.fixed is True
    assert world.places["ahead"] == pytest.approx((0.5, 0.0))
    world.drive(0.0, 0.6)
    for _ in range(300):
        world.step(1 / 30)
    # Turned away obliquely, with a long wall behind it, the foam bears on nothing.
    turned = QuickWorld([wall("behind", 0.0, 0.6, 4.0, 0.1)])
    turned.pose = (0.0, 0.0, -2.2)
    assert turned.step(1 / 30).touching == ()
    # The hull's corner meets the box or the wall: it stands.
    assert world.state().turn_rate_rad_s == 0.0


@settings(max_examples=200, deadline=None)
@given(
    x=st.floats(-0.6, 0.6), y=st.floats(-0.6, 0.6), yaw=st.floats(-3.2, 3.2), heading=st.floats(-3.2, 3.2),
    long=st.floats(0.02, 0.8), wide=st.floats(0.02, 0.8), round_=st.booleans(),
)  # fmt: skip
def test_the_hull_meets_what_its_outline_meets(
    x: float, y: float, yaw: float, heading: float, long: float, wide: float, round_: bool
) -> None:
    """Against shapely; corners between sampled points are met as well."""
    thing = (
        cylinder("thing", x, y, 0.5 * long, 0.3, mass_kg=1.0)
        if round_
        else box("thing", x, y, (long, wide, 1.0), fixed=True, yaw_rad=yaw)
    )
    world = QuickWorld([thing])
    (back, front), half = world._hull_m, 0.5 * world.config.width_m
    hull = rotate(shapely.box(back, -half, front, half), heading, origin=(0, 0), use_radians=True)
    shape = shapely.Point(x, y).buffer(0.5 * long, quad_segs=64)
    if not round_:
        own = shapely.box(x - 0.5 * long, y - 0.5 * wide, x + 0.5 * long, y + 0.5 * wide)
        shape = rotate(own, yaw, origin=(x, y), use_radians=True)
    gap = hull.distance(shape) - hull.intersection(shape).area
    assume(abs(gap) > 1e-3)  # a circle of shapely has corners
    assert world._overlaps(thing, (0.0, 0.0, heading)) == (gap < 0)


def test_a_wall_hit_fast_and_obliquely_is_fixed() -> None:
    """From the way along: while the platform brakes the foam eases, as when something begins to slide."""
    for degrees in (0.0, 5.0, 10.0, 20.0):
        world = QuickWorld([wall("ahead", 0.5, 0.0, 2.0, 0.1, yaw_rad=math.radians(90.0 + degrees))])
        foam: Any = QuickFoam(world, np.random.default_rng(0))
        world.drive(0.15, 0.0)
        for frame in QuickFrames(world):
            if foam.read(frame).contacts:
                break
        contact = contact_of(explore_obstacle(world, QuickFrames(world), foam, FAST))
        assert contact is not None
        assert not contact.movable


def test_odometry_drifts_as_declared() -> None:
    """40 runs of 2 m: the error along is 1 % of the way; commands go through."""
    errors = []
    for seed in range(40):
        world = QuickWorld([])
        base = DriftingBase(
            world, np.random.default_rng(seed), OdometryErrors(scale=0.01, slip_m=1e-6, walk_rad=1e-6)
        )
        base.drive(0.5, 0.0)
        for _ in range(150):
            world.step(1 / 30)
            base.state()
        errors.append(base.state().x_m / world.state().x_m - 1.0)
    # The standard deviation of 40 values is known to 11 %.
    assert np.std(errors) == pytest.approx(0.01, rel=0.35)
    assert base.state().t_s == world.t_s


def test_a_slice_of_a_room() -> None:
    """Eight contacts of the benchmark's 22."""
    trial = map_virtual_room(0, contacts=8)
    assert trial.mapping.ending.outcome == MapOutcome.MAPPED
    assert trial.score.iou > 0.6
    assert trial.score.correct_flags == 8
    assert trial.score.mixed == 0
    assert any(contact.movable for contact in trial.mapping.contacts)
    assert (
        replay(trial.mapping.trace, TouchMapTask(MapSettings(contacts=8)), MapObservation)
        == trial.mapping.ending
    )


def test_the_next_wall_is_met_no_harder_than_the_platform_may_push() -> None:
    """In a corner the whole foam meets a wall on the way along the other: 86 N where 20 N are the limit, once."""
    room = touch_room(12)
    x, y, heading = room.start
    strip = QuickWorld([]).config.strip
    world = QuickWorld(room.obstacles, PlatformConfig(x_m=x, y_m=y, heading_rad=heading, strip=strip))
    foam: Any = QuickFoam(world, np.random.default_rng(12))
    felt_N: list[float] = []

    class Watched(QuickFrames):
        def advance(self, dt_s: float) -> float:
            t_s = super().advance(dt_s)
            felt_N.append(float(world.truth.strip.load_N))
            return t_s

    grid = HapticMap.empty((-0.5, -0.5), (room.size_m[0] + 1.0, room.size_m[1] + 1.0))
    done = map_by_touch(world, Watched(world), foam, grid, MapSettings(contacts=3, timeout_s=200.0))
    assert done.ending.success
    # A tenth for the sensor's gain and the frame in which the limit is passed.
    assert max(felt_N) <= 1.1 * ExploreSettings().max_force_N

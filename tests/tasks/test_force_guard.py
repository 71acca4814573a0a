"""A platform stops at its maximum force, whatever the cause; a stopped clock and a wrong robot are reported."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np
import pytest
from tests.navigation.plan_scenes import ROBOT, STOOL, box, rooms, with_objects
from tests.tasks.block_robot import BlockRobot

from visuohaptic.core import (
    ClockWatch,
    ErrorBudget,
    ForceProfile,
    FrameSource,
    Gripper,
    HapticTag,
    InputError,
    MobileBase,
    ProbeArm,
    Reason,
    from_dict,
    require_members,
    to_dict,
)
from visuohaptic.database import merge_tags
from visuohaptic.navigation.problem import (
    MovableObject,
    PlanningProblem,
    failure_probability,
    manipulability,
    objects_from_data,
)
from visuohaptic.tasks.framework import Machine, Rule
from visuohaptic.tasks.mobile import (
    ExploreSettings,
    FoamLimit,
    ForceGuard,
    GuardState,
    PushEnd,
    PushSettings,
    ReactionTime,
    SteeredPush,
)
from visuohaptic.tasks.mobile.travel import TravelOutcome, TravelSenses, TravelSettings, travel

LIMIT_N = ROBOT.push_force_max_N
WALLS = rooms(4.0, 3.0, [(1.9, 0.0, 2.0, 1.0), (1.9, 1.9, 2.0, 3.0)])


def go(robot, tag=None, **settings):
    block = MovableObject("block", box(1.95, 1.4, 0.35), tag)
    problem = PlanningProblem(
        with_objects(WALLS, [block]), ROBOT, np.array([0.7, 1.4]), np.array([3.4, 1.4]), (block,)
    )
    return travel(problem, robot, robot, getattr(robot, "wait", None), TravelSettings(**settings))


@pytest.mark.parametrize("stiffness", [1e6, 2e3])
@pytest.mark.parametrize("tag", [None, STOOL])
def test_travel_stops_at_the_largest_force(stiffness, tag):
    """A block of 60 N, unknown or believed to be light, is not pushed by a platform of 20 N."""
    robot = BlockRobot(60.0, stiffness_N_per_m=stiffness)
    done = go(robot, tag)
    assert done.outcome is TravelOutcome.NO_PLAN
    assert robot.overloaded(LIMIT_N) == 0
    # A rigid rim reaches 60 N within one period: as far as three single periods at 0.08 m/s.
    assert robot.block_x - 1.95 < 3 * 0.08 * 0.02 + 1e-6
    found = done.problem.objects[0].tag
    assert found.fixed
    assert found.min_static_friction_N == LIMIT_N
    assert found.static_friction_N is None
    assert robot.force_N == 0.0  # it has retreated


def test_a_block_below_the_limit_is_pushed_and_its_friction_is_what_was_seen():
    robot = BlockRobot(19.0, stiffness_N_per_m=2e4)
    done = go(robot, timeout_s=25.0)
    assert robot.block_x - 1.95 > 0.4
    assert done.problem.objects[0].tag.min_static_friction_N is None
    assert done.problem.objects[0].tag.static_friction_N.value == pytest.approx(19.0, rel=0.01)


def test_the_momentum_of_the_first_contact_is_no_friction():
    """43, 20.4 and 21.5 N while the platform brakes against a block of 14 N, as in physics: it is pressed from rest, and moves."""
    robot = BlockRobot(14.0, stiffness_N_per_m=2e4)
    felt, impact = robot.touch, [21.5, 20.4, 42.9]

    def touch():
        force_N, point = felt()
        return (impact.pop(), point) if force_N and impact else (force_N, point)

    robot.touch = touch
    done = go(robot, timeout_s=25.0)
    tag = done.problem.objects[0].tag
    assert not impact
    assert robot.block_x - 1.95 > 0.4
    assert not tag.fixed
    assert tag.min_static_friction_N is None
    assert tag.static_friction_N.value == pytest.approx(14.0, rel=0.01)


def test_a_force_that_is_not_read_ends_the_travel():
    robot = BlockRobot(8.0, stiffness_N_per_m=2e4)
    free = robot.wait

    def wait(period_s):
        free(period_s)
        robot.read = robot.force_N == 0.0  # goes blind with the first touch

    robot.wait = wait
    done = go(robot, STOOL)
    assert done.outcome is TravelOutcome.SENSOR_FAILED
    assert "not read" in done.reason
    assert robot.speed == 0.0
    assert robot.block_x - 1.95 < 0.08 * 0.02 + 1e-6


@pytest.mark.parametrize("periods", [10, 10000])
def test_a_robot_that_does_not_know_where_it_is_stands_until_it_does(periods):
    robot = BlockRobot(8.0, stiffness_N_per_m=2e4)
    free, true_pose, lost = robot.wait, robot.pose, []

    def wait(period_s):
        if 100 <= len(robot.pressed) < 100 + periods:
            lost.append(robot.speed)
        free(period_s)

    robot.wait = wait
    robot.pose = lambda: (math.nan,) * 3 if 100 <= len(robot.pressed) < 100 + periods else true_pose()
    done = go(robot, STOOL, timeout_s=60.0)
    assert not any(lost)
    if periods > 25:
        assert done.outcome is TravelOutcome.SENSOR_FAILED
        assert "the pose is not read" in done.reason
    else:
        assert done.pushes >= 1


def test_a_steered_push_alone_stops_too():
    robot = BlockRobot(60.0, at=(1.5, 1.4))
    push = SteeredPush(np.array([1.5, 1.4]), 0.0, 0.3, settings=PushSettings(search_m=0.3))
    while push.end is None:
        force, point = robot.touch()
        robot.drive(*push.command(robot.t_s, np.array(robot.pose()), force, point, None))
        robot.wait(0.02)
    assert push.end is PushEnd.TOO_HEAVY
    assert robot.overloaded(20.0) == 0


def test_the_guard_tells_blows_from_friction_and_counts_what_is_not_read():
    guard = ForceGuard(20.0)
    assert [guard.update(f) for f in (25.0, 0.0, 8.0, 8.0, 24.0, 8.0, 9.0)] == [
        GuardState.HOLD, GuardState.GO, GuardState.GO, GuardState.GO, GuardState.HOLD, GuardState.GO,
        GuardState.GO,
    ]  # fmt: skip
    guard = ForceGuard(20.0)
    assert [guard.update(20.0) for _ in range(3)][-1] is GuardState.TOO_HEAVY
    assert guard.update(30.0, pressing=False) is GuardState.GO
    assert ForceGuard(20.0, median_of=1).update(19.0, 0.5) is GuardState.TOO_HEAVY
    guard = ForceGuard(20.0, max_unread=3)
    assert [guard.update(math.nan) for _ in range(3)] == [GuardState.HOLD, GuardState.HOLD, GuardState.UNREAD]
    with pytest.raises(InputError, match="expected more than 0"):
        ForceGuard(math.nan)


@pytest.mark.parametrize(("friction_N", "heavy"), [(8.0, False), (25.0, True)])
def test_impacts_that_come_with_every_motion_are_no_friction(friction_N, heavy):
    """A rigid rim strikes at 16 N more after each halt, and the object slides out of contact: it was called too heavy."""
    guard, force_N, states = ForceGuard(20.0), 0.0, []
    for _ in range(50):
        states.append(guard.update(force_N))
        moves = states[-1] is GuardState.GO
        force_N = friction_N + 16.0 * guard.speed_fraction if moves else 0.0
    assert (GuardState.TOO_HEAVY in states) is heavy
    assert heavy or states.count(GuardState.GO) > 30


def test_the_planner_believes_the_bound_and_files_keep_it():
    tag = HapticTag(explored=1, min_static_friction_N=20.0)
    assert not manipulability(tag, ROBOT).possible
    assert "more than 20.0 N" in manipulability(tag, ROBOT).reason
    assert failure_probability(tag, 0.1, ROBOT) == 1.0
    assert from_dict(HapticTag, to_dict(tag)).min_static_friction_N == 20.0
    read = objects_from_data(
        {"objects": [{"id": "a", "footprint_m": box(0, 0, 1).tolist(), "haptic_tag": to_dict(tag)}]}
    )
    assert read[0].tag.needs_more_than(20.0)
    assert not read[0].tag.needs_more_than(25.0)
    assert merge_tags(tag, HapticTag(fixed=True)).min_static_friction_N == 20.0
    assert merge_tags(tag, HapticTag(fixed=False)).min_static_friction_N is None


def test_a_travel_ends_when_the_robots_clock_stands_still():
    robot = BlockRobot(8.0)
    robot.clock_runs = False
    done = go(robot, STOOL)
    assert done.outcome is TravelOutcome.CLOCK_STOPPED
    assert "clock has stood still at 0 s" in done.reason
    assert len(robot.pressed) < 300


def test_a_slow_clock_does_not_stretch_a_time_out():
    """It advances by a thousandth: by its own clock the travel would last for half an hour."""
    robot = BlockRobot(8.0)
    free = robot.wait

    def wait(period_s):
        free(period_s)
        robot.t_s += 1e-3 * period_s

    robot.clock_runs, robot.wait = False, wait
    robot.drive = lambda speed, turn: None  # it stands, too
    done = go(robot, STOOL, timeout_s=4.0)
    assert done.outcome is TravelOutcome.TIMED_OUT
    assert len(robot.pressed) <= 201


def test_the_host_notices_what_the_periods_do_not():
    host = [0.0]
    watch = ClockWatch(max_periods=None, max_host_s=5.0, host_clock=lambda: host[0])
    for _ in range(1000):
        assert not watch.update(1.0)
    host[0] = 5.1
    assert "has stood still at 1 s" in watch.update(1.0)
    assert not watch.update(1.1)


class _State(StrEnum):
    WAIT = "wait"


@dataclass(frozen=True)
class _Seen:
    t_s: float


class _Task(Machine):
    task = "wait"
    rules: ClassVar = {_State.WAIT: Rule((), 5.0)}

    def decide(self, seen):
        return "go"

    def halt(self):
        return "halt"


@pytest.mark.parametrize("frozen_s", [1.0, math.nan])
def test_every_task_ends_when_no_newer_observation_comes(frozen_s):
    task, host = _Task(), [0.0]
    task.host_clock = lambda: host[0]
    task.step(_Seen(1.0))
    for _ in range(20):
        host[0] += 1.0
        if task.ended:
            break
        assert task.step(_Seen(frozen_s)) == "halt"
    assert task.ending.outcome == "clock_stopped"
    assert 5.0 < host[0] < 8.0


def test_wrong_robots_are_refused_by_name():
    class Silent:
        pass

    class NoStop:
        def drive(self, speed_m_s, turn_rate_rad_s): ...
        def state(self): ...

    class Number(NoStop):
        stop = 3

    class Short(NoStop):
        def stop(self): ...
        def drive(self, speed_m_s): ...

    for wrong, expected in (
        (Silent(), r"type Silent without method drive\(speed_m_s, turn_rate_rad_s\), which must return None"),
        (NoStop(), r"type NoStop without method stop\(\)"),
        (Number(), "whose stop is int"),
        (Short(), "whose drive takes other arguments"),
        (None, "type NoneType without method drive"),
    ):
        with pytest.raises(InputError, match=expected) as raised:
            go(wrong)
        assert "\n" not in str(raised.value)
    robot = BlockRobot(8.0)
    with pytest.raises(InputError, match=r"TravelSenses object of type NoStop without method pose\(\)"):
        travel(None, robot, NoStop(), robot.wait)
    with pytest.raises(InputError, match=r"arm of type Silent without method move_linear\("):
        require_members(Silent(), ProbeArm, "grasp", "arm")
    with pytest.raises(InputError, match="without property camera, which must return Camera"):
        require_members(Silent(), FrameSource, "grasp", "frame source")
    with pytest.raises(InputError, match="without method move"):
        require_members(Silent(), Gripper, "grasp", "gripper")
    require_members(robot, MobileBase, "travel")
    require_members(robot, TravelSenses, "travel")


def test_the_reaction_is_as_long_as_readings_have_waited():
    """At 30 Hz a touch shows after one frame and is read in another; three lost frames make that five."""
    reaction, frame_s = ReactionTime(2 / 30), 1 / 30
    for k in range(10):
        reaction.update(k * frame_s, 5.0 + k * frame_s)
    assert reaction.reaction_s == pytest.approx(2 * frame_s)
    reaction.update(13 * frame_s, 5.0 + 13 * frame_s)
    assert reaction.reaction_s == pytest.approx(5 * frame_s)
    # In order, but two frames later than the quickest: it shows what was the case two frames ago.
    reaction = ReactionTime(2 / 30)
    for k, late in enumerate((0, 0, 1, 2, 2)):
        reaction.update(k * frame_s, (k + late) * frame_s)
    assert reaction.reaction_s == pytest.approx((2 + 2 + 1) * frame_s)
    # A supervisor has stopped the platform by then: at an age of 0.15 s, by a check at 50 Hz.
    reaction.update(40 * frame_s, 40 * frame_s)
    assert reaction.reaction_s == pytest.approx(0.15 + 0.02 + frame_s)


def test_foam_that_is_not_read_is_as_full_as_it_was():
    """A body that hides the strip's other half from the camera has not freed it."""
    limit, zero = FoamLimit(ExploreSettings(), 0.010), np.zeros(2)

    def drive(t_s, *delta_m):
        profile = ForceProfile(
            t_s, True, Reason.OK, 0.0, ErrorBudget(0.0, 0.0, 0.0, 0.0), np.array([-0.1, 0.1]),
            np.array(delta_m), zero, zero, zero, zero == 0.0,
        )  # fmt: skip
        limit.update(t_s, t_s, profile)
        return limit.limited(1.0, 0.0)[0]

    free = drive(0.0, 0.0, 0.0)
    pressed = drive(1 / 30, 0.0, 0.009)
    assert pressed < 0.5 * free
    assert drive(2 / 30, 0.0, math.nan) == pytest.approx(pressed)
    assert drive(3 / 30, 0.0, 0.0) == pytest.approx(free)


def test_half_a_second_of_unread_force_at_50_Hz_ends_and_three_of_five_readings_are_a_median():
    guard = ForceGuard(20.0)
    states = [guard.update(math.nan) for _ in range(25)]
    assert (states[-2], states[-1]) == (GuardState.HOLD, GuardState.UNREAD)
    guard = ForceGuard(20.0)
    # The reading after a stop was made while the platform was held, and does not count.
    states = [guard.update(force_N) for force_N in (20.0, 1.0, 1.0, 1.0, 20.0, 20.0)]
    assert (states[-2], states[-1]) == (GuardState.HOLD, GuardState.TOO_HEAVY)

"""State machine of a navigation task: plan, drive, push, explore, turn, retreat (Alt 2016, Sec. 4.2 to 4.4)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ....core.robots import BaseState
from ....navigation.planning.path_follower import PathFollower
from ....navigation.planning.policies import make_plan
from ....navigation.problem.path_plan import Plan, Task
from ....navigation.problem.planning_problem import PlanningProblem
from ...framework.machine import Machine, Rule
from ..force_guard import MAX_UNREAD
from .plan_duration import Clearance, clearance_of, expected_duration_s, follow_limits
from .travel_memory import TravelMemory
from .travel_motion import RETREAT_M_S, Motion, TravelInterrupted, TravelMotion
from .travel_plans import TravelPlans
from .travel_pushes import TravelPushes
from .travel_types import (
    TravelCommand,
    TravelObservation,
    TravelOutcome,
    TravelRecord,
    TravelSettings,
    TravelState,
)

_WORKING = (
    TravelState.DRIVE, TravelState.PUSH, TravelState.SIDEWARD, TravelState.EXPLORE, TravelState.TURN, TravelState.WAIT,
    TravelState.DOOR,
)  # fmt: skip


class TravelTask(Machine[TravelState, TravelObservation, TravelCommand]):
    """Plan, execute, look, plan again.

    After every push the object is located, the result is recorded (counters of the tag, centre of
    friction), and the task plans again: a manipulation node whose object was removed becomes a navigation node, and one
    that failed is avoided (Sec. 4.2.1). If no straight push helps, an object is rotated by an off-centre
    push.

    Parameters
    ----------
    problem
        Map, tagged objects, robot, goal.
    settings
        Margins, limits and tolerances.
    planner
        Planner, called with a robot radius enlarged by a margin. A replay needs the same one.
    without_passage_sensors
        Whether there are no sensors for open passages.
    """

    task = "travel"

    def __init__(
        self,
        problem: PlanningProblem,
        settings: TravelSettings | None = None,
        planner: Callable[[PlanningProblem], Plan] = make_plan,
        *,
        without_passage_sensors: bool = False,
    ) -> None:
        self.settings = settings or TravelSettings()
        s = TravelState
        after = (s.PLAN, *_WORKING)
        self.rules = {
            s.PLAN: Rule(after),
            s.DRIVE: Rule((*after, s.BACK_OFF)),
            s.PUSH: Rule((s.BACK_OFF,)),
            s.SIDEWARD: Rule((*after, s.BACK_OFF)),
            s.EXPLORE: Rule((s.BACK_OFF, s.PLAN)),
            s.TURN: Rule((s.BACK_OFF,)),
            s.WAIT: Rule(after),
            s.DOOR: Rule((*after, s.BACK_OFF)),
            s.BACK_OFF: Rule(after),
        }
        super().__init__(self.settings)
        self._waits_blindly = without_passage_sensors
        self.robot = problem.robot
        self.records: list[TravelRecord] = []
        self.memory = TravelMemory(problem)
        self.plans = TravelPlans(self.memory, self.settings, planner, self._note)
        self.motion = TravelMotion(self.robot.push_force_max_N, self.settings.timeout_s, problem.start_m)
        self.pushes = TravelPushes(self.robot, self.memory, self.motion, self.settings, self._note)
        self._objects = tuple(item.id for item in problem.objects)
        self._tasks: list[Task] = []
        self._clearance: Clearance = lambda _: math.inf
        self._driven_m = 0.0
        self._as_planned = False  #: whether the last push reached its planned goal
        self._behind_m = 0.0  #: known free distance straight behind the robot
        self._unlocated = 0  #: number of consecutive control periods without a pose
        self._run = self._from_state_to_state()

    @property
    def length_m(self) -> float:
        """Distance driven so far, without retreats [m]."""
        return self._driven_m + self.pushes.driven_m

    def halt(self) -> TravelCommand:
        """Command that stops the robot."""
        return TravelCommand()

    def decide(self, seen: TravelObservation) -> TravelCommand:
        """Velocity for the next control period."""
        # Without a pose the robot stops until it is localised.
        self._unlocated = 0 if all(map(math.isfinite, seen.pose_m)) else self._unlocated + 1
        if self._unlocated:
            if self._unlocated >= MAX_UNREAD:
                self._finish(TravelOutcome.SENSOR_FAILED, "the pose is not read (NaN)")
            return self.halt()
        try:
            self.motion.observe(seen)
            return next(self._run)
        except TravelInterrupted as interrupted:
            self._finish(interrupted.outcome, interrupted.reason)
        except StopIteration:
            assert self.ended
        return self.halt()

    def _from_state_to_state(self) -> Motion[None]:
        while True:
            step: Callable[[], Motion[TravelState | None]] = getattr(self, f"_{self.state.name.lower()}")
            following = yield from step()
            if following is None:
                return
            self.go(following, self.records[-1].event if self.records else "")

    def _finish(self, outcome: TravelOutcome, reason: str) -> None:
        self._note(str(outcome), reason=reason)
        self.end(outcome in (TravelOutcome.ARRIVED, TravelOutcome.EXPLORED), outcome.value, reason)

    def _plan(self) -> Motion[TravelState | None]:
        """Locate the objects, and plan with the largest feasible margin."""
        if self.plans.calls >= self.settings.plans:
            self._finish(TravelOutcome.GAVE_UP, f"after {self.plans.calls} plans")
            return None
        yield from self._look_around()
        pose = self.motion.pose_m()
        best, last = self.plans.largest_margin(pose)
        turn = self.plans.turning(pose) if best is None else None
        if best is not None:
            self.pushes.margin_m, problem, plan = best
            self._tasks = list(plan.tasks)
        elif turn is not None:
            self.pushes.margin_m, problem, tasks = turn
            self._tasks, plan = list(tasks), Plan(True, tasks)
        elif self.plans.reset_failures():
            self._note("failures reset")
            return TravelState.PLAN
        else:
            self._finish(TravelOutcome.NO_PLAN, last.reason)
            return None
        self._clearance = clearance_of(problem)
        expected_s = expected_duration_s(plan, problem, float(pose[2]), self.pushes.margin_m)
        self._note("set out", expected_s=expected_s)
        return self._next()

    def _next(self) -> TravelState | None:
        """State of the next task; ``None`` at the goal."""
        if not self._tasks:
            self._finish(TravelOutcome.ARRIVED, "")
            return None
        kind = self._tasks[0].kind
        state = TravelState.DRIVE if kind == "navigate" else TravelState(kind)
        return state if state in _WORKING else TravelState.PLAN

    def _drive(self) -> Motion[TravelState | None]:
        """Follow the path of the plan until its end, or until a contact."""
        task, robot, settings, motion = self._tasks[0], self.robot, self.settings, self.motion
        limits = replace(follow_limits(robot), radius_m=robot.radius_m + self.pushes.margin_m)
        follower = PathFollower(np.array(task.path_m), limits, clearance=self._clearance)
        last, start_s = motion.pose_m(), motion.now_s()
        moved_s, bumped_s = start_s, math.nan
        before_rad = float(last[2])  # heading before a turn on the spot
        motion.new_guard()
        while True:
            pose, now_s, force_N = motion.pose_m(), motion.now_s(), motion.seen.force_N
            x, y, heading = (float(value) for value in pose)
            speed, turn = follower.command(BaseState(now_s, x, y, heading, 0.0, 0.0))
            before_rad = heading if speed else before_rad
            if follower.done:
                self._driven_m += task.length_m
                self._tasks.pop(0)
                self._behind_m = 0.0
                self._note("drove", seconds=now_s - start_s)
                return self._next()
            turned = math.remainder(pose[2] - last[2], 2.0 * math.pi)
            if np.hypot(*(pose[:2] - last[:2])) > 0.02 or abs(turned) > 0.1:
                last, moved_s = pose, now_s
            if force_N < settings.bump_N or math.isnan(bumped_s):
                bumped_s = now_s
            event = ""
            if now_s - moved_s > settings.drive_stall_s:
                event = "stalled"
            elif now_s - bumped_s > settings.bump_s or now_s - start_s > 20.0 + 10 * task.cost_s:
                event = "bumped"
            elif not (yield from motion.go(speed, turn)):
                event = "overloaded"
            if event:
                return (yield from self._bumped(event, force_N, None if speed else before_rad))

    def _bumped(self, event: str, force_N: float, before_rad: float | None) -> Motion[TravelState]:
        """Process an unexpected contact, of a turn on the spot if the heading before it is given: retreat, plan again."""
        point = self.motion.point_m()
        yield from self._look_around()
        new = point is not None and self.memory.touched(point)
        self._note(
            event, force_N=force_N, point_m=[] if point is None else [float(v) for v in point], new=new
        )
        if new:
            self.plans.changed()
        else:
            self.plans.bumped(self.pushes.margin_m)
        self._behind_m, self._as_planned = self.settings.back_off_m, False
        if self.robot.footprint_m:
            if before_rad is None:
                return TravelState.BACK_OFF
            yield from self.motion.turn_to(before_rad, leaving=True)
            return TravelState.PLAN
        if point is not None and not self.memory.near(point):
            yield from self.motion.leave(point, self.settings.leave_m)
            return TravelState.PLAN
        return TravelState.BACK_OFF

    def _back_off(self) -> Motion[TravelState | None]:
        """Retreat straight back over floor that was just driven on."""
        yield from self.motion.straight(-RETREAT_M_S, self._behind_m, 4.0 + self._behind_m / 0.05)
        if self._as_planned:
            self._tasks.pop(0)
            return self._next()
        return TravelState.PLAN

    def _push(self) -> Motion[TravelState]:
        """Push an object; continue the plan if it reached its planned goal."""
        self.plans.changed()
        self._as_planned = yield from self.pushes.push(self._tasks[0])
        self._behind_m = self.pushes.behind_m
        return TravelState.BACK_OFF

    def _sideward(self) -> Motion[TravelState | None]:
        """Push an object aside while driving past it; continue the plan if it reached its planned goal."""
        self.plans.changed()
        pose = self.motion.pose_m()
        problem = self.memory.problem(pose, self.pushes.margin_m)
        done = yield from self.pushes.sideward(self._tasks[0], problem)
        self._as_planned, self._behind_m = False, self.pushes.behind_m
        if done is None:
            return TravelState.BACK_OFF
        if not done:
            return TravelState.PLAN
        self._tasks.pop(0)
        return self._next()

    def _explore(self) -> Motion[TravelState]:
        """Touch and tag an unknown object, then plan again."""
        self.plans.changed()
        unknown = self._tasks[0].object
        after = next((t for t in self._tasks[1:] if t.kind == "push" and t.object == unknown), None)
        if after is None and self._tasks[0].contact_m is not None:  # of a tour
            x, y = (float(value) for value in self.motion.pose_m()[:2])
            ahead = self._tasks[0].contact_m[0] - x, self._tasks[0].contact_m[1] - y
            after = replace(self._tasks[0], path_m=((x, y),), displacement_m=ahead)
        if after is None:
            return TravelState.PLAN
        yield from self.pushes.explore(after)
        self._as_planned, self._behind_m = False, self.pushes.behind_m
        return TravelState.BACK_OFF

    def _turn(self) -> Motion[TravelState]:
        """Push an object off-centre."""
        self.plans.changed()
        yield from self.pushes.turn(self._tasks[0])
        self._as_planned, self._behind_m = False, self.pushes.behind_m
        return TravelState.BACK_OFF

    def _wait(self) -> Motion[TravelState | None]:
        """Wait in front of a passage until it is open; plan again if it does not open."""
        task, start_s = self._tasks[0], self.motion.now_s()
        patience_s = task.cost_s + self.settings.patience_sigma * task.sigma_s
        opened = False
        while not opened and self.motion.now_s() - start_s < patience_s:
            yield TravelCommand(passage=task.object)
            opened = task.object in self.motion.seen.open
        waited_s = self.motion.now_s() - start_s
        return self._passed("opened", waited_s, done=opened or self._waits_blindly)

    def _door(self) -> Motion[TravelState | None]:
        """Push a door leaf open with the rim, and drive through; plan again if it does not move."""
        task, start_s = self._tasks[0], self.motion.now_s()
        begin, end = np.array(task.path_m[0]), np.array(task.path_m[-1])
        length_m = float(np.hypot(*(end - begin)))
        yield from self.motion.turn_to(math.atan2(*(end - begin)[::-1]))
        patience_s = length_m / self.robot.v_push_m_s + self.settings.patience_sigma * task.sigma_s
        yield from self.motion.straight(self.robot.v_push_m_s, length_m, patience_s)
        gone_m = float(np.hypot(*(self.motion.pose_m()[:2] - begin)))
        self._driven_m += gone_m
        self._behind_m, self._as_planned = gone_m, False
        through = gone_m > length_m - self.settings.near_m
        following = self._passed("passed", self.motion.now_s() - start_s, done=through)
        return following if through else TravelState.BACK_OFF

    def _passed(self, event: str, seconds: float, *, done: bool) -> TravelState | None:
        """Next state after a passage has opened, or has stayed closed."""
        task = self._tasks[0]
        if done:
            self._tasks.pop(0)
            self._note(event, task.object, seconds=seconds)
            return self._next()
        self._note("closed", task.object, seconds=seconds)
        self.memory.closed(task.object)
        self.plans.changed()
        return TravelState.PLAN

    def _look_around(self) -> Motion[None]:
        """Locate every object."""
        if self._objects:
            yield TravelCommand(look=self._objects)
        for id in self._objects:
            seen = self.motion.place_m(id)
            if seen is not None and self.memory.seen(id, seen):
                self.plans.changed()
                self._note("looked", id, place_m=[float(value) for value in seen])

    def _note(self, event: str, object: str = "", **values: Any) -> None:
        """Log one event of the task."""
        motion = self.motion
        self.records.append(
            TravelRecord(motion.now_s(), str(self.state), event, motion.seen.pose_m, object, values)
        )

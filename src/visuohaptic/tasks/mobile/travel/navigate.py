"""Drive to a goal and push what is in the way: plan, execute, look, plan again (Alt 2016, Sec. 4.2 to 4.4).

The machine has few states::

    PLAN -> DRIVE -> PUSH, EXPLORE or TURN -> BACK_OFF -> PLAN ... -> ARRIVED or FAILED

It knows the robot as a :class:`~visuohaptic.core.robots.MobileBase` and what it
perceives as :class:`TravelSenses`; whether these are real it never asks.
After every push it looks where the object is, takes down how the push went
(counters of the tag, centre of friction), and plans again: a manipulation
node whose object was moved away is a navigation node then, and one that
failed is avoided (Sec. 4.2.1). Where no straight push helps, it turns an
object by a push beside its centre.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from ....core.errors import InputError
from ....core.geometry import wrap_angle
from ....core.objects import Estimate, HapticTag
from ....core.robots import BaseState, MobileBase, require_members
from ....navigation.grid.cost_grid import SpeedLimits, grid_layers
from ....navigation.planning.off_centre_push import OffCentrePush
from ....navigation.planning.path_follower import FollowLimits, PathFollower
from ....navigation.planning.policies import make_plan
from ....navigation.problem.path_plan import Plan, Task
from ....navigation.problem.planning_problem import PlanningProblem
from ..steered_push import PushEnd, PushSettings, SteeredPush
from .travel_memory import TravelMemory
from .travel_motion import TravelInterrupted, TravelMotion, force_unread
from .travel_plans import TravelPlans
from .travel_trace import TravelRecord
from .travel_types import TravelOutcome, TravelSenses, TravelSettings, TravelState

__all__ = ["Travel", "TravelOutcome", "TravelSenses", "TravelSettings", "TravelState", "travel"]


@dataclass(frozen=True, slots=True, eq=False)
class Travel:
    """The result."""

    outcome: TravelOutcome
    trace: tuple[TravelRecord, ...]
    problem: PlanningProblem  #: as it is believed at the end: map, footprints, tags
    duration_s: float
    length_m: float  #: driven, without backing off
    pushes: int
    plans: int
    reason: str = ""

    @property
    def arrived(self) -> bool:
        """Whether the robot is at the goal."""
        return self.outcome is TravelOutcome.ARRIVED


def travel(
    problem: PlanningProblem,
    base: MobileBase,
    senses: TravelSenses,
    wait: Callable[[float], None],
    settings: TravelSettings | None = None,
    *,
    plan: Callable[[PlanningProblem], Plan] = make_plan,
) -> Travel:
    """Drive to the problem's goal.

    Parameters
    ----------
    problem
        Map, tagged objects, robot, goal; its start is replaced by where the robot is.
    base, senses
        The robot.
    wait
        Called with the period [s] after every command: sleeps, or lets simulated time pass.
    settings
        Limits.
    plan
        The planner; asked with a robot that is larger by a margin.

    Raises
    ------
    InputError
        ``base`` or ``senses`` lacks a member of its protocol.
    """
    require_members(base, MobileBase, "travel")
    require_members(senses, TravelSenses, "travel", "TravelSenses object")
    return _Machine(problem, base, senses, wait, settings or TravelSettings(), plan).run()


@dataclass(slots=True, eq=False)
class _Machine:
    problem: PlanningProblem
    base: MobileBase
    senses: TravelSenses
    wait: Callable[[float], None]
    settings: TravelSettings
    planner: Callable[[PlanningProblem], Plan]
    memory: TravelMemory = field(init=False)
    plans: TravelPlans = field(init=False)
    trace: list[TravelRecord] = field(default_factory=list)
    tasks: list[Task] = field(default_factory=list)
    state: TravelState = TravelState.PLAN
    reason: str = ""
    outcome: TravelOutcome | None = None
    margin_m: float = 0.0
    clearance: Callable[[Float[np.ndarray, "2"]], float] = field(default=lambda _: math.inf)
    pushes: int = 0
    turning: OffCentrePush | None = None  #: what follows the tasks
    length_m: float = 0.0
    as_planned: bool = False  #: the last push did what the plan said
    motion: TravelMotion = field(init=False)
    at_wall: bool = False  #: whether the last push ended at a wall
    behind_m: float = 0.0  #: so far straight behind the robot is known to be free

    def __post_init__(self) -> None:
        self.memory = TravelMemory(self.problem)
        self.plans = TravelPlans(self.memory, self.settings, self.planner, self._planned)
        self.motion = TravelMotion(
            self.base, self.senses, self.wait, self.problem.robot.push_force_max_N, self.settings.timeout_s
        )

    def run(self) -> Travel:
        """From state to state until the end."""
        begin_s = self._now()
        steps = {
            TravelState.PLAN: self._plan,
            TravelState.DRIVE: self._drive,
            TravelState.PUSH: self._push,
            TravelState.EXPLORE: self._explore,
            TravelState.TURN: self._turn,
            TravelState.BACK_OFF: self._back_off,
        }
        try:
            while self.state in steps:
                self.state = steps[self.state]()
        except TravelInterrupted as interrupted:
            self.state = self._end(interrupted.outcome, interrupted.reason)
        finally:
            self.base.stop()
        assert self.outcome is not None
        end_s = self._now()
        return Travel(
            self.outcome,
            tuple(self.trace),
            self.memory.problem(self._pose()),
            end_s - begin_s,
            self.length_m,
            self.pushes,
            self.plans.asked,
            self.reason,
        )

    # ---- planning

    def _plan(self) -> TravelState:
        """Look around, and ask the planner with the largest margin that lets it find something."""
        if self.plans.asked >= self.settings.plans:
            return self._end(TravelOutcome.GAVE_UP, f"after {self.plans.asked} plans")
        self._look_around()
        best, last = self.plans.with_room(self._pose())
        turn = self.plans.turning(self._pose()) if best is None else None
        if best is not None:
            self.margin_m, problem, plan = best
            self.tasks, self.turning = list(plan.tasks), None
        elif turn is not None:
            self.margin_m, problem, self.turning = turn
            way = tuple((float(x), float(y)) for x, y in self.turning.approach_m)
            length_m = float(np.hypot(*np.diff(self.turning.approach_m, axis=0).T).sum())
            self.tasks = [Task("navigate", self.turning.cost_s, length_m, way)] if len(way) > 1 else []
        elif self.plans.reset_failures():
            self._note("forgiven")
            return TravelState.PLAN
        else:
            return self._end(TravelOutcome.NO_PLAN, last.reason)
        self.clearance = _clearance(problem)
        return self._next()

    def _next(self) -> TravelState:
        """State of the next task."""
        if not self.tasks and self.turning is not None:
            return TravelState.TURN
        if not self.tasks:
            return self._end(TravelOutcome.ARRIVED, "")
        return {
            "navigate": TravelState.DRIVE,
            "push": TravelState.PUSH,
            "explore": TravelState.EXPLORE,
        }.get(self.tasks[0].kind, TravelState.PLAN)

    # ---- driving

    def _drive(self) -> TravelState:
        task = self.tasks[0]
        robot = self.problem.robot
        limits = FollowLimits(
            robot.radius_m + self.margin_m, robot.v_max_m_s, min(robot.v_min_m_s, robot.v_max_m_s)
        )
        follower = PathFollower(np.array(task.path_m), limits, clearance=self.clearance)
        pose = last = self._pose()
        moved_s = begin_s = self._now()
        bumped_s = math.nan
        self.motion.new_guard()
        while True:
            pose = self._pose()
            t_s = self._now()
            x, y, heading = (float(value) for value in pose)
            speed, turn = follower.command(BaseState(t_s, x, y, heading, 0.0, 0.0))
            if follower.done:
                self.base.stop()
                self.length_m += task.length_m
                self.tasks.pop(0)
                self.behind_m = 0.0
                self._note("drove", seconds=t_s - begin_s)
                return self._next()
            if np.hypot(*(pose[:2] - last[:2])) > 0.02 or abs(wrap_angle(pose[2] - last[2])) > 0.1:
                last, moved_s = pose, t_s
            force = self.senses.touch()[0]
            if force < self.settings.bump_N or math.isnan(bumped_s):
                bumped_s = t_s
            stalled = t_s - moved_s > self.settings.drive_stall_s
            if stalled or t_s - bumped_s > self.settings.bump_s or t_s - begin_s > 20.0 + 10 * task.cost_s:
                return self._bumped("stalled" if stalled else "bumped", force)
            if not self.motion.go(speed, turn):
                return self._bumped("overloaded", force)

    def _bumped(self, event: str, force_N: float) -> TravelState:
        """Something is where the map has nothing: remember it, back off, plan again."""
        self.base.stop()
        point = self.senses.touch()[1]
        self._look_around()
        new = point is not None and self.memory.touched(np.array(point))
        self._note(event, force_N=force_N, point_m=list(point) if point else [], new=new)
        if new:
            self.plans.changed()
        else:
            self.plans.bumped(self.margin_m)
        self.behind_m, self.as_planned = self.settings.back_off_m, False
        if point is not None and not self.memory.near(np.array(point)):
            self._leave(np.array(point))
            return TravelState.PLAN
        return TravelState.BACK_OFF

    def _leave(self, point: Float[np.ndarray, "2"]) -> None:
        """Away from a wall that is touched: a disc turns on the spot, and what it leaves does not hold it."""
        away = self._pose()[:2] - point
        ahead = math.atan2(away[1], away[0])
        behind = abs(wrap_angle(ahead - float(self._pose()[2]))) > 0.5 * math.pi
        self.motion.turn_to(wrap_angle(ahead + math.pi) if behind else ahead)
        self.motion.straight(-0.05 if behind else 0.05, self.settings.leave_m, 3.0)

    def _back_off(self) -> TravelState:
        """Straight back, over floor that it has just driven on."""
        self.motion.straight(-0.1, self.behind_m, 4.0 + self.behind_m / 0.05)
        if self.as_planned:
            self.tasks.pop(0)
            return self._next()
        return TravelState.PLAN

    # ---- touching

    def _push(self) -> TravelState:
        task = self.tasks[0]
        self.plans.changed()
        assert task.displacement_m is not None
        length_m = float(np.hypot(*task.displacement_m))
        push = self._pushed(task, length_m)
        self.pushes += 1
        item = self.memory.item(task.object)
        seen = self._look(task.object)
        if seen is not None and self.memory.seen(task.object, seen):
            self._note("looked", task.object, place_m=[float(value) for value in seen])
        self.as_planned = (
            push.end is PushEnd.DONE
            and seen is not None
            and task.goal_m is not None
            and float(np.hypot(*(seen[:2] - task.goal_m))) < self.settings.near_m
            and abs(push.turned_rad) < self.settings.near_rad
        )
        moved = float(push.moved_m[0])
        good = moved > max(self.settings.moved_m, 0.5 * length_m)
        if good or moved > self.settings.moved_m:
            self.memory.pushed(task.object, failed=not good)
        elif self._too_heavy(push):
            self.memory.too_heavy(task.object)
        else:
            fixed = (push.end is PushEnd.STALLED and not self.at_wall) or self.memory.failures(
                task.object
            ) + 1 >= self.settings.failures
            self.memory.refused(task.object, fixed=fixed)
        if (beside := push.centre_beside_m()) is not None:
            self.memory.learn_centre(task.object, _direction(task), beside)
        self._note(
            "pushed", task.object, end=str(push.end), moved_m=[float(v) for v in push.moved_m],
            turned_rad=push.turned_rad, length_m=length_m, as_planned=self.as_planned, force_N=_finite(push.force_N[1]), known=item.tag is not None,
        )  # fmt: skip
        return TravelState.BACK_OFF

    def _explore(self) -> TravelState:
        """Touch, push a little, and take down a tag; the next plan decides."""
        task = self.tasks[0]
        self.plans.changed()
        after = next((t for t in self.tasks[1:] if t.kind == "push" and t.object == task.object), None)
        if after is None:
            return TravelState.PLAN
        push = self._pushed(after, self.settings.explore_m)
        moved = float(push.moved_m[0]) > self.settings.moved_m
        robot = self.problem.robot
        first, rest = push.force_N
        observed = math.isfinite(first)
        tag = HapticTag(
            static_friction_N=Estimate(first, 0.1 * first) if observed and moved else None,
            dynamic_friction_N=Estimate(rest, 0.1 * rest) if observed and moved else None,
            fixed=not moved,
            explored=1,
            failed=0 if moved else 1,
            min_static_friction_N=None if moved or not self._too_heavy(push) else robot.push_force_max_N,
        )
        self.memory.explored(task.object, tag)
        self.as_planned = False
        self._note("explored", task.object, end=str(push.end), moved=moved, force_N=_finite(first))
        return TravelState.BACK_OFF

    def _turn(self) -> TravelState:
        """Drive straight against an object beside its centre."""
        wanted, self.turning = self.turning, None
        self.plans.changed()
        assert wanted is not None
        before = self._look(wanted.object)
        way_m = max(wanted.length_m - wanted.free_m, 0.01)
        push = self._touch(wanted.object, wanted.start_m, wanted.direction_rad, way_m, None)
        self.pushes += 1
        after = self._look(wanted.object)
        off = np.zeros(3) if before is None or after is None else after - before
        off[2] = wrap_angle(off[2])
        moved = bool(np.hypot(off[0], off[1]) > self.settings.moved_m or abs(off[2]) > self.settings.near_rad)
        if moved or before is None or after is None:
            self.memory.pushed(wanted.object, failed=False)
        elif self._too_heavy(push):
            self.memory.too_heavy(wanted.object)
        else:
            fixed = self.memory.failures(wanted.object) + 1 >= self.settings.failures
            self.memory.refused(wanted.object, fixed=fixed)
        self.as_planned = False
        self._note(
            "turned", wanted.object, end=str(push.end), moved_m=[float(v) for v in off[:2]],
            turned_rad=float(off[2]), predicted_m=[float(v) for v in wanted.displacement_m],
            predicted_rad=wanted.turn_rad, opens=wanted.opens, force_N=_finite(push.force_N[1]),
        )  # fmt: skip
        return TravelState.BACK_OFF

    def _too_heavy(self, push: SteeredPush) -> bool:
        """Whether a push met an object, and not a wall, that takes more than the platform has."""
        return push.end is PushEnd.TOO_HEAVY and not self.at_wall

    def _pushed(self, task: Task, length_m: float) -> SteeredPush:
        """Push an object through its centre, steering by where it is seen."""
        return self._touch(
            task.object, np.array(task.path_m[0]), _direction(task), length_m, self._look(task.object)
        )

    def _touch(
        self,
        id: str,
        stand: Float[np.ndarray, "2"],
        direction: float,
        length_m: float,
        place: Float[np.ndarray, "3"] | None,
    ) -> SteeredPush:
        """Turn to the object, push it, stop; straight where its place is not given."""
        self.motion.turn_to(direction)
        robot = self.problem.robot
        offset, lever = self.memory.friction(id)
        speed = min(robot.v_push_m_s, robot.v_max_m_s)
        push = SteeredPush(
            stand, direction, length_m, object_m=place, offset_m=offset, lever_m=lever,
            settings=PushSettings(
                radius_m=robot.radius_m, speed_m_s=speed, search_m=0.15 + 2 * self.margin_m,
                max_force_N=robot.push_force_max_N,
                timeout_s=min(30.0 + 3.0 * length_m / speed, self.motion.left_s()),
            ),
        )  # fmt: skip
        begin = self._pose()
        looked_s = -math.inf
        seen = place
        while True:
            t_s = self._now()
            if t_s - looked_s >= self.settings.look_s:
                seen, looked_s = self._look(id) if place is not None else None, t_s
            force, point = self.senses.touch()
            speed_m_s, turn = push.command(t_s, self._pose(), force, point, seen)
            if push.end is not None:
                break
            self.motion.command(speed_m_s, turn)
        self.base.stop()
        if push.end is PushEnd.UNREAD:
            raise force_unread()
        point = self.senses.touch()[1]
        self.motion.halt()
        gone = float(np.hypot(*(self._pose()[:2] - begin[:2])))
        self.length_m += gone
        held = push.end in (PushEnd.STALLED, PushEnd.TOO_HEAVY)
        self.at_wall = held and point is not None and not self.memory.near(np.array(point))
        if self.at_wall and point is not None:
            self._leave(np.array(point))
        self.behind_m = 0.0 if self.at_wall else min(self.settings.back_off_m, gone + 0.02)
        return push

    # ---- perceiving

    def _now(self) -> float:
        return self.base.state().t_s

    def _pose(self) -> Float[np.ndarray, "3"]:
        return np.array(self.senses.pose())

    def _look(self, id: str) -> Float[np.ndarray, "3"] | None:
        seen = self.senses.look(id)
        return None if seen is None else np.array(seen)

    def _look_around(self) -> None:
        for item in self.problem.objects:
            seen = self._look(item.id)
            if seen is not None and self.memory.seen(item.id, seen):
                self.plans.changed()
                self._note("looked", item.id, place_m=[float(value) for value in seen])

    def _planned(self, event: str, **values: Any) -> None:
        self._note(event, **values)

    def _note(self, event: str, object: str = "", **values: Any) -> None:
        x, y, heading = (float(value) for value in self._pose())
        self.trace.append(TravelRecord(self._now(), str(self.state), event, (x, y, heading), object, values))

    def _end(self, outcome: TravelOutcome, reason: str) -> TravelState:
        self.outcome, self.reason = outcome, reason
        arrived = outcome is TravelOutcome.ARRIVED
        self._note(str(outcome), reason=reason)
        return TravelState.ARRIVED if arrived else TravelState.FAILED


def _clearance(problem: PlanningProblem) -> Callable[[Float[np.ndarray, "2"]], float]:
    """Distance to the nearest obstacle at a point, from the map that was planned in."""
    robot = problem.robot
    layers = grid_layers(problem.map, SpeedLimits(robot.radius_m, robot.v_max_m_s, robot.v_min_m_s))
    distance, grid = layers.distance_m, problem.map
    x, y, yaw = grid.origin
    c, s, scale = math.cos(yaw), math.sin(yaw), 1.0 / grid.resolution_m
    rows, columns = grid.shape

    def clearance(point: Float[np.ndarray, "2"]) -> float:
        dx, dy = float(point[0]) - x, float(point[1]) - y
        column, row = int((c * dx + s * dy) * scale), int((c * dy - s * dx) * scale)
        return float(distance[row, column]) if 0 <= row < rows and 0 <= column < columns else 0.0

    return clearance


def _direction(task: Task) -> float:
    if task.displacement_m is None:
        raise InputError("travel", f"found a {task.kind} task without displacement_m, expected one")
    return math.atan2(task.displacement_m[1], task.displacement_m[0])


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None

"""Pushes of a navigation task: through the centre of an object, off-centre, or for exploration (Alt 2016, Sec. 4.3)."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ....core.errors import InputError
from ....core.measurement import normal_sigmas
from ....core.objects import Estimate, HapticTag
from ....core.robots import BaseState
from ....navigation.planning.path_follower import FollowLimits, PathFollower
from ....navigation.planning.sideward_plan import SidewardCheck
from ....navigation.problem.path_plan import Task
from ....navigation.problem.planning_problem import PlanningProblem, RobotModel
from ....navigation.pushing.push_monitor import PushMonitor
from ....navigation.pushing.quasi_static import line_path
from ..outline_curvature import contact_curvature
from ..steered_push import PushEnd, PushSettings, SteeredPush
from .travel_memory import TravelMemory
from .travel_motion import Motion, TravelMotion, force_unread
from .travel_types import PERIOD_S, TravelCommand, TravelSettings

#: Bound of the lateral offset at the end of a push in standard deviations: exceeded by one in a hundred as declared.
ASIDE_SIGMAS = normal_sigmas(0.01)


class TravelPushes:
    """Pushes objects and updates their estimates.

    Parameters
    ----------
    robot
        Radius, speeds and force of the platform.
    memory
        Poses and tags of the objects.
    motion
        Motion primitives of the platform.
    settings
        Limits and tolerances.
    note
        Logs an event with an object and values.
    """

    def __init__(
        self,
        robot: RobotModel,
        memory: TravelMemory,
        motion: TravelMotion,
        settings: TravelSettings,
        note: Callable[..., None],
    ) -> None:
        self._robot, self._memory, self._motion, self._settings = robot, memory, motion, settings
        self._note = note
        self.count = 0  #: number of pushes towards a planned goal
        self.driven_m = 0.0  #: distance driven in all pushes
        self.margin_m = 0.0  #: margin beside the robot of the present plan
        self.behind_m = 0.0  #: known free distance straight behind the robot after the last push
        self._at_wall = False  #: whether the last push ended at a wall
        #: Pose of the last pushed object, if it is known by touch only.
        self._felt_m: Float[np.ndarray, "3"] | None = None
        self._gone_m = 0.0  #: length of the last push

    def push(self, task: Task) -> Motion[bool]:
        """Push an object as planned.

        Parameters
        ----------
        task
            A task of kind "push".

        Returns
        -------
        bool
            Whether the object is at its planned goal.
        """
        assert task.displacement_m is not None
        settings = self._settings
        length_m = float(np.hypot(*task.displacement_m))
        push = yield from self._through_centre(task, length_m, task.turn_rad)
        self.count += 1
        if self._robot.footprint_m:  # the plan has room to turn there
            ahead = np.array([math.cos(_direction(task)), math.sin(_direction(task))])
            back_m = float((self._motion.pose_m()[:2] - task.path_m[-1]) @ ahead)
            self.behind_m = min(max(self.behind_m, back_m), self._gone_m + 0.02)
        known = self._memory.item(task.object).tag is not None
        seen = yield from self._look(task.object, self._felt_m)
        as_planned = (
            push.end is PushEnd.DONE
            and seen is not None
            and task.goal_m is not None
            and float(np.hypot(*(seen[:2] - task.goal_m))) < settings.near_m
            and abs(push.turned_rad - task.turn_rad) < settings.near_rad
        )
        moved_m = float(push.moved_m[0])
        good = moved_m > max(settings.moved_m, 0.5 * length_m)
        stalled = push.end is PushEnd.STALLED and not self._at_wall
        moved = good or moved_m > settings.moved_m
        self._learn(task.object, moved=moved, failed=not good, heavy=self._too_heavy(push), fixed=stalled)
        if self._felt_m is None and (beside := push.centre_offset_m()) is not None:
            self._memory.learn_centre(task.object, _direction(task), beside)
        self._note(
            "pushed", task.object, end=str(push.end), moved_m=[float(v) for v in push.moved_m],
            turned_rad=push.turned_rad, length_m=length_m, as_planned=as_planned,
            force_N=_finite(push.force_N[1]), known=known,
        )  # fmt: skip
        return as_planned

    def sideward(self, task: Task, problem: PlanningProblem) -> Motion[bool | None]:
        """Push an object aside while driving past it; the path is replanned from the contacts (Sec. 4.3.2).

        Parameters
        ----------
        task
            A task of kind "sideward".
        problem
            Present planning problem, with the margins of the plan.

        Returns
        -------
        bool or None
            Whether the object is at its planned goal; ``None`` if the robot did not get past it.
        """
        motion, settings = self._motion, self._settings
        check = SidewardCheck(problem, task.object)
        monitor = PushMonitor(check.model, check.place_m, self._robot.radius_m)
        start = motion.pose_m()
        end, corrections = yield from self._past(task, check, monitor)
        yield from motion.halt()
        gone_m = float(np.hypot(*(motion.pose_m()[:2] - start[:2])))
        self.count += 1
        self.driven_m += gone_m
        self.behind_m = min(settings.back_off_m, gone_m + 0.02)
        seen = yield from self._look(task.object)
        moved_m = 0.0 if seen is None else float(np.hypot(*(seen[:2] - check.place_m[:2])))
        moved = end == "done" or moved_m > settings.moved_m
        self._learn(task.object, moved=moved, failed=end != "done", heavy=end == "too heavy")
        near = seen is not None and float(np.hypot(*(seen[:2] - np.array(task.goal_m)))) < settings.near_m
        self._note(
            "brushed", task.object, end=end, moved_m=moved_m, corrections=corrections, as_planned=near,
            residual_m=monitor.estimate().residual_m,
        )  # fmt: skip
        return near if end == "done" else None

    def _past(self, task: Task, check: SidewardCheck, monitor: PushMonitor) -> Motion[tuple[str, int]]:
        """Follow a path past an object; returns how it ended, and the number of path corrections."""
        motion, robot = self._motion, self._robot
        speed = min(robot.v_push_m_s, robot.v_max_m_s)
        limits = FollowLimits(robot.radius_m, speed, min(robot.v_min_m_s, speed))
        corners, rng, corrections = np.array(task.path_m), np.random.default_rng(0), 0
        yield from motion.turn_to(math.atan2(*(corners[1] - corners[0])[::-1]))
        follower, begin_s = PathFollower(corners, limits), motion.now_s()
        patience_s = self._settings.drive_stall_s + 3.0 * task.length_m / speed
        motion.new_guard()
        while True:
            pose, now_s = motion.pose_m(), motion.now_s()
            if now_s - begin_s > patience_s:
                return "stalled", corrections
            if monitor.update(motion.seen.pose_m, motion.seen.point_m) and motion.seen.point_m:
                rest = _poses(np.vstack([pose[:2], follower.rest_m]))
                bent = monitor.corrected(
                    rest, rng, allowed=lambda path, trace: check.free(path, trace.object_m)
                )
                if bent is None:
                    return "gave up", corrections
                if bent is not rest:
                    follower, corrections = PathFollower(bent[[0, -1], :2], limits), corrections + 1
            command = follower.command(BaseState(now_s, *motion.seen.pose_m, 0.0, 0.0))
            if follower.done:
                return "done", corrections
            if not (yield from motion.go(*command)):
                return "too heavy", corrections

    def explore(self, task: Task) -> Motion[None]:
        """Touch an unknown object, push it a little, and record a tag.

        Parameters
        ----------
        task
            The push for which the plan needs the tag.
        """
        push = yield from self._through_centre(task, self._settings.explore_m)
        moved = float(push.moved_m[0]) > self._settings.moved_m
        first, rest = push.force_N
        observed = math.isfinite(first)
        tag = HapticTag(
            static_friction_N=Estimate(first, 0.1 * first) if observed and moved else None,
            dynamic_friction_N=Estimate(rest, 0.1 * rest) if observed and moved else None,
            fixed=not moved,
            explored=1,
            failed=0 if moved else 1,
            min_static_friction_N=None
            if moved or not self._too_heavy(push)
            else self._robot.push_force_max_N,
        )
        self._memory.explored(task.object, tag)
        if self._felt_m is not None:
            self._memory.seen(task.object, self._felt_m)
        self._note("explored", task.object, end=str(push.end), moved=moved, force_N=_finite(first))

    def turn(self, task: Task) -> Motion[None]:
        """Rotate an object by a straight off-centre push.

        Parameters
        ----------
        task
            A task of kind "turn".
        """
        before = yield from self._motion.look(task.object)
        start, touch, end = np.array(task.path_m[:3])
        direction = math.atan2(*(end - start)[::-1])
        length_m = max(float(np.hypot(*(end - touch))), 0.01)
        push = yield from self._contact(task.object, start, direction, length_m)
        self.count += 1
        after = yield from self._motion.look(task.object)
        off = np.zeros(3) if before is None or after is None else after - before
        off[2] = math.remainder(off[2], 2.0 * math.pi)
        settings = self._settings
        moved = bool(np.hypot(off[0], off[1]) > settings.moved_m or abs(off[2]) > settings.near_rad)
        unseen = before is None or after is None
        self._learn(task.object, moved=moved or unseen, failed=False, heavy=self._too_heavy(push))
        self._note(
            "turned", task.object, end=str(push.end), moved_m=[float(v) for v in off[:2]],
            turned_rad=float(off[2]), predicted_rad=task.turn_rad, force_N=_finite(push.force_N[1]),
        )  # fmt: skip

    def _look(
        self, id: str, felt_m: Float[np.ndarray, "3"] | None = None
    ) -> Motion[Float[np.ndarray, "3"] | None]:
        """Locate an object, by touch where it is not seen, and update its pose if it has moved."""
        seen = yield from self._motion.look(id)
        seen = felt_m if seen is None else seen
        if seen is not None and self._memory.seen(id, seen):
            self._note("looked", id, place_m=[float(value) for value in seen])
        return seen

    def _learn(self, id: str, *, moved: bool, failed: bool, heavy: bool, fixed: bool = False) -> None:
        """Update the tag of an object after a push or a refusal."""
        if moved:
            self._memory.pushed(id, failed=failed)
        elif heavy:
            self._memory.too_heavy(id)
        else:
            often = self._memory.failures(id) + 1 >= self._settings.failures
            self._memory.refused(id, fixed=fixed or often)

    def _too_heavy(self, push: SteeredPush) -> bool:
        """Whether a push met an object, not a wall, that withstood the maximum push force."""
        return push.end is PushEnd.TOO_HEAVY and not self._at_wall

    def _through_centre(self, task: Task, length_m: float, turn_rad: float = 0.0) -> Motion[SteeredPush]:
        """Push an object through its centre, steered by its pose, which is seen or follows from the contacts."""
        place = yield from self._motion.look(task.object)
        place = self._memory.push_model(task.object)[1] if place is None else place
        stand = np.array(task.path_m[0])
        direction = _direction(task)
        left = np.array([-math.sin(direction), math.cos(direction), 0.0])
        # Lateral offset declared for the end of the push; it is also accepted on the way.
        aside_m = (
            ASIDE_SIGMAS * math.sqrt(left @ np.array(task.end_covariance) @ left)
            if task.end_covariance
            else math.inf
        )
        curvature = 0.0
        if task.contact_m is not None:
            outline_m = self._memory.item(task.object).footprint_m
            curvature = contact_curvature(outline_m, task.contact_m, self._robot.radius_m)
        return (
            yield from self._contact(
                task.object, stand, direction, length_m, place, aside_m, turn_rad, curvature
            )
        )

    def _contact(
        self,
        id: str,
        stand: Float[np.ndarray, "2"],
        direction: float,
        length_m: float,
        place: Float[np.ndarray, "3"] | None = None,
        aside_m: float = math.inf,
        turn_rad: float = 0.0,
        curvature: float = 0.0,
    ) -> Motion[SteeredPush]:
        """Turn to the object, push it, stop; straight if its pose is not given."""
        motion, settings, robot = self._motion, self._settings, self._robot
        yield from motion.turn_to(direction)
        model, _ = self._memory.push_model(id)
        speed = min(robot.v_push_m_s, robot.v_max_m_s)
        planned = robot.grown(self.margin_m)
        limits = PushSettings(
            radius_m=robot.front_m,
            steered=not robot.footprint_m,
            speed_m_s=speed,
            search_m=0.12 + planned.stand_off_m + 2 * self.margin_m,
            max_force_N=robot.push_force_max_N,
            timeout_s=min(30.0 + 3.0 * length_m / speed, motion.remaining_s()),
            aside_m=aside_m,
            curvature_per_m=curvature,
        )
        start = motion.pose_m()
        # At the first contact, the platform's own momentum may reach the limit: from there it is pressed once more, from rest.
        for _ in range(2):
            push = SteeredPush(
                stand, direction, length_m, turn_rad=turn_rad, object_m=place, offset_m=model.centre_m,
                lever_m=model.lever_m, settings=limits,
            )  # fmt: skip
            yield from self._steered(push, id, place)
            point = motion.point_m()
            yield from motion.halt()
            if not (push.end is PushEnd.TOO_HEAVY and push.is_impact):
                break
        gone_m = float(np.hypot(*(motion.pose_m()[:2] - start[:2])))
        self.driven_m += gone_m
        self._gone_m = gone_m
        held = push.end in (PushEnd.STALLED, PushEnd.TOO_HEAVY)
        self._at_wall = held and point is not None and not self._memory.near(point)
        turns_there = self._at_wall and not robot.footprint_m
        if turns_there and point is not None:
            yield from motion.leave(point, settings.leave_m)
        room_m = settings.back_off_m + robot.reach_m - robot.front_m
        self.behind_m = 0.0 if turns_there else min(room_m, gone_m + 0.02)
        return push

    def _steered(self, push: SteeredPush, id: str, place: Float[np.ndarray, "3"] | None) -> Motion[None]:
        """Drive until the push has ended, looking at the object if its pose is given.

        While it is not located, its pose is that which explains the contacts on the rim.
        """
        motion, looked_s, seen = self._motion, -math.inf, place
        monitor: PushMonitor | None = None
        felt, felt_at = None, motion.pose_m()  # pose by the monitor, and of the platform then
        self._felt_m = None
        while True:
            now_s = motion.now_s()
            force_N, point_m = motion.seen.force_N, motion.seen.point_m
            pose = motion.pose_m()
            if monitor is not None and monitor.update(motion.seen.pose_m, point_m) and push.touched:
                felt, felt_at = monitor.estimate().object_m, pose
            if felt is not None:  # since the last step of the monitor, it has moved as far as the platform
                self._felt_m = seen = felt + np.array([*(pose - felt_at)[:2], 0.0])
            speed_m_s, turn = push.command(now_s, pose, force_N, point_m, seen)
            if push.end is PushEnd.UNREAD:
                raise force_unread()
            if push.end is not None:
                return
            # A look requested with this command is observed after it.
            due = place is not None and now_s + PERIOD_S - looked_s >= self._settings.look_s
            yield TravelCommand(speed_m_s, turn, (id,) if due else ())
            if not due:
                continue
            located, looked_s = motion.place_m(id), motion.now_s()
            if located is not None:
                seen, monitor, felt, self._felt_m = located, None, None, None
            elif monitor is None and seen is not None and not self._robot.footprint_m:  # its rim is a circle
                monitor = PushMonitor(self._memory.push_model(id)[0], seen.tolist(), self._robot.front_m)


def _direction(task: Task) -> float:
    if task.displacement_m is None:
        raise InputError("travel", f"found a {task.kind} task without displacement_m, expected one")
    return math.atan2(task.displacement_m[1], task.displacement_m[0])


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _poses(corners_m: Float[np.ndarray, "c 2"]) -> Float[np.ndarray, "k 3"]:
    """Poses along straight lines from corner to corner: x, y [m], heading [rad]."""
    lines = [line_path(a, b) for a, b in pairwise(corners_m) if np.hypot(*(b - a)) > 1e-9]
    parts = [line[:-1] for line in lines[:-1]] + lines[-1:]
    return np.concatenate(parts) if parts else np.zeros((0, 3))

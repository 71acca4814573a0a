"""Navigation among movable objects as a node: takes map, pose and goal, publishes a plan."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future
from typing import Any

import numpy as np
from pydantic import Field

from ...core import DeviceError, Pose
from ...core.files.plain_json import dumps
from ...core.resources import WAIT_S
from ...io.ros import ros_messages as messages
from ...navigation.planning.policies import make_plan
from ...navigation.planning.search.push_states import SearchLimits
from ...navigation.problem import Plan, PlanningProblem
from ..markers import arrow
from ..transports.topic_node import Received
from ..wire.graph import LATCHED
from .component import Status
from .map_nodes import MapNode, MapParameters


class PlanParameters(MapParameters):
    """Parameters of the node plan."""

    pose: str = Field(
        "amcl_pose", description="topic of geometry_msgs/PoseWithCovarianceStamped in the map frame"
    )
    goal: str = Field("goal_pose", description="topic of geometry_msgs/PoseStamped, as RViz sends it")
    budget_s: float = Field(2.0, ge=0.01, le=600.0, description="CPU time of a search [s]")


class PlanNode(MapNode):
    """Plans when a goal arrives, and when ``~/plan`` is called; a new goal replaces the previous one."""

    summary = "navigation among movable objects: OccupancyGrid and goal in, Path, markers and tasks out"
    parameter_model = PlanParameters

    def configure(self) -> None:
        super().configure()
        parameters, node = self.parameters, self.host.node
        self._newest: dict[str, Any] = {}
        self._lock, self._asked = threading.Lock(), list[Future[Mapping[str, Any]]]()
        self._path = node.advertise("plan", "nav_msgs/msg/Path", LATCHED)
        self._markers = node.advertise("plan/pushes", "visualization_msgs/msg/MarkerArray", LATCHED)
        self._tasks = node.advertise("plan/tasks", "std_msgs/msg/String", LATCHED)
        pose = "geometry_msgs/msg/PoseWithCovarianceStamped"
        node.subscribe(parameters.pose, pose, self._take("pose"), LATCHED)
        node.subscribe(parameters.goal, "geometry_msgs/msg/PoseStamped", self._take("goal"))
        self.host.offer("~/plan", self.plan)

    def _take(self, name: str) -> Any:
        def take(received: Received) -> None:
            self._newest[name] = received.message
            if name == "goal":
                self._due.set()

        return take

    def plan(self) -> Mapping[str, Any]:
        """Let the node's thread plan to the latest goal and publish the plan.

        Waits as long as a search may take (three times its budget in wall time), or until the node is
        deactivated.

        Raises
        ------
        DeviceError
            Map, pose or goal are missing, the node was deactivated in the meantime, or the search does not end.
        InputError
            Start or goal is not in free space, or in another frame than the map.
        """
        answer: Future[Mapping[str, Any]] = Future()
        with self._lock:
            self._asked.append(answer)
        self._due.set()
        limit_s = 3.0 * self.parameters.budget_s + WAIT_S
        try:
            return answer.result(limit_s)
        except TimeoutError as error:
            raise DeviceError(f"no plan after {limit_s:g} s; lower budget_s or ask again") from error

    def work(self) -> None:
        with self._lock:
            asked = tuple(self._asked)
        try:
            self._answer(asked, self._search().to_json())
        except Exception as error:
            self._answer(asked, error)
            raise

    def _answer(
        self, asked: Iterable[Future[Mapping[str, Any]]], found: Mapping[str, Any] | Exception
    ) -> None:
        """Answer all waiting requests."""
        with self._lock:
            for answer in set(asked).intersection(self._asked):
                self._asked.remove(answer)
                if isinstance(found, Exception):
                    answer.set_exception(found)
                else:
                    answer.set_result(found)

    def deactivate(self) -> None:
        self._end.set()
        gone = DeviceError(f"the node {self.host.node.name} was deactivated in the meantime")
        self._answer(tuple(self._asked), gone)
        self._due.clear()  # requests end with the activation in which they were made
        super().deactivate()

    def _search(self) -> Plan:
        end, newest = self._end, self._newest | ({} if self._map is None else {"map": self._map})
        if missing := [name for name in ("map", "pose", "goal") if name not in newest]:
            topics = ", ".join(self.host.node.resolve(getattr(self.parameters, name)) for name in missing)
            raise DeviceError(f"nothing on {topics} yet; check that it is published")
        posed, aimed = (
            self.in_map(newest[name], getattr(self.parameters, name)) for name in ("pose", "goal")
        )
        start, goal = _place(posed.pose.pose), _place(aimed.pose)
        problem = PlanningProblem(self._grid(), self._robot, start, goal, self._objects, self._passages)
        found = make_plan(problem, limits=SearchLimits(self.parameters.budget_s))
        self.still(end)
        self._publish(found, newest["map"].header.frame_id)
        words = {"cost_s": found.cost_s if found.reachable else "none", "pushes": len(found.pushes)}
        self._told = Status(found.reachable, found.answer if found.reachable else found.reason, words)
        return found

    def _publish(self, found: Plan, frame: str) -> None:
        t_s = self.host.node.now_s()
        header = messages.header(t_s, frame)
        poses = [{"header": header, "pose": messages.pose(pose)} for pose in _poses(found)]
        self._path.publish({"header": header, "poses": poses})
        pushes = [
            arrow(t_s, frame, task.object, number, _pushed(task), width_m=0.05)
            for number, task in enumerate(found.pushes)
            if task.goal_m and task.displacement_m
        ]
        self._markers.publish({"markers": pushes})
        self._tasks.publish({"data": dumps(found.to_json())})


def _place(pose: Any) -> np.ndarray:
    return np.array([pose.position.x, pose.position.y])


def _pushed(task: Any) -> list[list[float]]:
    (x, y), (dx, dy) = task.goal_m, task.displacement_m
    return [[x - dx, y - dy, 0.0], [x, y, 0.0]]


def _poses(found: Plan) -> Iterator[Pose]:
    """Positions of the whole plan, each oriented towards the next one."""
    points = np.array([point for task in found.tasks for point in task.path_m]).reshape(-1, 2)
    steps = np.diff(points, axis=0, append=points[-1:])
    heading = 0.0
    for (x, y), (dx, dy) in zip(points, steps, strict=True):
        heading = float(np.arctan2(dy, dx)) if dx or dy else heading
        yield Pose.from_rotation_vector(np.array([0.0, 0.0, heading]), np.array([x, y, 0.0]))

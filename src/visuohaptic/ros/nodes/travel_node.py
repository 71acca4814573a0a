"""Navigation among movable objects as a node: Nav2's navigation action, via ``cmd_vel``."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from ...core import DeviceError, StaleFrameError, VisuohapticError, compose_2d, relative_2d, wrap_angle
from ...navigation.problem.planning_problem import PlanningProblem
from ...tasks.mobile.travel.navigate import Travel, travel
from ..frames import planar
from ..latest import LatestMessage
from ..robots.mobile_base import RosBase
from ..transports.topic_node import Received, TopicNode
from ..wire.graph import LATCHED
from .component import Status
from .map_nodes import MapNode, MapParameters, objects_text


class TravelParameters(MapParameters):
    """Parameters of the node travel."""

    pose: str = Field(
        "amcl_pose",
        description="topic of PoseWithCovarianceStamped in the map; empty: odometry is of the map",
    )
    odometry: str = Field("odom", description="topic of nav_msgs/Odometry")
    command: str = Field("cmd_vel", description="topic of geometry_msgs/Twist")
    stamped_frame: str = Field("", description="send TwistStamped in this frame, as base_link; empty: Twist")
    wrench: str = Field("foam/wrench", description="topic of WrenchStamped of the bumper, force along x")
    seen: str = Field("seen", description="objects are seen on SEEN/ID: geometry_msgs/PoseStamped in the map")
    action: str = Field("navigate_through_pushes", description="name of the action, nav2_msgs/NavigateToPose")
    goal: str = Field("goal_pose", description="topic of geometry_msgs/PoseStamped, as RViz sends it")
    max_speed_m_s: float = Field(0.5, gt=0.0, le=5.0, description="larger commands are an error [m/s]")
    touch_N: float = Field(0.3, gt=0.0, le=100.0, description="smaller forces are not a contact [N]")
    max_age_s: float = Field(0.5, gt=0.0, le=10.0, description="older odometry and forces count as none [s]")


class _CancelledError(VisuohapticError):
    """The goal was cancelled."""


class _Senses:
    """Localisation, bumper and object observations from topics."""

    def __init__(
        self, node: TopicNode, base: RosBase, chosen: TravelParameters, ids: tuple[str, ...]
    ) -> None:
        self._base, self._chosen = base, chosen
        self.radius_m = 0.0
        self._lock = threading.Lock()
        self._map_odom = (0.0, 0.0, 0.0)
        stamped = "geometry_msgs/msg/PoseStamped"
        if chosen.pose:
            pose = "geometry_msgs/msg/PoseWithCovarianceStamped"
            node.subscribe(chosen.pose, pose, self._locate, LATCHED)
        wrench = "geometry_msgs/msg/WrenchStamped"
        self._wrench = LatestMessage(node, chosen.wrench, wrench, chosen.max_age_s)
        self._seen = {id: LatestMessage(node, f"{chosen.seen}/{id}", stamped, chosen.max_age_s) for id in ids}
        self.turned: dict[str, float] = {}  #: heading of each object at its first observation [rad]
        self.located = not chosen.pose
        self.place: Any = None  #: latest message of the robot's pose in the map

    def _locate(self, received: Received) -> None:
        """Compute the pose of the odometry frame in the map, from the robot's pose in both."""
        try:
            state = self._base.state()
        except StaleFrameError:
            return
        base_odom = relative_2d((state.x_m, state.y_m, state.heading_rad), (0.0, 0.0, 0.0))
        with self._lock:
            self._map_odom = compose_2d(planar(received.message.pose.pose), base_odom)
            self.located, self.place = True, received.message

    def pose(self) -> tuple[float, float, float]:
        state = self._base.state()
        with self._lock:
            x, y, heading = compose_2d(self._map_odom, (state.x_m, state.y_m, state.heading_rad))
        return x, y, wrap_angle(heading)

    def touch(self) -> tuple[float, tuple[float, float] | None]:
        try:
            force_N = abs(self._wrench.get(0.0).message.wrench.force.x)
        except StaleFrameError:
            return math.nan, None
        if not force_N >= self._chosen.touch_N:
            return (0.0 if force_N == force_N else math.nan), None
        x, y, heading = self.pose()
        return force_N, (x + self.radius_m * math.cos(heading), y + self.radius_m * math.sin(heading))

    def look(self, id: str) -> tuple[float, float, float] | None:
        try:
            x, y, heading = planar(self._seen[id].get(0.0).message.pose)
        except (KeyError, StaleFrameError):
            return None
        begin = self.turned.setdefault(id, heading)
        return x, y, math.remainder(heading - begin, 2.0 * math.pi)


class TravelNode(MapNode):
    """Drives to goals of the action or topic, and pushes obstacles where that costs less than a detour."""

    summary = "drives to a goal among movable objects: NavigateToPose action and goal topic in, cmd_vel out"
    parameter_model = TravelParameters

    def configure(self) -> None:
        super().configure()
        parameters, node = self.parameters, self.host.node
        self._base = RosBase(
            node,
            command=parameters.command,
            odometry=parameters.odometry,
            stamped_frame=parameters.stamped_frame or None,
            max_speed_m_s=parameters.max_speed_m_s,
            max_age_s=parameters.max_age_s,
        )
        self._senses = _Senses(node, self._base, parameters, tuple(each.id for each in self._objects))
        self._senses.radius_m = self._robot.front_m
        self._known = node.advertise("objects", "std_msgs/msg/String", LATCHED)
        self._driving = threading.Lock()
        self._cancel = threading.Event()
        self._goal: Any = None
        node.subscribe(parameters.goal, "geometry_msgs/msg/PoseStamped", self._take_goal)
        self.host.offer("~/cancel", self._take_back)
        self.host.act(parameters.action, "nav2_msgs/action/NavigateToPose", self.navigate)

    def _take_goal(self, received: Received) -> None:
        if self.host.active.is_set() and not self._driving.locked():
            self._cancel.clear()
            self._goal = received.message
            self._due.set()

    def work(self) -> None:
        self.drive(self._goal, self.parameters.goal, lambda remaining_m: None, self._cancel.is_set)

    def _take_back(self) -> Mapping[str, Any]:
        self._cancel.set()
        return {"driving": self._driving.locked()}

    def navigate(
        self, goal: Any, tell: Callable[[Mapping[str, Any]], None], cancelled: Callable[[], bool]
    ) -> bool:
        """Execute a ``NavigateToPose`` goal; returns whether the robot has arrived.

        Parameters
        ----------
        goal
            Goal with ``pose``, a PoseStamped in the map.
        tell
            Called with the feedback's fields.
        cancelled
            Returns whether the goal was cancelled.

        Raises
        ------
        VisuohapticError
            The goal was cancelled, or the robot cannot be driven.
        """
        done = self.drive(
            goal.pose,
            self.parameters.action,
            lambda remaining_m: tell({"distance_remaining": remaining_m}),
            cancelled,
        )
        return done.arrived

    def drive(
        self, goal: Any, topic: str, tell: Callable[[float], None], cancelled: Callable[[], bool]
    ) -> Travel:
        """Drive to a position in the map.

        Parameters
        ----------
        goal
            PoseStamped.
        topic
            Topic or action that it comes from, for messages.
        tell
            Called about twice per second with the distance to the goal [m].
        cancelled
            Returns whether to stop.

        Raises
        ------
        DeviceError
            The robot is already driving, or map, localisation or odometry are missing.
        InputError
            Goal or localisation is in another frame than the map.
        """
        if not self._driving.acquire(blocking=False):
            raise DeviceError("the robot is driving to another goal; cancel that first")
        try:
            if self._map is None or not self._senses.located:
                place = self.parameters.map if self._map is None else self.parameters.pose
                raise DeviceError(
                    f"nothing on {self.host.node.resolve(place)} yet; check that it is published"
                )
            goal_m = planar(self.in_map(goal, topic).pose)[:2]
            if self._senses.place is not None:
                self.in_map(self._senses.place, self.parameters.pose)
            start = np.array(self._senses.pose()[:2])
            problem = PlanningProblem(
                self._grid(), self._robot, start, np.array(goal_m), self._objects, self._passages
            )
            self._told = Status(True, "driving")
            periods = iter(range(10**9))

            def wait(period_s: float) -> None:
                if cancelled() or not self.host.active.is_set():
                    raise _CancelledError("the goal was cancelled")
                if next(periods) % 25 == 0:
                    x, y, _ = self._senses.pose()
                    tell(math.hypot(goal_m[0] - x, goal_m[1] - y))
                time.sleep(period_s)

            done = travel(problem, self._base, self._senses, wait)
            # Final positions and tags of the pushed objects; their rotation is relative to these.
            self._objects = done.problem.objects
            self._senses.turned.clear()
            self._known.publish({"data": objects_text(self._objects)})
            counts = {"pushes": done.pushes, "plans": done.plans, "length_m": done.length_m}
            self._told = Status(done.arrived, done.outcome.value, counts)
            return done
        finally:
            self._driving.release()

    def deactivate(self) -> None:
        self._cancel.set()
        super().deactivate()

    def close(self) -> None:
        super().close()
        self._base.close()

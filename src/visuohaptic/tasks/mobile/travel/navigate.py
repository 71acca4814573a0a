"""Navigation among movable obstacles: drive to a goal and push obstacles out of the way (Alt 2016, Sec. 4.2 to 4.4).

:func:`travel` is the loop around :class:`~visuohaptic.tasks.mobile.travel.travel_task.TravelTask`. It uses the
robot as a :class:`~visuohaptic.core.robots.MobileBase` and its perception as :class:`TravelSenses`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from ....core.errors import InputError
from ....core.robots import MobileBase, require_members
from ....navigation.planning.policies import make_plan
from ....navigation.problem import Plan, PlanningProblem
from ...framework import Trace, run_machine
from .travel_task import TravelTask
from .travel_types import (
    PERIOD_S,
    ObjectSighting,
    PassageSenses,
    TravelCommand,
    TravelObservation,
    TravelOutcome,
    TravelRecord,
    TravelSenses,
    TravelSettings,
)


@dataclass(frozen=True, slots=True, eq=False)
class Travel:
    """Result of a navigation task."""

    outcome: TravelOutcome
    records: tuple[TravelRecord, ...]  #: log of events
    trace: Trace  #: every control period; can be replayed by ``TravelTask``
    problem: PlanningProblem  #: estimate at the end: map, footprints, tags
    duration_s: float
    length_m: float  #: distance driven, without retreats
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
    passages: PassageSenses | None = None,
) -> Travel:
    """Drive to the goal of a planning problem.

    Parameters
    ----------
    problem
        Map, tagged objects, robot, goal; its start is replaced by the pose of the robot.
    base
        The platform.
    senses
        Localisation, rim and cameras of the robot.
    wait
        Called with the period [s] after every command: sleeps, or advances simulated time.
    settings
        Margins, limits and tolerances.
    plan
        Planner; called with a robot radius enlarged by a margin.
    passages
        Doors and elevators; by default the robot waits for their expected opening time, and drives on.

    Raises
    ------
    InputError
        ``base`` or ``senses`` lacks a member of its protocol.

    Examples
    --------
    A simulated platform in an empty room:

    >>> import numpy as np
    >>> from visuohaptic.io.maps import OccupancyMap
    >>> from visuohaptic.navigation.problem import RobotModel
    >>> from visuohaptic.simulation.floor import FloorSenses, FloorWorld
    >>> cells = np.zeros((60, 80), np.int8)
    >>> cells[[0, -1]] = cells[:, [0, -1]] = 100
    >>> room = OccupancyMap(cells, 0.05)
    >>> problem = PlanningProblem(room, RobotModel(0.17), np.array([0.7, 1.5]), np.array([1.5, 1.5]))
    >>> world = FloorWorld(room, [], (0.7, 1.5, 0.0))
    >>> done = travel(problem, world.base, FloorSenses(world, np.random.default_rng(0)), world.step)
    >>> done.arrived, round(done.length_m, 1), done.pushes
    (True, 0.8, 0)
    """
    _check_robot(base, senses, "travel")
    task = TravelTask(problem, settings, plan, without_passage_sensors=passages is None)
    return drive_task(task, base, senses, wait, passages=passages)


def _check_robot(base: MobileBase, senses: TravelSenses, task: str) -> None:
    require_members(base, MobileBase, task)
    require_members(senses, TravelSenses, task, "TravelSenses object")


def drive_task(
    task: TravelTask,
    base: MobileBase,
    senses: TravelSenses,
    wait: Callable[[float], None],
    *,
    passages: PassageSenses | None = None,
) -> Travel:
    """Run a navigation task to its end.

    Parameters
    ----------
    task
        The task; it was not started before.
    base, senses, wait, passages
        See :func:`travel`.

    Raises
    ------
    InputError
        ``base`` or ``senses`` lacks a member of its protocol.
    """
    _check_robot(base, senses, task.task)
    command, waited_for = TravelCommand(), ""

    def observations() -> Iterator[TravelObservation]:
        for periods in itertools.count():
            yield _observation(base, senses, passages, periods, command)
            wait(PERIOD_S)

    def execute(requested: TravelCommand) -> None:
        nonlocal command, waited_for
        command = requested
        if passages is not None and command.passage not in ("", waited_for):
            passages.request(command.passage)
        waited_for = command.passage
        if command.speed_m_s or command.turn_rate_rad_s:
            base.drive(command.speed_m_s, command.turn_rate_rad_s)
        else:
            base.stop()

    ending = run_machine(task, observations(), execute, base.stop)
    return Travel(
        TravelOutcome(ending.outcome),
        tuple(task.records),
        task.trace(),
        task.memory.problem(task.motion.pose_m()),
        task.motion.elapsed_s(),
        task.length_m,
        task.pushes.count,
        task.plans.calls,
        ending.why,
    )


def _observation(
    base: MobileBase,
    senses: TravelSenses,
    passages: PassageSenses | None,
    periods: int,
    command: TravelCommand,
) -> TravelObservation:
    """Observation of one control period, with the sightings requested by the last command."""
    state, pose_m, touched = base.state(), _placed("pose()", senses.pose()), senses.touch()
    looked = ((id, senses.look(id)) for id in command.look)
    try:
        force_N, point = touched
    except (TypeError, ValueError):
        raise InputError(
            "senses", f"found {touched!r}, expected force [N] and its place (x, y) or None", field="touch()"
        ) from None
    return TravelObservation(
        t_s=periods * PERIOD_S,
        base_t_s=float(state.t_s),
        pose_m=pose_m,
        speed_m_s=float(state.speed_m_s),
        turn_rate_rad_s=float(state.turn_rate_rad_s),
        force_N=float(force_N),
        point_m=None if point is None else (float(point[0]), float(point[1])),
        sightings=tuple(
            ObjectSighting(id, None if at is None else _placed(f"look({id!r})", at)) for id, at in looked
        ),
        open=(command.passage,)
        if command.passage and passages is not None and passages.is_open(command.passage)
        else (),
    )


def _placed(call: str, found: Any) -> tuple[float, float, float]:
    """What the senses of a robot returned as a place [m] and a rotation [rad]."""
    try:
        x, y, turn = map(float, found)
    except (TypeError, ValueError):
        expected = "expected x [m], y [m] and rotation [rad]"
        raise InputError("senses", f"found {found!r}, {expected}", field=call) from None
    return x, y, turn

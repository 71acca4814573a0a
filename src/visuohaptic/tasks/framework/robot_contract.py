"""Conformance test of a robot driver: behaviour that the protocols require beyond their signatures.

The robot moves: 10 cm and half a radian with its base, 2 cm with its arm, 1 cm with its fingers.
Every rule compares a command with the state that the robot reports, with a tolerance wide enough for ramps
and delays (0.5 to 1.5 times), and narrow enough to detect any wrong unit.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np

from ...core import InputError, Pose, VisuohapticError, wrap_angle
from ...core.robots import (
    ROBOT_CONTRACT,
    BaseState,
    DepthSource,
    FrameSource,
    Gripper,
    GripperState,
    Localizer,
    MobileBase,
    ProbeArm,
    require_members,
)
from ._sensor_rules import (
    MAX_RATIO,
    MIN_RATIO,
    FRESH_s,
    HOLD_s,
    SPEED_m_s,
    TouchReader,
    TURN_rad_s,
    camera_rules,
    clock_rules,
    depth_rules,
    localizer_rules,
    rule,
    touch_rules,
)  # fmt: skip

#: Test distances of arm and fingers [m].
LIFT_m, SQUEEZE_m = 0.02, 0.01
#: Maximum motion of a stopped part [m], [rad], and tolerance of a reached position [m].
STILL_m, STILL_rad, REACHED_m = 0.002, 0.01, 0.002
#: Maximum distance of the reported point from the centre of a turn on the spot [m], and tolerance of a reported speed
#: against the reported path, both of which tasks use as they are.
BESIDE_m, MISMATCH = 0.04, 0.1


@dataclass(frozen=True, slots=True)
class RobotParts:
    """Parts of a robot; missing parts are ``None``."""

    base: MobileBase | None = None
    arm: ProbeArm | None = None
    gripper: Gripper | None = None
    camera: FrameSource | None = None
    localizer: Localizer | None = None
    depth: DepthSource | None = None
    feel: TouchReader | None = None  #: sensor of the finger that the camera looks at
    contract: str = ROBOT_CONTRACT  #: version of the protocols that the driver implements
    wait: Callable[[float], None] = time.sleep  #: waits for a duration [s]; a simulation steps here


@dataclass(frozen=True, slots=True)
class ContractRule:
    """Result of one rule."""

    part: str  #: base, arm, gripper, camera, localizer, depth or feel
    rule: str  #: required behaviour
    problem: str  #: observed behaviour; empty if the rule is kept


def check_robot(
    robot: RobotParts | Mapping[str, Any], *, motion: bool = True, where: str = "robot"
) -> list[ContractRule]:
    """Test the parts of a robot against their protocols; all parts are stopped at the end.

    Parameters
    ----------
    robot
        Parts of the robot, or a mapping with the same names.
    motion
        Whether to move the robot; otherwise only signatures, readings and images are checked.
    where
        Name of the robot in messages.

    Returns
    -------
    list of ContractRule
        Results in the order of the tests; after a broken rule a part is not moved any more, and rules that need what is
        broken may be omitted.

    Raises
    ------
    InputError
        There is no part, or an unknown name.

    Examples
    --------
    >>> class Still:
    ...     def drive(self, speed_m_s, turn_rate_rad_s): pass
    ...     def stop(self): pass
    ...     def state(self): return BaseState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    >>> broken = [rule for rule in check_robot({"base": Still(), "wait": lambda s: None}) if rule.problem]
    >>> broken[0].rule
    'time advances, in seconds'
    """
    parts = _parts(robot, where)
    tried: dict[str, tuple[type, Callable[..., Iterator[tuple[str, str]]]]] = {
        "base": (MobileBase, _base_rules),
        "arm": (ProbeArm, _arm_rules),
        "gripper": (Gripper, _gripper_rules),
        "camera": (FrameSource, lambda part, _wait, _moves: camera_rules(part)),
        "localizer": (Localizer, lambda part, wait, moves: localizer_rules(part, parts.base, wait, moves)),
        "depth": (DepthSource, lambda part, wait, _moves: depth_rules(part, wait)),
        "feel": (TouchReader, lambda part, _wait, _moves: touch_rules(part, parts.camera)),
    }
    found = []
    for name, (protocol, rules) in tried.items():
        part = getattr(parts, name)
        if part is None:
            continue
        signature = f"it is a {protocol.__name__}"
        try:
            members = ("__call__",) if protocol is TouchReader else None
            require_members(part, protocol, where, role=name, members=members)
        except InputError as problem:
            found.append(ContractRule(name, signature, str(problem)))
            continue
        kept = ContractRule(name, signature, "")
        found += _tried(kept, part, partial(rules, part, parts.wait), motion)
    return found


def _tried(
    kept: ContractRule,
    part: Any,
    rules: Callable[[Callable[[], bool]], Iterator[tuple[str, str]]],
    motion: bool,
) -> list[ContractRule]:
    """Results of one part, after the first. After a broken rule its readings are checked on, but it is not moved."""
    found, name = [kept], kept.part
    moving = False

    def may_move() -> bool:
        nonlocal moving
        moving = motion and not any(one.problem for one in found)
        return moving

    for trial in (rules(may_move), _stopped(part)):
        broken = False
        try:
            for rule, fault in trial:
                found.append(ContractRule(name, rule, fault))
                broken = broken or bool(fault)
                if fault and moving:
                    break
        except Exception as problem:  # noqa: BLE001 - whatever somebody's robot raises is a finding
            if not broken:  # otherwise it may follow from that, such as a state of another type
                fault = f"{type(problem).__name__}: {problem}, after '{found[-1].rule}'"
                found.append(ContractRule(name, "its methods work", fault))
    return found


def _stopped(part: Any) -> Iterator[tuple[str, str]]:
    if hasattr(part, "stop"):
        part.stop()
    yield "stop() can be called at any time", ""


def _parts(robot: RobotParts | Mapping[str, Any], where: str) -> RobotParts:
    names = [field.name for field in fields(RobotParts)]
    if isinstance(robot, Mapping):
        if unknown := [name for name in robot if name not in names]:
            raise InputError(where, f"found part {unknown[0]!r}, expected some of {', '.join(names)}")
        robot = RobotParts(**robot)
    if not isinstance(robot, RobotParts):
        raise InputError(
            where, f"found {type(robot).__name__}, expected RobotParts or a mapping of {', '.join(names)}"
        )
    parts = [name for name in names if name not in ("wait", "contract")]
    if all(getattr(robot, name) is None for name in parts):
        raise InputError(where, f"has no parts, expected one of {', '.join(parts)} at least")
    if str(robot.contract).partition(".")[0] != ROBOT_CONTRACT.partition(".")[0]:
        raise InputError(
            where,
            f"found a robot for contract {robot.contract}, expected {ROBOT_CONTRACT}",
            remedy="see docs/howto/your_robot.md for what has changed",
        )
    return robot


def assert_robot(robot: RobotParts | Mapping[str, Any], *, motion: bool = True, where: str = "robot") -> None:
    """Assertion for the tests of a driver: fails with every broken rule of the contract.

    Parameters
    ----------
    robot, motion, where
        As for :func:`check_robot`.

    Raises
    ------
    AssertionError
        A rule is broken.
    """
    broken = [rule for rule in check_robot(robot, motion=motion, where=where) if rule.problem]
    assert not broken, "\n".join(f"{rule.part}: {rule.rule}: {rule.problem}" for rule in broken)


def _between(promise: str, found: float, commanded: float, unit: str) -> tuple[str, str]:
    """Rule that is kept if the measured motion is within the tolerance of ramps and delays."""
    both = f"{found:.4g} {unit} where {commanded:.4g} {unit} were commanded"
    return rule(promise, MIN_RATIO <= found / commanded <= MAX_RATIO, both)


def _refuses(command: str, try_it: Callable[[], object]) -> tuple[str, str]:
    """Rule that an invalid command raises an error of this library."""
    try:
        try_it()
    except (VisuohapticError, ValueError):
        return f"{command} is refused", ""
    return (
        f"{command} is refused",
        "was accepted without an error, expected InputError, DeviceError or ValueError",
    )


def _holds(
    read_m: Callable[[], float | np.ndarray], max_drift_m: float, wait: Callable[[float], None]
) -> tuple[str, str]:
    """Rule that a stopped part is still at rest 0.3 s later."""
    wait(0.3)
    held_m = read_m()
    wait(0.5)
    drift_m = float(np.linalg.norm(np.subtract(read_m(), held_m)))
    return rule("it holds after stop()", drift_m < max_drift_m, f"{1e3 * drift_m:.3g} mm in half a second")


def _next_state(base: MobileBase, wait: Callable[[float], None]) -> BaseState:
    """The first state measured from now on; the newest one if none arrives in time."""
    before = base.state()
    for _ in range(10):
        wait(0.1 * FRESH_s)
        if (state := base.state()).t_s > before.t_s:
            return state
    return before


def _base_rules(
    base: MobileBase, wait: Callable[[float], None], moves: Callable[[], bool]
) -> Iterator[tuple[str, str]]:
    start = base.state()
    yield rule("state() is a BaseState", isinstance(start, BaseState), type(start).__name__)
    numbers = [getattr(start, field.name) for field in fields(BaseState)]
    yield rule("its numbers are finite", np.isfinite(numbers).all(), f"{start}")
    yield from clock_rules(lambda: base.state().t_s, wait, HOLD_s)
    still = base.state()
    if not moves():
        return
    base.drive(0.0, TURN_rad_s)
    wait(HOLD_s)
    turned = base.state()
    angle = turned.heading_rad - still.heading_rad
    if max(abs(turned.heading_rad), abs(still.heading_rad)) <= math.pi:
        angle = wrap_angle(angle)
    turns = "a positive turn rate turns counter-clockwise, in radians, until the next command"
    yield _between(turns, angle, TURN_rad_s * HOLD_s, "rad")
    beside_m = math.hypot(turned.x_m - still.x_m, turned.y_m - still.y_m) / abs(2.0 * math.sin(0.5 * angle))
    found = f"it turned about a point {beside_m:.2g} m from the one reported"
    yield rule("x_m and y_m are those of the point about which it turns", beside_m < BESIDE_m, found)
    base.stop()
    wait(1.0)
    aligned = base.state()
    base.drive(SPEED_m_s, 0.0)
    wait(0.5 * HOLD_s)
    half = base.state()
    wait(0.5 * HOLD_s)
    driven = base.state()
    way = np.array([driven.x_m - aligned.x_m, driven.y_m - aligned.y_m])
    heading = np.array([math.cos(aligned.heading_rad), math.sin(aligned.heading_rad)])
    yield _between("a positive speed drives metres", float(np.hypot(*way)), SPEED_m_s * HOLD_s, "m")
    found = f"a way along ({way[0]:.3g}, {way[1]:.3g}) m at a heading of {aligned.heading_rad:.3g} rad"
    yield rule("it drives where its heading points", way @ heading > 0.9 * np.hypot(*way), found)
    yield _between("speed_m_s is what it drives", half.speed_m_s, SPEED_m_s, "m/s")
    path_m = math.hypot(driven.x_m - half.x_m, driven.y_m - half.y_m)
    expected_m = 0.5 * (half.speed_m_s + driven.speed_m_s) * (driven.t_s - half.t_s)
    found = f"{path_m:.4g} m driven where its speed gives {expected_m:.4g} m"
    yield rule("its speed and its path agree", abs(path_m - expected_m) < MISMATCH * expected_m, found)
    base.stop()
    wait(FRESH_s)
    stopping = _next_state(base, wait)
    found = f"{stopping.speed_m_s:.3g} m/s {FRESH_s} s after stop()"
    yield rule("a command acts in time", stopping.speed_m_s < (1.0 - MISMATCH) * driven.speed_m_s, found)
    wait(1.0)
    rest = base.state()
    wait(0.5)
    later = base.state()
    drift_m = math.hypot(later.x_m - rest.x_m, later.y_m - rest.y_m)
    turn_rad = abs(later.heading_rad - rest.heading_rad)
    found = f"{1e3 * drift_m:.3g} mm and {turn_rad:.3g} rad in half a second"
    yield rule("it stands a second after stop()", drift_m < STILL_m and turn_rad < STILL_rad, found)
    yield _refuses("a speed that is not a number", lambda: base.drive(math.nan, 0.0))


def _gripper_rules(
    gripper: Gripper, wait: Callable[[float], None], moves: Callable[[], bool]
) -> Iterator[tuple[str, str]]:
    start = gripper.state()
    yield rule("state() is a GripperState", isinstance(start, GripperState), type(start).__name__)
    yield rule(
        "its opening is in metres", 0 <= start.opening_m < 0.5, f"{start.opening_m}, expected 0 to 0.5"
    )
    yield from clock_rules(lambda: gripper.state().t_s, wait, 0.5)
    if not moves():
        return
    sign = -1.0 if start.opening_m > 1.5 * SQUEEZE_m else 1.0
    target, speed = start.opening_m + sign * SQUEEZE_m, 0.01
    gripper.move(target, speed)
    wait(0.5 * SQUEEZE_m / speed)
    half = gripper.state()
    gone = sign * (half.opening_m - start.opening_m)
    yield _between("it moves at the commanded speed", gone, 0.5 * SQUEEZE_m, "m")
    yield _between("speed_m_s is the rate of the opening", half.speed_m_s, sign * speed, "m/s")
    gripper.stop()
    yield _holds(lambda: gripper.state().opening_m, 0.5 * STILL_m, wait)
    gripper.move(target, speed)
    wait(SQUEEZE_m / speed + 0.5)
    missed = abs(gripper.state().opening_m - target)
    found = f"an opening {1e3 * missed:.3g} mm from the one commanded"
    yield rule("it reaches the commanded target", missed < REACHED_m, found)
    yield _refuses("an opening below 0", lambda: gripper.move(-0.01, speed))
    yield _refuses("a speed that is not a number", lambda: gripper.move(target, math.nan))
    gripper.move(start.opening_m, speed)
    wait(SQUEEZE_m / speed + 0.5)


def _arm_rules(
    arm: ProbeArm, wait: Callable[[float], None], moves: Callable[[], bool]
) -> Iterator[tuple[str, str]]:
    _, start = arm.pose()
    yield rule("pose() is a time and a Pose", isinstance(start, Pose), type(start).__name__)
    reach = np.asarray(arm.reach_m(), dtype=float)
    good = reach.shape == (2,) and np.isfinite(reach).all() and 0 <= reach[0] < reach[1] < 10.0
    yield rule("reach_m() is two ascending distances in metres", good, f"{reach.tolist()}")
    far = float(np.linalg.norm(start.translation_m))
    found = f"{far:.4g} m, reach {reach[0]:.4g} to {reach[1]:.4g} m"
    yield rule("the tip is within its reach, in metres", reach[0] <= far <= reach[1], found)
    yield from clock_rules(lambda: arm.pose()[0], wait, 0.5)
    if not moves():
        return
    up = np.array([0.0, 0.0, LIFT_m])
    # Towards the middle of the reach: up or down, whichever stays inside.
    above = float(np.linalg.norm(start.translation_m + up))
    up = up if above <= reach[1] else -up
    target = Pose(start.rotation, start.translation_m + up)
    arm.move_linear(target, LIFT_m)
    wait(0.5)
    half = arm.pose()[1].translation_m - start.translation_m
    along = float(half @ up) / LIFT_m
    yield _between("it moves at the commanded speed", along, 0.5 * LIFT_m, "m")
    aside = float(np.linalg.norm(half - along * up / LIFT_m))
    yield rule("it moves in a straight line", aside < STILL_m, f"it {1e3 * aside:.3g} mm from it half-way")
    arm.stop()
    yield _holds(lambda: arm.pose()[1].translation_m, STILL_m, wait)
    arm.move_linear(target, LIFT_m)
    wait(1.5)
    missed = float(np.linalg.norm(arm.pose()[1].translation_m - target.translation_m))
    found = f"a pose {1e3 * missed:.3g} mm from the one commanded"
    yield rule("it reaches the commanded target", missed < REACHED_m, found)
    away = Pose(start.rotation, np.array([0.0, 0.0, 3.0 * reach[1]]))
    yield _refuses("a pose out of reach", lambda: arm.move_linear(away, LIFT_m))
    yield _refuses("a speed of 0", lambda: arm.move_linear(target, 0.0))
    arm.move_linear(start, LIFT_m)
    wait(1.5)

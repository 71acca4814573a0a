"""State machine for opening a crown cap with an opener on a beam sensor (Alt 2016, Sec. 3.6.5; rows of Table 3.1).

The tool frame has its origin in the middle of the opener's bridge: x across,
y forward, z up; a hook is behind and below the bridge. The camera locates the cap
to about a centimetre; the remaining steps use the force sensor:

- **push down** until F_z shows that the bridge is on the cap (the hook on
  the cap instead shows as M_x: the tool then moves back and tries again),
- **sideways**: a bridge loaded on one side only shows as M_y; lift, shift,
  press again until M_y is small,
- **forward** until F_y shows that the hook is under the rim and at the neck,
- **rotate** about the bridge until M_x has risen and collapsed,
- **check**: M_x is zero and the cap is no longer detected on the bottle.
"""

from __future__ import annotations

import math

import numpy as np

from ...core.geometry import so3_exp, so3_log
from ..framework.machine import Machine, Rule
from .crown_cap_records import CapCommand, CapObservation, CapOutcome, CapSettings, CapState, Vector
from .hand import as_vector

_STOP = CapCommand(False)


class CrownCapTask(Machine[CapState, CapObservation, CapCommand]):
    """The decisions of Table 3.1, one observation at a time.

    Parameters
    ----------
    settings
        Distances, forces and limits.
    """

    task = "crown_cap"

    def __init__(self, settings: CapSettings | None = None) -> None:
        self.settings = settings or CapSettings()
        limit, s = self.settings.state_timeout_s, CapState
        self.rules = {
            s.FIND: Rule((s.TRACK,), 3 * limit),
            s.TRACK: Rule((s.APPROACH,), limit),
            s.APPROACH: Rule((s.PUSH_DOWN,), limit),
            s.PUSH_DOWN: Rule((s.FEEL, s.LIFT), limit),
            s.FEEL: Rule((s.LIFT, s.FORWARD), limit),
            s.LIFT: Rule((s.PUSH_DOWN,), limit),
            s.FORWARD: Rule((s.ROTATE, s.LIFT), limit),
            s.ROTATE: Rule((s.LEAVE,), limit),
            s.LEAVE: Rule((s.CHECK,), limit),
            s.CHECK: Rule((s.APPROACH,), limit),
        }
        super().__init__(self.settings)
        self.attempts = 0
        self._waypoint = self._presses = self._misses = 0
        self._sightings: list[Vector] = []
        self._readings: list[tuple[float, ...]] = []
        self._cap = np.full(3, math.nan)  #: best estimate of the centre of the cap
        self._aim = np.full(3, math.nan)  #: target of the tip
        self._top_m = math.nan  #: height of the bridge at contact with the cap
        self._start = np.zeros(3)
        self._upright = np.zeros(3)  #: rotation of the tool at the start
        self._turn = np.zeros(3)  #: rotation of the tool at work
        self._side_step, self._last_side = self.settings.side_step_m, 0.0
        self._peak = 0.0
        self._broke = False
        self._lean = 0.0
        self._aim_lift = np.full(3, math.nan)
        self._looks: list[bool] = []

    def halt(self) -> CapCommand:
        """Command that stops the arm."""
        return _STOP

    def decide(self, seen: CapObservation) -> CapCommand:
        """Command of the arm after one frame."""
        tip = np.array(seen.tip_m)
        looks = self.state in (CapState.FIND, CapState.TRACK)
        if self.unread(seen.felt or looks, CapOutcome.SENSOR_FAILED, self.settings.max_invalid_frames):
            return _STOP
        if not (seen.felt or looks):
            return _STOP
        command: CapCommand = getattr(self, f"_{self.state.value}")(seen, tip)
        return command

    # Vision

    def _find(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        if self._waypoint == 0:
            self._turn = self._upright = np.array(seen.turn_rad)
        if seen.seen:
            self._cap = np.array(seen.cap_m)
            self.go(CapState.TRACK, f"cap detected, {1e2 * math.dist(seen.cap_m, seen.tip_m):.0f} cm away")
            return self._to(self._above(self.settings.look_above_m), self.settings.fast_m_s)
        scan = self.settings.scan_m
        if self._waypoint < len(scan) and _near(tip, np.array(scan[self._waypoint])):
            self._waypoint += 1
        if self._waypoint >= len(scan):
            # The image of the previous position is one frame late.
            if self.since_s(seen.t_s) > 0.2:
                return self.give_up(CapOutcome.NOT_FOUND, f"{len(scan)} places looked at")
            return _STOP
        return self._to(np.array(scan[self._waypoint]), self.settings.fast_m_s)

    def _track(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        there = _near(tip, self._aim)
        if there and seen.seen:
            self._sightings.append(seen.cap_m)
        elif seen.seen:
            # Nearer detections are more accurate: correct the target during the motion.
            self._cap = np.array(seen.cap_m)
            return self._to(self._above(self.settings.look_above_m), self.settings.fast_m_s)
        if len(self._sightings) >= self.settings.look_frames:
            self._cap = np.median(np.array(self._sightings), axis=0)
            self._sightings = []
            self.go(CapState.APPROACH, f"tracked at {_mm(self._cap)} mm")
            return self._approach(seen, tip)
        if there and self.since_s(seen.t_s) > 6.0:
            return self.give_up(CapOutcome.LOST, "not seen from above")
        return self._to(self._aim, self.settings.fast_m_s)

    # Touch

    def _approach(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        s = self.settings
        top = self._cap[2] if math.isnan(self._top_m) else self._top_m
        hover = s.hover_m if math.isnan(self._top_m) else 2 * s.lift_m
        aim = np.array([self._cap[0], self._cap[1] - s.behind_m, top + hover])
        if _near(tip, aim) and _straight(seen, self._turn):
            if math.isnan(self._top_m) and len(self._sightings) < s.look_frames:
                return self._nearer(seen)
            self._presses = self._misses = 0
            self._side_step, self._last_side = s.side_step_m, 0.0
            self.go(CapState.PUSH_DOWN, f"{1e3 * hover:.0f} mm above the cap")
            self._start = aim
            return self._down(self._start)
        # Sideways at a safe height above the cap, then down.
        high = max(aim[2], top + s.hover_m)
        if math.hypot(tip[0] - aim[0], tip[1] - aim[1]) > 1e-3:
            above = tip if tip[2] < high - 1e-3 else aim
            return self._to(np.array([above[0], above[1], high]), s.fast_m_s)
        return self._to(aim, s.fast_m_s)

    def _nearer(self, seen: CapObservation) -> CapCommand:
        """Look again from nearby, where the angle error of the camera has less effect."""
        self._sightings.append(seen.cap_m if seen.seen else as_vector(self._cap))
        if len(self._sightings) == self.settings.look_frames:
            self._cap[:2] = np.median(np.array(self._sightings), axis=0)[:2]
        return _STOP

    def _push_down(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        s, (x, y, z) = self.settings, seen.force_N
        if z > s.press_N or math.hypot(x, y) > max(0.5 * s.press_N, 1.5 * z):
            self._readings = []
            self.go(CapState.FEEL, f"F_z {z:.1f} N, aside {math.hypot(x, y):.1f} N")
            return _STOP
        floor = (self._cap[2] if math.isnan(self._top_m) else self._top_m) - s.depth_m
        if tip[2] <= floor + 1e-4:
            self._misses += 1
            if self._misses > 4:
                why = f"no contact {1e3 * s.depth_m:.0f} mm below its place"
                return self.give_up(CapOutcome.NO_CONTACT, why)
            return self._again(tip, 0.0, s.ahead_m, "no contact: ahead")
        # Slow from the first contact on: on a stiff beam the motion of one frame is many newtons.
        touched = z > s.touch_N or math.hypot(x, y) > s.touch_N
        return self._to(np.array([tip[0], tip[1], floor]), s.slow_m_s * (0.15 if touched else 0.5))

    def _feel(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        s = self.settings
        if self.since_s(seen.t_s) < 0.15:
            return _STOP  # wait until the arm and the frame in transit are at rest
        self._readings.append((*seen.force_N, *seen.moment_Nm[:2]))
        if len(self._readings) < s.hold_frames:
            return _STOP
        aside, along, push, about_x, about_y = np.mean(self._readings, axis=0)
        sideways = math.hypot(aside, along)
        if push < max(s.touch_N, sideways):
            # The edge slides down the flank of the cap, which pushes it away: move against that push.
            back = -s.ahead_m / max(sideways, 1e-3)
            return self._again(tip, back * aside, back * along, f"met the flank, {sideways:.1f} N aside")
        # A force F_z at (x, y) of the tool gives M_x = y F_z and M_y = -x F_z.
        ahead, side = about_x / push, -about_y / push
        if ahead < -0.5 * s.hook_behind_m:
            return self._again(tip, 0.0, -s.back_m, f"the hook bears on the cap, {1e3 * ahead:.0f} mm: back")
        self._top_m = float(tip[2])
        if abs(side) > s.centred_m:
            if self._last_side * side < 0:
                self._side_step *= 0.5
            self._last_side = side
            # Loaded at its very end, the bridge is far from centred.
            far = self._side_step >= 1e-3 and abs(side) >= 0.9 * s.bridge_half_m
            step = math.copysign(1.5 * self._side_step if far else self._side_step, side)
            why = f"M_y: bears {1e3 * side:+.0f} mm aside, shift {1e3 * step:+.1f} mm"
            return self._again(tip, step, 0.0, why)
        self._cap[:2] = tip[0], tip[1] + s.behind_m
        self._start = tip.copy()
        # A tilted tool measures a component of the push as a forward force.
        self._lean = along / push
        self.go(CapState.FORWARD, f"M_y small: bears {1e3 * side:+.0f} mm aside")
        return self._forward(seen, tip)

    def _lift(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        aim = self._aim_lift
        if _near(tip, aim):
            self.go(CapState.PUSH_DOWN, "above the next place")
            return self._down(aim)
        if tip[2] < aim[2] - 1e-4:
            return self._to(np.array([tip[0], tip[1], aim[2]]), 3 * self.settings.slow_m_s)
        return self._to(aim, 3 * self.settings.slow_m_s)

    def _again(self, tip: np.ndarray, aside_m: float, ahead_m: float, why: str) -> CapCommand:
        """Lift, shift, and press again."""
        self._presses += 1
        if self._presses > self.settings.presses:
            return self.give_up(CapOutcome.NOT_ALIGNED, f"pressed {self._presses - 1} times, last: {why}")
        # If the hook is beside the cap it has to be lifted above it.
        up = self.settings.lift_m if ahead_m == 0 else self.settings.hover_m
        self._aim_lift = tip + np.array([aside_m, ahead_m, up])
        if ahead_m != 0 and math.isfinite(self._top_m):
            self._aim_lift[2] = max(self._aim_lift[2], self._top_m + self.settings.lift_m)
        self.go(CapState.LIFT, why)
        return self._to(np.array([tip[0], tip[1], self._aim_lift[2]]), 3 * self.settings.slow_m_s)

    def _forward(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        s, (_, y, z) = self.settings, seen.force_N
        gone = float(tip[1] - self._start[1])
        if y - self._lean * z < -s.forward_N * (1.0 + 0.5 * self.attempts):
            self._peak, self._broke = 0.0, False
            self._start = tip.copy()
            self.attempts += 1
            self.go(CapState.ROTATE, f"F_y {y:.1f} N after {1e3 * gone:.0f} mm")
            return self._rotate(seen, tip)
        if gone > s.forward_m:
            return self._again(tip, 0.0, -s.forward_m - s.back_m, "no contact with the neck: back")
        # Force control that keeps the bridge on the cap; the compliance of the beam is a millimetre per 4 N.
        down = np.clip(1e-4 * (z - s.press_down_N), -5e-4, 5e-4)
        return self._to(tip + np.array([0.0, 1e-3, down]), s.slow_m_s)

    def _rotate(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        s, moment = self.settings, seen.moment_Nm[0]
        self._peak = max(self._peak, moment)
        turned = _turned(self._turn, seen.turn_rad)
        if moment > s.max_Nm:
            return self.give_up(CapOutcome.TOO_TIGHT, f"M_x {moment:.1f} Nm")
        if self._peak > s.engaged_Nm and moment < s.broken * self._peak:
            self._broke = True
            return self._leave_now(seen, tip, f"M_x fell from {self._peak:.2f} to {moment:.2f} Nm")
        if turned > s.turn_rad - 0.01:
            why = f"turned by {math.degrees(turned):.0f} deg, M_x at most {self._peak:.2f} Nm"
            return self._leave_now(seen, tip, why)
        angle = min(turned + 0.1, s.turn_rad)
        return CapCommand(True, as_vector(self._start), _tilted(self._turn, angle), s.turn_m_s)

    def _leave_now(self, seen: CapObservation, tip: np.ndarray, why: str) -> CapCommand:
        self._start = tip.copy()
        self._looks = []
        self.go(CapState.LEAVE, why)
        return self._leave(seen, tip)

    def _leave(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        """Rotate back, retreat from under the rim, move up until the bottle is visible."""
        s, start = self.settings, self._start
        if not _straight(seen, self._turn) and tip[2] < start[2] + 1e-3:
            return CapCommand(True, as_vector(start), as_vector(self._turn), s.turn_m_s)
        out = start - [0.0, s.forward_m, 0.0]
        up = self._above(s.look_above_m)
        if tip[1] > out[1] + 1e-3 and tip[2] < start[2] + 1e-3:
            return self._to(out, 5 * s.slow_m_s)
        if tip[2] < up[2] - 1e-3:
            return self._to(np.array([tip[0], tip[1], up[2]]), s.fast_m_s)
        if not _near(tip, up):
            return self._to(up, s.fast_m_s)
        self.go(CapState.CHECK, "above the bottle")
        return _STOP

    def _check(self, seen: CapObservation, tip: np.ndarray) -> CapCommand:
        s = self.settings
        self._looks.append(seen.seen)
        if len(self._looks) < s.look_frames:
            return _STOP
        moment = seen.moment_Nm[0]
        if not any(self._looks) and abs(moment) < 0.5 * s.engaged_Nm:
            if self._broke:
                self.end(True, CapOutcome.OPENED, f"M_x {moment:+.2f} Nm and no cap on the bottle")
                return _STOP
            why = "the cap is not seen, but no moment broke down: the view may be blocked"
            return self.give_up(CapOutcome.NOT_VERIFIED, why)
        if self.attempts >= s.attempts:
            if any(self._looks):
                return self.give_up(CapOutcome.STILL_CLOSED, f"cap still seen after {self.attempts} turns")
            return self.give_up(CapOutcome.NOT_VERIFIED, f"M_x {moment:+.2f} Nm in the air")
        # The contact position is more accurate than the detected one. After a hook slipped off, the next
        # attempt holds it differently: lower, higher, and pressed harder.
        self._turn = np.array(_tilted(self._upright, s.tilts_rad[self.attempts % len(s.tilts_rad)]))
        self.go(CapState.APPROACH, "cap still seen: once more")
        return self._approach(seen, tip)

    # Helpers

    def _above(self, height_m: float) -> np.ndarray:
        return np.asarray(self._cap + np.array([0.0, 0.0, height_m]))

    def _down(self, start: np.ndarray) -> CapCommand:
        return self._to(start - [0.0, 0.0, 1e-3], self.settings.slow_m_s)

    def _to(self, place: np.ndarray, speed_m_s: float) -> CapCommand:
        self._aim = np.array(place, dtype=np.float64)
        return CapCommand(True, as_vector(place), as_vector(self._turn), speed_m_s)


def _mm(place: np.ndarray) -> str:
    return ", ".join(f"{1e3 * value:.0f}" for value in place)


def _near(tip: np.ndarray, aim: np.ndarray) -> bool:
    return bool(np.abs(tip - aim).max() < 3e-4)


def _straight(seen: CapObservation, turn: np.ndarray) -> bool:
    return bool(np.abs(np.array(seen.turn_rad) - turn).max() < 2e-3)


def _tilted(turn: np.ndarray, angle_rad: float) -> Vector:
    """Rotation of the tool with the hook raised by an angle about its own x axis."""
    return as_vector(so3_log(so3_exp(turn) @ so3_exp(np.array([-angle_rad, 0.0, 0.0]))))


def _turned(turn: np.ndarray, now: Vector) -> float:
    """Angle by which the hook has been raised [rad]."""
    return float(-so3_log(so3_exp(turn).T @ so3_exp(np.array(now)))[0])

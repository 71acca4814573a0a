"""The shortest robot that satisfies the contract: it executes commands exactly."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from visuohaptic.core import BaseState, GripperState, InputError, MapPose
from visuohaptic.core.camera import Camera, Frame, Pose


class Base:
    def __init__(self):
        self.t_s, self.pose, self.velocity = 0.0, np.zeros(3), np.zeros(2)

    def drive(self, speed_m_s, turn_rate_rad_s):
        if not math.isfinite(speed_m_s + turn_rate_rad_s):
            raise InputError("drive", f"found {speed_m_s} m/s, {turn_rate_rad_s} rad/s, expected numbers")
        self.velocity = np.array([speed_m_s, turn_rate_rad_s])

    def stop(self):
        self.drive(0.0, 0.0)

    def state(self):
        return BaseState(self.t_s, *self.pose, *self.velocity)

    def wait(self, duration_s):
        for _ in range(round(duration_s / 0.01)):
            speed, turn = self.velocity
            self.pose += 0.01 * np.array(
                [speed * math.cos(self.pose[2]), speed * math.sin(self.pose[2]), turn]
            )
            self.t_s += 0.01


class Fingers:
    def __init__(self, opening_m=0.08):
        self.t_s, self.opening_m, self.target_m, self.rate_m_s = 0.0, opening_m, opening_m, 0.0

    def move(self, opening_m, speed_m_s):
        if not (0 <= opening_m <= 0.1 and speed_m_s > 0):
            raise InputError("move", f"found {opening_m} m at {speed_m_s} m/s, expected 0 to 0.1 m, > 0 m/s")
        self.target_m, self.rate_m_s = opening_m, math.copysign(speed_m_s, opening_m - self.opening_m)

    def stop(self):
        self.target_m, self.rate_m_s = self.opening_m, 0.0

    def state(self):
        return GripperState(self.t_s, self.opening_m, self.rate_m_s)

    def wait(self, duration_s):
        self.t_s += duration_s
        left = self.target_m - self.opening_m
        self.opening_m += max(-abs(left), min(abs(left), self.rate_m_s * duration_s))


class Arm:
    def __init__(self):
        self.t_s, self.at, self.goal, self.speed = 0.0, np.array([0.4, 0.0, 0.3]), None, 0.0

    def move_linear(self, T_base_tip, speed_m_s):
        if not (speed_m_s > 0 and 0.1 <= np.linalg.norm(T_base_tip.translation_m) <= 0.8):
            raise InputError("move_linear", "out of reach, or no speed")
        self.goal, self.speed = T_base_tip.translation_m, speed_m_s

    def stop(self):
        self.goal = None

    def pose(self):
        return self.t_s, Pose(np.eye(3), self.at.copy())

    def reach_m(self):
        return np.array([0.1, 0.8])

    def wait(self, duration_s):
        self.t_s += duration_s
        if self.goal is not None:
            way = self.goal - self.at
            length = float(np.linalg.norm(way))
            self.at = self.at + way * min(1.0, self.speed * duration_s / max(length, 1e-12))


class Pictures:
    camera, frame_count = None, None

    def __iter__(self):
        return (Frame(np.full((4, 6), k, np.uint8), k / 30, k) for k in range(100))

    def close(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.close()


class MapFrame:
    """Where the base is in a map that is turned by a right angle against its odometry."""

    def __init__(self, base):
        self.base = base

    def locate(self):
        state = self.base.state()
        return MapPose(state.t_s, 3.0 - state.y_m, 1.0 + state.x_m, state.heading_rad + 0.5 * math.pi)


class Depth:
    camera = Camera.simple(6, 4, focal_px=5.0)
    t_s = 0.0

    def read(self):
        self.t_s += 1 / 30
        return SimpleNamespace(t_s=self.t_s, depth_m=np.full((4, 6), 1.5, np.float32))


def feel(frame):
    return SimpleNamespace(valid=True, force_N=0.02, surface_m=math.nan)


def connect(base=None, arm=None, gripper=None, camera=None, localizer=None, depth=None, feel=feel):
    base, arm, gripper = base or Base(), arm or Arm(), gripper or Fingers()

    def wait(duration_s):
        for part in (base, arm, gripper):
            part.wait(duration_s)

    return {
        "base": base, "arm": arm, "gripper": gripper, "camera": camera or Pictures(),
        "localizer": localizer or MapFrame(base), "depth": depth or Depth(), "feel": feel, "wait": wait,
    }  # fmt: skip

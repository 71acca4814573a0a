"""A stand-in for LeRobot's LeKiwi and its camera, following its sources: names, units, errors, and the watchdog of its host."""

from __future__ import annotations

from typing import Any

import numpy as np

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
#: The host stops the wheels after so long without an action, and wheels take so long to follow [s].
WATCHDOG_S, LAG_S = 0.5, 0.05
#: Fastest motion of a motor [units/s].
MOTOR_PER_S = 200.0


class DeviceNotConnectedError(ConnectionError):
    """As ``lerobot.errors`` has it."""


class LeKiwi:
    def __init__(self) -> None:
        self.t_s, self.commanded_s = 0.0, -np.inf
        self.is_connected = True
        self.at = {f"arm_{joint}.pos": 10.0 * number for number, joint in enumerate(JOINTS)}
        self.goal = dict(self.at)
        self.velocity = {"x.vel": 0.0, "y.vel": 0.0, "theta.vel": 0.0}
        self.wanted = dict(self.velocity)
        self.actions: list[dict[str, float]] = []

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys([*self.at, *self.velocity], float)

    def get_observation(self) -> dict[str, Any]:
        self._connected()
        return {**self.at, **self.velocity, "front": np.zeros((48, 64, 3), np.uint8)}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        self._connected()
        if not isinstance(action["arm_elbow_flex.pos"], float):  # the client reads this motor of every action
            raise TypeError(action)
        self.goal.update({name: action[name] for name in self.goal if name in action})
        self.wanted.update({name: action.get(name, 0.0) for name in self.wanted})
        self.commanded_s = self.t_s
        self.actions.append(dict(action))
        return action

    def advance(self, dt_s: float) -> None:
        self.t_s += dt_s
        late = self.t_s - self.commanded_s > WATCHDOG_S
        for name, wanted in self.wanted.items():
            self.velocity[name] += dt_s / LAG_S * ((0.0 if late else wanted) - self.velocity[name])
        for name, goal in self.goal.items():
            step = MOTOR_PER_S * dt_s
            self.at[name] += float(np.clip(goal - self.at[name], -step, step))

    def _connected(self) -> None:
        if not self.is_connected:
            raise DeviceNotConnectedError("LeKiwiClient is not connected. You need to run `robot.connect()`.")


class KiwiCamera:
    """Red images at 200 Hz, in LeRobot's order red, green, blue."""

    def __init__(self) -> None:
        self.is_connected = False
        self.lost = False

    def connect(self, warmup: bool = True) -> None:
        self.is_connected = True

    def async_read(self, timeout_ms: float = 200.0) -> np.ndarray:
        import time

        if not self.is_connected:
            raise DeviceNotConnectedError("not connected")
        if self.lost:
            raise TimeoutError(f"Timed out waiting for frame after {timeout_ms} ms")
        time.sleep(0.005)
        image = np.zeros((48, 64, 3), np.uint8)
        image[..., 0] = 255
        return image

    def disconnect(self) -> None:
        self.is_connected = False

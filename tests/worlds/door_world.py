"""A disc that drives on a floor with rectangular walls and one door, which slides open on request or is pushed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import SimpleNamespace

__all__ = ["DoorWorld"]

Rectangle = tuple[float, float, float, float]  #: x0, y0, x1, y1 [m]


@dataclass
class DoorWorld:
    """Base, senses and door in one; time passes with :meth:`wait`.

    A wing turns about its hinge as far as the rim presses it: until its free width lets the robot through, it blocks.
    """

    walls: list[Rectangle]
    door: Rectangle
    x: float
    y: float
    heading: float = 0.0
    radius_m: float = 0.17
    opens_after_s: float = math.inf  #: of a request
    wing_m: float = 0.0  #: path of the rim that opens a wing; 0 for a door that slides
    stays_s: float = 20.0  #: open
    t_s: float = 0.0
    speed: float = 0.0
    turn: float = 0.0
    pressed_m: float = 0.0
    touched: bool = False
    requested_s: float = math.inf
    requests: list[str] = field(default_factory=list)
    passed_s: float = math.inf  #: when it was in the door first

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        self.speed, self.turn = speed_m_s, turn_rate_rad_s

    def stop(self) -> None:
        self.speed = self.turn = 0.0

    def state(self) -> SimpleNamespace:
        return SimpleNamespace(
            t_s=self.t_s,
            x_m=self.x,
            y_m=self.y,
            heading_rad=self.heading,
            speed_m_s=self.speed,
            turn_rate_rad_s=self.turn,
        )

    def pose(self) -> tuple[float, float, float]:
        return self.x, self.y, self.heading

    def touch(self) -> tuple[float, tuple[float, float] | None]:
        if not self.touched:
            return 0.0, None
        return 6.0, (
            self.x + self.radius_m * math.cos(self.heading),
            self.y + self.radius_m * math.sin(self.heading),
        )

    def look(self, name: str) -> None:
        del name

    def request(self, name: str) -> None:
        self.requests.append(name)
        self.requested_s = self.t_s

    def is_open(self, name: str) -> bool:
        del name
        since_s = self.t_s - self.requested_s
        slid = self.wing_m == 0.0 and self.opens_after_s <= since_s <= self.opens_after_s + self.stays_s
        return slid or 0.0 < self.wing_m <= self.pressed_m

    def _gap_m(self, x: float, y: float, box: Rectangle) -> float:
        dx, dy = max(box[0] - x, 0.0, x - box[2]), max(box[1] - y, 0.0, y - box[3])
        return math.hypot(dx, dy)

    def wait(self, seconds: float) -> None:
        self.t_s += seconds
        self.heading += self.turn * seconds
        x = self.x + self.speed * math.cos(self.heading) * seconds
        y = self.y + self.speed * math.sin(self.heading) * seconds
        blocked = any(self._gap_m(x, y, wall) < self.radius_m for wall in self.walls)
        at_door = self._gap_m(x, y, self.door) < self.radius_m
        self.touched = blocked or (at_door and not self.is_open("door"))
        if at_door and self.wing_m and self.speed > 0.0 and not blocked:
            # The door leaf moves together with the rim.
            self.pressed_m += self.speed * seconds
            self.touched = not self.is_open("door")
        elif at_door and not self.is_open("door"):
            blocked = True
        if not blocked:
            self.x, self.y = x, y
        if self._gap_m(self.x, self.y, self.door) == 0.0:
            self.passed_s = min(self.passed_s, self.t_s)

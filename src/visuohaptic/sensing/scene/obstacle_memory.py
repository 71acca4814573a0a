"""Obstacles do not go away: the nearest one, carried on where the camera no longer sees it.

Between the lower border of the watched strip and the foam lies floor that is not watched. What has
come near enough to reach it fills the image, and after a while it looks like floor, or only its far
parts stand out. Free, or far away, would then be a wrong claim just before the touch: what was seen
last comes nearer as the platform goes on, until it is touched, is seen to be gone, or is turned away from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ...core.measurement import Motion
from .obstacle_mask import Obstacle

__all__ = ["ObstacleMemory", "ObstacleMemorySettings"]


@dataclass(frozen=True, slots=True)
class ObstacleMemorySettings:
    """When an obstacle that was seen before still counts."""

    tolerance_m: float = (
        0.01  #: a reading may be so much farther than expected and still be the same obstacle
    )
    forget_frames: int = 20  #: not seen for so long where it should be in view: it has gone
    passed_m: float = 0.04  #: so far behind the foam's front, and not touched: it was not there
    turned_rad: float = 0.35  #: turned by this much it is no longer ahead
    drift: float = 0.05  #: standard deviation that each metre driven adds, per metre


class ObstacleMemory:
    """Carries the nearest obstacle on by the platform's own motion.

    Parameters
    ----------
    blind_m
        Distance from the foam's front to the lower border of the strip: nearer obstacles are not watched.
    settings
        How long an obstacle is remembered.
    """

    def __init__(self, blind_m: float, settings: ObstacleMemorySettings | None = None) -> None:
        self.blind_m, self.settings = blind_m, settings or ObstacleMemorySettings()
        self.forget()

    def forget(self) -> None:
        """Nothing is known of what is ahead."""
        self._near_m = self._sigma_m = self._y_m = math.nan
        self._unseen, self._turned_rad = 0, 0.0

    def update(self, obstacle: Obstacle, motion: Motion, in_contact: bool = False) -> Obstacle:
        """What is ahead, with the memory where it is nearer than what the newest frame shows.

        Parameters
        ----------
        obstacle
            What the frame shows.
        motion
            Of frame F since the frame before; the memory stands still where it is not valid.
        in_contact
            Whether the foam touches something: then nothing is nearer, and the obstacle is at 0.
        """
        s = self.settings
        if motion.valid:
            ahead = float(motion.translation_m[0])
            self._near_m -= ahead
            self._sigma_m += s.drift * abs(ahead)
            self._turned_rad += motion.rotation_rad
        if in_contact:
            # What is let go of lies where it was left: the way counts from here.
            self._near_m, self._sigma_m, self._unseen, self._turned_rad = 0.0, 0.0, 0, 0.0
        else:
            if self._near_m < -s.passed_m or abs(self._turned_rad) > s.turned_rad:
                self.forget()
            if obstacle.valid:
                self._take(obstacle)
        return self._nearer(obstacle)

    def _take(self, obstacle: Obstacle) -> None:
        """Renew the memory by what the frame shows."""
        seen = math.isfinite(obstacle.proximity_m) and not self._farther(obstacle)
        if seen:
            self._y_m, self._unseen, self._turned_rad = obstacle.y_m, 0, 0.0
            # At the border it may be nearer than it looks: what was carried on is better then.
            if not (obstacle.at_border and self._near_m < obstacle.proximity_m):
                self._near_m, self._sigma_m = obstacle.proximity_m, obstacle.proximity_sigma_m
        elif self._near_m > self.blind_m + self.settings.tolerance_m:
            self._unseen += 1
            if self._unseen > self.settings.forget_frames:
                self.forget()
                self._take(obstacle)

    def _farther(self, obstacle: Obstacle) -> bool:
        """Whether what the frame shows is something behind the obstacle that is remembered."""
        return obstacle.proximity_m > self._near_m + self.settings.tolerance_m + 3.0 * self._sigma_m

    def _nearer(self, obstacle: Obstacle) -> Obstacle:
        if not (obstacle.valid and self._near_m < obstacle.proximity_m):
            return obstacle
        return replace(
            obstacle,
            proximity_m=max(self._near_m, 0.0),
            proximity_sigma_m=self._sigma_m,
            y_m=self._y_m,
            at_border=self._near_m < self.blind_m,
            remembered=True,
        )

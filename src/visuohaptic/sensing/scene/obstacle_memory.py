"""Persistence of obstacles: the nearest one is propagated where the camera no longer sees it.

The floor between the lower border of the monitored strip and the foam is not monitored. An obstacle that has
come close enough to reach it fills the image, and after a while it looks like floor, or only its far
parts are detected. Reporting free space, or a large distance, would then be wrong just before contact: the last
detected obstacle comes closer as the platform drives on, until it is touched, is observed to be absent, or is turned away from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ...core.measurement import Motion
from .obstacle_mask import Obstacle


@dataclass(frozen=True, slots=True)
class ObstacleMemorySettings:
    """Validity of a remembered obstacle."""

    tolerance_m: float = (
        0.01  #: a measurement that is farther than expected by up to this is the same obstacle
    )
    forget_frames: int = 20  #: not detected for this time where it should be in view: it is gone
    passed_m: float = 0.04  #: this far behind the foam's front without contact: it was not there
    turned_rad: float = 0.35  #: after a rotation by this angle it is no longer ahead
    drift: float = 0.05  #: standard deviation that each metre driven adds, per metre


class ObstacleMemory:
    """Propagates the nearest obstacle with the platform's own motion.

    Parameters
    ----------
    blind_m
        Distance from the foam's front to the lower border of the strip: closer obstacles are not monitored.
    settings
        Settings of the persistence.
    """

    def __init__(self, blind_m: float, settings: ObstacleMemorySettings | None = None) -> None:
        self.blind_m, self.settings = blind_m, settings or ObstacleMemorySettings()
        self.forget()

    def forget(self) -> None:
        """Forget the obstacle: the area ahead is unknown."""
        self._near_m = self._sigma_m = self._y_m = math.nan
        self._unseen, self._turned_rad = 0, 0.0

    def update(self, obstacle: Obstacle, motion: Motion, in_contact: bool = False) -> Obstacle:
        """Obstacle ahead; the remembered one if it is closer than the detection of the newest frame.

        Parameters
        ----------
        obstacle
            Detection in the frame.
        motion
            Motion of frame F since the previous frame; one that is not valid is a prediction with its covariance, or, with
            an infinite one, no motion at all, because no time has passed.
        in_contact
            Whether the foam touches something: then the obstacle is at distance 0.
        """
        s = self.settings
        if motion.valid or math.isfinite(motion.covariance[0, 0]):
            ahead = float(motion.translation_m[0])
            self._near_m -= ahead
            # Predictions of successive frames have the same error of the speed: their deviations add up, not their variances.
            unknown_m = 0.0 if motion.valid else math.sqrt(motion.covariance[0, 0])
            self._sigma_m += s.drift * abs(ahead) + unknown_m
            self._turned_rad += motion.rotation_rad
        if in_contact:
            # A released object stays where it was left: the distance counts from here.
            self._near_m, self._sigma_m, self._unseen, self._turned_rad = 0.0, 0.0, 0, 0.0
        else:
            if self._near_m < -s.passed_m or abs(self._turned_rad) > s.turned_rad:
                self.forget()
            if obstacle.valid:
                self._take(obstacle)
        return self._nearer(obstacle)

    def _take(self, obstacle: Obstacle) -> None:
        """Update the memory with the detection of the frame."""
        seen = math.isfinite(obstacle.proximity_m) and not self._farther(obstacle)
        if seen:
            self._y_m, self._unseen, self._turned_rad = obstacle.y_m, 0, 0.0
            # At the border it may be closer than detected: the propagated distance is better then.
            if not (obstacle.at_border and self._near_m < obstacle.proximity_m):
                self._near_m, self._sigma_m = obstacle.proximity_m, obstacle.proximity_sigma_m
        elif self._near_m > self.blind_m + self.settings.tolerance_m:
            self._unseen += 1
            if self._unseen > self.settings.forget_frames:
                self.forget()
                self._take(obstacle)

    def _farther(self, obstacle: Obstacle) -> bool:
        """Whether the detection is an object behind the remembered obstacle."""
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

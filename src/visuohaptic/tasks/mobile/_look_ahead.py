"""How fast to drive on what the scene tracking shows ahead of the foam."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...sensing.scene.scene_tracker import SceneReading
    from .explore import ExploreSettings

__all__ = ["LookAhead"]


class LookAhead:
    """How fast the platform may drive on what the scene shows ahead of the foam."""

    def __init__(self, sight_m: float, settings: ExploreSettings) -> None:
        self.sight_m, self.settings = sight_m, settings
        self.seen_m = self.expected_m = math.nan
        self._valid = False

    def look(self, reading: SceneReading, travel_m: float) -> None:
        """Take the newest frame."""
        obstacle = reading.obstacle
        self._valid = obstacle.valid
        if not (obstacle.valid and math.isfinite(obstacle.proximity_m)) or obstacle.at_border:
            return  # at the border it may be nearer than it looks: what was expected before holds
        if math.isnan(self.seen_m):
            self.seen_m = obstacle.proximity_m
        expected = travel_m + obstacle.proximity_m
        # Things do not go away before they are touched: the nearest that was seen counts.
        passed = travel_m > self.expected_m + 2.0 * self.settings.near_m
        self.expected_m = (
            expected if passed or math.isnan(self.expected_m) else min(self.expected_m, expected)
        )

    def speed_m_s(self, travel_m: float) -> float:
        """Largest speed that can still be braked to the slow one where something may be."""
        s = self.settings
        free = self.sight_m
        if travel_m < self.sight_m and s.free_ahead_m < self.sight_m:
            free = min(free, s.free_ahead_m - travel_m)  # what stood in view at the begin is not seen
        # Where nothing was after all, a few centimetres later, the view is free again.
        if travel_m < self.expected_m + 2.0 * s.near_m:
            free = min(free, self.expected_m - travel_m)
        if not self._valid:
            free = 0.0
        fastest = math.sqrt(s.approach_m_s**2 + 2.0 * s.brake_m_s2 * max(free - s.near_m, 0.0))
        return min(max(s.cruise_m_s, s.approach_m_s), fastest)

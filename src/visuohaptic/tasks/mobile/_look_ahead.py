"""How fast to drive on what the scene tracking shows ahead of the foam."""

from __future__ import annotations

import math

from .explore_records import ExploreSettings

__all__ = ["LookAhead"]


class LookAhead:
    """How fast the platform may drive on what the scene shows ahead of the foam.

    Parameters
    ----------
    sight_m
        How far ahead of the foam the scene is seen [m].
    settings
        Speeds, braking and gaps.
    """

    def __init__(self, sight_m: float, settings: ExploreSettings) -> None:
        self.sight_m, self.settings = sight_m, settings
        self.seen_m = math.nan
        self.expected_m = math.nan if settings.expected_m is None else settings.expected_m
        self._valid = False

    def update(self, valid: bool, ahead_m: float, travel_m: float, *, at_border: bool = False) -> None:
        """Take the newest frame.

        Parameters
        ----------
        valid
            Whether its obstacle mask can be trusted.
        ahead_m
            Gap from the foam to the nearest obstacle [m]; infinite: none is seen.
        travel_m
            Distance driven until then [m].
        at_border
            The obstacle meets the border of the image.
        """
        self._valid = valid
        if not (valid and math.isfinite(ahead_m)) or at_border:
            return  # at the border it may be nearer than it looks: what was expected before holds
        if math.isnan(self.seen_m):
            self.seen_m = ahead_m
        expected = travel_m + ahead_m
        # Obstacles do not go away before they are touched: the nearest that was seen counts.
        passed = travel_m > self.expected_m + 2.0 * self.settings.near_m
        self.expected_m = (
            expected if passed or math.isnan(self.expected_m) else min(self.expected_m, expected)
        )

    def speed_m_s(self, travel_m: float) -> float:
        """Largest speed [m/s] that can still be braked to the slow one where something may be.

        Parameters
        ----------
        travel_m
            Distance driven [m].
        """
        s = self.settings
        free = self.sight_m
        if travel_m < self.sight_m and s.free_ahead_m < self.sight_m:
            free = min(free, s.free_ahead_m - travel_m)  # what stood in view at the start is not seen
        # Where nothing was after all, a few centimetres later, the view is free again.
        if travel_m < self.expected_m + 2.0 * s.near_m:
            free = min(free, self.expected_m - travel_m)
        if not self._valid:
            free = 0.0
        fastest = math.sqrt(s.approach_m_s**2 + 2.0 * s.brake_m_s2 * max(free - s.near_m, 0.0))
        return min(max(s.cruise_m_s, s.approach_m_s), fastest)

"""Speed limit of the platform from the free distance that the scene tracker sees ahead of the foam."""

from __future__ import annotations

import math

from .explore_records import ExploreSettings


class LookAhead:
    """Speed limit of the platform from the free distance seen ahead of the foam.

    Parameters
    ----------
    sight_m
        Range of the scene tracker ahead of the foam [m].
    settings
        Speeds, braking and gaps.
    """

    def __init__(self, sight_m: float, settings: ExploreSettings) -> None:
        self.sight_m, self.settings = sight_m, settings
        self.seen_m = math.nan
        self.expected_m = math.nan if settings.expected_m is None else settings.expected_m
        self._valid = False

    def update(self, valid: bool, ahead_m: float, travel_m: float, *, at_border: bool = False) -> None:
        """Process the newest frame.

        Parameters
        ----------
        valid
            Whether its obstacle mask is valid.
        ahead_m
            Gap from the foam to the nearest obstacle [m]; infinite: no obstacle.
        travel_m
            Distance driven so far [m].
        at_border
            Whether the obstacle touches the border of the image.
        """
        self._valid = valid
        if not (valid and math.isfinite(ahead_m)) or at_border:
            return  # at the border it may be nearer than it appears: keep the previous estimate
        if math.isnan(self.seen_m):
            self.seen_m = ahead_m
        expected = travel_m + ahead_m
        # Obstacles do not disappear before contact: keep the nearest estimate.
        passed = travel_m > self.expected_m + 2.0 * self.settings.near_m
        self.expected_m = (
            expected if passed or math.isnan(self.expected_m) else min(self.expected_m, expected)
        )

    def speed_m_s(self, travel_m: float) -> float:
        """Maximum speed [m/s] from which the platform can brake to the slow speed before a possible obstacle.

        Parameters
        ----------
        travel_m
            Distance driven [m].
        """
        s = self.settings
        # What was in view at the start is not seen again; before the first parallax, nothing is seen at all.
        unseen = travel_m < self.sight_m and s.free_ahead_m < self.sight_m
        free = self.sight_m if self._valid and not unseen else s.free_ahead_m - travel_m
        # If there is no contact within a few centimetres, the estimate is discarded.
        if travel_m < self.expected_m + 2.0 * s.near_m:
            free = min(free, self.expected_m - travel_m)
        fastest = math.sqrt(s.approach_m_s**2 + 2.0 * s.brake_m_s2 * max(free - s.near_m, 0.0))
        return min(max(s.cruise_m_s, s.approach_m_s), fastest)

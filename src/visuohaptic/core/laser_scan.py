"""One turn of a laser scanner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .errors import InputError
from .measurement import Reason

__all__ = ["LaserScan"]

MAX_BEAMS = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """Distances in a plane parallel to the floor, in the frame of the scanner (x ahead, y left)."""

    t_s: float  #: time of the scan
    ranges_m: Float[np.ndarray, "n"]  #: infinite: nothing within range; NaN: no measurement
    angle_min_rad: float  #: direction of the first beam, counter-clockwise from x
    angle_step_rad: float  #: from one beam to the next
    range_min_m: float = 0.05  #: nearer is no measurement
    range_max_m: float = 30.0
    sigma_m: float = 0.01  #: standard deviation of a distance
    valid: bool = True
    reason: Reason = Reason.OK

    def __post_init__(self) -> None:
        ranges = np.asarray(self.ranges_m, dtype=np.float64)
        if ranges.ndim != 1 or not 1 <= len(ranges) <= MAX_BEAMS:
            raise InputError("LaserScan", f"found shape {ranges.shape}, expected 1 to {MAX_BEAMS} beams")
        numbers = (self.t_s, self.angle_min_rad, self.angle_step_rad, self.range_min_m, self.range_max_m)
        if not (np.isfinite(numbers).all() and np.isfinite(self.sigma_m) and self.sigma_m > 0):
            raise InputError(
                "LaserScan", f"found {numbers} and sigma {self.sigma_m}, expected finite, sigma > 0"
            )
        if not (0 <= self.range_min_m < self.range_max_m and self.angle_step_rad != 0):
            raise InputError(
                "LaserScan",
                f"found ranges {self.range_min_m} to {self.range_max_m} m, step {self.angle_step_rad} rad, "
                "expected 0 <= min < max and a step that is not 0",
            )
        object.__setattr__(self, "ranges_m", ranges)

    @property
    def angles_rad(self) -> Float[np.ndarray, "n"]:
        """Direction of every beam."""
        return np.asarray(self.angle_min_rad + self.angle_step_rad * np.arange(len(self.ranges_m)))

    @property
    def hits(self) -> Bool[np.ndarray, "n"]:
        """Beams that have met something within the range of the scanner."""
        with np.errstate(invalid="ignore"):
            return np.asarray((self.ranges_m >= self.range_min_m) & (self.ranges_m < self.range_max_m))

    @property
    def points_m(self) -> Float[np.ndarray, "k 2"]:
        """Where the beams that have met something end, frame of the scanner."""
        hits = self.hits
        angles, ranges = self.angles_rad[hits], self.ranges_m[hits]
        return np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])

"""One scan of a laser scanner."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from .errors import InputError
from .measurement import Reason
from .ranges import FINITE, NON_NEGATIVE, POSITIVE, check_order, check_ranges

#: Maximum number of beams of a scan; more indicate damage.
MAX_BEAMS = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """Ranges in a plane parallel to the floor, in the scanner's frame (x forward, y left)."""

    t_s: float = field(metadata=FINITE)  #: time of the scan [s]
    ranges_m: Float[np.ndarray, "n"]  #: infinite: no return within range; NaN: no measurement
    angle_min_rad: float = field(metadata=FINITE)  #: direction of the first beam, counter-clockwise from x
    angle_step_rad: float = field(metadata=FINITE)  #: angle between beams, not 0
    range_min_m: float = field(default=0.05, metadata=NON_NEGATIVE)  #: minimum range
    range_max_m: float = field(default=30.0, metadata=POSITIVE)
    sigma_m: float = field(default=0.01, metadata=POSITIVE)  #: standard deviation of a range
    valid: bool = True
    reason: Reason = Reason.OK

    def __post_init__(self) -> None:
        ranges = np.asarray(self.ranges_m, dtype=np.float64)
        if ranges.ndim != 1 or not 1 <= len(ranges) <= MAX_BEAMS:
            raise InputError("LaserScan", f"found shape {ranges.shape}, expected 1 to {MAX_BEAMS} beams")
        check_ranges(self)
        check_order(self, "range_min_m", "range_max_m")
        if self.angle_step_rad == 0:
            raise InputError("LaserScan", "found 0, expected a non-zero step", field="angle_step_rad")
        turns = abs(self.angle_step_rad) * (len(ranges) - 1) / (2 * np.pi)
        if turns > 2:  # some scanners repeat the first beams
            problem = (
                f"found {len(ranges)} beams over {turns:.3g} turns, expected at most 2 (angles in radians)"
            )
            raise InputError("LaserScan", problem, field="angle_step_rad")
        object.__setattr__(self, "ranges_m", ranges)

    @property
    def angles_rad(self) -> Float[np.ndarray, "n"]:
        """Direction of every beam."""
        return np.asarray(self.angle_min_rad + self.angle_step_rad * np.arange(len(self.ranges_m)))

    @property
    def hits(self) -> Bool[np.ndarray, "n"]:
        """Beams with a return within the scanner's range."""
        with np.errstate(invalid="ignore"):
            return np.asarray((self.ranges_m >= self.range_min_m) & (self.ranges_m < self.range_max_m))

    @property
    def points_m(self) -> Float[np.ndarray, "k 2"]:
        """End points of the beams with a return, in the scanner's frame."""
        hits = self.hits
        angles, ranges = self.angles_rad[hits], self.ranges_m[hits]
        return np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])

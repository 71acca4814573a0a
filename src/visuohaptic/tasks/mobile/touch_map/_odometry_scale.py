"""Calibration of the odometry scale by touch: wheel travel against a fixed object compared with the deflection of the foam.

A wrong wheel radius scales the whole room, which neither walls nor a compass reveal. The foam
does: while it presses against a fixed object, its front is at rest and its back moves with the platform, so
every contact compares about a centimetre of odometry with a length in the calibrated image. One
contact determines the scale to one per cent (wheel slip), the twenty of a room to a quarter of that.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ....core.camera.frame import USUAL_RATE_Hz
from ....core.measurement import SIGMA_PER_MAD, Contact, ForceProfile, Reason

if TYPE_CHECKING:
    from ..explore import ObstacleExploration

#: Minimum deflection of a compared point, and its minimum increase over the push [m].
MIN_M, MIN_RISE_M = 7e-4, 3e-3
#: Standard deviations of the front position in an image [m], and of the delay between wheels and images, one frame [s].
POINT_SIGMA_M, DELAY_SIGMA_S = 5e-5, 1.0 / USUAL_RATE_Hz
#: Minimum relative standard deviation of one contact, however well the contacts agree.
ONE_SIGMA = 0.005
#: Number of pushes from which their own scatter is used, and the relative scatter assumed before.
FEW, FEW_SIGMA = 5, 0.02


class OdometryScale:
    """Ratio of the odometry distance to the true distance, refined with every contact.

    Parameters
    ----------
    sigma
        Prior standard deviation of the ratio. Contacts that deviate by more than three
        times that are outliers: spinning wheels, or an object that moved after all.
    """

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma
        self._ratios: list[float] = []

    def add(self, found: ObstacleExploration) -> None:
        """Add one exploration; objects that moved, or weak contacts, are ignored.

        Parameters
        ----------
        found
            Result of the exploration.
        """
        ratio = odometry_scale_of(found)
        if abs(ratio - 1.0) < 3.0 * self.sigma + 3.0 * FEW_SIGMA:
            self._ratios.append(ratio)

    @property
    def value(self) -> float:
        """Odometry distance over true distance: weighted mean of the inlier contacts and the prior of 1."""
        if not self._ratios:
            return 1.0
        ratios = np.array(self._ratios)
        middle = float(np.median(ratios))
        spread = max(SIGMA_PER_MAD * float(np.median(np.abs(ratios - middle))), ONE_SIGMA)
        if len(ratios) < FEW:
            spread = max(spread, FEW_SIGMA)
        agree = ratios[np.abs(ratios - middle) <= 3.0 * spread]
        worth, before = len(agree) / spread**2, 1.0 / self.sigma**2
        value = (worth * float(agree.mean()) + before) / (worth + before)
        return value if abs(value - 1.0) < 3.0 * self.sigma else 1.0


def odometry_scale_of(found: ObstacleExploration) -> float:
    """Odometry distance over deflection for one push against a fixed object; NaN if it cannot be measured.

    The slope of the motion of the front towards the platform (along -x of F, at the points that are pressed until
    the end) over the odometry distance. A constant delay between wheels and images is estimated as well,
    since the platform decelerates as the foam fills.

    Parameters
    ----------
    found
        Result of the exploration.
    """
    if not found.touched or found.tag.fixed is False:
        return math.nan
    bears = [
        index
        for index, profile in enumerate(found.profiles)
        if profile.contacts and profile.reason is not Reason.SATURATED
    ]
    if not bears:
        return math.nan
    deepest = max(bears, key=lambda index: float(np.nansum(found.profiles[index].delta_m)))
    contact = _largest(found.profiles[deepest])
    pressed = contact.delta_m > 0.6 * float(contact.delta_m.max())
    if pressed.sum() < 3:
        return math.nan
    across_m = contact.points_foam_m[pressed, 1]
    felt, driven, t_s = [], [], []
    for index in bears[: bears.index(deepest) + 1]:
        contact = _largest(found.profiles[index])
        order = np.argsort(contact.points_foam_m[:, 1])
        (x_m, y_m), delta_m = contact.points_foam_m[order].T, contact.delta_m[order]
        bearing = np.interp(across_m, y_m, delta_m, left=0.0, right=0.0)
        if float(bearing.min()) > MIN_M:
            felt.append(-float(np.interp(across_m, y_m, x_m).mean()))
            driven.append(float(found.travel_m[index]))
            t_s.append(found.profiles[index].t_s)
    if len(felt) < 4 or max(felt) - min(felt) < MIN_RISE_M or max(driven) - min(driven) < 0.5 * MIN_RISE_M:
        return math.nan
    speed = np.gradient(driven, t_s)
    design = np.column_stack([driven, speed - speed.mean(), np.ones(len(felt))])
    # Prior of the delay: at a constant speed it is not observable.
    design = np.vstack([design, [0.0, POINT_SIGMA_M / DELAY_SIGMA_S, 0.0]])
    slope = float(np.linalg.lstsq(design, np.append(felt, 0.0))[0][0])
    return 1.0 / slope if slope > 0 else math.nan


def _largest(profile: ForceProfile) -> Contact:
    contact = profile.max_contact
    assert contact is not None  # only frames with contacts are asked
    return contact

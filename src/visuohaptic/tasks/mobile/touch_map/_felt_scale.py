"""The scale of odometry, felt: the distance that wheels measure into something fixed, by the deflection of the foam.

A wheel of a wrong radius makes a room larger or smaller, and neither walls nor a compass tell. The foam
does: while it bears on something fixed, its front stays where it is and its back goes with the platform, so
that every contact compares the odometry of a centimetre with a length in the calibrated picture. One
contact tells the scale to a per cent (wheels slip a little), the twenty of a room to a quarter of that.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ....core.measurement import Contact, ForceProfile, Reason

if TYPE_CHECKING:
    from ..explore import ObstacleExploration

__all__ = ["FeltScale", "felt_stretch"]

#: Deflection that every compared point has at least, and its least rise over the push [m].
MIN_M, MIN_RISE_M = 7e-4, 3e-3
#: Standard deviations of what a picture tells of the front, and of the delay between wheels and pictures: a frame.
POINT_SIGMA_M, DELAY_SIGMA_S = 5e-5, 0.033
#: What one contact may be wrong by at least, however well the others agree.
ONE_SIGMA = 0.005
#: Pushes compared before their own scatter is used, and the scatter until then.
FEW, FEW_SIGMA = 5, 0.02


class FeltScale:
    """Ratio of the distance by odometry to the true one, better with every contact.

    Parameters
    ----------
    sigma
        Standard deviation of the ratio before anything was felt. Contacts that say something beyond three
        times that are left out: wheels that spin, or an object that moved after all.
    """

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma
        self._ratios: list[float] = []

    def add(self, found: ObstacleExploration) -> None:
        """Take one exploration; what moved, or was hardly touched, says nothing.

        Parameters
        ----------
        found
            The exploration.
        """
        ratio = felt_stretch(found)
        if abs(ratio - 1.0) < 3.0 * self.sigma + 3.0 * FEW_SIGMA:
            self._ratios.append(ratio)

    @property
    def value(self) -> float:
        """Measured by true: the mean of the contacts that agree, and of 1, each by what it is worth."""
        if not self._ratios:
            return 1.0
        ratios = np.array(self._ratios)
        middle = float(np.median(ratios))
        spread = max(1.4826 * float(np.median(np.abs(ratios - middle))), ONE_SIGMA)
        if len(ratios) < FEW:
            spread = max(spread, FEW_SIGMA)
        agree = ratios[np.abs(ratios - middle) <= 3.0 * spread]
        worth, before = len(agree) / spread**2, 1.0 / self.sigma**2
        value = (worth * float(agree.mean()) + before) / (worth + before)
        return value if abs(value - 1.0) < 3.0 * self.sigma else 1.0


def felt_stretch(found: ObstacleExploration) -> float:
    """Distance by odometry over distance felt, of one push against something fixed; NaN when it cannot be measured.

    How far the front comes back towards the platform (along -x of F, at the places across that are pressed to
    the end), as a slope over the distance by odometry. A constant delay between wheels and pictures is one more unknown,
    since the platform slows down as its foam fills.

    Parameters
    ----------
    found
        The exploration.
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
    # The delay has its prior: at a constant speed the pictures say nothing of it.
    design = np.vstack([design, [0.0, POINT_SIGMA_M / DELAY_SIGMA_S, 0.0]])
    slope = float(np.linalg.lstsq(design, np.append(felt, 0.0))[0][0])
    return 1.0 / slope if slope > 0 else math.nan


def _largest(profile: ForceProfile) -> Contact:
    contact = profile.max_contact
    assert contact is not None  # only frames with contacts are asked
    return contact

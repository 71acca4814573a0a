"""Validity of a reading: edge states, uneven light and hidden foam in its budget, and the reason if it is not valid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from ...core import CalibrationError, Reason
from ...tracking.contours.contour import PointReason
from ._chain_kernels import OCCLUDER
from .deflection import Deflection, fill_gaps
from .material.foam_material import FoamMaterial
from .material.hysteresis import RELEASE_STRAIN
from .posterior import FALSE_ALARM
from .profile import NEGLIGIBLE_PART, FoamReading
from .strip import FoamSetup, ObservedStrip, ZeroReference
from .strip.zero import WIDTH_TOLERANCE

#: Force error of a frame that is negligible beside its standard deviations [N].
NEGLIGIBLE_N = 0.05
#: Hysteresis: the force of points that were hidden for ``_BRANCH_S`` or longer
#: is uncertain by this fraction until they are released.
_UNKNOWN_BRANCH, _BRANCH_S = 0.3, 0.1


class Validity:
    """Evaluates readings; remembers for how long each point was hidden.

    Parameters
    ----------
    setup
        Configuration of the sensor.
    """

    def __init__(self, setup: FoamSetup) -> None:
        self._material, self._cell_m = setup.material, setup.geometry.cell_m
        self._bump_px = setup.config.tracking.bump_px
        self._seen_t_s = np.full(len(self._cell_m), np.nan)  # time of the last observation of each point
        self._unseen_s = np.zeros(len(self._cell_m))  # total time hidden since its branch was known
        self._speed_m_s = setup.config.max_contact_speed_m_s
        # Last observed deflection of each point, and the largest one that it may have had while it was hidden [m].
        self._last_m, self._peak_m = np.zeros((2, len(self._cell_m)))

    def evaluate(
        self, reading: FoamReading, found: Deflection, strip: ObservedStrip, *, frame_s: float, drifted: bool
    ) -> tuple[FoamReading, Reason]:
        """The reading with the uncertainty of what was not seen, and the most severe reason why it is not valid.

        Points that were hidden may have changed direction meanwhile: their branch of the hysteresis is unknown until they are
        released, or pressed beyond any deflection that they could reach meanwhile and return from. Points without a contact before are included, because a contact may have begun meanwhile.

        Parameters
        ----------
        reading, found, strip
            Contacts, deflection, and observation of the strip in the same frame.
        frame_s
            Shortest time between two frames [s].
        drifted
            Whether the zero reference has to be taken again.
        """
        reading, wrong = with_states(reading, found, self._material, self._cell_m)
        material, seen = self._material, ~found.covered
        away = strip.t_s - self._seen_t_s
        late = seen & (away > 1.5 * frame_s)
        self._unseen_s[late] += away[late] - frame_s
        delta = np.where(np.isfinite(found.delta_m), found.delta_m, 0.0)
        reached = 0.5 * (self._last_m + delta + self._speed_m_s * away)
        self._peak_m[late] = np.maximum(self._peak_m, reached)[late]
        self._seen_t_s[seen], self._last_m[seen] = strip.t_s, delta[seen]
        if not reading.contacts:
            self._unseen_s[:] = 0.0
        self._peak_m[self._unseen_s == 0.0] = 0.0
        if self._unseen_s.any():
            released = delta < np.maximum(RELEASE_STRAIN * material.width_m, 3.0 * found.sigma_m)
            self._unseen_s[seen & (released | (delta > self._peak_m))] = 0.0
            part = np.where(seen, np.minimum(self._unseen_s / _BRANCH_S, 1.0), 0.0)
            pressed_N = (
                material.height_m * self._cell_m * material.stress(np.minimum(delta / material.width_m, 1.0))
            )
            model = math.hypot(reading.budget.model_N, _UNKNOWN_BRANCH * float(part @ pressed_N))
            reading = replace(reading, budget=replace(reading.budget, model_N=model))
        if strip.moved_px > self._bump_px:
            return reading, Reason.MOVED
        unseen_N = material.pressed_force_N(found.hidden_m, self._cell_m)
        if unseen_N > NEGLIGIBLE_N + NEGLIGIBLE_PART * reading.force_N:
            lost = ~found.seen & (strip.front.reason != PointReason.OCCLUDED)
            lost &= found.states.probability.argmax(axis=1) != OCCLUDER
            return reading, Reason.LOST if lost[found.hidden_m > 0.0].all() else Reason.OCCLUDED
        if drifted:
            return reading, Reason.DRIFTED
        return reading, Reason.OCCLUDED if wrong > FALSE_ALARM else reading.reason


def with_states(
    reading: FoamReading, found: Deflection, material: FoamMaterial, cell_m: Float[np.ndarray, "K"]
) -> tuple[FoamReading, float]:
    """The reading with the uncertainty of the edge states in its budget, and the probability that it is wrong nevertheless.

    A point with a wrong state has an error of its whole force f_k. What makes states wrong, another light or another surface,
    is common to all points of a frame: with the probability p_k that a state is wrong, the variance is the sum of
    f_i min(p_i, p_j) f_j. The least certain points make the reading wrong if their force exceeds three standard deviations of the
    other errors plus ``NEGLIGIBLE_N``.

    Parameters
    ----------
    reading
        Contacts of the frame.
    found
        Deflection of the same frame.
    material
        Calibrated foam.
    cell_m
        Length of foam that each point represents [m].
    """
    inside = np.zeros(len(cell_m), dtype=bool)
    states, doubt = found.states, found.states.doubt
    common = np.minimum.outer(doubt, doubt)
    known = (states.foam | states.shadow) & np.isfinite(found.raw_m)
    used = np.where(
        states.foam, found.delta_m, found.raw_m
    )  # inferred where that is more accurate than the edge
    pressed = np.where(known, np.minimum(used / material.width_m, 1.0), 0.0)
    each_N = material.height_m * cell_m * material.stress(pressed)
    contacts = []
    for contact in reading.contacts:
        part = slice(contact.first, contact.last + 1)
        inside[part] = True
        open_var = float(each_N[part] @ common[part, part] @ each_N[part])
        model = math.sqrt(contact.budget.model_N**2 + open_var)
        contacts.append(replace(contact, budget=replace(contact.budget, model_N=model)))
    delta, sigma = found.delta_m, found.sigma_m
    # Deflections that are too small, compared with the error of the zero, to count as a contact may still be one.
    with np.errstate(invalid="ignore"):
        unexplained = np.where(found.seen & (delta > 2.0 * sigma), delta, 0.0)
    unexplained = np.where(
        inside, 0.0, unexplained + np.where(np.isfinite(found.hidden_m), found.hidden_m, 0.0)
    )
    loose = material.pressed_force_N(unexplained, cell_m)
    # Uneven light shifts neighbouring points by a common error.
    light = found.light_m if not reading.contacts else np.where(inside, found.light_m, 0.0)
    if light.any():
        slope = material.slope(np.where(np.isfinite(delta), delta, 0.0) / material.width_m) / material.width_m
        loose = math.hypot(loose, material.height_m * float(cell_m @ (light * slope)))
    budget = replace(reading.budget, zero_N=math.hypot(reading.budget.zero_N, loose))
    order = np.argsort(-doubt)
    over = np.cumsum(each_N[order]) > 3.0 * budget.total_N + NEGLIGIBLE_N
    wrong = float(doubt[order][over].max(initial=0.0))
    budget = replace(budget, model_N=math.sqrt(budget.model_N**2 + float(each_N @ common @ each_N)))
    return replace(reading, contacts=tuple(contacts), budget=budget), wrong


def check_known(
    zero: ZeroReference, noise_m: Float[np.ndarray, "K"], outside: Bool[np.ndarray, "K"], setup: FoamSetup
) -> None:
    """Reject a zero reference with which no frame could be valid, see :meth:`Validity.evaluate`.

    Points of unknown width at rest, and outside the image, hide force even on a free strip. The zero reference is rejected if this force exceeds
    the accepted error of the largest force that the other points can measure.

    Parameters
    ----------
    zero
        The strip at rest.
    noise_m
        Standard deviation of the width of each point in one frame [m].
    outside
        Points outside the image.
    setup
        Configuration of the sensor.

    Raises
    ------
    CalibrationError
        Too many points were not observed.
    """
    geometry, material = setup.geometry, setup.material
    known = zero.known & ~outside
    noise, rest_sigma = np.where(known, [noise_m, zero.width_sigma_m], 0.0)
    hidden = fill_gaps(geometry, np.zeros(len(noise)), noise, noise, rest_sigma, known)[4]
    full = np.where(known, material.densification_strain * material.width_m, 0.0)
    hidden_N, full_N = (material.pressed_force_N(delta, geometry.cell_m) for delta in (hidden, full))
    if hidden_N > NEGLIGIBLE_N + NEGLIGIBLE_PART * full_N:
        raise CalibrationError(
            "zero",
            f"{zero.inferred.sum()} of {len(noise)} contour points were seen in fewer than half of the "
            f"{zero.frames} frames or inaccurately, {outside.sum()} of them outside the image, and "
            f"{(~known).sum()} could hide {hidden_N:.1f} N of {full_N:.1f} N",
            remedy="free the view of the strip, check T_camera_foam and the light",
        )


def check_untouched(zero: ZeroReference, s_m: Float[np.ndarray, "K"]) -> None:
    """Reject a zero reference with a dent: a body that presses and stands still does not move the front.

    As in :func:`.check_width`, a strip may be narrower by a tenth. Medians over five neighbours ignore edges that are found wrong, and
    inferred points are no evidence.

    Parameters
    ----------
    zero
        The strip at rest.
    s_m
        Places of its points along the strip [m].

    Raises
    ------
    CalibrationError
        The strip is narrower at one place than elsewhere.
    """
    at = np.flatnonzero(zero.known & ~zero.inferred)
    if len(at) < 5:
        return
    smooth_m = np.median(np.lib.stride_tricks.sliding_window_view(zero.width_m[at], 5), axis=1)
    usual_m, least = float(np.median(zero.width_m[at])), int(smooth_m.argmin())
    if smooth_m[least] < (1.0 - WIDTH_TOLERANCE) * usual_m:
        raise CalibrationError(
            "zero",
            f"found the strip {1e3 * smooth_m[least]:.1f} mm wide at s = {1e3 * s_m[at[least + 2]]:.0f} mm, expected "
            f"{1e3 * usual_m:.1f} mm as elsewhere, less {100 * WIDTH_TOLERANCE:.0f} % at most",
            remedy="zero while nothing touches the strip, or replace foam that stays compressed",
        )

"""From the observed widths of one frame to the deflection of the foam: which points, and with what error."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ...tracking.contours.contour import SHARED_NOISE
from .material.foam_material import FoamMaterial
from .profile import FoamContour, FoamReading
from .strip.geometry import StripGeometry
from .strip.optics import ObservedStrip, StripOptics
from .strip.zero import ZeroReference
from .validity.flank import stepped_points
from .validity.gaps import bridged, plausible
from .validity.hidden import hidden_points
from .validity.plausibility import OnsetWatch, rest_offset, roughness

__all__ = ["Deflection", "edge_uncertainty_m", "measure_deflection", "with_unexplained"]

#: What a point at a kink, and a bridge, scatters by from frame to frame, by its systematic error: over rendered
#: plates of 1 to 10 mm depth. The rest is the same in all frames.
_KINK_NOISE, _BRIDGE_NOISE = 0.05, 0.33

#: The search for a second edge sees steps from 3.5 sigma of the noise on: a front that is fainter
#: than that, or than this part of the foam's grey level, may be the wrong one of two.
_FAINT, _FAINT_OF_FOAM = 3.5, 0.12

#: Scatter from point to point, in declared sigmas, beyond which it counts in place of these.
_ROUGH = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Deflection:
    """Deflection of K points in one frame, normalised with the zero reference."""

    delta_m: Float[np.ndarray, "K"]  #: towards the base, short gaps bridged; NaN in long ones
    sigma_m: Float[np.ndarray, "K"]  #: its standard deviation, all errors but those common to all points
    noise_m: Float[np.ndarray, "K"]  #: the part that changes from frame to frame
    own_noise_m: Float[np.ndarray, "K"]  #: the part that changes and that neighbours do not share
    seen: Bool[np.ndarray, "K"]  #: measured, not bridged
    good: Bool[np.ndarray, "K"]  #: of these, seen as one clean step
    covered: Bool[np.ndarray, "K"]  #: something else than the foam's front was found
    gap: bool  #: a gap was too long to be bridged
    roughness: float  #: scatter from point to point in declared standard deviations

    def contour(self, geometry: StripGeometry, zero_sigma_m: float) -> FoamContour:
        """The same as input of :func:`~visuohaptic.sensing.foam.profile.read_profile`.

        Parameters
        ----------
        geometry
            Positions of the points.
        zero_sigma_m
            Error that is common to all points [m].
        """
        systematic = self.sigma_m**2 - self.noise_m**2 - self.own_noise_m**2
        return FoamContour(
            geometry.s_m,
            self.delta_m,
            self.noise_m,
            np.isfinite(self.delta_m),
            own_noise_m=self.own_noise_m,
            uncertainty_m=np.sqrt(np.maximum(systematic, 0.0)),
            zero_sigma_m=zero_sigma_m,
            shared_noise=SHARED_NOISE,
            end_cells_m=geometry.end_cells_m,
        )


def edge_uncertainty_m(strip: ObservedStrip) -> Float[np.ndarray, "K"]:
    """Error of a width where the edge is no clean step [m]: grows with the residual of the fit.

    Parameters
    ----------
    strip
        What one image shows.
    """
    return 1.5 * strip.width_sigma_m * np.sqrt(np.maximum(strip.front.chi2, 1.0))


def measure_deflection(
    strip: ObservedStrip, optics: StripOptics, zero: ZeroReference | None, onset: OnsetWatch
) -> Deflection:
    """Deflection of each point, and which points can be used.

    Parameters
    ----------
    strip, optics
        What one image shows, and the lines on which it was found.
    zero
        The strip at rest; without it the declared width is used.
    onset
        How each point has moved so far; takes this frame in.
    """
    geometry = optics.geometry
    width0 = zero.width_m if zero is not None else np.full(len(geometry.s_m), optics.rest_width_m)
    zero_sigma = zero.width_sigma_m if zero is not None else 0.0
    scale = geometry.width_m / width0
    delta = scale * (width0 - strip.width_m)
    sigma = scale * strip.width_sigma_m
    covered = np.zeros(len(delta), dtype=bool)
    if zero is not None:
        covered = hidden_points(strip, zero, optics, delta, np.hypot(sigma, scale * zero_sigma))
    step = np.abs(strip.front.contrast)
    faint = step < np.maximum(_FAINT * strip.front.noise_grey, _FAINT_OF_FOAM * strip.foam_grey)
    good = strip.usable & ~covered & ~faint
    low_confidence = strip.low_confidence & ~covered & ~faint
    # The error of the zero is the same in every frame: no noise of this image.
    systematic = scale * np.hypot(np.where(low_confidence, edge_uncertainty_m(strip), 0.0), zero_sigma)
    seen = good | plausible(geometry.s_m, delta, np.hypot(sigma, systematic), good, low_confidence)
    total = np.hypot(sigma, systematic)
    steps = stepped_points(geometry.s_m, delta, total, seen, geometry.width_m, geometry.end_cells_m)
    jumped = onset.check(strip.t_s, delta, total, seen, steps)
    covered |= jumped
    seen &= ~jumped
    rough = roughness(delta, total, seen)
    if rough > _ROUGH:
        systematic = np.hypot(systematic, rough * sigma)
    delta, sigma, unseen, gap = bridged(geometry.s_m, delta, sigma, seen)
    sigma = np.hypot(sigma, np.where(seen, systematic, unseen))
    # What changes from frame to frame is image noise; texture and the zero stay. Kinks do both, and
    # so do bridges: a point is seen in one frame and not in the next.
    noise = np.where(seen, np.minimum(scale * strip.width_noise_m, sigma), 0.0)
    kinks = np.where(low_confidence, _KINK_NOISE * scale * edge_uncertainty_m(strip), 0.0)
    own = np.where(seen, kinks, _BRIDGE_NOISE * unseen)
    own = np.minimum(own, np.sqrt(sigma**2 - noise**2))
    return Deflection(delta, sigma, noise, own, seen, good, covered, bool(gap), rough)


def with_unexplained(
    reading: FoamReading,
    found: Deflection,
    material: FoamMaterial,
    s_m: Float[np.ndarray, "K"],
    limit_m: float,
) -> FoamReading:
    """The reading with a budget that holds what a contact and a shifted zero could both explain.

    Deflection that is too small against the error of the zero to count as a contact may be one; and a whole strip
    that is deflected evenly may be a wide plate, or a zero that has shifted by less than ``limit_m``.

    Parameters
    ----------
    reading
        Contacts of the frame.
    found
        Deflection of the same frame.
    material
        Calibrated foam.
    s_m
        Position of the points along the strip [m].
    limit_m
        Shift of the zero beyond which it would not be trusted [m].
    """
    delta, sigma = found.delta_m, found.sigma_m
    offset_m = rest_offset(delta, sigma, found.seen)
    inside = np.zeros(len(delta), dtype=bool)
    for contact in reading.contacts:
        inside[contact.first : contact.last + 1] = True

    def force(depth: Float[np.ndarray, "K"]) -> float:
        pressure = material.stress(np.nan_to_num(np.maximum(depth, 0.0)) / material.width_m)
        return material.height_m * float(np.trapezoid(pressure, s_m))

    with np.errstate(invalid="ignore"):
        unexplained = force(np.where(~inside & (delta > 2.0 * sigma), delta, 0.0))
    if 0.0 < abs(offset_m) < limit_m and inside.any():
        pressed = np.where(inside, delta, 0.0)
        unexplained = np.hypot(unexplained, abs(force(pressed) - force(pressed - inside * offset_m)))
    budget = reading.budget
    return replace(reading, budget=replace(budget, zero_N=float(np.hypot(budget.zero_N, unexplained))))

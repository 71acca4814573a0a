"""Deflection of the foam from the edges of one frame: valid points, their errors, and bounds for hidden points."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ...tracking.contours.contour import SHARED_NOISE
from ._bridge_kernels import bridge, drop_bridged
from .edges import MeasuredEdges
from .material.foam_material import FoamMaterial
from .posterior import DECAY_PER_WIDTH, REST_PX, EdgeStates
from .profile import FoamContour, FoamReading
from .strip.geometry import StripGeometry
from .strip.optics import ObservedStrip

#: Frame-to-frame scatter of a point at a kink, and of an interpolated point, relative to its systematic error, from rendered
#: plates of 1 to 10 mm depth. The remaining error is the same in all frames.
_KINK_NOISE, _BRIDGE_NOISE = 0.08, 0.33
#: Gaps of up to this many points are interpolated from the shape of their neighbours.
_BRIDGED_POINTS = 2
#: Force error of a frame that is negligible beside its standard deviations [N].
NEGLIGIBLE_N = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Deflection:
    """Deflection of K points in one frame, normalised with the zero reference."""

    delta_m: Float[np.ndarray, "K"]  #: towards the base, gaps interpolated; NaN where that is impossible
    sigma_m: Float[np.ndarray, "K"]  #: its standard deviation, all errors except those common to all points
    noise_m: Float[np.ndarray, "K"]  #: the part that varies from frame to frame
    own_noise_m: Float[np.ndarray, "K"]  #: the part that varies and that neighbours do not share
    seen: Bool[np.ndarray, "K"]  #: measured, not interpolated
    hidden_m: Float[
        np.ndarray, "K"
    ]  #: upper bound of the deflection of a hidden point; infinite where there is none
    raw_m: Float[np.ndarray, "K"]  #: deflection if every edge belonged to the foam
    states: EdgeStates  #: states of the edges
    light_m: Float[np.ndarray, "K"]  #: standard deviation due to uneven light, shared by neighbours
    unclean_m: Float[np.ndarray, "K"]  #: error of edges that were not observed at rest, shared by neighbours
    encoding_m: Float[np.ndarray, "K"]  #: error due to the camera's encoding, shared by all points

    @property
    def covered(self) -> Bool[np.ndarray, "K"]:
        """Hidden points in gaps that are too long for interpolation."""
        return ~self.seen & (self.hidden_m > 0.0)

    def contour(self, geometry: StripGeometry, zero_sigma_m: float) -> FoamContour:
        """Convert to the input of :func:`~visuohaptic.sensing.foam.profile.read_profile`.

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
            unclean_m=self.unclean_m,
            shared_m=self.encoding_m,
            zero_sigma_m=zero_sigma_m,
            averaged=True,
            shared_noise=SHARED_NOISE,
            measured=~self.covered,
            end_cells_m=geometry.end_cells_m,
        )


def pressed_force_N(
    delta_m: Float[np.ndarray, "K"], material: FoamMaterial, cell_m: Float[np.ndarray, "K"]
) -> float:
    """Force of foam whose deflection is constant along each cell [N].

    Parameters
    ----------
    delta_m
        Deflection of each point [m], which may be infinite.
    material
        Calibrated foam.
    cell_m
        Length of foam that each point represents [m].
    """
    if not delta_m.any():
        return 0.0
    pressure = material.stress(np.minimum(delta_m / material.width_m, 1.0))
    return material.height_m * float(cell_m @ pressure)


def measure_deflection(
    edges: MeasuredEdges, states: EdgeStates, strip: ObservedStrip, geometry: StripGeometry
) -> Deflection:
    """Deflection of each point whose edge belongs to the foam, and bounds for the hidden points.

    Parameters
    ----------
    edges, states
        Deflection of the edges of one frame, and their states.
    strip
        Observation of the strip in the same frame.
    geometry
        Points of the strip.
    """
    # Under the edge of a shadow the foam looks like the zero image in another light: at rest within the pixel resolution.
    delta = np.where(states.shadow, 0.0, edges.delta_m)
    sigma = np.where(states.shadow, REST_PX * strip.pixel_m, edges.sigma_m)
    seen = (states.foam | states.shadow) & (strip.usable | strip.low_confidence)
    delta, sigma, noise, own, hidden = fill_gaps(
        geometry, delta, sigma, edges.noise_m, edges.systematic_m, seen
    )
    unclean, encoding = (np.where(states.foam, error, 0.0) for error in (edges.unclean_m, edges.encoding_m))
    raw, light = edges.delta_m, edges.light_m
    return Deflection(delta, sigma, noise, own, seen, hidden, raw, states, light, unclean, encoding)


def fill_gaps(
    geometry: StripGeometry,
    delta_m: Float[np.ndarray, "K"],
    sigma_m: Float[np.ndarray, "K"],
    noise_m: Float[np.ndarray, "K"],
    uncertainty_m: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
) -> tuple[Float[np.ndarray, "K"], ...]:
    """Deflection with interpolated gaps, its standard deviation, the parts due to noise and due to the own noise of each
    point, and the bound for hidden points, see :class:`Deflection`.

    One or two points are interpolated from the shape of their neighbours. A load in a wider gap would also deflect the
    adjacent foam: a point at a distance x from the last observed one, whose deflection is d +- sigma, is deflected by at most
    (d + sigma) exp(x / l) with the shortest decay length l of free foam.

    Parameters
    ----------
    geometry
        Points of the strip.
    delta_m, sigma_m, noise_m, uncertainty_m
        Deflection, noise and texture, the noise alone, and the systematic error [m].
    seen
        Points whose deflection is known.
    """
    s_m, width_m = geometry.s_m, geometry.width_m
    delta, sigma, error = delta_m.copy(), sigma_m.copy(), np.zeros(len(s_m))
    hidden, kept = np.zeros(len(s_m)), np.empty(len(s_m), dtype=bool)
    total_m = np.hypot(sigma_m, uncertainty_m)
    drop_bridged(s_m, delta_m, total_m, seen, delta, error, kept)
    delta[kept], error[kept], seen = delta_m[kept], 0.0, kept
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (~seen).astype(np.int8), [0]])))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        gap = np.arange(first, stop)
        ends = [k for k in (first - 1, stop) if 0 <= k < len(s_m)]
        if ends and len(gap) <= _BRIDGED_POINTS:
            bridge(s_m, delta_m, sigma_m, seen, first, stop, delta, error)
            if error[first] < np.inf:
                sigma[gap] = sigma_m[ends].max()
                continue
            error[first] = 0.0
        sigma[gap], delta[gap] = 0.0, np.nan
        hidden[gap] = np.inf
        for k in ends:
            drawn = (max(delta_m[k], 0.0) + total_m[k]) * np.exp(
                np.abs(s_m[gap] - s_m[k]) / (DECAY_PER_WIDTH * width_m)
            )
            hidden[gap] = np.minimum(hidden[gap], np.minimum(drawn, 1.0))
        if ends:
            delta[gap] = np.interp(s_m[gap], s_m[ends], delta_m[ends])
    error = np.where(np.isfinite(hidden) & (hidden > 0.0), hidden, error)
    total = np.hypot(sigma, np.where(seen, uncertainty_m, error))
    noise = np.where(seen, np.minimum(noise_m, total), 0.0)
    own = np.where(seen, _KINK_NOISE * uncertainty_m, np.where(hidden > 0.0, 0.0, _BRIDGE_NOISE * error))
    own = np.minimum(own, np.sqrt(np.maximum(total**2 - noise**2, 0.0)))
    return delta, total, noise, own, hidden


def with_states(
    reading: FoamReading, found: Deflection, material: FoamMaterial, cell_m: Float[np.ndarray, "K"]
) -> tuple[FoamReading, float]:
    """The reading with the uncertainty of the edge states in its budget, and the probability that it is wrong nevertheless.

    A run of points with a wrong state has an error of its whole force: with the force f_k of each point and the probability
    P_ij that all states from i to j are wrong, the variance is the sum of f_i P_ij f_j. A run makes the reading wrong if its
    force exceeds three standard deviations of the other errors plus ``NEGLIGIBLE_N``.

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
    runs, states = found.states.runs, found.states
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
        open_var = float(each_N[part] @ runs[part, part] @ each_N[part])
        model = math.sqrt(contact.budget.model_N**2 + open_var)
        contacts.append(replace(contact, budget=replace(contact.budget, model_N=model)))
    delta, sigma = found.delta_m, found.sigma_m
    # Deflections that are too small, compared with the error of the zero, to count as a contact may still be one.
    with np.errstate(invalid="ignore"):
        unexplained = np.where(found.seen & (delta > 2.0 * sigma), delta, 0.0)
    unexplained = np.where(
        inside, 0.0, unexplained + np.where(np.isfinite(found.hidden_m), found.hidden_m, 0.0)
    )
    loose = pressed_force_N(unexplained, material, cell_m)
    # Uneven light shifts neighbouring points by a common error.
    light = found.light_m if not reading.contacts else np.where(inside, found.light_m, 0.0)
    if light.any():
        slope = material.slope(np.where(np.isfinite(delta), delta, 0.0) / material.width_m) / material.width_m
        loose = math.hypot(loose, material.height_m * float(cell_m @ (light * slope)))
    budget = replace(reading.budget, zero_N=math.hypot(reading.budget.zero_N, loose))
    wrong = _wrong(each_N, runs, 3.0 * budget.total_N + NEGLIGIBLE_N)
    budget = replace(budget, model_N=math.sqrt(budget.model_N**2 + float(each_N @ runs @ each_N)))
    return replace(reading, contacts=tuple(contacts), budget=budget), wrong


def _wrong(each_N: Float[np.ndarray, "K"], runs: Float[np.ndarray, "K K"], tolerance_N: float) -> float:
    """Largest probability of a run whose force exceeds the tolerance."""
    force = np.concatenate([[0.0], np.cumsum(each_N)])
    first = np.arange(len(each_N))
    last = np.searchsorted(force, force[:-1] + tolerance_N) - 1
    possible = last < len(each_N)
    return float(runs[first[possible], last[possible]].max(initial=0.0))

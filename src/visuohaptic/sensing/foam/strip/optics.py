"""Optics of the foam sensor: width of the strip at each point from an image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32

from ....core import Frame, InputError, PlaneView
from ....tracking.contours.contour import Contour, ContourSettings, ContourTracker, PointReason, quick_median
from ....tracking.contours.lines import ConstraintLines
from ._rectify_kernels import rectify
from ._reference import ImageMotion, fit_motion, motion_basis
from .config import TrackingSection
from .encoding import encoded_shift_px
from .geometry import StripGeometry
from .stripe_view import StripeView
from .zero import PARALLELS, REACH, ZeroReference

_POLARITY = {"brighter": 1, "darker": -1, "either": 0}

#: The front is searched between these fractions of the width: foam is never thicker than at rest, but the model may have an error.
_SEARCH_FROM, _SEARCH_TO = 0.12, 1.12

#: The front corner of a free end moves inwards by up to this fraction of the width beside a plate, so that the last lines
#: meet the end face, which is parallel to them (0.18 at a depth of 0.45 of the width, a plate 3 to 12 mm from the end).
_RECEDES = 0.18

#: Minimum lever arm for estimating a change of distance from the motion of the base.
_SHORTEST_LEVER_PX = 30.0
#: Extent of the parallel lines of the image of the strip relative to the spacing of the points.
_BESIDE = 0.8

#: Sampling starts this far behind the front, to include a band of foam and the blur of the edge [px].
_BEFORE = 30

#: A shaking camera moves up to this many times faster within a frame than from frame to frame.
_SHAKE_FACTOR = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class ObservedStrip:
    """Observation of the strip in one image; K points."""

    t_s: float
    reference: Contour  #: reference contour (B) as tracked
    front: Contour  #: front contour as tracked
    reference_px: Float[np.ndarray, "K"]  #: reference contour as used, along the lines of the model
    reference_points_px: Float[np.ndarray, "K 2"]
    front_points_px: Float[np.ndarray, "K 2"]
    rest_px: Float[np.ndarray, "K"]  #: position of the front at rest along each line, from its origin
    width_m: Float[np.ndarray, "K"]  #: distance between both contours along the deflection
    width_sigma_m: Float[np.ndarray, "K"]  #: its standard deviation due to noise and texture
    width_noise_m: Float[np.ndarray, "K"]  #: the part of it that varies from frame to frame
    encoded_m: Float[np.ndarray, "K"]  #: excess of the width if the camera encodes its grey levels
    #: Grey levels along the lines, parallel lines beside each point; as in :class:`ZeroReference`.
    image: Float32[np.ndarray, "K parallels samples"]
    step_px: Float[np.ndarray, "K"]  #: spacing of its samples
    across_px: Float[np.ndarray, "K"]  #: spacing of its parallel lines
    stripe: bool  #: whether the front is the edge of a colour stripe
    pixel_m: Float[np.ndarray, "K"]  #: length of a pixel along the deflection, at the front
    usable: Bool[np.ndarray, "K"]  #: observed, with a known width at rest
    low_confidence: Bool[np.ndarray, "K"]  #: observed, but not as a clean step: kinks, texture at the edge
    moved_px: (
        float  #: largest shift of a reference point by unexpected motion since the zero reference was taken
    )
    common_sigma_m: float  #: common error of all widths due to motion of camera or finger
    blur_px: float  #: median blur of the front, pixel included; NaN if no front was observed
    lens_px: float  #: blur of the base, due only to the lens and the motion of the camera
    #: Edge of a shadow on the foam behind the front, along the lines of the model; 0 where there is none.
    edge_px: Float[np.ndarray, "K"]


@dataclass(frozen=True, slots=True, eq=False)
class BaseView:
    """The reference contour in one image; K points."""

    grey: np.ndarray  #: the image
    reference: Contour  #: as tracked
    position_px: Float[np.ndarray, "K"]  #: as used, along the lines of the model
    sigma_px: Float[np.ndarray, "K"]
    motion: ImageMotion  #: since the zero reference was taken
    moved_px: float  #: largest shift of a point by unexpected motion


class StripOptics:
    """Tracks both contours of a strip under a known pose.

    Parameters
    ----------
    geometry
        Points of the strip.
    tracking
        Appearance of the contours and their search ranges.
    plane
        The top plane of the foam as the camera sees it.
    stripe
        View of a colour stripe along the front; None: the edge of the front itself is tracked.
    """

    def __init__(
        self,
        geometry: StripGeometry,
        tracking: TrackingSection,
        plane: PlaneView,
        *,
        stripe: StripeView | None = None,
    ) -> None:
        self.geometry = geometry
        self.tracking = tracking
        self.stripe = stripe
        #: Distance from the back to the tracked edge at rest: the front, or the inner edge of a stripe.
        self.rest_width_m = geometry.width_m - (stripe.width_m if stripe is not None else 0.0)
        self._free_ends = math.ceil(_RECEDES * geometry.width_m / float(geometry.cell_m[0]))
        #: Sign of the step from the foam to what is in front of it, 0 if unknown.
        self.polarity = -_POLARITY[tracking.foam_is]
        self._front_tracker = ContourTracker(ContourSettings(polarity=self.polarity))
        self._reference_tracker = ContourTracker(ContourSettings(polarity=-_POLARITY[tracking.base_is]))
        self.forget_motion()
        self.place(plane)
        self._samples = int(REACH * self._length_px.max()) + 2

    def reset(self) -> None:
        """Discard the previous frame."""
        self._front_tracker.reset()
        self._reference_tracker.reset()
        if self.stripe is not None:
            self.stripe.reset()
        self.forget_motion()

    def forget_motion(self) -> None:
        """Discard the velocity of the camera, after a pause."""
        self._last_motion: tuple[float, np.ndarray] | None = None
        self._last_velocity: np.ndarray | None = None

    def place(self, plane: PlaneView) -> None:
        """Project the lines of the geometric model into the image.

        Parameters
        ----------
        plane
            The top plane of the foam as the camera sees it.
        """
        geometry = self.geometry
        width = self.rest_width_m
        self.plane = plane
        origin = plane.project(geometry.back_m)
        front = plane.project(geometry.back_m + width * geometry.outward)
        size = np.array([plane.camera.width - 1, plane.camera.height - 1])
        #: Points outside the image, which are hidden in every frame.
        self.outside: Bool[np.ndarray, "K"] = ~np.all(
            (origin >= 0) & (origin <= size) & (front >= 0) & (front <= size), axis=1
        )
        if 2 * self.outside.sum() > len(origin):
            raise InputError(
                "T_camera_foam",
                f"{int(self.outside.sum())} of {len(origin)} points of the strip are outside the image, expected less than half",
                remedy="check T_camera_foam and strip in sensor.yaml",
            )
        self._origin_px = np.ascontiguousarray(origin)
        self._length_px = np.linalg.norm(front - origin, axis=1)
        self._direction_px = np.ascontiguousarray((front - origin) / self._length_px[:, None])
        # If the camera approaches by the fraction q, each point moves by q times this along its line.
        principal = plane.camera.matrix[:2, 2]
        along = np.abs(np.einsum("ki,ki->k", origin - principal, self._direction_px))
        self._depth_lever_px = max(float(along.max()), _SHORTEST_LEVER_PX)
        spacing = np.linalg.norm(np.gradient(origin, axis=0), axis=1)
        self._half_width_px = 0.5 * spacing
        self._base_lines: ConstraintLines | None = (
            None  # for the expected contour, as long as it does not change
        )
        self._expected_px = np.empty(0)
        self._basis_scale = (origin.mean(axis=0), 0.5 * float(np.linalg.norm(origin[-1] - origin[0])))
        self._basis = motion_basis(origin, self._direction_px, *self._basis_scale)

    def observe(self, frame: Frame, zero: ZeroReference | None) -> ObservedStrip | None:
        """Track both contours; ``None`` if the reference contour cannot be found.

        Parameters
        ----------
        frame
            The next frame in chronological order.
        zero
            The strip at rest, if it is known.
        """
        base = self.find_base(frame.grey, zero)
        return None if base is None else self.find_front(frame, base, zero)

    def find_base(self, grey: np.ndarray, zero: ZeroReference | None) -> BaseView | None:
        """Track the reference contour; ``None`` if it cannot be found.

        Parameters
        ----------
        grey
            Grey image.
        zero
            The strip at rest, if it is known.
        """
        expected = zero.reference_px if zero is not None else np.zeros(len(self._origin_px))
        lines = self._base_lines
        if lines is None or expected is not self._expected_px:
            search = self.tracking.reference_search_px
            lines = self._base_lines = ConstraintLines(
                self._origin_px, self._direction_px, expected - search, expected + search, self._half_width_px
            )
            self._expected_px = expected
        reference = self._reference_tracker.track(grey, lines)
        shift = reference.position_px - expected
        motion = fit_motion(self._basis, shift, reference.sigma_px, reference.valid)
        if motion is None:
            return None
        moved = self._basis @ motion.parameters
        if zero is not None:
            position = expected + moved
            sigma = np.sqrt(np.einsum("ki,ij,kj->k", self._basis, motion.covariance, self._basis))
        else:
            # While zeroing, each point stays at its observed position: the base need not be a perfect curve.
            position = np.where(reference.valid, reference.position_px, moved)
            sigma = reference.sigma_px
        return BaseView(grey, reference, position, sigma, motion, float(np.abs(moved).max()))

    def find_front(self, frame: Frame, base: BaseView, zero: ZeroReference | None) -> ObservedStrip:
        """Track the front contour, relative to the reference contour of the same image.

        Parameters
        ----------
        frame
            The next frame in chronological order.
        base
            The reference contour in the same image.
        zero
            The strip at rest; without it, the whole width is sampled, and any point may be usable.
        """
        base_px = self._origin_px + base.position_px[:, None] * self._direction_px
        # The visible width ends at the front of the geometric model, measured from the moved reference.
        length = self._length_px - base.position_px
        lines = ConstraintLines(
            base_px, self._direction_px, _SEARCH_FROM * length, _SEARCH_TO * length, self._half_width_px
        )
        if self.stripe is None:
            # Without a zero reference the strip is assumed to be at rest, with its ends in place.
            front = self._front_tracker.track(
                base.grey, lines, free_ends=0 if zero is None else self._free_ends
            )
        else:
            front = self.stripe.track(frame, lines)
        skew = self._rolling_shutter_px(base.motion, base_px, front, frame.t_s)
        self._base = base, skew
        return self._observed(frame, base, skew, front, zero, np.zeros(len(length)))

    def with_front(
        self, frame: Frame, front: Contour, edge_px: Float[np.ndarray, "K"], zero: ZeroReference
    ) -> ObservedStrip:
        """Observation of the last frame with another contour of its front.

        Parameters
        ----------
        frame, zero
            As in :meth:`observe`.
        front, edge_px
            From :func:`~visuohaptic.sensing.foam.shadowed.second_front`.
        """
        return self._observed(frame, *self._base, front, zero, edge_px)

    def _observed(
        self,
        frame: Frame,
        base: BaseView,
        skew: tuple[np.ndarray | float, ...],
        front: Contour,
        zero: ZeroReference | None,
        edge_px: Float[np.ndarray, "K"],
    ) -> ObservedStrip:
        """Width of the strip between both contours, and its image."""
        skew_px, skew_sigma_px = skew
        base_px = self._origin_px + base.position_px[:, None] * self._direction_px
        position = front.position_px - skew_px
        behind = np.where(edge_px > 0.0, np.minimum(edge_px, position), position)
        front_px = base_px + position[:, None] * self._direction_px
        back_m, front_m, back_slope, front_slope = self._cast(base_px, front_px)
        outward = self.geometry.outward
        width = np.einsum("ki,ki->k", front_m - back_m, outward)
        front_sigma, back_sigma = front_slope * front.sigma_px, back_slope * base.sigma_px
        common = 0.0
        if np.any(skew_sigma_px):
            # Motion shifts all points by a common error; the deviations from it are independent errors.
            skew_m = front_slope * skew_sigma_px
            common = quick_median(skew_m[np.isfinite(skew_m)])
            front_sigma = np.hypot(front_sigma, np.sqrt(np.maximum(skew_m**2 - common**2, 0.0)))
        sigma = np.hypot(front_sigma, back_sigma)
        noise = np.hypot(front_slope * front.noise_px, back_sigma)
        finite = np.isfinite(width) & np.isfinite(sigma) & ~self.outside
        rest_m = self.rest_width_m * np.ones(len(width)) if zero is None else zero.width_m
        rest_px = self.plane.project(back_m + rest_m[:, None] * outward) - base_px
        # The deflection of a point is unknown without its width at rest.
        finite &= zero is None or zero.known
        # The base is one rigid edge: a shadow beside some of its points does not shift it.
        back_px = quick_median(encoded_shift_px(base.reference)[base.reference.valid])
        encoded = front_slope * encoded_shift_px(front) - back_slope * back_px
        return ObservedStrip(
            frame.t_s, base.reference, front, base.position_px, base_px, front_px,
            np.einsum("ki,ki->k", rest_px, self._direction_px), width, sigma, noise,
            np.zeros(len(width)) if self.stripe is not None else encoded,
            *self._rectified(base.grey, base_px, None if zero is None else behind),
            self.stripe is not None,
            front_slope,
            front.valid & finite,
            finite & ((front.reason == PointReason.POOR_FIT) | (front.reason == PointReason.JUMP)),
            base.moved_px,
            float(np.hypot(self.rest_width_m * base.moved_px / self._depth_lever_px, common)),
            quick_median(front.blur_px[front.valid]) if front.valid.any() else float("nan"),
            quick_median(base.reference.blur_px[base.reference.valid]),
            edge_px,
        )  # fmt: skip

    def _rectified(
        self, grey: np.ndarray, base_px: np.ndarray, front_px: Float[np.ndarray, "K"] | None
    ) -> tuple[Float32[np.ndarray, "K parallels samples"], Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
        """Image of the strip along the lines, spacing of its samples and of its parallel lines [px].

        Without ``front_px`` the whole width is sampled, else it starts a short distance behind the front.
        """
        step = REACH * self._length_px / (self._samples - 1)
        image = np.zeros((len(step), PARALLELS, self._samples), np.float32)
        first = np.zeros(len(step), dtype=np.int64)
        if front_px is not None:
            known_px = np.where(np.isfinite(front_px), front_px, 0.0)
            place = np.minimum(known_px, self._length_px) / step
            first = np.maximum(place - _BEFORE, 0.0).astype(np.int64)
        across = 2.0 * _BESIDE / (PARALLELS - 1) * self._half_width_px
        rectify(grey, base_px, self._direction_px, step, across, first, image)
        return image, step, across

    def visible_width_m(self, frame: Frame) -> float:
        """Median distance from the back to the first strong edge in front of it, at any distance [m].

        This is the measured width if the declared one is wrong. NaN if the back or an edge is not found at half of
        the points.

        Parameters
        ----------
        frame
            A frame of the untouched strip.
        """
        grey = frame.grey
        base = self.find_base(grey, None)
        if base is None or self.stripe is not None:
            return float("nan")
        base_px = self._origin_px + base.position_px[:, None] * self._direction_px
        size = np.array([grey.shape[1] - 1.0, grey.shape[0] - 1.0])
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = np.where(self._direction_px > 0, size - base_px, -base_px) / self._direction_px
        border = np.nanmin(np.where(self._direction_px == 0, np.inf, ahead), axis=1) - 1.0
        start = _SEARCH_FROM * self._length_px
        lines = ConstraintLines(
            base_px, self._direction_px, start, np.maximum(start, border), self._half_width_px
        )
        front = ContourTracker(self._front_tracker.settings).track(grey, lines)
        if 2 * front.valid.sum() < len(front.valid):
            return float("nan")
        back_m, front_m = self.plane.cast(np.concatenate([base_px, front.points_px])).reshape(2, -1, 2)[
            ..., :2
        ]
        width = np.einsum("ki,ki->k", front_m - back_m, self.geometry.outward)
        return float(np.median(width[front.valid]))

    def _rolling_shutter_px(
        self, motion: ImageMotion, base_px: np.ndarray, front: Contour, t_s: float
    ) -> tuple[np.ndarray | float, np.ndarray | float]:
        """Displacement of each front point since the exposure of its reference point, and its sigma.

        Rows are exposed ``row_delay_s`` apart; the motion is that of the reference contour
        since the last frame (Alt 2016, Sec. 3.3.2).
        """
        row_delay = self.plane.camera.row_delay_s
        last, self._last_motion = self._last_motion, (t_s, motion.parameters)
        if row_delay == 0.0 or last is None or t_s <= last[0]:
            return 0.0, 0.0
        velocity = (motion.parameters - last[1]) / (t_s - last[0])
        delay = front.position_px * self._direction_px[:, 1] * row_delay
        basis = motion_basis(base_px, self._direction_px, *self._basis_scale)
        change = velocity - (self._last_velocity if self._last_velocity is not None else velocity)
        self._last_velocity = velocity
        # If the motion changes from frame to frame, the motion within the frame is uncertain.
        shake_px = _SHAKE_FACTOR * float(np.nanmax(np.abs((basis @ change) * delay)))
        return (basis @ velocity) * delay, shake_px

    def _cast(self, base_px: np.ndarray, front_px: np.ndarray) -> tuple[np.ndarray, ...]:
        """Both contours in frame F and the scale [m/px] along each line at each of them."""
        step = 0.5 * self._direction_px
        pixels = np.stack([base_px + step, front_px + step, base_px - step, front_px - step])
        # Half a pixel is small compared with the focal length: the point is half way between its two neighbours.
        (back, front), (back_before, front_before) = self.plane.cast(pixels).reshape(2, 2, -1, 2)
        outward = self.geometry.outward
        back_slope = np.abs(np.einsum("ki,ki->k", back - back_before, outward))
        front_slope = np.abs(np.einsum("ki,ki->k", front - front_before, outward))
        return 0.5 * (back + back_before), 0.5 * (front + front_before), back_slope, front_slope

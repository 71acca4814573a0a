"""The optical half of the foam sensor: from an image to the width of the strip at each point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...camera import PlaneView
from ...errors import InputError
from ...tracking import ConstraintLines, Contour, ContourSettings, ContourTracker, PointReason
from ._appearance import interior_grey
from ._reference import ImageMotion, fit_motion, motion_basis
from .config import TrackingSection
from .geometry import StripGeometry
from .zero import ZeroReference

__all__ = ["ObservedStrip", "StripOptics"]

_POLARITY = {"brighter": 1, "darker": -1, "either": 0}

#: The front is searched from this fraction of the width ...
_SEARCH_FROM = 0.12
#: ... to this fraction of it (foam never gets thicker than at rest, but the model may be off).
_SEARCH_TO = 1.12

#: Motion of the base tells a change of distance no better than with a lever of this length.
_SHORTEST_LEVER_PX = 30.0

#: A shaking camera moves within a frame up to this many times faster than from frame to frame.
_SHAKE_FACTOR = 3.0

_DOUBTFUL = (PointReason.POOR_FIT, PointReason.JUMP)


@dataclass(frozen=True, slots=True, eq=False)
class ObservedStrip:
    """What one image shows of the strip; K points."""

    t_s: float
    reference: Contour  #: reference contour (B) as tracked
    front: Contour  #: front contour as tracked
    reference_px: Float[np.ndarray, "K"]  #: reference contour as used, along the model's lines
    reference_points_px: Float[np.ndarray, "K 2"]
    front_points_px: Float[np.ndarray, "K 2"]
    front_foam_m: Float[np.ndarray, "K 2"]  #: front contour in frame F
    width_m: Float[np.ndarray, "K"]  #: distance between both contours along the deflection
    width_sigma_m: Float[np.ndarray, "K"]
    foam_grey: Float[np.ndarray, "K"]  #: mean grey level between both contours
    usable: Bool[np.ndarray, "K"]
    doubtful: Bool[np.ndarray, "K"]  #: seen, but not as one clean step: kinks, texture at the edge
    motion: ImageMotion  #: of the base in the image since the zero reference was taken
    moved_px: float  #: largest shift of a reference point by that motion
    common_sigma_m: float  #: what the camera's motion may have changed all widths by
    blur_px: float  #: median blur of the front, pixel included; NaN where none was seen


class StripOptics:
    """Tracks both contours of a strip that is seen under a known pose."""

    def __init__(
        self,
        geometry: StripGeometry,
        tracking: TrackingSection,
        plane: PlaneView,
        *,
        stripe_width_m: float = 0.0,
    ) -> None:
        self.geometry = geometry
        self.tracking = tracking
        #: Distance from the back to the tracked edge at rest: the front, or the inner edge of a stripe.
        self.rest_width_m = geometry.width_m - stripe_width_m
        self._front_tracker = ContourTracker(ContourSettings(polarity=-_POLARITY[tracking.foam_is]))
        self._reference_tracker = ContourTracker(ContourSettings(polarity=-_POLARITY[tracking.base_is]))
        self.forget_motion()
        self.place(plane)

    def reset(self) -> None:
        """Forget the previous frame."""
        self._front_tracker.reset()
        self._reference_tracker.reset()
        self.forget_motion()

    def forget_motion(self) -> None:
        """Forget how fast the camera moved, after a pause."""
        self._last_motion: tuple[float, np.ndarray] | None = None
        self._last_velocity: np.ndarray | None = None
        self._shake_px = 0.0

    def place(self, plane: PlaneView) -> None:
        """Lay the lines of the geometric model into the image."""
        geometry = self.geometry
        width = self.rest_width_m
        self.plane = plane
        origin = plane.project(geometry.back_m)
        front = plane.project(geometry.back_m + width * geometry.outward)
        size = np.array([plane.camera.width - 1, plane.camera.height - 1])
        outside = ~((origin >= 0) & (origin <= size) & (front >= 0) & (front <= size)).all(axis=1)
        if outside.any():
            raise InputError(
                "pose_camera_foam",
                f"{int(outside.sum())} of {len(origin)} points of the strip are outside the image",
                remedy="check pose_camera_foam and strip in sensor.yaml",
            )
        self._origin_px = np.ascontiguousarray(origin)
        self._length_px = np.linalg.norm(front - origin, axis=1)
        self._direction_px = np.ascontiguousarray((front - origin) / self._length_px[:, None])
        # A camera that comes closer by the fraction q moves each point by q times this along its line.
        principal = plane.camera.matrix[:2, 2]
        along = np.abs(np.einsum("ki,ki->k", origin - principal, self._direction_px))
        self._depth_lever_px = max(float(along.max()), _SHORTEST_LEVER_PX)
        spacing = np.linalg.norm(np.gradient(origin, axis=0), axis=1)
        self._half_width_px = 0.5 * spacing
        self._basis_scale = (origin.mean(axis=0), 0.5 * float(np.linalg.norm(origin[-1] - origin[0])))
        self._basis = motion_basis(origin, self._direction_px, *self._basis_scale)

    def observe(self, grey: np.ndarray, t_s: float, zero: ZeroReference | None) -> ObservedStrip | None:
        """Track both contours; ``None`` when the reference contour cannot be found."""
        search = self.tracking.reference_search_px
        expected = zero.reference_px if zero is not None else np.zeros(len(self._origin_px))
        lines = ConstraintLines(
            self._origin_px, self._direction_px, expected - search, expected + search, self._half_width_px
        )
        reference = self._reference_tracker.track(grey, lines)
        shift = reference.position_px - expected
        motion = fit_motion(self._basis, shift, reference.sigma_px, reference.valid)
        if motion is None:
            return None
        if zero is not None:
            reference_px = expected + self._basis @ motion.parameters
            reference_sigma = np.sqrt(np.einsum("ki,ij,kj->k", self._basis, motion.covariance, self._basis))
        else:
            # The zero itself keeps each point where it was seen: the base need not be a perfect curve.
            reference_px = np.where(reference.valid, reference.position_px, self._basis @ motion.parameters)
            reference_sigma = reference.sigma_px
        base_px = self._origin_px + reference_px[:, None] * self._direction_px
        # The visible width ends where the geometric model's front is, seen from the moved reference.
        length = self._length_px - reference_px
        front_lines = ConstraintLines(
            base_px, self._direction_px, _SEARCH_FROM * length, _SEARCH_TO * length, self._half_width_px
        )
        front = self._front_tracker.track(grey, front_lines)
        position = front.position_px - self._rolling_shutter_px(motion, base_px, front, t_s)
        front_px = base_px + position[:, None] * self._direction_px
        back_m, front_m, back_slope, front_slope = self._cast(base_px, front_px)
        outward = self.geometry.outward
        width = np.einsum("ki,ki->k", front_m - back_m, outward)
        sigma = np.hypot(front_slope * front.sigma_px, back_slope * reference_sigma)
        finite = np.isfinite(width) & np.isfinite(sigma)
        moved_px = float(np.abs(self._basis @ motion.parameters).max())
        return ObservedStrip(
            t_s,
            reference,
            front,
            reference_px,
            base_px,
            front_px,
            front_m,
            width,
            sigma,
            interior_grey(grey, base_px, self._direction_px, np.nan_to_num(position, nan=-1.0)),
            front.valid & finite,
            ~front.valid & finite & np.isin(front.reason, _DOUBTFUL),
            motion,
            moved_px,
            float(
                np.hypot(
                    self.rest_width_m * moved_px / self._depth_lever_px,
                    self._shake_px * float(np.nanmedian(front_slope)),
                )
            ),
            float(np.median(front.blur_px[front.valid])) if front.valid.any() else float("nan"),
        )

    def _rolling_shutter_px(
        self, motion: ImageMotion, base_px: np.ndarray, front: Contour, t_s: float
    ) -> np.ndarray | float:
        """How far the camera's motion moved each front point since its reference point was exposed.

        Rows are exposed ``row_delay_s`` apart; the motion is that of the reference contour
        since the last frame (Alt 2016, Sec. 3.3.2).
        """
        row_delay = self.plane.camera.row_delay_s
        self._shake_px = 0.0
        last, self._last_motion = self._last_motion, (t_s, motion.parameters)
        if row_delay == 0.0 or last is None or t_s <= last[0]:
            return 0.0
        velocity = (motion.parameters - last[1]) / (t_s - last[0])
        delay = front.position_px * self._direction_px[:, 1] * row_delay
        basis = motion_basis(base_px, self._direction_px, *self._basis_scale)
        change = velocity - (self._last_velocity if self._last_velocity is not None else velocity)
        self._last_velocity = velocity
        # A motion that changes from frame to frame may have done anything in between.
        self._shake_px = _SHAKE_FACTOR * float(np.nanmax(np.abs((basis @ change) * delay)))
        return (basis @ velocity) * delay

    def _cast(self, base_px: np.ndarray, front_px: np.ndarray) -> tuple[np.ndarray, ...]:
        """Both contours in frame F and the scale [m/px] along each line at either of them."""
        count = len(base_px)
        step = 0.5 * self._direction_px
        pixels = np.concatenate(
            [base_px, front_px, base_px + step, base_px - step, front_px + step, front_px - step]
        )
        points = self.plane.cast(pixels).reshape(6, count, 2)
        outward = self.geometry.outward
        back_slope = np.abs(np.einsum("ki,ki->k", points[2] - points[3], outward))
        front_slope = np.abs(np.einsum("ki,ki->k", points[4] - points[5], outward))
        return points[0], points[1], back_slope, front_slope

    def base_shift_m(self, strip: ObservedStrip, axis_foam: Float[np.ndarray, "2"]) -> tuple[float, float]:
        """How far the base has moved along an axis of F since the zero reference, and its sigma [m].

        Only the part of the motion that is perpendicular to the contour shows.
        """
        step = self.plane.cast(strip.reference_points_px) - self.plane.cast(
            strip.reference_points_px - (self._basis @ strip.motion.parameters)[:, None] * self._direction_px
        )
        along = self.geometry.outward @ axis_foam
        weight = along**2 / max(float((along**2).sum()), 1e-12)
        shift = np.einsum("ki,ki->k", step, self.geometry.outward)
        safe = np.where(np.abs(along) > 1e-3, along, 1.0)
        mean_basis = (weight / safe) @ self._basis
        scale = float(np.median(self.geometry.width_m / self._length_px))
        sigma_px = float(np.sqrt(mean_basis @ strip.motion.covariance @ mean_basis))
        return float(weight @ (shift / safe)), sigma_px * scale

"""Optics of a sensor on a moving finger: track the reference contour, then measure the strip."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ....core import Frame, PlaneView, Pose
from ....tracking.contours.contour import Contour
from ._reference import ImageMotion
from .config import FoamSetup
from .finger_tag import TagView
from .optics import BaseView, ObservedStrip, StripOptics
from .stripe_view import StripeView
from .zero import ZeroReference

log = logging.getLogger(__name__)

#: The lines are placed again if the reference contour is farther than this from its expected position.
_REPLACE_PX = 0.5
_ZERO_PX = 0.03  # while the zero reference is taken
_MAX_REPLACEMENTS = 5
#: Standard deviation of the speed of a finger at its first observation [m/s].
_UNKNOWN_SPEED_M_S = 0.05
#: Common position error of all points of an edge, which averaging does not reduce.
_EDGE_BIAS_PX = 0.02


@dataclass(frozen=True, slots=True)
class FingerPosition:
    """Position of the finger in one frame."""

    t_s: float  #: exposure time of the rows of the reference contour
    position_m: float  #: along the axis, 0 at ``T_camera_foam``, positive when closing
    sigma_m: float  #: from the image; NaN like the position if the finger was not found

    @property
    def valid(self) -> bool:
        """Whether the finger was found."""
        return bool(np.isfinite(self.position_m))


@dataclass(frozen=True, slots=True, eq=False)
class _FrontMemory:
    """Front of the last frame, for estimating its velocity."""

    t_s: float
    place_m: Float[np.ndarray, "K"]  #: along the normals, in the fixed frame
    speed_m_s: Float[np.ndarray, "K"]  #: mean since the previous frame


class FingerOptics(StripOptics):
    """Strip optics whose geometric model moves with the finger.

    In each frame the lines of the model are placed at the predicted position of the finger, the reference
    contour is tracked, and the lines are placed again if it deviates by more than half a
    pixel. The remainder after the motion along the axis is motion of the camera. The tag
    provides the initial position, the position after a loss, and a periodic check.

    Parameters
    ----------
    setup
        Configuration with a section ``finger``, and all files that it names.
    """

    def __init__(self, setup: FoamSetup) -> None:
        finger = setup.config.finger
        assert finger is not None
        axis = np.asarray(finger.axis_foam, dtype=np.float64)
        self._axis = axis / np.linalg.norm(axis)
        self._setup, self._finger = setup, finger
        self._tag = _tag_view(setup)
        self.position = FingerPosition(float("nan"), float("nan"), float("nan"))  #: in the last frame
        self._held_m: float | None = None
        self._laid_m = self._last_m = 0.0  # position of the lines, last observed position of the finger
        self._lost()
        plane = PlaneView(setup.camera, setup.T_camera_foam)
        super().__init__(setup.geometry, setup.config.tracking, plane, stripe=StripeView.of(setup))

    def _lost(self) -> None:
        self._known: tuple[float, float] | None = None  # time and position at the start of the prediction
        self._forget_speed()
        self._until_check = self._finger.tag_every
        self._bump_px = 0.0

    def _forget_speed(self) -> None:
        self._speed, self._speed_sigma = 0.0, _UNKNOWN_SPEED_M_S
        self._mean_speed: float | None = None
        self._front: _FrontMemory | None = None

    def reset(self) -> None:
        """Discard the previous frames and the position of the finger."""
        super().reset()
        self._lost()

    def forget_motion(self) -> None:
        """Discard the velocities of finger and front, after a pause."""
        super().forget_motion()
        self._forget_speed()

    def hold(self) -> None:
        """Keep the lines in place while the finger is at rest."""
        self._held_m = self._laid_m

    def release(self) -> None:
        """Let the lines follow the finger again."""
        self._held_m = None

    def pose_at(self, position_m: float) -> Pose:
        """``T_camera_foam`` with the finger at a position along its axis.

        Parameters
        ----------
        position_m
            Position of the finger along its axis [m].
        """
        return _moved(self._setup.T_camera_foam, position_m * self._axis)

    def observe(self, frame: Frame, zero: ZeroReference | None) -> ObservedStrip | None:
        """Locate the finger, then track the front; ``None`` if the finger cannot be located."""
        grey = frame.grey
        found = self._follow(grey, frame.t_s, zero) or self._acquire(grey, frame.t_s, zero)
        if found is None:
            if self._known is not None:
                log.info("finger lost at %.3f s", frame.t_s)
            super().reset()
            self._lost()
            self.position = FingerPosition(frame.t_s, float("nan"), float("nan"))
            return None
        self.position, base = found
        if self._known is not None and self.position.t_s > self._known[0]:
            mean = (self.position.position_m - self._known[1]) / (self.position.t_s - self._known[0])
            # The mean over the last frame interval is the speed at its middle: extrapolate by half an interval.
            change = 0.5 * (mean - self._mean_speed) if self._mean_speed is not None else 0.0
            self._speed, self._speed_sigma = mean + change, abs(change)
            self._mean_speed = mean
        self._known = self.position.t_s, self.position.position_m
        self._last_m = self.position.position_m
        return self.find_front(frame, base, zero)

    def _follow(
        self, grey: np.ndarray, t_s: float, zero: ZeroReference | None
    ) -> tuple[FingerPosition, BaseView] | None:
        """Predict from the last frame; ``None`` if the contour is lost or the tag contradicts it."""
        if self._known is None:
            return None
        if self._held_m is not None:
            return self._approach(grey, t_s, zero, self._held_m)
        # The row delay of the contour is the same in this frame as in the last one.
        expected = self._known[1] + self._speed * max(0.0, t_s + self._row_delay_s() - self._known[0])
        found = self._approach(grey, t_s, zero, expected)
        if found is None or self._tag is None:
            return found
        self._until_check -= 1
        if self._until_check > 0:
            return found
        self._until_check = self._finger.tag_every
        fix = self._tag.locate(grey, found[0].position_m)
        if fix is None:
            return found
        self._bump_px = fix.bump_px
        if abs(fix.position_m - found[0].position_m) > self._finger.tag_tolerance_m + 3 * fix.sigma_m:
            log.warning(
                "the contour gives a finger position of %.2f mm, its tag %.2f mm",
                1e3 * found[0].position_m, 1e3 * fix.position_m,
            )  # fmt: skip
            return None
        return found

    def _acquire(
        self, grey: np.ndarray, t_s: float, zero: ZeroReference | None
    ) -> tuple[FingerPosition, BaseView] | None:
        """Start from the tag, or without it from the last observed position of the finger or its rest position."""
        start, bump_px = self._last_m, 0.0
        if self._tag is not None and (fix := self._tag.locate(grey, start)) is not None:
            start, bump_px = fix.position_m, fix.bump_px
        super().reset()
        self._lost()
        self._bump_px = bump_px
        return self._approach(grey, t_s, zero, start)

    def _approach(
        self, grey: np.ndarray, t_s: float, zero: ZeroReference | None, position: float
    ) -> tuple[FingerPosition, BaseView] | None:
        """Place the lines and track until both agree."""
        camera = self._setup.camera
        # The zero reference belongs to lines that start on the contour itself.
        tolerance = _REPLACE_PX if zero is not None else _ZERO_PX
        for _ in range(_MAX_REPLACEMENTS):
            if not self._lies_inside(position):
                return None
            self.place(PlaneView(camera, self.pose_at(position)))
            self._laid_m = position
            base = self.find_base(grey, zero)
            if base is None:
                return None
            slope = self._slope_px_per_m()
            step, sigma = _along_axis(base.motion, self._basis, slope)
            if self._held_m is not None or np.abs(slope * step).max() < tolerance:
                other = float(np.abs(self._basis @ base.motion.parameters - slope * step).max())
                row_s = float(base.reference.points_px[:, 1].mean()) * camera.row_delay_s
                sigma = float(np.hypot(sigma, _EDGE_BIAS_PX / np.abs(slope).max()))
                place = FingerPosition(t_s + row_s, position + step, sigma)
                return place, replace(base, moved_px=max(other, self._bump_px))
            position += step
        return None

    def _lies_inside(self, position: float) -> bool:
        """Whether the whole strip would be inside the image."""
        plane = PlaneView(self._setup.camera, self.pose_at(position))
        ends = np.concatenate([self.geometry.back_m, self.geometry.front_m])
        pixels = plane.project(ends)
        size = [plane.camera.width - 1, plane.camera.height - 1]
        return bool(((pixels >= 0) & (pixels <= size)).all())

    def _row_delay_s(self) -> float:
        return float(self._origin_px[:, 1].mean()) * self._setup.camera.row_delay_s

    def _slope_px_per_m(self) -> Float[np.ndarray, "K"]:
        """Displacement of each reference point along its line per displacement of the finger."""
        step_m = 1e-5
        moved = self.plane.project(self.geometry.back_m + step_m * self._axis[:2])
        return np.einsum("kd,kd->k", self._direction_px, moved - self._origin_px) / step_m

    def _rolling_shutter_px(
        self, motion: ImageMotion, base_px: np.ndarray, front: Contour, t_s: float
    ) -> tuple[np.ndarray | float, np.ndarray | float]:
        """Displacement of each front point since the exposure of its reference point, and its sigma.

        A free front moves with the finger, one that touches a rigid object is at rest: the
        velocity is that of the point itself, from its positions in the last three frames.
        """
        row_delay = self._setup.camera.row_delay_s
        if row_delay == 0.0:
            return 0.0, 0.0
        direction, outward = self._direction_px, self.geometry.outward
        pixels = base_px + front.position_px[:, None] * direction
        points = self.plane.cast(np.concatenate([pixels, pixels + 0.5 * direction, pixels - 0.5 * direction]))
        points = points.reshape(3, -1, 2)
        m_per_px = np.einsum("kd,kd->k", points[1] - points[2], outward)
        along = outward @ self._axis[:2]
        place = np.einsum("kd,kd->k", points[0], outward) + self._laid_m * along
        late = front.position_px * direction[:, 1] * row_delay  # delay after the reference point [s]
        free = self._speed * along
        speed, uncertainty = free, np.abs(self._speed_sigma * along)
        mean, last = free, self._front
        if last is not None and t_s > last.t_s:
            measured = (place - last.place_m) / (t_s - last.t_s)
            # A point that was hidden in one of the frames is assumed to move with the finger.
            seen = front.valid & np.isfinite(measured) & (np.abs(measured) < 2 * np.abs(free).max() + 0.02)
            mean = np.where(seen, measured, free)
            change = 0.5 * (mean - last.speed_m_s)
            speed = np.where(seen, mean + change, free)
            uncertainty = np.where(seen, np.abs(change), uncertainty)
        self._front = _FrontMemory(t_s, np.where(front.valid, place, np.nan), mean)
        scale = late / np.where(np.abs(m_per_px) > 1e-9, m_per_px, np.inf)
        return speed * scale, uncertainty * np.abs(scale)


def finger_pose(setup: FoamSetup, frame: Frame) -> Pose:
    """``T_camera_foam`` in an image: from the tag on the finger, or from the configuration.

    Parameters
    ----------
    setup
        Configuration of the sensor.
    frame
        The image.
    """
    view = _tag_view(setup)
    fix = view.locate(frame.grey) if view is not None else None
    if view is None or fix is None:
        return setup.T_camera_foam
    return _moved(setup.T_camera_foam, fix.position_m * view.axis)


def _tag_view(setup: FoamSetup) -> TagView | None:
    finger = setup.config.finger
    if finger is None or finger.T_foam_tag is None:
        return None
    axis = np.asarray(finger.axis_foam, dtype=np.float64)
    return TagView(
        setup.camera, setup.T_camera_foam, axis / np.linalg.norm(axis),
        finger.T_foam_tag.pose(), finger.tag_id, finger.tag_size_m,
    )  # fmt: skip


def _moved(rest: Pose, shift_m: Float[np.ndarray, "3"]) -> Pose:
    return Pose(rest.rotation, rest.translation_m + rest.rotation @ shift_m)


def _along_axis(
    motion: ImageMotion, basis: Float[np.ndarray, "K 4"], slope_px_per_m: Float[np.ndarray, "K"]
) -> tuple[float, float]:
    """Motion along the axis that fits an image motion best, and its sigma [m]."""
    weights = (slope_px_per_m @ basis) / (slope_px_per_m @ slope_px_per_m)
    return float(weights @ motion.parameters), float(np.sqrt(weights @ motion.covariance @ weights))

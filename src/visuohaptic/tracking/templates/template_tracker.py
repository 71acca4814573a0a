"""Detection and tracking of several templates in a stream of frames, including recovery after loss.

Alt 2016, Sec. 2.3.4. Tracking runs on every frame, with the original template, so that there is no drift. Detection
runs in a separate thread while a template is lost: first near the last position, then in the whole image.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ...core import Camera, Closing, Frame, InputError, Pose, Reason
from ..points.homography import apply_homography, estimate_homography
from ..pose.plane_pose import PlanePose, estimate_plane_poses, pose_difference, tilted_back
from .alignment.block_fit import corners_within
from .alignment.esm import Alignment, align
from .alignment.esm_blur import matching_blur
from .alignment.esm_pyramid import EsmSettings
from .alignment.esm_template import CURVES
from .alignment.warp import is_proper
from .detector import DetectorSettings
from .lens import lens_offset, lens_samples
from .lost_search import LostPlace, LostSearch
from .template import Template

_log = logging.getLogger(__name__)

#: The corners' covariance is known up to a factor, whose inverse has so many degrees of freedom: the likelihood of chi^2,
#: F-distributed, in open pictures of another renderer is largest at 1.4 to 2, and flat there.
_SCATTER_FREEDOM = 2.0


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Settings of tracking and recovery."""

    esm: EsmSettings = field(default_factory=EsmSettings)
    detector: DetectorSettings = field(default_factory=DetectorSettings)
    ncc_found: float = 0.7  #: minimum correlation to accept a recovered template
    region_tries: int = 3  #: detections near the last position before the whole image is searched
    blur_frames: int = 30  #: interval between measurements of the blur, in frames
    flip_chi2: float = 10.0  #: accumulated difference of chi^2 at which the tilt is switched


@dataclass(frozen=True, slots=True, eq=False)
class TemplatePose:
    """Pose of one template in one frame."""

    name: str
    t_s: float
    valid: bool
    reason: Reason
    detail: str  #: description of why it is invalid; empty if valid
    T_camera_template: Pose | None  #: None if invalid
    #: of (x, y, z, rx, ry, rz) [m, rad], rotation about the camera's axes; NaN if invalid
    covariance: Float[np.ndarray, "6 6"]
    ambiguous: bool  #: a second tilt explains the view equally well; the covariance includes both
    #: chi^2 of the pose with 2 degrees of freedom; a large value indicates that camera
    #: calibration or flatness of the print is worse than the image noise
    chi2: float
    alignment: Alignment | None  #: homography, correlation, noise; None if nothing was aligned


@dataclass(slots=True)
class _Track:
    """State of one template between frames."""

    template: Template
    homography: np.ndarray | None = None  #: latest estimate; None while lost
    before: np.ndarray | None = None  #: corners one frame earlier, for the prediction
    last_seen: np.ndarray | None = None  #: last valid homography
    pose: Pose | None = None
    advantage: float = 0.0  #: accumulated chi^2 advantage of this tilt over the other
    min_chi2: float = 0.0  #: chi^2 of the best initial pose when the last pose could not be used
    lens: Float32[np.ndarray, "17 17 2"] | None = None  #: lens displacement beyond the homography [px]
    offset: Float32[np.ndarray, "2 R C"] | None = None  #: the same at every pixel
    tries: int = 0  #: number of detections since it was lost
    #: blur of the image relative to the template [template px^2]; None: not measured yet
    blur: float | None = None
    curve: float | None = None  #: curve from light to grey levels; None: not measured yet
    blur_age: int = 0  #: frames since the blur was measured
    blur_scale: float = 0.0  #: size in the image when the blur was measured [px]


class TemplateTracker(Closing):
    """Tracks templates through frames; one call of :meth:`update` per frame.

    Parameters
    ----------
    templates
        Templates with unique names.
    camera
        Intrinsics and distortion.
    settings
        Thresholds and effort.
    threaded
        Detect in a separate thread, so that a frame never waits for it (live use). Otherwise,
        every frame with a lost template is searched synchronously: slower, but reproducible.

    Examples
    --------
    >>> from visuohaptic.core.camera import Frame
    >>> tag = Template.from_tag(7, size_m=0.04)
    >>> camera = Camera.simple(640, 480, focal_px=600.0)
    >>> image = np.full((480, 640), 200, np.uint8)
    >>> rows, columns = tag.image.shape
    >>> image[60 : 60 + rows, 140 : 140 + columns] = tag.image  # seen from straight ahead
    >>> with TemplateTracker([tag], camera, threaded=False) as tracker:
    ...     (pose,) = tracker.update(Frame(image, 0.0, 0))
    >>> pose.valid, round(float(pose.T_camera_template.translation_m[2] / (600.0 * tag.pixel_m)), 2)  # of the distance
    (True, 1.0)
    """

    def __init__(
        self,
        templates: Sequence[Template],
        camera: Camera,
        settings: TrackerSettings | None = None,
        *,
        threaded: bool = True,
    ) -> None:
        names = [template.name for template in templates]
        if not names or len(set(names)) != len(names):
            raise InputError(
                "TemplateTracker", f"found the names {names}, expected one or more, all different"
            )
        self.camera = camera
        self.settings = settings or TrackerSettings()
        self._tracks = {template.name: _Track(template) for template in templates}
        self._search = LostSearch(self.settings.detector, threaded=threaded)
        self._last_t_s = -np.inf

    def close(self) -> None:
        """End the detector's thread; may be called repeatedly."""
        self._search.close()

    def reset(self) -> None:
        """Discard all state; every template is searched again."""
        self._search.forget()
        self._tracks = {name: _Track(track.template) for name, track in self._tracks.items()}
        self._last_t_s = -np.inf

    def update(self, frame: Frame) -> tuple[TemplatePose, ...]:
        """Poses of all templates in a frame, in the given order.

        Frames that are not newer than the previous one give ``Reason.STALE``.

        Parameters
        ----------
        frame
            The next frame in temporal order.
        """
        if not frame.t_s > self._last_t_s:
            return tuple(
                _no_pose(name, frame.t_s, Reason.STALE, "the frame is not newer than the previous one", None)
                for name in self._tracks
            )
        self._last_t_s = frame.t_s
        grey = frame.grey
        if (grey.shape[1], grey.shape[0]) != (self.camera.width, self.camera.height):
            raise InputError(
                "TemplateTracker",
                f"found a frame of {grey.shape[1]} x {grey.shape[0]} px, "
                f"expected {self.camera.width} x {self.camera.height} as in the camera model",
            )
        for name, detection in self._search.collected().items():
            if self._tracks[name].homography is None:
                self._tracks[name].homography = detection.homography
        results = {name: self._follow(track, grey, frame.t_s) for name, track in self._tracks.items()}
        lost = [track for track in self._tracks.values() if track.homography is None]
        if lost and not self._search.busy:
            found = self._search.search([self._place(track) for track in lost], grey)
            for name, detection in found.items():
                self._tracks[name].homography = detection.homography
                results[name] = self._follow(self._tracks[name], grey, frame.t_s)
        return tuple(results.values())

    def _place(self, track: _Track) -> LostPlace:
        """Search area of a lost template: first near its last position, then the whole image."""
        track.tries += 1
        near = track.last_seen is not None and track.tries <= self.settings.region_tries
        return LostPlace(track.template, track.last_seen, near)

    # -- tracking ----------------------------------------------------------------------

    def _follow(self, track: _Track, grey: UInt8[np.ndarray, "height width"], t_s: float) -> TemplatePose:
        """Align one template with a frame, from its prediction or from its last position."""
        name = track.template.name
        was_lost = track.pose is None
        start = self._prediction(track)
        if start is None:
            return _no_pose(name, t_s, Reason.LOST, "not found yet", None)
        alignment = self._align(track, grey, start)
        if not alignment.valid and track.homography is not None and start is not track.homography:
            alignment = self._align(track, grey, track.homography)  # the motion did not continue
        if alignment.valid and was_lost and alignment.ncc < self.settings.ncc_found:
            return self._loose(
                track, t_s, f"correlation {alignment.ncc:.2f} is too low to start tracking", alignment
            )
        if alignment.valid:
            alignment = self._with_blur(track, grey, alignment)
        if not alignment.valid:
            return self._loose(track, t_s, alignment.reason, alignment)
        poses = self._poses(track, alignment)
        if poses and self.camera.distortion.any():
            alignment, poses = self._with_distortion(track, grey, alignment, poses)
        if not poses:
            return self._loose(track, t_s, "no pose has the template in front of the camera", alignment)
        chosen, ambiguous, covariance = self._choose(track, poses)
        # The eight coordinates of the corners scatter about the six of a pose: two more observations of the factor.
        scatter = (_SCATTER_FREEDOM + chosen.chi2) / (_SCATTER_FREEDOM + 2.0)
        within = corners_within(scatter * alignment.corner_covariance, self.settings.esm.right_px)
        if within < self.settings.esm.min_probability:
            return self._loose(track, t_s, f"the corners fit no pose (chi2 {chosen.chi2:.0f})", alignment)
        covariance = scatter * covariance
        track.before = None if was_lost or track.last_seen is None else _corners(track, track.last_seen)
        track.homography = track.last_seen = alignment.homography
        track.pose = chosen.T_camera_template
        track.tries = 0
        return TemplatePose(
            name=name,
            t_s=t_s,
            valid=True,
            reason=Reason.OK,
            detail="",
            T_camera_template=chosen.T_camera_template,
            covariance=covariance,
            ambiguous=ambiguous,
            chi2=chosen.chi2,
            alignment=alignment,
        )

    def _align(self, track: _Track, grey: UInt8[np.ndarray, "height width"], start: np.ndarray) -> Alignment:
        return align(
            track.template.esm,
            grey,
            start,
            self.settings.esm,
            offset=track.offset,
            blur=track.blur,
            curve=track.curve,
        )

    def _with_blur(
        self, track: _Track, grey: UInt8[np.ndarray, "height width"], alignment: Alignment
    ) -> Alignment:
        """Measure the blur of the image periodically, and repeat the alignment if it changed."""
        size = float(np.linalg.norm(alignment.corners[2] - alignment.corners[0]))
        track.blur_age += 1
        near = abs(size / max(track.blur_scale, 1e-9) - 1) < 0.05
        same = near and track.blur_age < self.settings.blur_frames
        # Half the distance between two curves.
        if same and track.curve is not None and abs(alignment.curve - track.curve) < 0.5 * CURVES[1]:
            return alignment
        track.blur_age, track.blur_scale = 0, size
        # An alignment with the wrong blur biases the next measurement.
        for _ in range(3):
            track.curve = alignment.curve
            blur = matching_blur(
                track.template.esm, grey, alignment, self.settings.esm, offset=track.offset, start=track.blur
            )
            if blur == track.blur:
                break
            track.blur = blur
            alignment = self._align(track, grey, alignment.homography)
            if not alignment.valid:
                break  # the place of a blur that explains the image less well is a wrong one
        return alignment

    def _prediction(self, track: _Track) -> np.ndarray | None:
        """Corners extrapolated with their last motion; the last position while lost."""
        if track.homography is None:
            return track.last_seen
        if track.before is None:
            return track.homography
        now = _corners(track, track.homography)
        step = now - track.before
        if np.abs(step).max() < 2.0:  # small enough to track without a prediction
            return track.homography
        try:
            predicted = estimate_homography(track.template.esm.corners, now + step)
        except InputError:
            return track.homography
        return predicted if is_proper(predicted, track.template.esm.corners) else track.homography

    def _loose(self, track: _Track, t_s: float, detail: str, alignment: Alignment | None) -> TemplatePose:
        if track.pose is not None:
            _log.info("%s lost at %.3f s: %s", track.template.name, t_s, detail)
        track.homography, track.before, track.pose = None, None, None
        track.advantage = track.min_chi2 = track.blur_scale = 0.0
        track.blur = track.curve = None  # the view in which it is found again has its own
        return _no_pose(track.template.name, t_s, Reason.LOST, detail, alignment)

    # -- pose --------------------------------------------------------------------------

    def _poses(self, track: _Track, alignment: Alignment) -> tuple[PlanePose, ...]:
        points = track.template.points_m(track.template.esm.corners)
        starts: tuple[Pose, ...] = ()
        if track.pose is not None:
            starts = (track.pose,)
            if track.advantage < 50.0 or _slant(track.pose) < np.deg2rad(20.0):
                starts = (track.pose, tilted_back(track.pose))
        found = estimate_plane_poses(
            self.camera, points, alignment.corners, alignment.corner_covariance, starts=starts
        )
        if starts and (not found or found[0].chi2 > max(100.0, 2.0 * track.min_chi2)):
            # The last pose could not be used: start with the decomposition.
            found += estimate_plane_poses(self.camera, points, alignment.corners, alignment.corner_covariance)
            found = tuple(sorted(found, key=lambda pose: pose.chi2))[:2]
            # The remaining error (a print that is not flat, an inaccurate calibration) persists in the next frame.
            track.min_chi2 = found[0].chi2 if found else 0.0
        return found

    def _with_distortion(
        self,
        track: _Track,
        grey: UInt8[np.ndarray, "height width"],
        alignment: Alignment,
        poses: tuple[PlanePose, ...],
    ) -> tuple[Alignment, tuple[PlanePose, ...]]:
        """Apply the lens displacement to the template, and repeat the alignment if it changed."""
        samples = lens_samples(self.camera, track.template, poses[0].T_camera_template)
        old = np.zeros_like(samples) if track.lens is None else track.lens
        # Changes below a two-hundredth of a pixel are far below the noise.
        if np.abs(samples - old).max() < 0.005:
            return alignment, poses
        track.lens, track.offset = samples, lens_offset(samples, track.template)
        again = self._align(track, grey, alignment.homography)
        if not again.valid:
            return alignment, poses
        return again, self._poses(track, again)

    def _choose(
        self, track: _Track, poses: tuple[PlanePose, ...]
    ) -> tuple[PlanePose, bool, Float[np.ndarray, "6 6"]]:
        """Choose between two tilts; evidence is accumulated over frames, so that a noisy frame cannot switch it."""
        if len(poses) == 1:
            return poses[0], False, poses[0].covariance
        current, other = poses
        if track.pose is not None:
            kept = track.pose.rotation
            turn = [np.trace(kept.T @ pose.T_camera_template.rotation) for pose in poses]
            if turn[1] > turn[0]:
                current, other = other, current
        apart = pose_difference(current.T_camera_template, other.T_camera_template)
        if apart @ np.linalg.solve(current.covariance, apart) < 25.0:
            # In a frontal view, both coincide: previous evidence is no longer valid.
            track.advantage *= 0.5
            return current, False, current.covariance
        # A single frame has little evidence if the model is inexact; its contribution is bounded.
        gain = float(np.clip(other.chi2 - current.chi2, -20.0, 20.0))
        track.advantage = float(np.clip(track.advantage + gain, -100.0, 100.0))
        if track.advantage < -self.settings.flip_chi2:
            _log.info("%s: the opposite tilt explains the frames better", track.template.name)
            current, other = other, current
            track.advantage = -track.advantage
        ambiguous = track.advantage < self.settings.flip_chi2
        if not ambiguous:
            return current, False, current.covariance
        # Mixture of both: the other is weighted by its likelihood ratio.
        weight = 1.0 / (1.0 + np.exp(min(0.5 * track.advantage, 50.0)))
        apart = pose_difference(current.T_camera_template, other.T_camera_template)
        return current, True, current.covariance + weight * np.outer(apart, apart)


def template_outlines(poses: Iterable[TemplatePose]) -> list[Float[np.ndarray, "6 2"]]:
    """Closed outline in pixels of every visible template, with a tick at its first corner.

    Parameters
    ----------
    poses
        Poses of one frame; invalid ones are skipped.
    """
    found = []
    for pose in poses:
        if pose.valid and pose.alignment is not None:
            corners = pose.alignment.corners
            # The tick marks the upright direction.
            tick = corners[0] + 0.25 * (corners.mean(axis=0) - corners[0])
            found.append(np.vstack([corners, corners[:1], tick]))
    return found


def _no_pose(name: str, t_s: float, reason: Reason, detail: str, alignment: Alignment | None) -> TemplatePose:
    nothing = np.full((6, 6), np.nan)
    return TemplatePose(name, t_s, False, reason, detail, None, nothing, False, np.nan, alignment)


def _corners(track: _Track, homography: np.ndarray) -> np.ndarray:
    return apply_homography(homography, track.template.esm.corners)


def _slant(pose: Pose) -> float:
    """Angle between the normal of a template and the line of sight [rad]."""
    sight = pose.translation_m / np.linalg.norm(pose.translation_m)
    return float(np.arccos(np.clip(pose.rotation[:, 2] @ sight, -1.0, 1.0)))

"""The gripper variant: the strip rides on a finger, the reference contour tells where the finger is.

Alt 2016, Sec. 3.3 and 3.6.4.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...camera import Camera, Frame, PlaneView, Pose
from ...errors import CalibrationError, InputError
from ...objects import ForceProfile, Reason
from .config import FoamSensorConfig, FoamSetup
from .sensor import FoamSensor
from .zero import ZeroReference

__all__ = ["FingerReading", "FingerSensor", "find_tag"]

#: The lines are laid anew when the reference contour is further than this from where they expect it.
_REPLACE_PX = 1.0
_MOST_REPLACEMENTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class FingerReading:
    """Force profile and position of the finger from one frame."""

    profile: ForceProfile
    position_m: float  #: of the finger along its axis since the zero reference, closing positive
    position_sigma_m: float
    position_valid: bool


class FingerSensor:
    """A foam sensor on a finger that moves along a line in front of a fixed camera.

    The initial pose comes from an AprilTag on the finger (or from ``pose_camera_foam`` when
    there is no tag in view); from then on the reference contour is followed from frame to
    frame, and the tag is searched again only when the contour is lost.
    """

    def __init__(self, setup: FoamSetup, zero: ZeroReference | None = None) -> None:
        if setup.config.finger is None:
            raise InputError("FingerSensor", "the configuration has no section 'finger'", field="finger")
        self.setup = setup
        self._finger = setup.config.finger
        self._axis = np.asarray(self._finger.axis_foam, dtype=np.float64)
        norm = np.linalg.norm(self._axis)
        if not norm > 1e-6:
            raise InputError(
                "finger", f"found {self._axis.tolist()}, expected a direction", field="axis_foam"
            )
        self._axis /= norm
        self.sensor = FoamSensor(setup, zero)
        self._position: float | None = None
        self._speed = 0.0
        self._last_t_s: float | None = None

    @classmethod
    def load(cls, path: Path | str) -> FingerSensor:
        """A finger sensor as described by ``sensor.yaml``."""
        setup = FoamSensorConfig.load(path)
        zero = None
        if setup.zero_path.exists():
            zero = ZeroReference.load(setup.zero_path, len(setup.geometry.s_m))
        return cls(setup, zero)

    def pose_at(self, position_m: float) -> Pose:
        """``T_camera_foam`` with the finger at a position along its axis."""
        rest = self.setup.pose_camera_foam
        return Pose(rest.rotation, rest.translation_m + rest.rotation @ (position_m * self._axis))

    def locate(self, frame: Frame) -> float | None:
        """Position from the tag [m]; ``None`` when the tag is not seen."""
        pose = find_tag(frame.grey, self.setup.camera, self._finger.tag_id, self._finger.tag_size_m)
        if pose is None:
            return None
        pose_camera_foam = pose @ self._finger.pose_foam_tag.pose().inverse()
        rest = self.setup.pose_camera_foam
        moved = rest.rotation.T @ (pose_camera_foam.translation_m - rest.translation_m)
        return float(moved @ self._axis)

    def zero(self, frames: Iterable[Frame], *, limit: int = 60) -> ZeroReference:
        """Take the zero reference while nothing touches the strip and the finger stands still.

        Raises
        ------
        CalibrationError
            The contours were not found, or the strip moved meanwhile.
        """
        frames = iter(frames)
        first = next(frames, None)
        if first is None:
            raise CalibrationError("zero", "found no frames, expected at least one")
        found = self.locate(first)
        self._follow(first.t_s, 0.0 if found is None else found)
        assert self._position is not None
        self._speed = 0.0
        self.sensor.optics.place(PlaneView(self.setup.camera, self.pose_at(self._position)))
        return self.sensor.zero(chain([first], frames), limit=limit)

    def read(self, frame: Frame) -> FingerReading:
        """Follow the finger, then read the force."""
        start = self._predict(frame)
        for attempt in range(2):
            position = start
            for _ in range(_MOST_REPLACEMENTS):
                self.sensor.optics.place(PlaneView(self.setup.camera, self.pose_at(position)))
                strip = self.sensor.optics.observe(frame.grey, frame.t_s, self.sensor.zero_reference)
                if strip is None:
                    break
                step_m, sigma_m = self.sensor.optics.base_shift_m(strip, self._axis[:2])
                position += step_m
                if strip.moved_px < _REPLACE_PX:
                    self._follow(frame.t_s, position)
                    profile = self.sensor.read(frame)
                    return FingerReading(profile, position, sigma_m, True)
            found = self.locate(frame) if attempt == 0 else None
            if found is None:
                break
            start = found
        self._position = None
        profile = self.sensor.blank(frame.t_s, Reason.LOST)
        return FingerReading(profile, float("nan"), float("nan"), False)

    def _predict(self, frame: Frame) -> float:
        if self._position is None or self._last_t_s is None:
            found = self.locate(frame)
            return 0.0 if found is None else found
        return self._position + self._speed * max(0.0, frame.t_s - self._last_t_s)

    def _follow(self, t_s: float, position: float) -> None:
        if self._position is not None and self._last_t_s is not None and t_s > self._last_t_s:
            self._speed = (position - self._position) / (t_s - self._last_t_s)
        self._position, self._last_t_s = position, t_s


def find_tag(grey: np.ndarray, camera: Camera, tag_id: int, size_m: float) -> Pose | None:
    """``T_camera_tag`` of an AprilTag 36h11, or ``None`` when it is not seen.

    Tag frame: origin at the centre, x to the right, y down, z into the tag.

    Parameters
    ----------
    size_m
        Side of the black square.
    """
    import cv2

    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    corners, ids, _ = detector.detectMarkers(grey)
    if ids is None or tag_id not in ids.ravel():
        return None
    found: Float[np.ndarray, "4 2"] = corners[int(np.flatnonzero(ids.ravel() == tag_id)[0])].reshape(4, 2)
    half = size_m / 2
    model = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    done, rotation, translation = cv2.solvePnP(
        model, found.astype(np.float64), camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    if not done:
        return None
    return Pose.from_rotation_vector(rotation.ravel(), translation.ravel())

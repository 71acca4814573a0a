"""Position of a finger along its axis, from the corners of an AprilTag on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ....core import Camera, Pose

#: Standard deviation of a corner after sub-pixel refinement [px].
_CORNER_PX = 0.1
#: Residuals below this are errors of the corners (blur, print, distortion), not motion of the camera [px].
_CLEAR_PX = 1.0
#: Margin of the searched region around the tag, relative to the size of the tag.
_MARGIN = 1.0


@dataclass(frozen=True, slots=True)
class TagFix:
    """Position of the finger from its tag."""

    position_m: float  #: along the axis
    sigma_m: float
    residual_px: float  #: rms residual; large if the camera has moved or the model is wrong

    @property
    def bump_px(self) -> float:
        """The residual if it exceeds the errors of the corners, otherwise 0."""
        return self.residual_px if self.residual_px > _CLEAR_PX else 0.0


class TagView:
    """Detects the tag and solves for the position along the axis.

    The finger translates along its axis without rotation, so four corners give eight equations for
    one unknown; a full pose from a small tag would be noisier because of the uncertain tilt.

    Parameters
    ----------
    camera, T_camera_foam
        The camera, and the pose of the finger at position 0.
    axis
        Direction of motion in frame F.
    T_foam_tag, tag_id, size_m
        The tag of family 36h11 on the finger; ``size_m`` is the side of its black square.
    """

    def __init__(
        self,
        camera: Camera,
        T_camera_foam: Pose,
        axis: Float[np.ndarray, "3"],
        T_foam_tag: Pose,
        tag_id: int,
        size_m: float,
    ) -> None:
        half = size_m / 2
        corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
        self.axis = axis
        self._camera = camera
        self._corners_camera = T_camera_foam.apply(T_foam_tag.apply(corners))
        self._axis_camera = T_camera_foam.rotation @ axis
        self._tag_id = tag_id

    def project(self, position_m: float) -> Float[np.ndarray, "4 2"]:
        """Pixels of the corners for a position of the finger.

        Parameters
        ----------
        position_m
            Position of the finger along its axis [m].
        """
        return self._camera.project(self._corners_camera + position_m * self._axis_camera)

    def locate(self, grey: np.ndarray, near_m: float | None = None) -> TagFix | None:
        """Position of the finger along its axis [m]; ``None`` if the tag is not detected.

        Parameters
        ----------
        grey
            Grey image.
        near_m
            Expected position; the region around the tag at this position is searched first.
        """
        found = None
        if near_m is not None:
            found = self._detect(grey, self.project(near_m))
        if found is None:
            found = self._detect(grey, None)
        return None if found is None else self._solve(found, near_m or 0.0)

    def _detect(self, grey: np.ndarray, around: np.ndarray | None) -> Float[np.ndarray, "4 2"] | None:
        import cv2

        left, top, right, bottom = 0, 0, grey.shape[1], grey.shape[0]
        if around is not None:
            low, high = around.min(axis=0), around.max(axis=0)
            reach = _MARGIN * float((high - low).max())
            left, top = np.clip(np.floor(low - reach).astype(int), 0, [right, bottom])
            right, bottom = np.clip(np.ceil(high + reach).astype(int), 0, [right, bottom])
            if right - left < 16 or bottom - top < 16:
                return None
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        part = np.ascontiguousarray(grey[top:bottom, left:right])
        corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(part)
        if ids is None or self._tag_id not in ids.ravel():
            return None
        at = int(np.flatnonzero(ids.ravel() == self._tag_id)[0])
        found = np.asarray(corners[at], dtype=np.float64).reshape(4, 2)
        return found + np.array([left, top])

    def _solve(self, found: Float[np.ndarray, "4 2"], start_m: float) -> TagFix:
        """Gauss-Newton iteration for one unknown."""
        position, slope = start_m, np.ones(8)
        for _ in range(6):
            seen = self.project(position)
            slope = (self.project(position + 1e-5) - seen).ravel() / 1e-5
            position += float(slope @ (found - seen).ravel() / (slope @ slope))
        rest = (found - self.project(position)).ravel()
        residual = float(np.sqrt(np.mean(rest**2)))
        return TagFix(position, max(_CORNER_PX, residual) / float(np.linalg.norm(slope)), residual)

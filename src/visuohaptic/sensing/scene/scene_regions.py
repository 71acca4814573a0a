"""Image regions for the selection of points: floor patches beside the foam, and the face of the touched object (Sec. 3.5)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...core import POSITIVE, Camera, PlaneView, Pose, Ranged, at_least
from ...tracking.points.flow import FlowSettings
from .ego_motion import EgoMotionSettings
from .floor_motion import FloorMotionSettings
from .object_events import ObjectMotionSettings
from .object_motion import ObjectTracker
from .obstacle_mask import Obstacle
from .obstacle_parallax import ObstacleSettings

FLOOR, OBJECT = 1, 2
#: Edge of the cells that store where points are not on the floor, or not on the object [px].
_CELL_PX = 16


@dataclass(frozen=True, slots=True)
class SceneSettings(Ranged):
    """Regions and settings of point selection."""

    flow: FlowSettings = field(default_factory=FlowSettings)
    floor: FloorMotionSettings = field(default_factory=FloorMotionSettings)
    ego: EgoMotionSettings = field(default_factory=EgoMotionSettings)
    object: ObjectMotionSettings = field(default_factory=ObjectMotionSettings)
    obstacles: ObstacleSettings = field(default_factory=ObstacleSettings)
    front_m: float = 0.02  #: x of the foam's undeformed front, frame F
    foam_half_m: float = field(default=0.125, metadata=POSITIVE)  #: half length of the foam along y
    patch_inner_m: float = 0.06  #: floor patches start at this distance left and right of the centre
    #: Points on the object are selected up to this height above the foam.
    object_height_m: float = field(default=0.12, metadata=POSITIVE)
    object_margin_m: float = 0.004  #: and at this distance inside the contact's ends
    beside_m: float = 0.04  #: no floor is selected this close to the contact
    max_width_px: int = field(
        default=800, metadata=at_least(100)
    )  #: wider images than this are binned for the tracks
    lost_contact_frames: int = 20  #: after this time without contact, the next contact is a new object
    min_discriminative_flow_px: float = (
        1.0  #: flow of the floor above which a point can be classified as floor or not
    )
    widening: float = 1.6  #: a contact whose width has grown by this factor determines its face better


class SceneRegions:
    """Labels of the image's pixels: 0 nothing, ``FLOOR``, or ``OBJECT`` on the face of the touched object.

    Parameters
    ----------
    camera, T_camera_foam
        The sensor's camera and the pose of frame F in it.
    floor_view
        The floor in the camera's view.
    settings
        Regions and settings.
    """

    def __init__(
        self, camera: Camera, T_camera_foam: Pose, floor_view: PlaneView, settings: SceneSettings
    ) -> None:
        self.camera, self.T_camera_foam = camera, T_camera_foam
        self.floor_view, self.settings = floor_view, settings
        #: last relevant row of the image, exclusive
        self._hidden, self._patches, self.last_row = self._static_regions()
        # Cells (in pixels) where points turned out to be on another surface, during a contact.
        self._not_floor = np.zeros((-(-camera.height // _CELL_PX), -(-camera.width // _CELL_PX)), np.uint8)
        self._not_object = self._not_floor.copy()

    def forget(self) -> None:
        """Forget where points turned out to be on another surface."""
        self._not_floor[:], self._not_object[:] = 0, 0

    def exclude(self, label: int, pixels: Float[np.ndarray, "n 2"]) -> None:
        """Store where points turned out to be on another surface than assumed.

        Parameters
        ----------
        label
            Assumed surface, ``FLOOR`` or ``OBJECT``.
        pixels
            Their positions, (x, y) [px].
        """
        cells = self._not_floor if label == FLOOR else self._not_object
        at = np.clip(pixels / _CELL_PX, 0, np.array(cells.shape[::-1]) - 1).astype(int)
        cells[at[:, 1], at[:, 0]] = 1

    def labels(
        self, obstacle: Obstacle | None, tracked: ObjectTracker, half_width_m: float
    ) -> UInt8[np.ndarray, "rows columns"]:
        """Regions for the selection of points in this frame.

        Parameters
        ----------
        obstacle
            Obstacles in the upper strip of the image; None: not yet known.
        tracked
            The touched object, if any.
        half_width_m
            Half the width of its face, from the contact [m].
        """
        import cv2

        regions, s = self._patches.copy(), self.settings
        # Below an obstacle in the strip there is no floor, but the lower part of the same obstacle.
        if obstacle is not None and obstacle.valid:
            n = obstacle.binning
            standing = np.repeat(np.count_nonzero(obstacle.mask, axis=0) > 0.15 * obstacle.mask.shape[0], n)
            columns = np.zeros(self.camera.width, bool)
            columns[: len(standing)] = standing
            regions[:, columns] = 0
        if tracked.face is not None:
            polygon = self._face_polygon(tracked, half_width_m, s.object_height_m)
            # An object is wider than its contact: the floor starts some centimetres beside it.
            whole = self._face_polygon(tracked, half_width_m + s.beside_m, np.inf)
            if polygon is not None and whole is not None:
                clear, above = np.zeros_like(regions), np.zeros_like(regions)
                cv2.fillConvexPoly(clear, polygon, 1)
                cv2.fillConvexPoly(above, whole, 1)
                regions[above > 0] = 0
                regions[(clear > 0) & ~self._hidden] = OBJECT
            for label, cells in ((FLOOR, self._not_floor), (OBJECT, self._not_object)):
                if cells.any():
                    size = (cells.shape[1] * _CELL_PX, cells.shape[0] * _CELL_PX)
                    large = cv2.resize(cells, size, interpolation=cv2.INTER_NEAREST)
                    regions[(large[: regions.shape[0], : regions.shape[1]] > 0) & (regions == label)] = 0
        return regions

    def _face_polygon(
        self, tracked: ObjectTracker, half_width_m: float, height_m: float
    ) -> np.ndarray | None:
        """The part of the object's face above the foam, at its current pose [px]."""
        assert tracked.face is not None
        a = half_width_m
        eye_z = float(self.T_camera_foam.inverse().translation_m[2])
        high = min(height_m, 0.85 * eye_z)
        corners = np.array([[-a, 0.003, 0.0], [a, 0.003, 0.0], [a, high, 0.0], [-a, high, 0.0]])
        placed = tracked.moved(tracked.face.apply(corners))
        pixels = self.camera.project(self.T_camera_foam.apply(placed))
        if not np.isfinite(pixels).all() or np.abs(pixels).max() > 1e5:
            return None
        return np.rint(pixels).astype(np.int32)

    def _static_regions(
        self,
    ) -> tuple[Bool[np.ndarray, "rows columns"], UInt8[np.ndarray, "rows columns"], int]:
        """The region hidden by the sensor, the floor patches, and the last relevant row."""
        import cv2

        s, n = self.settings, 4
        rows, columns = self.camera.height, self.camera.width
        v, u = np.mgrid[0:rows:n, 0:columns:n].astype(np.float64)
        pixels = np.stack([u, v], axis=-1)
        top = PlaneView(self.camera, self.T_camera_foam).cast(pixels)
        floor = self.floor_view.cast(pixels)
        # The body extends slightly beyond the foam's ends, the side of the foam is visible below its edge.
        hidden = (top[..., 0] < s.front_m + 0.004) & (np.abs(top[..., 1]) < s.foam_half_m + 0.035)
        hidden |= top[..., 0] < 0.0
        side = (floor[..., 0] < s.front_m + 0.004) & (np.abs(floor[..., 1]) < s.foam_half_m + 0.01)
        hidden |= side | ~np.isfinite(floor[..., 0])
        hidden = cv2.dilate(hidden.astype(np.uint8), np.ones((5, 5), np.uint8))
        patches = ((hidden == 0) & (np.abs(floor[..., 1]) > s.patch_inner_m)).astype(np.uint8)
        full = [np.kron(a, np.ones((n, n), np.uint8))[:rows, :columns] for a in (hidden, patches)]
        border = max(8, columns // 60)
        full[1][:border] = full[1][-border:] = full[1][:, :border] = full[1][:, -border:] = 0
        free = np.flatnonzero((full[0] == 0).any(axis=1))
        last = min(rows, int(free[-1]) + 40) if len(free) else rows
        return full[0] > 0, full[1], last

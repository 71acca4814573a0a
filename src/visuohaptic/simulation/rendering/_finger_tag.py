"""An AprilTag on the finger, drawn into a rendered image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ...core.camera.model import Camera
from ...core.camera.pose import Pose

__all__ = ["FingerTag", "paint_tag"]

#: Cells of a tag of family 36h11 along its side, with its black border; a white cell goes around it.
CELLS = 8
#: Samples per pixel along each axis.
FINE = 4


@dataclass(frozen=True, slots=True)
class FingerTag:
    """A tag of family 36h11 on the top of the finger, upright in the image of the camera behind it."""

    tag_id: int = 0
    size_m: float = 0.02  #: side of the black square
    centre_m: tuple[float, float] = (-0.018, 0.0)  #: in frame F
    dark: float = 25.0  #: grey levels of its cells
    bright: float = 215.0

    @property
    def T_foam_tag(self) -> Pose:
        """Maps tag coordinates (x to the right, y down, z into the tag) to frame F."""
        axes = np.column_stack([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        return Pose(axes, np.array([*self.centre_m, 0.0]))


@lru_cache(maxsize=4)
def _cells(tag_id: int) -> UInt8[np.ndarray, "10 10"]:
    """1 where the tag is white, with its white margin."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    marker = cv2.aruco.generateImageMarker(dictionary, tag_id, CELLS * 4)[2::4, 2::4]
    return np.pad((marker > 127).astype(np.uint8), 1, constant_values=1)


def paint_tag(
    image: Float32[np.ndarray, "rows columns channels"],
    camera: Camera,
    T_camera_foam: Pose,
    tag: FingerTag,
    position_m: Float[np.ndarray, "rows"],
    blur_px: float,
) -> None:
    """Draw the tag into the image, each row with the finger position at the exposure of the row.

    Parameters
    ----------
    image
        Exact image (rows, columns, channels) float32, changed.
    camera
        Camera.
    T_camera_foam
        Pose of the finger at position 0.
    tag
        AprilTag and its pose on the finger.
    position_m
        Position of the finger along x of F at the exposure of each row.
    blur_px
        Blur of the lens.
    """
    import cv2

    T_foam_tag = tag.T_foam_tag
    half = tag.size_m * (0.5 + 1.0 / CELLS)
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    seen = []
    for shift in (position_m.min(), position_m.max()):
        seen.append(
            camera.project(T_camera_foam.apply(T_foam_tag.apply(corners) + np.array([shift, 0.0, 0.0])))
        )
    pixels = np.concatenate(seen)
    rows, columns, _ = image.shape
    left, top = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 6, 0)
    right, bottom = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 7, [columns, rows])
    if right - left < 4 or bottom - top < 4:
        return
    offset = (np.arange(FINE) + 0.5) / FINE - 0.5
    x = (np.arange(left, right)[:, None] + offset).ravel()
    y = (np.arange(top, bottom)[:, None] + offset).ravel()
    rays = camera.rays(np.stack(np.meshgrid(x, y), axis=-1))
    normal, origin = T_camera_foam.rotation[:, 2], T_camera_foam.translation_m
    depth = (origin @ normal) / (rays @ normal)
    points = (rays * depth[..., None] - origin) @ T_camera_foam.rotation
    points[..., 0] -= np.interp(y, np.arange(rows), position_m)[:, None]
    places = T_foam_tag.inverse().apply(points)[..., :2]
    cell = np.floor(places / tag.size_m * CELLS + CELLS / 2).astype(int) + 1
    inside = ((cell >= 0) & (cell < CELLS + 2)).all(axis=-1)
    index = np.clip(cell, 0, CELLS + 1)
    level = tag.dark + (tag.bright - tag.dark) * _cells(tag.tag_id)[index[..., 1], index[..., 0]]
    shape = (bottom - top, FINE, right - left, FINE)
    fraction = inside.reshape(shape).mean(axis=(1, 3)).astype(np.float32)
    paint = (level * inside).reshape(shape).mean(axis=(1, 3)).astype(np.float32)
    if blur_px > 0:
        fraction = cv2.GaussianBlur(fraction, (0, 0), blur_px)
        paint = cv2.GaussianBlur(paint, (0, 0), blur_px)
    region = image[top:bottom, left:right]
    region *= (1.0 - fraction)[..., None]
    region += paint[..., None]

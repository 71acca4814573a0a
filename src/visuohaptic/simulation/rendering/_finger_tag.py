"""An AprilTag on the finger, drawn into a rendered image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32, Int16, UInt8

from ...core import Camera, Pose

#: Cells of a tag of family 36h11 along its side, with its black border; a white cell goes around it.
CELLS = 8
#: Samples per pixel along each axis.
FINE = 4
#: Corners of the window in which the tag is drawn are multiples of it, so that consecutive frames share one: the image does
#: not depend on it.
BLOCK_PX = 32


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
def tag_cells(tag_id: int) -> UInt8[np.ndarray, "10 10"]:
    """1 where the tag is white, with its white margin.

    Parameters
    ----------
    tag_id
        Number of the AprilTag of family 36h11.
    """
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    marker = cv2.aruco.generateImageMarker(dictionary, tag_id, CELLS * 4)[2::4, 2::4]
    return np.pad((marker > 127).astype(np.uint8), 1, constant_values=1)


def _samples(first: int, end: int) -> Float[np.ndarray, "n"]:
    """Coordinates of the samples of pixels along one axis."""
    samples: np.ndarray = (np.arange(first, end)[:, None] + (np.arange(FINE) + 0.5) / FINE - 0.5).ravel()
    return samples


def _cell(place_m: Float[np.ndarray, "h w"], tag: FingerTag) -> Int16[np.ndarray, "h w"]:
    """Index of the cell along one axis of the tag; what is outside counts to a cell at either end."""
    cell = np.floor(place_m / tag.size_m * CELLS + CELLS / 2)
    return np.clip(cell + 2, 0, CELLS + 3).astype(np.int16)


@lru_cache(maxsize=8)
def _on_finger(
    camera: Camera, T_camera_foam: Pose, tag: FingerTag, window: tuple[int, int, int, int]
) -> tuple[Float[np.ndarray, "h w"], Int16[np.ndarray, "h w"]]:
    """Where the rays of a window meet the finger along its motion [m], and the tag's column; the same in consecutive frames."""
    left, right, top, bottom = window
    rays = camera.rays(np.stack(np.meshgrid(_samples(left, right), _samples(top, bottom)), axis=-1))
    normal, origin = T_camera_foam.rotation[:, 2], T_camera_foam.translation_m
    depth = (origin @ normal) / (rays @ normal)
    points = (rays * depth[..., None] - origin) @ T_camera_foam.rotation
    # The tag's x is along -Y of the finger, its y along -X.
    return tag.centre_m[0] - points[..., 0], _cell(tag.centre_m[1] - points[..., 1], tag)


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
    # Whole blocks: consecutive frames have the same window.
    left, top = np.maximum(np.floor((pixels.min(axis=0) - 6) / BLOCK_PX).astype(int) * BLOCK_PX, 0)
    right, bottom = np.minimum(
        np.ceil((pixels.max(axis=0) + 7) / BLOCK_PX).astype(int) * BLOCK_PX, [columns, rows]
    )
    if right - left < 4 or bottom - top < 4:
        return
    down_m, column = _on_finger(camera, T_camera_foam, tag, (int(left), int(right), int(top), int(bottom)))
    moved_m = np.interp(_samples(top, bottom), np.arange(rows), position_m)
    index = _cell(down_m + moved_m[:, None], tag) * (CELLS + 4) + column
    inside = np.pad(np.ones((CELLS + 2, CELLS + 2), np.float32), 1)
    levels = np.pad(tag.dark + (tag.bright - tag.dark) * tag_cells(tag.tag_id), 1).astype(np.float32)
    size = int(right - left), int(bottom - top)
    # Means over the samples of each pixel.
    fraction, paint = (
        cv2.resize(table.ravel()[index], size, interpolation=cv2.INTER_AREA) for table in (inside, levels)
    )
    if blur_px > 0:
        fraction = cv2.GaussianBlur(fraction, (0, 0), blur_px)
        paint = cv2.GaussianBlur(paint, (0, 0), blur_px)
    region = image[top:bottom, left:right]
    region *= (1.0 - fraction)[..., None]
    region += paint[..., None]

"""Camera frames with drawn sensor results, as in Alt 2016, Fig. 3.10."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ..core.errors import InputError
from ..core.objects import Primitive, PrimitiveKind

#: Colours in OpenCV's order blue, green, red.
REFERENCE_BGR = (40, 40, 230)
FRONT_BGR = (0, 190, 255)
INVALID_BGR = (160, 160, 160)
CONTACT_BGR = (70, 220, 90)
PRIMITIVE_BGR = (255, 90, 200)

_SUBPIXEL_BITS = 4


@dataclass(frozen=True, slots=True, eq=False)
class FrameNotes:
    """Annotations of a frame, all in pixels of the image."""

    reference_px: Float[np.ndarray, "k 2"] | None = None  #: contour at the robot's side
    front_px: Float[np.ndarray, "k 2"] | None = None  #: contour towards the objects
    front_valid: Bool[np.ndarray, "k"] | None = None  #: valid points of the front contour
    contacts_px: Sequence[Float[np.ndarray, "m 2"]] = ()  #: front contour inside each contact
    primitives_px: Sequence[Float[np.ndarray, "m 2"]] = ()  #: outlines of the fitted shapes
    lines: Sequence[str] = field(default=())  #: text lines, from the top left downwards


def gradient_image(grey: UInt8[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns"]:
    """Magnitude of the grey-level gradient, dark for zero; the 99.5 % quantile is white.

    Parameters
    ----------
    grey
        Image [grey levels].
    """
    import cv2

    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    # Sobel's 3 x 3 kernels have a gain of 8.
    dx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) / 8
    dy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1) / 8
    strength = np.hypot(dx, dy)
    white = max(float(np.quantile(strength[::4, ::4], 0.995)), 1.0)
    return np.clip(strength * (255 / white), 0, 255).astype(np.uint8)


def annotated_frame(
    image: UInt8[np.ndarray, "rows columns *colour"],
    notes: FrameNotes,
    *,
    split_row: int | None = None,
    split: bool = True,
) -> UInt8[np.ndarray, "rows columns 3"]:
    """The image in the upper part, its gradients in the lower part, with contours, contacts and primitives on both.

    Parameters
    ----------
    image
        Grey, or blue-green-red.
    notes
        Annotations to draw.
    split_row
        First row that shows gradients; by default the middle of the image.
    split
        Whether to show gradients.

    Raises
    ------
    InputError
        There is not one validity for each point of the front.
    """
    import cv2

    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    if split:
        row = grey.shape[0] // 2 if split_row is None else int(np.clip(split_row, 0, grey.shape[0]))
        canvas[row:] = gradient_image(grey)[row:, :, None]
        cv2.line(canvas, (0, row), (grey.shape[1] - 1, row), (200, 200, 200), 1)
    thickness = max(1, round(grey.shape[1] / 800))
    for contact in notes.contacts_px:
        _polyline(canvas, contact, CONTACT_BGR, 4 * thickness)
    if notes.reference_px is not None:
        _polyline(canvas, notes.reference_px, REFERENCE_BGR, thickness)
    if notes.front_px is not None:
        _polyline(canvas, notes.front_px, FRONT_BGR, thickness)
        valid = np.ones(len(notes.front_px), bool) if notes.front_valid is None else notes.front_valid
        if len(valid) != len(notes.front_px):
            raise InputError(
                "FrameNotes", f"found {len(valid)}, expected {len(notes.front_px)}", field="front_valid"
            )
        for point, good in zip(notes.front_px, valid, strict=True):
            _dot(canvas, point, FRONT_BGR if good else INVALID_BGR, thickness + 1)
    for outline in notes.primitives_px:
        _polyline(canvas, outline, PRIMITIVE_BGR, 2 * thickness)
    scale = grey.shape[1] / 1600
    for index, line in enumerate(notes.lines):
        corner = (round(18 * scale), round((38 + 36 * index) * scale))
        for colour, width in (((0, 0, 0), 4 * thickness), ((255, 255, 255), thickness)):
            cv2.putText(
                canvas, line, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.95 * scale, colour, width, cv2.LINE_AA
            )
    return canvas


def primitive_outline(primitive: Primitive, *, reach_m: float = 0.15) -> Float[np.ndarray, "m 2"]:
    """Points of a primitive's outline in the frame of its parameters [m].

    Lines and the edges of corners are infinite; they are drawn ``reach_m`` long
    to each side.

    Parameters
    ----------
    primitive
        Circle, segment, corner or line.
    reach_m
        Drawn length of infinite lines, to each side [m].

    Returns
    -------
    (m, 2) array
        Points in the frame of the primitive's parameters [m].
    """
    values = np.asarray(primitive.parameters, dtype=np.float64)

    def ray(angle_rad: float) -> np.ndarray:
        return reach_m * np.array([np.cos(angle_rad), np.sin(angle_rad)])

    if primitive.kind is PrimitiveKind.CIRCLE:
        angle = np.linspace(0, 2 * np.pi, 181)
        return values[:2] + values[2] * np.column_stack([np.cos(angle), np.sin(angle)])
    if primitive.kind is PrimitiveKind.SEGMENT:
        ends = [values[:2], values[2:4]]
    elif primitive.kind is PrimitiveKind.CORNER:
        ends = [values[:2] + ray(values[2]), values[:2], values[:2] + ray(values[3])]
    else:
        ends = [values[:2] - ray(values[2]), values[:2] + ray(values[2])]
    # Many points, because lens distortion bends straight lines.
    steps = np.linspace(0, 1, 40)[:, None]
    return np.vstack([start + steps * (stop - start) for start, stop in pairwise(ends)])


def _polyline(
    canvas: np.ndarray, points_px: np.ndarray, colour: tuple[int, int, int], thickness: int
) -> None:
    """Draw with sub-pixel positions; non-finite points interrupt the line."""
    import cv2

    points = np.asarray(points_px, dtype=np.float64)
    # Distant points would overflow OpenCV's fixed-point coordinates.
    good = np.abs(np.nan_to_num(points, nan=np.inf)).max(axis=1, initial=0.0) < 1e5
    for run in np.split(np.arange(len(points)), np.flatnonzero(~good)):
        kept = run[good[run]]
        if len(kept) >= 2:
            fixed = np.round(points[kept] * (1 << _SUBPIXEL_BITS)).astype(np.int32)
            cv2.polylines(
                canvas, [fixed.reshape(-1, 1, 2)], False, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS
            )


def _dot(canvas: np.ndarray, point_px: np.ndarray, colour: tuple[int, int, int], radius: int) -> None:
    import cv2

    if np.isfinite(point_px).all() and (np.abs(point_px) < 1e5).all():
        x, y = np.round(np.asarray(point_px) * (1 << _SUBPIXEL_BITS)).astype(int)
        cv2.circle(
            canvas, (int(x), int(y)), radius << _SUBPIXEL_BITS, colour, -1, cv2.LINE_AA, _SUBPIXEL_BITS
        )

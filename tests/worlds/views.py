"""Views of planar images by a webcam: up to 60 degrees of tilt, occluded, in uneven light, blurred.

An image of 600 px is the physical pattern; the template is its mean over 3 x 3 px, a view the mean over 3 x 3 samples
of a pixel. Even seeds are open, odd ones closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .foam_optics import Sensor, point_spread

__all__ = ["PICTURES", "View", "mapped", "pinhole", "view"]

#: Images shipped with scikit-image.
PICTURES = (
    "astronaut",
    "camera",
    "coffee",
    "chelsea",
    "rocket",
    "moon",
    "coins",
    "text",
    "page",
    "brick",
    "gravel",
)
#: Sides of a template and of an image [px], samples of a pixel along each axis, focal length [px].
SIDE, SIZE, SAMPLES, FOCAL_PX = 200, (640, 480), 3, 800.0


@dataclass(frozen=True, slots=True)
class View:
    """One view of an image."""

    template: np.ndarray  #: uint8 (SIDE, SIDE)
    image: np.ndarray  #: uint8 (480, 640)
    homography: np.ndarray  #: template pixels to image pixels, true
    start: np.ndarray  #: the prediction
    corners: np.ndarray  #: of the template in the image, (4, 2) [px]
    tilt_rad: float
    covered: float  #: fraction of the template that is not seen
    start_px: float  #: root mean square distance of the prediction's corners


def picture(name: str, rng: np.random.Generator) -> np.ndarray:
    """A square part of an image, grey, float32, 3 SIDE px wide."""
    from skimage import data

    photo = getattr(data, name)()
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY) if photo.ndim == 3 else photo
    side = int(min(grey.shape) * rng.uniform(0.6, 1.0))
    row, column = (int(rng.integers(0, n - side + 1)) for n in grey.shape)
    part = grey[row : row + side, column : column + side].astype(np.float32)
    wide = SAMPLES * SIDE
    way = cv2.INTER_AREA if side > wide else cv2.INTER_CUBIC
    return np.clip(cv2.GaussianBlur(cv2.resize(part, (wide, wide), interpolation=way), (0, 0), 1.0), 0, 255)


def pinhole(
    tilt_rad: float, azimuth_rad: float, roll_rad: float, scale: float, centre_px: np.ndarray
) -> np.ndarray:
    """Homography of a plane that is tilted about an axis through the template's middle, which is at ``centre_px``."""
    cos, sin = np.cos(azimuth_rad), np.sin(azimuth_rad)
    axis = np.array([[0, 0, sin], [0, 0, -cos], [-sin, cos, 0]])  # cross product with (cos, sin, 0)
    tilt = np.eye(3) + np.sin(tilt_rad) * axis + (1 - np.cos(tilt_rad)) * axis @ axis
    turn = np.array(
        [[np.cos(roll_rad), -np.sin(roll_rad), 0], [np.sin(roll_rad), np.cos(roll_rad), 0], [0, 0, 1]]
    )
    rotation = tilt @ turn
    middle = 0.5 * (SIDE - 1)
    camera = np.array([[FOCAL_PX, 0, 0.5 * (SIZE[0] - 1)], [0, FOCAL_PX, 0.5 * (SIZE[1] - 1)], [0, 0, 1]])
    distance = FOCAL_PX / scale  # in template pixels
    place = np.append((centre_px - camera[:2, 2]) / FOCAL_PX, 1.0) * distance
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], place])
    found = camera @ plane @ np.array([[1, 0, -middle], [0, 1, -middle], [0, 0, 1]])
    return found / found[2, 2]


def mapped(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (n, 2) under a homography."""
    found = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return found[:, :2] / found[:, 2:]


def view(seed: int) -> View:
    """The view of a seed."""
    rng = np.random.default_rng([31, seed])
    real, around = (picture(str(rng.choice(PICTURES)), rng) for _ in range(2))
    template = np.rint(cv2.resize(real, (SIDE, SIDE), interpolation=cv2.INTER_AREA)).astype(np.uint8)
    tilt = float(np.deg2rad(rng.uniform(0, 60)))
    centre = 0.5 * (np.array(SIZE) - 1) + rng.uniform(-60, 60, 2)
    homography = pinhole(
        tilt, rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi), rng.uniform(0.7, 1.4), centre
    )
    square = np.array([[0, 0], [SIDE - 1, 0], [SIDE - 1, SIDE - 1], [0, SIDE - 1]], float)
    corners = mapped(homography, square)
    start_px = float(rng.uniform(0, 8))
    moved = rng.standard_normal((4, 2))
    moved *= start_px / np.sqrt(np.mean(np.sum(moved**2, axis=1)))
    start, _ = cv2.findHomography(square, corners + moved)
    # Fine pixel f shows image pixel (f - 1) / 3; real pixel 3 t + 1 is template pixel t.
    fine = np.array([[SAMPLES, 0, 1], [0, SAMPLES, 1], [0, 0, 1.0]])
    size = (SAMPLES * SIZE[0], SAMPLES * SIZE[1])
    to_fine = fine @ homography @ np.linalg.inv(fine)
    seen = cv2.resize(around, size)
    cv2.warpPerspective(real, to_fine, size, seen, cv2.INTER_CUBIC, cv2.BORDER_TRANSPARENT)
    cover = _cover(corners, rng)
    body = (
        cv2.resize(np.roll(around, 200, axis=0), size) if rng.random() < 0.5 else float(rng.uniform(10, 240))
    )
    light = cv2.resize(np.where(cover > 0, body, seen), SIZE, interpolation=cv2.INTER_AREA)
    back = cv2.warpPerspective(cover, fine @ homography, (SIDE, SIDE), flags=cv2.WARP_INVERSE_MAP)
    image = _photographed(light * _illumination(corners, rng), rng)
    return View(template, image, homography, start / start[2, 2], corners, tilt, float(back.mean()), start_px)


def _cover(corners: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Mask of the occluder, at fine pixels; 0 to 40 % of the template."""
    cover = np.zeros((SAMPLES * SIZE[1], SAMPLES * SIZE[0]), np.uint8)
    target = rng.uniform(0, 0.4)
    inside = np.zeros_like(cover)
    cv2.fillConvexPoly(inside, np.rint(SAMPLES * corners).astype(np.int32), 1)
    total = np.float32(cv2.countNonZero(inside))
    side = np.sqrt(total)
    for _ in range(40):
        if rng.random() < 0.1 and target < 0.1:
            break
        trial = cover.copy()
        at = SAMPLES * (rng.dirichlet(np.ones(4)) @ corners)
        if rng.random() < 0.5:
            axes = rng.uniform(0.05, 0.3, 2) * side
            box = (tuple(map(float, at)), tuple(map(float, 2 * axes)), float(rng.uniform(0, 180)))
            cv2.ellipse(trial, box, 1, -1)
        else:  # a finger or a hand from the border of the image
            end = at + 3 * side * np.array([np.cos(a := rng.uniform(-np.pi, np.pi)), np.sin(a)])
            ends = (tuple(np.rint(p).astype(int).tolist()) for p in (at, end))
            cv2.line(trial, *ends, 1, int(rng.uniform(0.05, 0.35) * side) + 1)
        if cv2.countNonZero(cv2.bitwise_and(trial, inside)) <= target * total:
            cover = trial
    return cover.astype(np.float32)


def _illumination(corners: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Factor of the light at each pixel: a gradient, sometimes a shadow edge or a bright spot."""
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in SIZE))
    light = rng.uniform(0.5, 1.1) * (1 + rng.uniform(-0.3, 0.3) * (x / SIZE[0] - 0.5) * 2)
    middle = corners.mean(0) + rng.uniform(-60, 60, 2)
    if rng.random() < 0.4:
        turn = rng.uniform(-np.pi, np.pi)
        away = (x - middle[0]) * np.cos(turn) + (y - middle[1]) * np.sin(turn)
        light = light * (1 - rng.uniform(0.1, 0.6) * np.clip(away / rng.uniform(0.5, 40) + 0.5, 0, 1))
    if rng.random() < 0.2:
        away = np.hypot(x - middle[0], y - middle[1]) / rng.uniform(10, 40)
        light = light * (1 + rng.uniform(0.5, 3) * np.exp(-0.5 * away**2))
    return light.astype(np.float32)


def _photographed(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Effects of a webcam: blur, noise, rounding, JPEG; grey levels follow the light."""
    sensor = Sensor(
        1.0, float(rng.uniform(0.5, 4)), float(rng.uniform(0, 0.03)), 0.0, int(rng.choice([0, 0, 60, 85]))
    )
    motion = float(rng.choice([0.0, rng.uniform(1, 6)], p=[0.7, 0.3]))
    spread = point_spread(
        float(rng.uniform(0.3, 1.2)), motion_px=motion, angle_rad=float(rng.uniform(0, np.pi))
    )
    return sensor.image(light[:, :, None] / np.float32(255), spread, rng)

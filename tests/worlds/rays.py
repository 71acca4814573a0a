"""A stereo depth camera among clear glass: ray tracing, window matching, invalid and refracted readings.

    world = World(objects, boxes)
    raw = look(world, DepthCamera(), eye_m, rotation)      # what both cameras see and where they match
    depth_m = read([raw, ...], Imperfections(), rng)[0]    # output of such a camera, NaN: invalid

Everything follows from geometry (Snell, Fresnel, occlusion, windows) except for reflections of
a room that is not modelled: they invalidate further readings through glass, until the invalid fraction is the requested one.
Of the glass pixels of a real D435, 29 to 77 % are invalid (typically 53 %).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from .ray_objects import BLACK, METAL
from .ray_optics import CLEAR, Box, Revolved, cast, compile_scene
from .ray_stereo import match

__all__ = ["DepthCamera", "Imperfections", "RawView", "World", "look", "read"]


@dataclass(frozen=True, slots=True)
class DepthCamera:
    """Active stereo, as a D415 or D435 at a quarter of its pixels; depth is that of the left eye."""

    width: int = 320
    height: int = 240
    focal_px: float = 277.0
    baseline_m: float = 0.055

    @property
    def centre_px(self) -> tuple[float, float]:
        """Principal point (x, y); the middle of the first pixel is (0, 0)."""
        return 0.5 * (self.width - 1), 0.5 * (self.height - 1)

    @property
    def matrix(self) -> np.ndarray:
        """Intrinsic matrix (3, 3)."""
        cx, cy = self.centre_px
        return np.array([[self.focal_px, 0, cx], [0, self.focal_px, cy], [0, 0, 1]])

    def directions(self, rotation: np.ndarray) -> np.ndarray:
        """Unit directions (pixels, 3) of all pixels in the world, by rows."""
        cx, cy = self.centre_px
        x, y = np.meshgrid(np.arange(self.width) - cx, np.arange(self.height) - cy)
        rays = np.stack([x, y, np.full(x.shape, self.focal_px)], axis=-1).reshape(-1, 3)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True) @ np.asarray(rotation).T


@dataclass(frozen=True, slots=True)
class Imperfections:
    """Imperfections of a camera that do not follow from geometry."""

    lost_glass: float = 0.53  #: fraction of glass pixels without a reading, at least what geometry takes
    noise_px: float = 0.05  #: standard deviation of a disparity at normal incidence
    near_glass: float = 0.03  #: fraction of glass pixels that read the glass itself: dirt, highlights
    lost_opaque: float = 0.003  #: of bright opaque surfaces, at random
    lost_black: float = 0.55  #: of black ones
    mixed: float = 0.3  #: of pixels at an edge that read between both surfaces
    unit_m: float = 0.001


class World:
    """Objects at rest or moved between views."""

    def __init__(self, objects: Sequence[Revolved], boxes: Sequence[Box]) -> None:
        self.objects, self.boxes = list(objects), list(boxes)
        self.compiled = compile_scene(self.objects, self.boxes)

    @property
    def materials(self) -> np.ndarray:
        """Of all objects, solids of revolution first."""
        return self.compiled[4]


@dataclass(frozen=True, slots=True)
class RawView:
    """A view before noise; images of shape (rows, columns)."""

    camera: DepthCamera
    disparity_px: np.ndarray  #: NaN: no window matches
    quality: np.ndarray  #: matched fraction of the window times transmission of both eyes
    glass: np.ndarray  #: whether the first object is clear
    first_m: np.ndarray  #: depth of the first surface along the optical axis
    cosine: np.ndarray  #: of the incidence where the ray ends
    material: np.ndarray  #: of the object there; -2: none
    glint_rad: np.ndarray  #: smallest angle between the first normal and the bisector to a lamp


#: Lamps: at the camera (its projector) and two of the room, in the world [m].
_LAMPS_M = np.array([[1.2, 0.8, 1.9], [-1.0, -0.6, 1.9]])


def look(world: World, camera: DepthCamera, eye_m: np.ndarray, rotation: np.ndarray) -> RawView:
    """Raw view of the camera from a point; rotation (3, 3) has its axes right, down, forward as columns."""
    eye_m, rotation = np.asarray(eye_m, dtype=float), np.asarray(rotation, dtype=float)
    shape = (camera.height, camera.width)
    rays = camera.directions(rotation)
    left = cast(world.compiled, eye_m, rays)
    right = cast(world.compiled, eye_m + camera.baseline_m * rotation[:, 0], rays)
    forward = rays @ rotation[:, 2]
    depth = (left.point_m - eye_m) @ rotation[:, 2]
    seen = np.column_stack([left.point_m, depth]).reshape(*shape, 4)
    disparity, quality = match(seen, right.point_m.reshape(*shape, 3), camera.focal_px, camera.baseline_m)
    columns = np.tile(np.arange(camera.width), (camera.height, 1))
    with np.errstate(invalid="ignore"):
        there = np.clip(np.rint(columns - disparity), 0, camera.width - 1)
    there = np.where(np.isfinite(there), there, 0).astype(int)
    passed = right.passed.reshape(shape)[np.arange(camera.height)[:, None], there]
    materials = np.append(world.materials, -2)
    return RawView(
        camera,
        disparity,
        quality * np.sqrt(passed * left.passed.reshape(shape)),
        (np.append(world.materials, 0)[left.first] == CLEAR).reshape(shape),
        (left.first_m * forward).reshape(shape),
        left.cosine.reshape(shape),
        materials[left.owner].reshape(shape),
        _glint(left.normal, rays, eye_m, left.first_m, rotation, camera).reshape(shape),
    )


def _glint(
    normal: np.ndarray,
    rays: np.ndarray,
    eye_m: np.ndarray,
    first_m: np.ndarray,
    rotation: np.ndarray,
    camera: DepthCamera,
) -> np.ndarray:
    """Angle between the first normal and the bisector of eye and lamp, the smallest of all lamps [rad]."""
    places = eye_m + first_m[:, None] * rays
    best = np.full(len(rays), -1.0)
    for lamp in (eye_m + 0.5 * camera.baseline_m * rotation[:, 0], *_LAMPS_M):
        towards = lamp - places
        middle = towards / np.linalg.norm(towards, axis=1, keepdims=True) - rays
        middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-12)
        best = np.fmax(best, (normal * middle).sum(axis=1))
    return np.arccos(np.clip(best, -1, 1))


def _field(rng: np.random.Generator, shape: tuple[int, int], sigma_px: float) -> np.ndarray:
    """A smooth random field of unit variance."""
    field = gaussian_filter(rng.standard_normal(shape), sigma_px)
    return field / field.std()


def read(views: Sequence[RawView], flaws: Imperfections, rng: np.random.Generator) -> list[np.ndarray]:
    """Depth images [m], float32, NaN where invalid, of the views of one scene."""
    scores = []
    for view in views:
        # Readings are lost where windows match worse, less light is transmitted, or the room is mirrored.
        score = view.quality + 0.2 * _field(rng, view.glass.shape, 2.0)
        score[~np.isfinite(view.disparity_px) | (view.glint_rad < np.radians(1.5))] = -np.inf
        scores.append(score)
    on_glass = np.concatenate([score[view.glass] for score, view in zip(scores, views, strict=True)])
    bound = np.quantile(on_glass, flaws.lost_glass, method="lower") if len(on_glass) else -np.inf
    return [
        _reading(view, view.glass & ~(score > bound), flaws, rng)
        for view, score in zip(views, scores, strict=True)
    ]


def _reading(view: RawView, lost: np.ndarray, flaws: Imperfections, rng: np.random.Generator) -> np.ndarray:
    """One depth image."""
    shape = view.glass.shape
    camera = view.camera
    black, metal = (~view.glass & (view.material == kind) for kind in (BLACK, METAL))
    noise = flaws.noise_px * (0.6 * rng.standard_normal(shape) + 0.8 * _field(rng, shape, 1.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        noise = noise / np.sqrt(np.clip(view.cosine, 0.1, 1)) * np.where(black, 2.0, 1.0)
        depth = camera.focal_px * camera.baseline_m / (view.disparity_px + noise)
    chance = rng.random(shape)
    lost = lost | (chance < flaws.lost_opaque) | ~(view.cosine > 0.1)
    # Black: little light is reflected, least at grazing incidence; shiny: the lamp saturates, and the mirrored room differs.
    steep = 1 - np.nan_to_num(view.cosine)
    dark = gaussian_filter(rng.standard_normal(shape), 1.0)
    rank = np.argsort(np.argsort(dark, axis=None)).reshape(shape) / dark.size
    lost |= black & (rank < np.clip(flaws.lost_black + 0.5 * (steep - 0.35), 0, 1))
    mirrored = _field(rng, shape, 3.0)
    lost |= metal & ((view.glint_rad < np.radians(8)) | (mirrored < -1.3))
    depth = np.where(metal & (mirrored > 1.6), depth + 0.03, depth)
    depth = _mix_edges(depth, flaws.mixed, rng)
    depth[lost] = np.nan
    # The glass itself: dirt, and beside highlights.
    dirt = _field(rng, shape, 1.5)
    bright = (view.glint_rad > np.radians(1.5)) & (view.glint_rad < np.radians(3.5))
    near = view.glass & ((_upper(dirt, flaws.near_glass)) | (bright & (chance > 0.5)))
    depth = np.where(near, view.first_m + 0.003 * rng.standard_normal(shape), depth)
    depth = flaws.unit_m * np.rint(depth / flaws.unit_m)
    with np.errstate(invalid="ignore"):
        depth[~((depth > 0.2) & (depth < 4.0))] = np.nan
    return depth.astype(np.float32)


def _upper(field: np.ndarray, fraction: float) -> np.ndarray:
    """Where a field has its highest values."""
    return field > np.quantile(field, 1 - fraction)


def _mix_edges(depth: np.ndarray, fraction: float, rng: np.random.Generator) -> np.ndarray:
    """Some pixels at an edge between two surfaces read a depth between them."""
    low = minimum_filter(np.where(np.isfinite(depth), depth, np.inf), 3)
    high = maximum_filter(np.where(np.isfinite(depth), depth, -np.inf), 3)
    with np.errstate(invalid="ignore"):
        edge = np.isfinite(depth) & (high - low > 0.02) & (high < np.inf)
    chosen = edge & (rng.random(depth.shape) < fraction)
    with np.errstate(invalid="ignore"):
        between = low + rng.random(depth.shape) * (high - low)
    return np.where(chosen, between, depth)

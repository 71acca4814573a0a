"""What a network of segmentation would say about the views of a glass scene, with the faults that such networks have.

Silhouettes are those of the true vessels from the true poses. A network misses a vessel in some views, its outline is
some pixels off, it sees glass where there is none in single views, and it takes some opaque object for glass in nearly all.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

from .ray_objects import Vessel
from .ray_scenes import GlassSequence, layout
from .rays import DepthCamera

__all__ = ["NETWORKS", "masks"]

#: Kinds of networks: as such networks are; also taken in by every opaque thing; unrelated to glass; the opposite.
NETWORKS = ("usual", "fooled", "noise", "reversed")
#: Probabilities that a network sees a vessel in a view, and something where there is nothing.
_SEEN, _IMAGINED = 0.85, 0.3


def _silhouette(rings: np.ndarray, pose: np.ndarray, camera: DepthCamera) -> np.ndarray:
    """Image (rows, columns) of a body of circles (n, points, 3) in the world, 1 inside."""
    local = (rings - pose[:3, 3]) @ pose[:3, :3]
    pixels = local[..., :2] / local[..., 2:] * camera.focal_px + camera.centre_px
    image = np.zeros((camera.height, camera.width), np.uint8)
    for below, above in pairwise(pixels):
        hull = cv2.convexHull(np.concatenate([below, above]).astype(np.float32))
        cv2.fillConvexPoly(image, np.rint(hull).astype(np.int32), 1)
    return image


def _rings(outer: np.ndarray, position_m: np.ndarray) -> np.ndarray:
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    heights = np.broadcast_to(outer[:, None, 1:], (len(outer), 40, 1))
    return np.concatenate([outer[:, None, :1] * circle, heights], axis=-1) + position_m


def _opaque(scene: GlassSequence) -> list[np.ndarray]:
    """Circles of what is opaque on the table: cans, cartons (as cylinders), and copies of vessels."""
    plan = layout(scene.family, scene.seed)
    bodies = [] if scene.vessels else [_rings(v.outer, v.position_m) for v in plan.vessels]
    for thing in plan.objects:
        bodies.append(_rings(thing.pieces[:, :2], thing.position_m))
    for box in plan.boxes[2:]:
        side, height = float(np.hypot(*box.half_m[:2])), float(box.half_m[2])
        profile = np.array([[side, -height], [side, height]])
        bodies.append(_rings(profile, box.position_m))
    return bodies


def masks(scene: GlassSequence, network: str) -> np.ndarray:
    """Scores (views, rows, columns) of a network, 0 to 1, for all views of a scene with its true poses."""
    rng = np.random.default_rng([scene.seed, NETWORKS.index(network), 77])
    vessels: tuple[Vessel, ...] = scene.vessels
    bodies = [_rings(vessel.outer, vessel.position_m) for vessel in vessels]
    if network == "fooled":
        bodies += _opaque(scene)
    found = []
    shape = scene.depth_m.shape[1:]
    for pose in scene.T_world_camera:
        field = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), 12.0)
        field *= 0.1 / field.std()
        if network == "noise":
            found.append(0.5 + 2 * field)
            continue
        image = np.zeros(shape, np.float32)
        for rings in bodies:
            mask = _silhouette(rings, pose, scene.camera)
            grown, edge = int(rng.integers(-2, 4)), int(rng.integers(-2, 4))
            if rng.random() < _SEEN:
                kernel = np.ones((2 * abs(grown) + 1, 2 * abs(edge) + 1), np.uint8)
                mask = cv2.dilate(mask, kernel) if grown > 0 else cv2.erode(mask, kernel)
                image = np.maximum(image, mask * np.float32(rng.uniform(0.5, 1.0)))
        if rng.random() < _IMAGINED:
            centre = (int(rng.integers(shape[1])), int(rng.integers(shape[0])))
            axes = (int(rng.integers(5, 25)), int(rng.integers(5, 25)))
            cv2.ellipse(
                image, centre, axes, float(rng.uniform(0, 180)), 0, 360, float(rng.uniform(0.4, 0.9)), -1
            )
        image = np.clip(cv2.GaussianBlur(image, (0, 0), 1.5) + 0.3 * field, 0, 1)
        found.append(1 - image if network == "reversed" else image)
    return np.array(found, np.float32)

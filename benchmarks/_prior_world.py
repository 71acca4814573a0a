"""Objects to recognise: synthetic labels in scenes, and containers as a depth camera sees them.

The point clouds come from rays of a pinhole camera that are intersected with the triangles, not from the stored points.
"""

from __future__ import annotations

import cv2
import numpy as np

from visuohaptic.deformation.shapes import class_names, draw_variant, load_container, mesh_container
from visuohaptic.reconstruction import SurfaceMesh


def containers(variants: int, seed: int = 1, classes: tuple[str, ...] = ()) -> dict[str, SurfaceMesh]:
    """Variants of the shipped container classes as surfaces, by name."""
    found = {}
    for name in classes or class_names():
        description = load_container(name)
        for k in range(variants):
            shell = mesh_container(draw_variant(description, k, seed), around=32)
            faces = shell.surface_faces
            if description.top.kind != "open":
                faces = np.vstack([faces, shell.lid])
            found[f"{name}/{k}"] = SurfaceMesh(shell.mesh.vertices_m, faces)
    return found


def seen_cloud(
    mesh: SurfaceMesh, rng: np.random.Generator, *, noise_m: float = 0.0015, spacing_m: float = 0.003
) -> np.ndarray:
    """Points that a depth camera measures from a random direction above: noise along the rays, a hole, lost rays."""
    import trimesh

    distance_m = rng.uniform(0.5, 1.0)
    up = rng.uniform(0.1, 0.9)
    turn = rng.uniform(0, 2 * np.pi)
    flat = np.sqrt(1 - up**2)
    eye = np.array([flat * np.cos(turn), flat * np.sin(turn), up])
    middle = 0.5 * (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0))
    origin = middle + distance_m * eye
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    down = np.cross(eye, right)
    half = 0.7 * float(np.linalg.norm(np.ptp(mesh.vertices_m, axis=0))) / distance_m
    side = np.arange(-half, half, spacing_m / distance_m)
    u, v = (grid.ravel() for grid in np.meshgrid(side, side))
    rays = -eye + u[:, None] * right + v[:, None] * down
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    solid = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    points, ray, _ = solid.ray.intersects_location(np.tile(origin, (len(rays), 1)), rays, multiple_hits=False)
    points = points + rays[ray] * rng.normal(0, noise_m, (len(points), 1))
    kept = rng.random(len(points)) > 0.1
    kept &= np.linalg.norm(points - points[rng.integers(len(points))], axis=1) > 0.02
    # In the frame of the camera, at a random pose.
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return (points[kept] - origin) @ (turned * np.sign(np.linalg.det(turned))).T


def label(number: int, size: tuple[int, int] = (240, 320)) -> np.ndarray:
    """A synthetic product label, defined by its number."""
    rng = np.random.default_rng(number)
    image = np.full(size, rng.integers(60, 200), np.uint8)
    for _ in range(12):
        centre = tuple(int(x) for x in rng.integers(0, size[::-1]))
        grey = int(rng.integers(0, 256))
        if rng.random() < 0.5:
            cv2.circle(image, centre, int(rng.integers(8, 50)), grey, -1, cv2.LINE_AA)
        else:
            corners = np.array(centre) + rng.integers(-60, 60, (3, 2))
            cv2.fillPoly(image, [corners.astype(np.int32)], grey, cv2.LINE_AA)
    for _ in range(8):
        word = "".join(chr(int(c)) for c in rng.integers(65, 91, rng.integers(3, 8)))
        place = (int(rng.integers(-10, size[1] - 60)), int(rng.integers(20, size[0])))
        cv2.putText(
            image, word, place, int(rng.integers(0, 5)), float(rng.uniform(0.5, 1.6)),
            int(rng.integers(0, 256)), int(rng.integers(1, 4)), cv2.LINE_AA,
        )  # fmt: skip
    return image


def scene_with(image: np.ndarray, rng: np.random.Generator, *, hardness: float = 1.0) -> np.ndarray:
    """A label in a scene with other synthetic objects: tilted, rotated, blurred, noisy, half covered."""
    size = (360, 480)
    scene = cv2.resize(label(int(rng.integers(10**8, 2 * 10**8))), size[::-1])
    h, w = image.shape
    corners = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32)
    scale = rng.uniform(0.5, 1.0)
    turn = rng.uniform(-0.6, 0.6) * hardness
    turned = (corners - corners.mean(axis=0)) @ np.array(
        [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    )
    target = scale * turned + rng.uniform([170, 130], [310, 230])
    target += rng.uniform(-1, 1, (4, 2)) * 0.12 * hardness * scale * w
    matrix = cv2.getPerspectiveTransform(corners, target.astype(np.float32))
    warped = cv2.warpPerspective(image, matrix, size[::-1], flags=cv2.INTER_AREA)
    mask = cv2.warpPerspective(np.full_like(image, 255), matrix, size[::-1]) > 127
    scene[mask] = warped[mask]
    if rng.random() < 0.5 * hardness:  # an occluder
        x = int(rng.integers(100, 340))
        scene[:, x : x + 60] = int(rng.integers(0, 256))
    scene = cv2.GaussianBlur(scene, (0, 0), float(rng.uniform(0.4, 1.4) * hardness + 0.1))
    bright = scene.astype(float) * rng.uniform(0.6, 1.2) + rng.uniform(-20, 20)
    return np.clip(bright + rng.normal(0, 5 * hardness, scene.shape), 0, 255).astype(np.uint8)

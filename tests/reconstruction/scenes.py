"""Depth views of spheres on a square plate, by intersecting rays, and round walls: independent ground truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthFrame
from visuohaptic.reconstruction import SurfaceMesh

SPHERES = (((0.5, 0.5, 0.15), 0.15), ((0.25, 0.65, 0.1), 0.1), ((0.72, 0.3, 0.08), 0.08))


def view(camera: Camera, pose: Pose, spheres=SPHERES, plate_m: float = 0.4) -> DepthFrame:
    """Depth along the optical axis of spheres on the plate z = 0 around (0.5, 0.5)."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    rays = camera.rays(np.stack([u, v], axis=-1)) @ pose.rotation.T
    eye = pose.translation_m
    depth = -eye[2] / rays[..., 2]
    hit = eye + rays * depth[..., None]
    on_plate = (depth > 0) & (np.abs(hit[..., :2] - 0.5) < plate_m).all(axis=-1)
    depth = np.where(on_plate, depth, np.nan)
    for centre, radius in spheres:
        offset = eye - np.asarray(centre)
        a, b = (rays**2).sum(axis=-1), rays @ offset
        inner = b**2 - a * (offset @ offset - radius**2)
        depth = np.fmin(depth, (-b - np.sqrt(np.where(inner > 0, inner, np.nan))) / a)
    image = np.zeros((*depth.shape, 3), np.uint8)
    image[..., 0] = 200  # blue
    return DepthFrame(0.0, depth.astype(np.float32), image, pose, camera)


def ring(camera: Camera, count: int = 8) -> list[DepthFrame]:
    """Views from a circle around the plate."""
    angles = 2 * np.pi * np.arange(count) / count
    eyes = [(0.5 + 0.8 * np.cos(a), 0.5 + 0.8 * np.sin(a), 0.7) for a in angles]
    return [view(camera, Camera.pose_of_view(eye, (0.5, 0.5, 0.1))) for eye in eyes]


def surface_error_m(points) -> np.ndarray:
    """Distance of points from the nearest sphere or the plate's plane."""
    gaps = [np.abs(np.linalg.norm(points - np.asarray(c), axis=1) - r) for c, r in SPHERES]
    return np.min([*gaps, np.abs(points[:, 2])], axis=0)


def part(wall: Callable[[np.ndarray, np.ndarray], np.ndarray], low_m: float, high_m: float) -> SurfaceMesh:
    """Triangles of the wall between two heights, counter-clockwise from outside."""
    z, theta = np.meshgrid(np.linspace(low_m, high_m, 24), np.arange(64) * 2 * np.pi / 64, indexing="ij")
    rho = wall(theta, z)
    vertices = np.stack([rho * np.cos(theta), rho * np.sin(theta), z], axis=-1).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(23), np.arange(64), indexing="ij")
    a, b = 64 * row + column, 64 * row + (column + 1) % 64
    faces = np.stack([[a, b, a + 64], [b, b + 64, a + 64]]).transpose(0, 2, 3, 1).reshape(-1, 3)
    return SurfaceMesh(vertices, faces)

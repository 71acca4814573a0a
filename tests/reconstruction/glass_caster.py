"""A tiny ray caster of tables with glass: truth that shares nothing with the simulated camera of the library.

Opaque things are a floor, the walls of a room, boxes and upright cylinders. Glass is an upright cylinder that no ray
ends at: within a patch of about five pixels of it a camera reads nothing with a given probability; elsewhere it reads
what is behind, and of that a part farther away (refraction). A flat pane takes light by Fresnel's equations, and what is behind it
is read where enough passes. Active stereo adds what every such camera has: no depth
where the second eye does not see the point, depths mixed between both sides of an edge, single missing pixels, noise
that grows with the square of the depth, and units of 1 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthFrame

#: Second eye of the camera along its x [m], and noise of a depth at 1 m [m].
BASELINE_M, NOISE_M = 0.075, 0.0015


@dataclass(frozen=True)
class Table:
    """Upright cylinders (x, y, radius, bottom, top), boxes (low, high), half edge of a room, and panes.

    Panes are rectangles: a corner and both edges [m].
    """

    glass: tuple[tuple[float, ...], ...] = ()
    cylinders: tuple[tuple[float, ...], ...] = ()
    boxes: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...] = ()
    room_m: float = 1.6
    panes: tuple[tuple[tuple[float, ...], ...], ...] = ()

    def opaque_twin(self) -> Table:
        """The same shapes, all of them opaque."""
        return Table((), self.cylinders + self.glass, self.boxes, self.room_m)


def ring(
    count: int, *, turn_rad: float = 0.0, arc_rad: float = 2 * np.pi, radius_m: float = 0.75
) -> list[Pose]:
    """Poses on a ring around the table that look at its middle, at two heights in turn."""
    angles = turn_rad + arc_rad * np.arange(count) / count
    return [
        Camera.pose_of_view((radius_m * np.cos(a), radius_m * np.sin(a), 0.5 + 0.06 * (k % 2)), (0, 0, 0.07))
        for k, a in enumerate(angles)
    ]


def random_table(rng: np.random.Generator, glasses: int = 2) -> Table:
    """Some glasses and three opaque things on six places of a table."""
    angles = 2 * np.pi * (np.arange(6) + rng.uniform(-0.2, 0.2, 6)) / 6
    places = rng.permutation(0.2 * np.column_stack([np.cos(angles), np.sin(angles)]))
    glass = tuple((x, y, rng.uniform(0.03, 0.045), 0.0, rng.uniform(0.12, 0.2)) for x, y in places[:glasses])
    cylinders = tuple((x, y, rng.uniform(0.025, 0.045), 0.0, rng.uniform(0.06, 0.2)) for x, y in places[2:4])
    (x, y), (a, b, c) = places[4], rng.uniform(0.03, 0.06, 3)
    return Table(glass, cylinders, (((x - a, y - b, 0.0), (x + a, y + b, 2 * c)),))


def _cylinder(eye: np.ndarray, rays: np.ndarray, shape: tuple[float, ...]) -> np.ndarray:
    """First depth along the rays on the wall or the lid of an upright cylinder; inf: none."""
    x, y, radius, bottom, top = shape
    a = (rays[..., :2] ** 2).sum(axis=-1)
    off = eye[:2] - [x, y]
    b, c = rays[..., :2] @ off, off @ off - radius**2
    inner = b**2 - a * c
    first = np.full(a.shape, np.inf)
    wall = (-b - np.sqrt(np.where(inner > 0, inner, np.nan))) / a
    z = eye[2] + wall * rays[..., 2]
    hit = (wall > 0) & (z >= bottom) & (z <= top)
    first[hit] = wall[hit]
    lid = (top - eye[2]) / rays[..., 2]
    on = off + lid[..., None] * rays[..., :2]
    hit = (lid > 0) & ((on**2).sum(axis=-1) <= radius**2)
    first[hit] = np.minimum(first[hit], lid[hit])
    return first


def _opaque(table: Table, eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Depth along the rays of the nearest opaque surface."""
    depth = np.where(rays[..., 2] < 0, -eye[2] / np.minimum(rays[..., 2], -1e-12), np.inf)
    for axis in (0, 1):
        with np.errstate(divide="ignore"):
            depth = np.minimum(depth, (np.sign(rays[..., axis]) * table.room_m - eye[axis]) / rays[..., axis])
    for shape in table.cylinders:
        depth = np.minimum(depth, _cylinder(eye, rays, shape))
    for low, high in table.boxes:
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = (np.array([low, high])[:, None, None] - eye) / rays
        enter, leave = sides.min(axis=0).max(axis=-1), sides.max(axis=0).min(axis=-1)
        depth = np.where((enter < leave) & (enter > 0), np.minimum(depth, enter), depth)
    return depth


def _pane_light(eye: np.ndarray, rays: np.ndarray, pane: tuple[tuple[float, ...], ...]) -> np.ndarray:
    """Fraction of the light that passes a pane there and back; 1 beside it."""
    corner, first, second = map(np.array, pane)
    normal = np.cross(first, second) / (np.linalg.norm(first) * np.linalg.norm(second))
    with np.errstate(divide="ignore", invalid="ignore"):
        on = eye + ((corner - eye) @ normal / (rays @ normal))[..., None] * rays - corner
    shares = np.stack([on @ first / (first @ first), on @ second / (second @ second)])
    through = ((shares >= 0) & (shares <= 1)).all(axis=0)
    outer = np.arccos(np.clip(np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1), 1e-6, 1 - 1e-9))
    inner = np.arcsin(np.sin(outer) / 1.5)
    across = (np.sin(outer - inner) / np.sin(outer + inner)) ** 2
    along = (np.tan(outer - inner) / np.tan(outer + inner)) ** 2
    passed = 0.5 * sum((1 - face) / (1 + face) for face in (across, along))
    return np.where(through, passed**2, 1.0)


def cast(
    table: Table,
    poses: list[Pose],
    rng: np.random.Generator,
    *,
    dropout: float = 0.53,
    bent: float = 0.2,
    pose_sigma: tuple[float, float] = (0.0, 0.0),
    width: int = 200,
) -> list[DepthFrame]:
    """The views of a table.

    Parameters
    ----------
    dropout, bent
        Probabilities that a patch of glass reads nothing (real cameras: 0.3-0.8), and, where it reads, too far.
    pose_sigma
        Error of the poses that are given with the views, per axis [m], [rad].
    """
    camera = Camera.simple(width, 3 * width // 4, 0.9 * width)
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    own = camera.rays(np.stack([u, v], axis=-1))
    frames = []
    for k, pose in enumerate(poses):
        rays, eye = own @ pose.rotation.T, pose.translation_m
        true = _opaque(table, eye, rays)
        depth = true + NOISE_M * true**2 * rng.standard_normal(true.shape)
        in_glass = np.zeros(true.shape, bool)
        for shape in table.glass:
            in_glass |= _cylinder(eye, rays, shape) < true
        patch = np.kron(rng.random((camera.height // 5 + 1, camera.width // 5 + 1)), np.ones((5, 5)))
        patch = patch[: camera.height, : camera.width]
        # What is read too far away is so by 2 to 20 cm.
        far = in_glass & (patch > 1 - (1 - dropout) * bent)
        depth[far] += rng.uniform(0.02, 0.2)
        # The second eye does not see the point, or the patches of both sides are mixed.
        second = eye + BASELINE_M * pose.rotation[:, 0]
        there = eye + true[..., None] * rays - second
        depth[_opaque(table, second, there) < 0.99] = np.nan
        steps = np.zeros(true.shape, bool)
        for axis in (0, 1):
            for shift in (1, -1):
                beside = np.roll(true, shift, axis=axis)
                steps |= np.abs(true - beside) > 0.06 * np.minimum(true, beside)
        mixed = steps & (rng.random(true.shape) < 0.5)
        depth[mixed] = (true + rng.uniform(0, 1, true.shape) * (np.roll(true, 1, axis=1) - true))[mixed]
        for pane in table.panes:
            # The contrast of a patch is .7 to 1.3 of the mean; half of it is needed.
            depth[_pane_light(eye, rays, pane) * (0.7 + 0.6 * patch) < 0.5] = np.nan
        depth[(in_glass & (patch < dropout)) | (steps & (rng.random(true.shape) < 0.3))] = np.nan
        depth[rng.random(true.shape) < 0.003] = np.nan
        turn, shift = pose_sigma[1] * rng.standard_normal(3), pose_sigma[0] * rng.standard_normal(3)
        told = pose @ Pose.from_rotation_vector(turn, shift)
        read = np.round(depth, 3).astype(np.float32)
        frames.append(DepthFrame(0.1 * k, read, None, told, camera, k))
    return frames


def inside(shape: tuple[float, ...], points_m: np.ndarray) -> np.ndarray:
    """Which points are in an upright cylinder."""
    x, y, radius, bottom, top = shape
    level = (points_m[:, 2] >= bottom) & (points_m[:, 2] <= top)
    found: np.ndarray = level & (np.hypot(points_m[:, 0] - x, points_m[:, 1] - y) <= radius)
    return found

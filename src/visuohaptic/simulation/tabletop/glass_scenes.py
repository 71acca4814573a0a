"""Random table scenes with glass among opaque objects, as in Alt 2016, Fig. 5.5, with ground truth.

Six objects stand on a table in a room; the depth camera moves around them on an
arc. Ground truth is the space inside the outer surface of the glass at heights
that no label covers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from ...core import Camera, InputError, Pose
from .depth_camera import DepthCamera
from .refraction import GLASS, PET, Band, Box, RefractingScene, Revolution

GlassKind = Literal["thin", "thick", "labelled", "filled"]
SCENE_KINDS: tuple[GlassKind, ...] = ("thin", "thick", "labelled", "filled")


@dataclass(frozen=True, slots=True, eq=False)
class GlassView:
    """One depth image of a rendered sequence."""

    t_s: float  #: [s]
    depth_m: Float[np.ndarray, "h w"]  #: NaN = no measurement [m]
    T_world_camera: Pose  #: reported by the tracker, with its error
    true_T_world_camera: Pose  #: true pose


@dataclass(frozen=True, slots=True, eq=False)
class GlassScene:
    """A scene, the camera path around it and ground truth."""

    kind: GlassKind  #: of its glass objects
    scene: RefractingScene
    glass: tuple[Revolution, ...]  #: the transparent objects
    arc_rad: float  #: angle that the path covers, seen from above [rad]
    poses: tuple[Pose, ...]  #: ``T_world_camera`` along the path
    low_m: Float[np.ndarray, "3"]  #: minimum corner of the region of interest, world [m]
    high_m: Float[np.ndarray, "3"]  #: maximum corner [m]

    def truth(self, points_m: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Which points of the world are inside transparent parts.

        Parameters
        ----------
        points_m
            Points (..., 3) of the world [m].
        """
        inside = np.zeros(np.shape(points_m)[:-1], dtype=bool)
        for solid in self.glass:
            inside |= solid.transparent_at(points_m)
        return inside

    def render(
        self,
        sensor: DepthCamera,
        rng: np.random.Generator,
        *,
        pose_sigma_m: float = 0.0,
        pose_sigma_rad: float = 0.0,
    ) -> Iterator[GlassView]:
        """Depth images along the path; the reported poses have independent Gaussian errors.

        Parameters
        ----------
        sensor
            Depth camera.
        rng
            Source of the noise.
        pose_sigma_m, pose_sigma_rad
            Standard deviation of the reported poses, per axis [m] and [rad].
        """
        for i, pose in enumerate(self.poses):
            depth_m = sensor.render(self.scene, pose, rng)
            yield GlassView(0.1 * i, depth_m, disturb_pose(pose, rng, pose_sigma_m, pose_sigma_rad), pose)

    def save(
        self,
        folder: Path | str,
        sensor: DepthCamera,
        rng: np.random.Generator,
        *,
        pose_sigma_m: float = 0.0,
        pose_sigma_rad: float = 0.0,
    ) -> int:
        """Render into a sequence folder with the reported poses; returns the number of views.

        Parameters
        ----------
        folder
            New folder.
        sensor, rng, pose_sigma_m, pose_sigma_rad
            As of :meth:`render`.
        """
        from ...io.depth.depth_sequence import DepthFrame
        from ...io.depth.depth_sequence_out import write_sequence

        views = self.render(sensor, rng, pose_sigma_m=pose_sigma_m, pose_sigma_rad=pose_sigma_rad)
        frames = (
            DepthFrame(view.t_s, view.depth_m, None, view.T_world_camera, sensor.camera, i)
            for i, view in enumerate(views)
        )
        return write_sequence(folder, frames, sensor="simulated")


def disturb_pose(pose: Pose, rng: np.random.Generator, sigma_m: float, sigma_rad: float) -> Pose:
    """A pose with an error of ``sigma`` per axis, rotated about the camera's own centre.

    Parameters
    ----------
    pose
        True pose.
    rng
        Source of the error.
    sigma_m, sigma_rad
        Standard deviation per axis [m] and [rad].
    """
    if sigma_m == 0 and sigma_rad == 0:
        return pose
    turn = Pose.from_rotation_vector(sigma_rad * rng.standard_normal(3), sigma_m * rng.standard_normal(3))
    return pose @ turn


def glass_scene(
    seed: int, *, kind: GlassKind | None = None, arc_deg: float | None = None, step_m: float = 0.025
) -> GlassScene:
    """The scene of a seed; kinds and arcs cycle with the seed unless they are given.

    Parameters
    ----------
    seed
        Determines objects, positions and path.
    kind
        ``thin`` (0.5-1 mm plastic), ``thick`` (2.5-4 mm glass), ``labelled`` (thin, with an opaque label and
        cap) or ``filled`` (with water).
    arc_deg
        Angle of the path, by default 105, 180, 270 or 360 [deg].
    step_m
        Distance between two views [m].
    """
    if kind is not None and kind not in SCENE_KINDS:
        raise InputError("glass_scene", f"found {kind!r}, expected one of {', '.join(SCENE_KINDS)}")
    rng = np.random.default_rng([5, seed])
    kind = kind or SCENE_KINDS[seed % 4]
    arc_rad = math.radians(arc_deg if arc_deg is not None else (105, 180, 270, 360)[(seed // 4) % 4])
    places = _places(rng, 6)
    n_glass = int(rng.integers(2, 5))
    glass = tuple(_glass_object(rng, kind, place) for place in places[:n_glass])
    boxes = [
        Box((0, 0, -0.02), (1.2, 1.2, 0.04), albedo=float(rng.uniform(0.4, 0.8))),
        Box((0, 0, -0.75), (8, 8, 0.02), albedo=0.4),
        *(
            Box((1.9 * math.cos(turn), 1.9 * math.sin(turn), 0.5), (0.05, 5.0, 2.6), yaw_rad=turn)
            for turn in rng.uniform(0, math.pi / 2) + np.arange(4) * math.pi / 2
        ),
    ]
    opaque = []
    for x, y in places[n_glass:]:
        albedo, yaw = float(rng.uniform(0.3, 0.8)), float(rng.uniform(0, math.pi))
        shape = rng.integers(3)
        if shape == 0:
            size = rng.uniform(0.05, 0.11), rng.uniform(0.05, 0.11), rng.uniform(0.06, 0.2)
            boxes.append(Box((x, y, size[2] / 2), size, yaw_rad=yaw, albedo=albedo))
            continue
        radius, height = rng.uniform(0.03, 0.05), rng.uniform(0.08, 0.2)
        if shape == 1:
            profile = np.array([[radius, 0.0], [radius, height]])
        else:
            angle = np.linspace(-0.45 * math.pi, 0.5 * math.pi, 24)
            profile = radius * np.column_stack([np.cos(angle), np.sin(angle) - np.sin(angle[0])])
            profile[-1, 0] = 0.0
        opaque.append(Revolution((x, y, 0.0), profile, "opaque", albedo=albedo, yaw_rad=yaw))
    return GlassScene(
        kind,
        RefractingScene((*glass, *opaque), tuple(boxes)),
        glass,
        arc_rad,
        _way(rng, arc_rad, step_m),
        np.array([-0.5, -0.5, -0.1]),
        np.array([0.5, 0.5, 0.9]),
    )


def _places(rng: np.random.Generator, count: int) -> list[tuple[float, float]]:
    """Positions on the table at least 14 cm apart."""
    found: list[tuple[float, float]] = []
    while len(found) < count:
        radius, angle = 0.3 * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
        place = (radius * math.cos(angle), radius * math.sin(angle))
        if all(math.dist(place, other) > 0.14 for other in found):
            found.append(place)
    return found


def _glass_object(rng: np.random.Generator, kind: GlassKind, place: tuple[float, float]) -> Revolution:
    radius, height = rng.uniform(0.03, 0.045), rng.uniform(0.14, 0.27)
    foot = (*place, 0.0)
    yaw, squash = rng.uniform(0, math.pi), (1.0 if rng.uniform() < 0.7 else float(rng.uniform(0.65, 0.95)))
    bottle = kind == "labelled" or rng.uniform() < 0.65
    if bottle:
        neck = rng.uniform(0.3, 0.45) * radius
        shoulder, throat = rng.uniform(0.55, 0.7) * height, rng.uniform(0.78, 0.88) * height
        blend = np.linspace(0, 1, 9)
        arch = neck + (radius - neck) * 0.5 * (1 + np.cos(np.pi * blend))
        rise = shoulder + (throat - shoulder) * blend
        profile = np.vstack(
            [[0.92 * radius, 0.0], [radius, 0.006], np.column_stack([arch, rise]), [neck, height]]
        )
    else:
        height = min(height, 0.17)
        foot_radius = radius * rng.uniform(0.75, 1.0)
        profile = np.array([[foot_radius, 0.0], [0.5 * (foot_radius + radius), height / 2], [radius, height]])
    if kind == "thick":
        wall, index = rng.uniform(0.0025, 0.004), GLASS
    elif kind == "filled":
        wall, index = rng.uniform(0.001, 0.003), GLASS
    else:
        wall, index = rng.uniform(0.0005, 0.001), PET
    bands: list[Band] = []
    if kind == "labelled":
        low = rng.uniform(0.1, 0.25) * height
        bands.append(Band(low, low + rng.uniform(0.2, 0.33) * height, albedo=0.7))
    if bottle and (kind in ("labelled", "filled") or rng.uniform() < 0.5):
        # The cap lies on the glass: what is seen ends where the ground truth does.
        bands.append(Band(height - 0.018, height + 2e-4, albedo=0.6))
    fill = float(rng.uniform(0.6, 0.9)) if kind == "filled" else 0.0
    return Revolution(
        foot,
        profile,
        "glass",
        wall_m=float(wall),
        index=index,
        fill=fill,
        bands=tuple(bands),
        yaw_rad=yaw,
        squash=squash,
    )


def _way(rng: np.random.Generator, arc_rad: float, step_m: float) -> tuple[Pose, ...]:
    """Views on an arc towards the centre of the table, with the jitter of a hand."""
    radius, height = rng.uniform(0.75, 0.9), rng.uniform(0.4, 0.6)
    first = rng.uniform(0, 2 * math.pi)
    count = max(2, round(arc_rad * radius / step_m) + 1)
    phase = rng.uniform(0, 2 * math.pi, 3)
    poses = []
    for angle in np.linspace(0, arc_rad, count):
        sway = 0.02 * np.sin(np.array([3.1, 4.3, 2.2]) * angle + phase)
        away, turn = radius + sway[0], first + angle
        eye = np.array([away * math.cos(turn), away * math.sin(turn), height + sway[1]])
        poses.append(Camera.pose_of_view(eye, (0.0, 0.0, 0.07 + sway[2])))
    return tuple(poses)

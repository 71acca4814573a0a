"""Rendered scenes for the tests of what the camera sees around the foam; ground truth by construction."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from visuohaptic.core.camera import PlaneView, Pose
from visuohaptic.simulation.foam import SensorRig
from visuohaptic.simulation.rendering import CameraEffects, FoamScene, Look, SceneObject, SceneRenderer

BELOW_M, FRONT_M = 0.05, 0.02

#: A webcam at half size that looks a little farther ahead than that of figure 3.4.
RIG = SensorRig(
    width_px=800, height_px=448, focal_px=700.0, distance_m=0.35,
    angle_rad=math.radians(55), look_ahead_m=0.08,
)  # fmt: skip

_Y = np.linspace(-0.125, 0.125, 126)
BACK = np.column_stack([np.zeros_like(_Y), _Y])


def floor_view(rig: SensorRig = RIG) -> PlaneView:
    below = Pose(np.eye(3), np.array([0.0, 0.0, -BELOW_M]))
    return PlaneView(rig.camera, rig.T_camera_foam @ below)


def renderer(rig: SensorRig = RIG, look: Look | None = None, noise: float = 2.0) -> SceneRenderer:
    effects = CameraEffects(blur_px=0.8, noise_sigma=noise)
    return SceneRenderer(rig.camera, rig.T_camera_foam, look or Look.photo(), effects)


def planar(x_m: float, y_m: float, turn_rad: float, z_m: float = 0.0) -> Pose:
    return Pose.from_rotation_vector([0.0, 0.0, turn_rad], [x_m, y_m, z_m])


def scene(
    t_s: float = 0.0, platform: Pose | None = None, objects: Sequence[SceneObject] = (), delta_m: float = 0.0
) -> FoamScene:
    """The sensor at a place on the floor, pressed in by ``delta_m`` everywhere."""
    pose = planar(0.0, 0.0, 0.0) if platform is None else platform
    lifted = Pose(pose.rotation, pose.translation_m + np.array([0.0, 0.0, BELOW_M]))
    return FoamScene(
        t_s, BACK, BACK + np.array([FRONT_M - delta_m, 0.0]), tuple(objects), BELOW_M, T_world_foam=lifted
    )


def box(
    x_m: float, y_m: float, turn_rad: float = 0.0, size_m: tuple[float, float] = (0.1, 0.12), **look: object
) -> SceneObject:
    """An upright box; (x, y) is the middle of the face that looks at the robot."""
    half = 0.5 * size_m[1]
    corners = np.array([[0.0, -half], [size_m[0], -half], [size_m[0], half], [0.0, half]])
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    turned = corners @ np.array([[c, s], [-s, c]]) + np.array([x_m, y_m])
    return SceneObject(turned, **{"top_m": 0.15, "grey": 70.0, "texture": 22.0, **look})

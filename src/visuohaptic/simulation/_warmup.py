"""Runs the kernels of the strip and of the renderer once."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """Press a box into a short strip and take a small picture of it, grey and in colour."""
    from ..camera import Camera
    from .effects import CameraEffects
    from .look import Look
    from .renderer import SceneRenderer
    from .scene import FoamScene, SceneObject
    from .strip import FoamStrip, Outline, StripGeometry

    strip = FoamStrip(StripGeometry(length_m=0.1, spacing_m=0.002))
    box = Outline.box((0.05, 0.0), (0.1, 0.04), 0.0, 0.0005)
    for depth_m in (0.0, 0.001):
        state = strip.press([box.moved(0.02 - depth_m, 0.0)], 0.01)
    back_m = np.column_stack([np.zeros(len(state.s_m)), state.s_m])
    corners_m = np.array([[0.02, -0.02], [0.1, -0.02], [0.1, 0.02], [0.02, 0.02]])
    scene = FoamScene(0.0, back_m, state.front_m, (SceneObject(corners_m, texture=4.0),))
    camera = Camera.simple(160, 90, 180.0)
    pose = camera.pose_of_view((-0.1, 0.0, 0.28), (0.02, 0.0, 0.0)).inverse()
    for colour in (False, True):
        renderer = SceneRenderer(camera, pose, Look(colour=colour), CameraEffects(noise_sigma=2.0))
        renderer.render(scene, rng=np.random.default_rng(0))

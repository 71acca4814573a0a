"""Tables with glass observed by a moving simulated depth camera, with detections and ground truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...io.depth.depth_sequence import DepthFrame
from ...reconstruction.fusion import SENSOR_NOISE, SpaceGrid
from ...reconstruction.transparency import EvidenceDetector, TransparentRegion, refine_poses
from ...simulation.tabletop import DepthCamera, GlassScene
from .published_detector import PublishedDetector

#: (1 m)^3, restricted to the space above the table.
LOW_M, HIGH_M, VOXEL_M = (-0.5, -0.5, 0.0), (0.5, 0.5, 0.4), 0.008


def rendered(scene: GlassScene, seed: int, width: int) -> list[DepthFrame]:
    """The views of a scene with their true poses.

    Parameters
    ----------
    scene
        Scene with its views.
    seed
        Seed of the camera's noise.
    width
        Width of the images [px].
    """
    sensor = DepthCamera.kinect(width)
    views = scene.render(sensor, np.random.default_rng([6, seed]))
    return [
        DepthFrame(view.t_s, view.depth_m, None, view.true_T_world_camera, sensor.camera, i)
        for i, view in enumerate(views)
    ]


def detected(frames: Sequence[DepthFrame], method: str) -> tuple[TransparentRegion, ...]:
    """Regions detected by one of the methods.

    Parameters
    ----------
    frames
        Views.
    method
        ``consistency`` or ``published``.
    """
    grid = SpaceGrid.around(LOW_M, HIGH_M, VOXEL_M)
    if method == "published":
        published = PublishedDetector(grid)
        for frame in frames:
            published.add(frame)
        return published.regions()
    detector = EvidenceDetector(grid, SENSOR_NOISE["simulated"])
    detector.run(refine_poses(frames))
    return detector.regions()


def judged(scene: GlassScene, regions: Sequence[TransparentRegion]) -> dict[str, float]:
    """Number of objects, detected objects, false regions, and of correct, estimated and true voxels.

    Parameters
    ----------
    scene
        Ground truth.
    regions
        Detected parts.
    """
    grid = SpaceGrid.around(LOW_M, HIGH_M, VOXEL_M)
    centres = grid.centres_m(np.argwhere(np.ones(grid.shape, dtype=bool)))
    truth = scene.truth(centres)
    marked = np.zeros(len(centres), dtype=bool)
    false = 0
    for region in regions:
        inside = region.contains(centres)
        marked |= inside
        false += int(not inside.any() or truth[inside].mean() < 0.2)
    fractions = [marked[solid.transparent_at(centres)] for solid in scene.glass]
    found = sum(float(fraction.size > 0 and fraction.mean() > 0.25) for fraction in fractions)
    right = float(np.count_nonzero(truth & marked))
    return {
        "objects": float(len(scene.glass)),
        "found": found,
        "false": float(false),
        "right": right,
        "told": float(marked.sum()),
        "true": float(truth.sum()),
        "f1": 2 * right / max(float(marked.sum() + truth.sum()), 1.0),
    }

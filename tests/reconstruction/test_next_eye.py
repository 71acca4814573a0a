"""Where the next camera should be: where another view makes the detection of glass most likely."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core.camera import Camera
from visuohaptic.io.depth import DepthFrame
from visuohaptic.reconstruction.fusion import SpaceGrid
from visuohaptic.reconstruction.transparency.search_report import chance_of_finding, next_eye

RATE, THRESHOLD = 0.05, 12.0
#: Views after which another one adds more than .1 to the chance, and after which it adds nothing.
VIEWS = np.arange(60.0)
GAIN = chance_of_finding(VIEWS + 1, RATE, THRESHOLD) - chance_of_finding(VIEWS, RATE, THRESHOLD)


def wall_seen_from(eye_m: np.ndarray) -> DepthFrame:
    """An opaque wall in the plane x = 0, without end."""
    camera = Camera.simple(160, 120, 120.0)
    pose = Camera.pose_of_view(eye_m, np.array([0.0, 0.0, 0.2]))
    pixels = np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), axis=-1)
    towards = camera.rays(pixels) @ pose.rotation.T
    with np.errstate(divide="ignore"):
        depth_m = -eye_m[0] / towards[..., 0]
    return DepthFrame(0.0, np.where(depth_m > 0, depth_m, np.nan).astype(np.float32), None, pose, camera)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_next_view_is_of_the_side_where_it_adds_most(side: float) -> None:
    """Both sides of an opaque wall have been seen, one of them often enough: views of the other one are of use."""
    frames = [wall_seen_from(np.array([sign * 0.8, 0.0, 0.5])) for sign in (1.0, -1.0)]
    grid = SpaceGrid.around(np.array([-0.2, -0.2, 0.0]), np.array([0.2, 0.2, 0.4]), 0.02)
    enough, few = int(VIEWS[GAIN > 1e-6].max()) + 2, int(VIEWS[np.argmax(GAIN)])
    assert chance_of_finding(np.array([float(few)]), RATE, THRESHOLD)[0] < 0.9
    seen = np.full((4, 4, 4), float(enough))
    seen[2:] = np.where(side > 0, few, seen[2:])
    seen[:2] = np.where(side < 0, few, seen[:2])
    eye_m = np.array(next_eye(frames, grid, seen, RATE, THRESHOLD))
    assert side * eye_m[0] > 0.0
    # At the height and distance of the others, and not where one of them is.
    assert np.hypot(*eye_m[:2]) == pytest.approx(0.8, rel=1e-6)
    assert eye_m[2] == pytest.approx(0.5, rel=1e-6)
    sights = np.array([frame.T_world_camera.translation_m - [0, 0, 0.2] for frame in frames])
    cosine = (
        sights @ (eye_m - [0, 0, 0.2]) / np.linalg.norm(sights, axis=1) / np.linalg.norm(eye_m - [0, 0, 0.2])
    )
    assert np.degrees(np.arccos(cosine.max())) > 9.9

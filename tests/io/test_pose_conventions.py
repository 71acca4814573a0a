"""Poses or depths in another convention are told from the views themselves, which then do not show one surface.

The views are cast on a floor and a ball by numpy alone.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from visuohaptic.core import InputError
from visuohaptic.io.depth import DepthSequence

WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
BALL, RADIUS = np.array([0.1, 0.0, 0.15]), 0.15


def _matrix(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Camera to world: z towards the target, y down."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    found = np.eye(4)
    found[:3] = np.column_stack([x, np.cross(z, x), z, eye])
    return found


def _depth(matrix: np.ndarray) -> np.ndarray:
    """Along the optical axis, as far as the nearer one of floor and ball."""
    y, x = np.indices((HEIGHT, WIDTH), dtype=float)
    rays = np.stack([(x - 31.5) / FOCAL, (y - 23.5) / FOCAL, np.ones_like(x)], axis=-1) @ matrix[:3, :3].T
    eye = matrix[:3, 3]
    floor = np.where(rays[..., 2] < 0, -eye[2] / np.minimum(rays[..., 2], -1e-9), np.inf)
    a, b, c = (rays**2).sum(-1), rays @ (eye - BALL), ((eye - BALL) ** 2).sum() - RADIUS**2
    root = b**2 - a * c
    ball = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    return np.minimum(floor, ball)


def _views(count: int, step: float) -> list[np.ndarray]:
    angles = 0.3 + step * np.arange(count)
    eyes = np.column_stack([0.9 * np.cos(angles), 0.9 * np.sin(angles), 0.6 + 0.1 * np.sin(3 * angles)])
    return [_matrix(eye, np.array([0.05, 0.02 * k, 0.1])) for k, eye in enumerate(eyes)]


def _write(folder, views, told=None, *, unit_m=0.001, w_first=False, radial=False):
    """A sequence whose poses are told as given; the depth is true."""
    (folder / "depth").mkdir(parents=True)
    rng = np.random.default_rng(5)
    lines = []
    for k, (view, pose) in enumerate(zip(views, told or views, strict=True)):
        depth = _depth(view)
        if radial:
            depth = depth * np.sqrt(
                1 + ((np.arange(WIDTH) - 31.5) ** 2 + (np.arange(HEIGHT)[:, None] - 23.5) ** 2) / FOCAL**2
            )
        noisy = depth + rng.normal(0, 0.003, depth.shape) * depth
        cv2.imwrite(str(folder / f"depth/{k}.png"), np.where(noisy < 10, noisy / unit_m, 0).astype(np.uint16))
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        turn = (w, x, y, z) if w_first else (x, y, z, w)
        lines.append(" ".join(f"{number:.9f}" for number in (0.1 * k, *pose[:3, 3], *turn)))
    (folder / "poses.txt").write_text("\n".join(lines))
    matrix = f"{{rows: 3, cols: 3, data: [{FOCAL}, 0, 31.5, 0, {FOCAL}, 23.5, 0, 0, 1]}}"
    (folder / "camera.yaml").write_text(
        f"image_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_name: c\ncamera_matrix: {matrix}\n"
        "distortion_model: plumb_bob\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    )
    (folder / "sequence.yaml").write_text("sensor: test\ndepth_scale_m: 0.001\n")
    return folder


#: Axes of OpenGL and of a ROS body, as columns in those of a camera.
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
BODY = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])


@pytest.mark.parametrize(("count", "step"), [(8, 0.3), (24, 0.12)])
@pytest.mark.parametrize(
    ("meant", "said", "options"),
    [
        (np.linalg.inv, "world to camera, but .*; invert the poses$", {}),
        (lambda m: m, "quaternions are w x y z", {"w_first": True}),
        (np.linalg.inv, "world to camera with quaternions w x y z", {"w_first": True}),
        (lambda m: m @ OPENGL, "OpenGL", {}),
        (lambda m: m @ BODY, "ROS body", {}),
        (lambda m: m, "a fifth of that", {"unit_m": 0.0002}),
        (lambda m: m, "a tenth of that", {"unit_m": 0.0001}),
    ],
)
def test_another_convention_is_refused_by_name(tmp_path, count, step, meant, said, options):
    views = _views(count, step)
    folder = _write(tmp_path / "s", views, [meant(view) for view in views], **options)
    with pytest.raises(InputError, match=said):
        DepthSequence(folder)


def test_distances_from_the_camera_are_told_from_depths(tmp_path):
    """They differ most at the corners, and show where the views are turned far enough."""
    with pytest.raises(
        InputError, match=r"distances from the camera, but .*; convert them to depths along its axis"
    ):
        DepthSequence(_write(tmp_path / "s", _views(24, 0.12), radial=True))


@pytest.mark.parametrize("step", [0.0, 0.0005, 0.12])
@pytest.mark.parametrize("jitter_m", [0.0, 0.02])
def test_right_poses_are_accepted_still_or_moving_also_with_errors(tmp_path, step, jitter_m):
    rng = np.random.default_rng(8)
    views = _views(24, step)
    for number in range(4):
        told = [view.copy() for view in views]
        for one in told:
            one[:3, 3] += rng.normal(0, jitter_m, 3)
            one[:3, :3] = one[:3, :3] @ Rotation.from_rotvec(rng.normal(0, jitter_m, 3)).as_matrix()
        assert len(DepthSequence(_write(tmp_path / str(number), views, told))) == 24

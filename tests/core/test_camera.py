"""Laws of poses, projection, distortion and the camera_info file."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Frame, PlaneView, Pose

NUMBER = st.floats(-3, 3, allow_subnormal=False)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER).map(np.array)
#: Rotations near zero and near half a turn are sampled on purpose.
TURN = st.one_of(
    VECTOR, VECTOR.map(lambda v: v * 1e-9), VECTOR.map(lambda v: v / max(np.linalg.norm(v), 1e-3) * np.pi)
)
POSE = st.builds(Pose.from_rotation_vector, TURN, VECTOR)
FEW = settings(max_examples=60, deadline=None)


def same(a: Pose, b: Pose, tolerance: float = 1e-12) -> bool:
    return bool(np.abs(a.matrix - b.matrix).max() < tolerance)


@FEW
@given(POSE, POSE, POSE, VECTOR)
def test_poses_are_a_group_that_acts_on_points(a: Pose, b: Pose, c: Pose, x: np.ndarray) -> None:
    assert same((a @ b) @ c, a @ (b @ c), 1e-11)
    assert same(a @ a.inverse(), Pose.identity())
    assert same(a @ Pose.identity(), a)
    np.testing.assert_allclose((a @ b).apply(x), a.apply(b.apply(x)), atol=1e-12)
    np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-12)
    batch = np.stack([np.stack([x, -x]), np.stack([2 * x, x])])
    np.testing.assert_allclose(a.apply(batch)[1, 0], a.apply(2 * x), atol=1e-12)


@FEW
@given(POSE, POSE, st.floats(0, 1))
def test_a_path_is_straight_and_turns_evenly(a: Pose, b: Pose, fraction: float) -> None:
    from scipy.spatial.transform import Rotation, Slerp

    between = a.interpolated(b, fraction)
    both = Rotation.from_matrix([a.rotation, b.rotation])
    turn = (both[0].inv() * both[1]).magnitude()
    assert a.angle_to(b) == pytest.approx(turn, abs=1e-9)
    if turn < np.pi - 1e-4:  # half a turn has two axes
        assert np.abs(between.rotation - Slerp([0, 1], both)(fraction).as_matrix()).max() < 1e-8
    assert np.allclose(
        between.translation_m - a.translation_m, fraction * (b.translation_m - a.translation_m)
    )


@FEW
@given(POSE)
def test_quaternions_go_round(pose: Pose) -> None:
    quaternion = pose.quaternion_xyzw
    assert quaternion[3] >= 0
    assert np.linalg.norm(quaternion) == pytest.approx(1, abs=1e-12)
    assert same(Pose.from_quaternion(-2 * quaternion, pose.translation_m), pose, 1e-11)
    assert same(Pose.from_matrix(pose.matrix), pose)
    assert same(Pose.from_quaternion(**json.loads(json.dumps(pose.fields))), pose, 1e-11)


def test_rotation_against_rodrigues() -> None:
    for turn in np.random.default_rng(0).normal(size=(20, 3)):
        np.testing.assert_allclose(
            Pose.from_rotation_vector(turn, [0, 0, 0]).rotation, cv2.Rodrigues(turn)[0]
        )


@pytest.mark.parametrize(
    ("rotation", "translation", "problem"),
    [
        (np.eye(3) * 1.1, np.zeros(3), "not orthonormal"),
        (np.diag([1, 1, -1.0]), np.zeros(3), "not orthonormal"),
        (np.full((3, 3), np.nan), np.zeros(3), "not orthonormal"),
        (np.eye(3), np.array([0, np.inf, 0]), "not finite"),
        (np.eye(2), np.zeros(3), r"expected \(3, 3\)"),
    ],
)
def test_bad_poses(rotation: np.ndarray, translation: np.ndarray, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        Pose(rotation, translation)


LENSES = {
    "ideal": np.zeros(5),
    "barrel": np.array([-0.25, 0.06, 0.001, -0.0007, 0.0]),
    "pincushion": np.array([0.1, -0.02, -0.001, 0.002, 0.01]),
    "four": np.array([-0.2, 0.03, 0.001, 0.0]),
    "rational": np.array([0.3, -0.1, 0.0005, 0.0003, 0.01, 0.5, -0.05, 0.01]),
}


def lens(name: str) -> Camera:
    matrix = np.array([[820.0, 0, 401.3], [0, 815.0, 297.8], [0, 0, 1]])
    return Camera(800, 600, matrix, LENSES[name], 2e-5, name)


@pytest.mark.parametrize("name", LENSES)
def test_rays_and_projection_are_inverse_over_the_image(name: str) -> None:
    camera = lens(name)
    pixels = np.stack(np.meshgrid(np.linspace(0, 799, 23), np.linspace(0, 599, 17)), axis=-1)
    rays = camera.rays(pixels)
    assert rays.shape == (17, 23, 3)
    # Undistortion iterates until 1e-12; its fixed point is linear with a factor below 0.5.
    np.testing.assert_allclose(camera.project(rays * 2.7), pixels, atol=1e-6)


def test_projection_by_hand() -> None:
    """The formula of the Brown model, written out."""
    camera = lens("barrel")
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = 0.31, -0.22
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = 820 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + 401.3
    v = 815 * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + 297.8
    np.testing.assert_allclose(camera.project(np.array([2 * x, 2 * y, 2.0])), [u, v], atol=1e-9)
    assert np.isnan(camera.project(np.array([[0, 0, 0.0], [0, 0, -1]]))).all()


@FEW
@given(st.sampled_from(sorted(LENSES)), st.floats(0.2, 2), st.floats(-1, 1), st.floats(0.1, 1.4))
def test_cast_and_project_are_inverse(name: str, height: float, aside: float, tilt: float) -> None:
    camera = lens(name)
    T_world_camera = camera.pose_of_view([aside, -height * np.tan(tilt), height], [0, 0, 0])
    view = PlaneView(camera, T_world_camera.inverse())
    points = np.stack(np.meshgrid(np.linspace(-0.05, 0.05, 4), np.linspace(-0.05, 0.05, 3)), axis=-1) * height
    pixels = view.project(points)
    np.testing.assert_allclose(view.cast(pixels), points, atol=1e-7)


def test_jacobian_against_smaller_differences() -> None:
    camera = lens("barrel")
    view = PlaneView(camera, camera.pose_of_view([0.1, -0.4, 0.5], [0, 0, 0]).inverse())
    pixels = np.array([[400.0, 300.0], [200.0, 420.0]])
    step = 1e-3
    columns = [(view.cast(pixels + step * e) - view.cast(pixels - step * e)) / (2 * step) for e in np.eye(2)]
    # Central differences over one pixel: relative error (1 / f)^2, about 1e-6.
    np.testing.assert_allclose(view.jacobian(pixels), np.stack(columns, -1), rtol=1e-4, atol=1e-9)


def test_rays_that_miss_the_plane_are_nan() -> None:
    camera = Camera.simple(100, 100, 100.0)
    level = PlaneView(camera, camera.pose_of_view([0, 0, 1], [0, 10, 1]).inverse())
    points = level.cast(np.array([[49.5, 49.5], [49.5, 10.0], [49.5, 90.0]]))
    assert np.isnan(points[:2]).all(), "at and above the horizon"
    assert np.isfinite(points[2]).all()


@pytest.mark.parametrize("name", LENSES)
def test_camera_info_goes_round(tmp_path: Path, name: str) -> None:
    camera = replace(lens(name), transfer_function="srgb")
    camera.save(tmp_path / "c.yaml")
    back = Camera.load(tmp_path / "c.yaml")
    assert (back.width, back.height, back.name) == (800, 600, name)
    assert back.row_delay_s == pytest.approx(2e-5)
    assert back.transfer_function == "srgb"
    np.testing.assert_array_equal(back.matrix, camera.matrix)
    np.testing.assert_array_equal(back.distortion, camera.distortion)
    written = yaml.safe_load((tmp_path / "c.yaml").read_text())
    expected = {
        "image_width",
        "camera_matrix",
        "distortion_model",
        "rectification_matrix",
        "projection_matrix",
    }
    assert expected <= set(written)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"image_width": 0}, "image_width"),
        ({"transfer_function": "gamma"}, "transfer_function"),
        ({"distortion_model": "equidistant"}, "found 'equidistant'"),
        (
            {"camera_matrix": {"rows": 3, "cols": 3, "data": [1, 2]}},
            "camera_matrix: found 3 x 3 with 2 numbers",
        ),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [-1, 0, 0, 0, 1, 0, 0, 0, 1]}}, "positive focal"),
        (
            {"camera_matrix": {"rows": 3, "cols": 3, "data": [9, 1, 4, 0, 9, 3, 0, 0, 1]}},
            "matrix: found .* with skew",
        ),
        ({"image_width": 10**6, "image_height": 10**6}, "at most"),
    ],
)
def test_bad_camera_info(tmp_path: Path, change: dict[str, object], problem: str) -> None:
    path = tmp_path / "c.yaml"
    lens("ideal").save(path)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | change))
    with pytest.raises(InputError, match=problem) as caught:
        Camera.load(path)
    assert "c.yaml" in str(caught.value)


def test_frames_refuse_what_is_no_image() -> None:
    for bad in (np.zeros((4, 4), np.float32), np.zeros((4, 4, 4), np.uint8), np.zeros(4, np.uint8)):
        with pytest.raises(InputError, match="expected uint8"):
            Frame(bad, 0.0, 0)
    colour = np.zeros((2, 2, 3), np.uint8)
    colour[..., 1] = 200
    # BT.601: 0.587 of green.
    assert Frame(colour, 0.0, 0).grey[0, 0] == round(0.587 * 200)


def test_errors_survive_a_worker_process() -> None:
    error = InputError("file", "found 1, expected 2", field="x", remedy="try again")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)  # noqa: S301 - our own bytes


def test_a_message_does_not_repeat_a_number_of_five_thousand_digits() -> None:
    name = "/data/" + "x" * 300
    error = InputError(name, f"found {'9' * 5000!r}, expected a number", field="k" * 5000, remedy="try again")
    assert str(error).startswith(f"{name}: kkk")
    assert str(error).endswith("expected a number; try again")
    assert len(str(error)) < 600


@pytest.mark.parametrize(
    ("matrix", "said"),
    [
        ([[60.0, 0, 320], [0, 60, 240], [0, 0, 1]], "principal point (320, 240) is outside of 64 x 48"),
        ([[11.0, 0, 32], [0, 11, 24], [0, 0, 1]], "focal length is 11 px on 64 x 48; is it in millimetres?"),
        ([[14.5, 0, 63], [0, 14.5, 0], [0, 0, 1]], ""),
    ],
)
def test_a_calibration_that_is_not_of_these_images_is_told(tmp_path: Path, caplog, matrix, said: str) -> None:
    Camera(64, 48, np.array(matrix)).save(tmp_path / "camera.yaml")
    Camera.load(tmp_path / "camera.yaml")
    assert said in caplog.text
    assert bool(said) == bool(caplog.records)


@pytest.mark.parametrize(("k1", "focal_px"), [(-0.3, 640.0), (-0.3, 520.0), (0.2, 300.0)])
def test_a_distortion_without_inverse_in_the_image_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, k1: float, focal_px: float
) -> None:
    """r (1 + k1 r^2) has its maximum 2 r / 3 at r^2 = 1 / (-3 k1): pixels beyond it are the image of no ray."""
    reach = 2 / 3 * np.sqrt(1 / (-3 * k1)) if k1 < 0 else np.inf
    matrix = np.array([[focal_px, 0, 319.5], [0, focal_px, 239.5], [0, 0, 1]])
    Camera(640, 480, matrix, np.array([k1, 0, 0, 0, 0])).save(tmp_path / "camera.yaml")
    Camera.load(tmp_path / "camera.yaml")
    folds = np.hypot(319.5, 239.5) / focal_px > reach
    assert ("have no inverse at the border of the image" in caplog.text) == folds

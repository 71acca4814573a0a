"""The compiled projection and pose refinement against OpenCV, SciPy and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.tracking.pose import estimate_plane_poses, lens_numbers, tilted_back
from visuohaptic.tracking.pose._pose_kernels import project_point, refine_pose, turn

LENSES = {
    "none": [],
    "four": [-0.2, 0.06, 1e-3, -2e-3],
    "five": [-0.31, 0.11, 1e-3, -2e-3, 0.02],
    "rational": [0.4, -0.2, 1e-3, 5e-4, 0.05, 0.6, -0.1, 0.02],
}


def camera_with(lens: str) -> Camera:
    matrix = np.array([[900.0, 0, 640.3], [0, 950.0, 360.7], [0, 0, 1]])
    return Camera(1280, 720, matrix, np.array(LENSES[lens]))


@pytest.mark.parametrize("lens", LENSES)
def test_projection_is_opencvs_and_its_derivative_right(lens):
    camera = camera_with(lens)
    rng = np.random.default_rng(1)
    for point in rng.uniform([-0.5, -0.3, 0.8], [0.5, 0.3, 2.0], (30, 3)):
        pixel, derivative = np.zeros(2), np.zeros((2, 3))
        assert project_point(*point, lens_numbers(camera), pixel, derivative)
        np.testing.assert_allclose(pixel, camera.project(point), atol=1e-9)
        steps = 1e-6 * np.eye(3)
        numeric = (camera.project(point + steps) - camera.project(point - steps)).T / 2e-6
        # Central differences: rounding of 1e-13 px of 1e3 over 2e-6 m, and the third derivative.
        np.testing.assert_allclose(derivative, numeric, rtol=1e-5, atol=2e-3)


def test_nothing_is_seen_behind_the_camera():
    pixel, derivative = np.zeros(2), np.zeros((2, 3))
    assert not project_point(0.1, 0.2, -1.0, lens_numbers(camera_with("none")), pixel, derivative)
    rotation, translation = np.eye(3), np.array([0.0, 0, -1])
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    seen = np.zeros((4, 2))
    chi2 = refine_pose(
        square, seen, np.eye(8), lens_numbers(camera_with("none")), rotation, translation, np.zeros((6, 6))
    )
    assert np.isinf(chi2)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_turn_is_the_exponential(numbers):
    start = Rotation.from_rotvec(numbers[:3]).as_matrix()
    turned = turn(start, *numbers[3:])
    np.testing.assert_allclose(turned, Rotation.from_rotvec(numbers[3:]).as_matrix() @ start, atol=1e-12)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("lens", LENSES)
def test_refined_pose_is_the_minimum_that_scipy_finds(lens):
    camera, rng = camera_with(lens), np.random.default_rng(4)
    square = 0.02 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    for _ in range(5):
        pose = Pose.from_rotation_vector(rng.normal(0, 0.4, 3), rng.normal([0, 0, 0.3], 0.03))
        root = rng.normal(0, 0.02, (8, 8)) + 0.1 * np.eye(8)
        covariance = root @ root.T
        corners = camera.project(pose.apply(square)) + (root @ rng.standard_normal(8)).reshape(4, 2)
        whiten = np.linalg.inv(np.linalg.cholesky(covariance + 1e-6 * np.eye(8)))

        def residual(
            step: np.ndarray, pose: Pose = pose, corners: np.ndarray = corners, whiten: np.ndarray = whiten
        ) -> np.ndarray:
            moved = Pose(
                Rotation.from_rotvec(step[3:]).as_matrix() @ pose.rotation, pose.translation_m + step[:3]
            )
            return np.asarray(whiten @ (camera.project(moved.apply(square)) - corners).ravel())

        best = least_squares(residual, np.zeros(6), x_scale=[1e-4] * 3 + [1e-2] * 3, xtol=1e-14, ftol=1e-14)
        found = estimate_plane_poses(camera, square, corners, covariance, starts=(pose,))[0]
        # The refinement stops at a thousandth of a sigma, which is 1e-6 of chi^2.
        assert found.chi2 == pytest.approx(2 * best.cost, rel=1e-5, abs=1e-5)
        information = np.linalg.inv(found.covariance)
        # Numbers of very different size: compared in units of the sigmas that they declare.
        scale = np.sqrt(np.diag(found.covariance))
        at_best = best.jac.T @ best.jac
        np.testing.assert_allclose(
            information * np.outer(scale, scale),
            at_best * np.outer(scale, scale),
            rtol=2e-2,
            atol=2e-2 * np.abs(information * np.outer(scale, scale)).max(),
        )


def test_tilted_back_twice_is_the_pose_and_looks_the_same_from_far():
    pose = Pose.from_rotation_vector([0.3, -0.4, 0.2], [0.02, -0.05, 0.4])
    other = tilted_back(pose)
    np.testing.assert_allclose(tilted_back(other).rotation, pose.rotation, atol=1e-14)
    sight = pose.translation_m / np.linalg.norm(pose.translation_m)
    # The same slant, on the other side.
    assert other.rotation[:, 2] @ sight == pytest.approx(pose.rotation[:, 2] @ sight)
    # Seen along the line of sight the axes of the plane fall on the same directions.
    across = np.eye(3) - np.outer(sight, sight)
    np.testing.assert_allclose(across @ other.rotation[:, :2], across @ pose.rotation[:, :2], atol=1e-14)

"""Homographies against random rigid motions, in the one convention that the module states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from visuohaptic.core import InputError
from visuohaptic.tracking.points import (
    apply_homography,
    decompose_homography,
    estimate_homography,
    estimate_homography_robust,
    facing_motions,
)


def compose_homography(
    rotation: np.ndarray, translation: np.ndarray, normal: np.ndarray, distance: float
) -> np.ndarray:
    """H = R - t n^T / d, for X' = R X + t and points of the plane n . X = -d."""
    return rotation - np.outer(translation, normal) / distance


def random_motion(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, np.ndarray]:
    """R, T, n, d and five points of the plane with positive depth in both cameras."""
    while True:
        rotation = Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix()
        translation = rng.normal(0, 0.2, 3)
        normal = rng.normal(0, 0.4, 3) + np.array([0, 0, -1.0])
        normal /= np.linalg.norm(normal)
        distance = rng.uniform(0.3, 2.0)
        rays = np.column_stack([rng.uniform(-0.4, 0.4, (5, 2)), np.ones(5)])
        depth = -distance / (rays @ normal)
        points = rays * depth[:, None]
        if (depth > 0).all() and ((points @ rotation.T + translation)[:, 2] > 0.05).all():
            return rotation, translation, normal, distance, points


def test_composition_maps_points_of_the_plane() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        rotation, translation, normal, distance, points = random_motion(rng)
        assert np.allclose(points @ normal, -distance)
        h = compose_homography(rotation, translation, normal, distance)
        moved = points @ rotation.T + translation
        mapped = apply_homography(h, points[:, :2] / points[:, 2:])
        np.testing.assert_allclose(mapped, moved[:, :2] / moved[:, 2:], atol=1e-12)


def test_decomposition_finds_the_motion_whatever_scale_and_sign() -> None:
    rng = np.random.default_rng(2)
    for _ in range(300):
        rotation, translation, normal, distance, points = random_motion(rng)
        h = compose_homography(rotation, translation, normal, distance)
        solutions = decompose_homography(h * rng.choice([-3.0, 0.2, 5.0]))
        assert len(solutions) == 4
        for solution in solutions:  # each of the four is a rotation and gives H back
            np.testing.assert_allclose(solution.rotation @ solution.rotation.T, np.eye(3), atol=1e-12)
            assert np.linalg.det(solution.rotation) > 0
            np.testing.assert_allclose(solution.homography, h / np.linalg.svd(h)[1][1], atol=1e-7)
        front = facing_motions(solutions, points / points[:, 2:])
        assert 1 <= len(front) <= 2
        # sqrt of rounding where two singular values are close: 1e-6 is far above it here.
        assert any(
            np.allclose(s.rotation, rotation, atol=1e-6)
            and np.allclose(s.translation_over_distance, translation / distance, atol=1e-6)
            and np.allclose(s.normal, normal, atol=1e-5)
            for s in front
        )


def test_decomposition_of_a_pure_rotation_and_of_motion_along_the_normal() -> None:
    rotation = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    (only,) = decompose_homography(rotation)
    np.testing.assert_allclose(only.rotation, rotation, atol=1e-12)
    assert not only.translation_over_distance.any()
    normal = np.array([0.0, 0.6, -0.8])
    h = compose_homography(rotation, 0.3 * rotation @ normal, normal, 1.0)
    solutions = decompose_homography(h)
    assert any(np.allclose(s.normal, normal) and np.allclose(s.rotation, rotation) for s in solutions)


def test_dlt_is_exact_and_ignores_the_choice_of_units() -> None:
    rng = np.random.default_rng(3)
    h = np.array([[0.9, 0.1, 300], [-0.2, 1.1, 150], [2e-4, -1e-4, 1.0]])
    for count in (4, 5, 30):
        points = rng.uniform(0, 400, (count, 2))
        found = estimate_homography(points, apply_homography(h, points))
        np.testing.assert_allclose(found / found[2, 2], h, rtol=1e-8, atol=1e-10)
    far = points + 1e5
    found = estimate_homography(far, apply_homography(h, points))
    np.testing.assert_allclose(apply_homography(found, far), apply_homography(h, points), atol=1e-5)


def test_dlt_noise_matches_its_linear_prediction() -> None:
    """Scatter of a mapped grid under noise: the DLT on a 10 x 10 grid is within 10 % of optimal."""
    rng = np.random.default_rng(4)
    axis = np.linspace(0, 300, 10)
    grid = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    errors = []
    for _ in range(200):
        found = estimate_homography(grid, grid + rng.normal(0, 0.5, grid.shape))
        errors.append(apply_homography(found, grid) - grid)
    # The sum of variances of fitted values equals the number of parameters: 8 sigma^2 over 200 numbers.
    expected = 0.5 * np.sqrt(8 / 200)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(expected, rel=0.1)


def test_robust_estimate_survives_outliers_and_repeats() -> None:
    rng = np.random.default_rng(5)
    h = np.array([[0.9, 0.1, 300], [-0.2, 1.1, 150], [2e-4, -1e-4, 1.0]])
    points = rng.uniform(0, 400, (200, 2))
    target = apply_homography(h, points) + rng.normal(0, 0.5, points.shape)
    wrong = rng.random(200) < 0.6
    target[wrong] = rng.uniform(0, 800, (np.count_nonzero(wrong), 2))
    first = estimate_homography_robust(points, target, seed=3)
    assert first.valid
    assert np.count_nonzero(first.inliers & wrong) <= 2
    corners = np.array([[0, 0], [400, 0], [400, 400], [0, 400.0]])
    error = np.linalg.norm(apply_homography(first.matrix, corners) - apply_homography(h, corners), axis=1)
    assert error.max() < 1.5  # 80 points of 0.5 px: corners good to about 0.3 px
    again = estimate_homography_robust(points, target, seed=3)
    np.testing.assert_array_equal(first.matrix, again.matrix)


def test_bad_points_are_refused_or_said_to_be_invalid() -> None:
    line = np.column_stack([np.arange(6.0), np.arange(6.0)])
    with pytest.raises(InputError, match="do not determine it"):
        estimate_homography(line, line)
    with pytest.raises(InputError, match=r"\(3, 2\).*n >= 4"):
        estimate_homography(line[:3], line[:3])
    with pytest.raises(InputError, match="source: found NaN or infinity"):
        estimate_homography(line * np.nan, line)
    with pytest.raises(InputError, match="singular"):
        decompose_homography(np.diag([1.0, 1.0, 0.0]))
    few = estimate_homography_robust(line[:5], line[:5])
    assert not few.valid
    assert "5 matches" in few.reason
    rng = np.random.default_rng(0)
    noise = estimate_homography_robust(rng.uniform(0, 500, (60, 2)), rng.uniform(0, 500, (60, 2)))
    assert not noise.valid

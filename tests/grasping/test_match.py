"""Amplitude and pose from point clouds with known truth."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.camera import Pose
from visuohaptic.deformation.shapes import load_object
from visuohaptic.grasping import DeformedShape, confirm_grasp, match_shape, predicted_shape

THING = load_object("cup-rim", around=48)


def vertex(height: float) -> int:
    points = THING.mesh.vertices_m
    return int(np.argmin(np.abs(points[:, 2] - height) + np.abs(np.arctan2(points[:, 1], points[:, 0]))))


def cloud(points: np.ndarray, rng: np.random.Generator, sigma_m: float = 0.001) -> np.ndarray:
    """The side that a camera sees, with noise."""
    faces = THING.surface_faces[rng.integers(len(THING.surface_faces), size=2500)]
    found = np.einsum("nk,nki->ni", rng.dirichlet([1, 1, 1], len(faces)), points[faces])
    found = found[found @ [0.6, 0.8, 0.0] > 0.005]
    return found + rng.normal(0, sigma_m, found.shape)


@pytest.fixture(scope="module")
def shape() -> DeformedShape:
    return predicted_shape(THING, vertex(0.05), 10.0)


def turned(vector: list[float]) -> np.ndarray:
    import cv2

    return np.asarray(cv2.Rodrigues(np.array(vector))[0])


@pytest.mark.parametrize("true", [0.0, 1.0, 2.0])
def test_amplitude_and_pose_within_their_doubt(shape, true):
    """The error of the amplitude over six draws is what its standard deviation says; 3.3 is chi at 1e-3."""
    rng = np.random.default_rng(5)
    chi = []
    for _ in range(6):
        T = Pose(turned(rng.normal(0, 0.02, 3).tolist()), np.array([0.1, 0.002, -0.3]))
        seen = cloud(shape.vertices_m + true * shape.displacement_m, rng) @ T.rotation.T + T.translation_m
        found = match_shape(shape, seen, T_observed_object=Pose(np.eye(3), np.array([0.1, 0.0, -0.3])))
        chi.append((found.amplitude.value - true) / found.amplitude.sigma)
        assert found.residual_m == pytest.approx(0.001, rel=0.15)
    # 1.5: the standard deviation leaves out that closest points follow the noise.
    assert np.sqrt(np.mean(np.square(chi))) < 2.0
    assert abs(np.mean(chi)) < 1.5


def test_as_predicted_goes_on_and_too_soft_stops(shape):
    rng = np.random.default_rng(1)
    good = match_shape(shape, cloud(shape.points_m, rng))
    assert not good.stop
    assert good.reason == ""
    soft = match_shape(shape, cloud(shape.vertices_m + 3 * shape.displacement_m, rng))
    assert soft.stop
    assert "limit 5 mm" in soft.reason
    stiff = match_shape(shape, cloud(shape.vertices_m, rng))
    assert stiff.stop
    assert "stiffer than predicted" in stiff.reason


def test_a_wall_that_folds_is_seen_before_the_full_force():
    """Truth from the nonlinear shell: at 10 N the middle of the cup is far softer than its map says."""
    said = confirm_grasp(THING, vertex(0.05), 10.0)
    rng = np.random.default_rng(2)
    found = match_shape(predicted_shape(THING, vertex(0.05), 10.0), cloud(said.shape_m, rng))
    assert found.stop
    assert found.amplitude.value > 1.3


def test_fingers_and_table_are_not_the_object(shape):
    rng = np.random.default_rng(3)
    table = np.column_stack([rng.uniform(-0.2, 0.2, (500, 2)), np.full(500, -0.03)])
    holes = np.full((50, 3), np.nan)
    seen = np.concatenate([cloud(shape.points_m, rng), table, holes])
    found = match_shape(shape, seen)
    assert not found.stop
    assert not found.used[-550:].any()
    assert found.amplitude.value == pytest.approx(1, abs=4 * found.amplitude.sigma)


def test_another_object_has_another_shape(shape):
    rng = np.random.default_rng(4)
    other = cloud(shape.vertices_m * [1.15, 0.8, 1.0], rng)
    found = match_shape(shape, other)
    assert found.stop


def test_few_points_are_refused(shape):
    with pytest.raises(InputError, match="found 5 finite points, expected at least 30"):
        match_shape(shape, np.zeros((5, 3)))
    with pytest.raises(InputError, match="0 points are within"):
        match_shape(shape, np.full((100, 3), 1.0))
    with pytest.raises(InputError, match="force_N: found -1"):
        predicted_shape(THING, vertex(0.05), -1.0)
    with pytest.raises(InputError, match=r"expected numbers \(n, 3\)"):
        match_shape(shape, np.zeros((50, 2)))


def test_gas_takes_part_in_the_prediction():
    from visuohaptic.deformation.nonlinear import Contents

    container = load_object("elliptic", around=32)
    points = container.mesh.vertices_m
    flat = int(np.argmin(np.abs(points[:, 2] - 0.06) - points[:, 1]))
    free, shut = (predicted_shape(container, flat, 5.0, what) for what in (None, Contents(fill=0.9)))
    assert shut.deformation_m < free.deformation_m

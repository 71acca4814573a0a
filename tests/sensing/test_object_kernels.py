"""The compiled fit of a body's motion against the same steps in NumPy, and against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.sensing.scene._object_kernels import fit_motion
from visuohaptic.tracking.pose import lens_numbers

CAMERA = Camera(
    800, 450, np.array([[700.0, 0, 399.5], [0, 710.0, 224.5], [0, 0, 1]]), np.array([-0.1, 0.02, 1e-3, 0, 0])
)
VIEW = Pose.from_rotation_vector([1.9, -0.1, 0.1], [0.02, 0.05, 0.4])
PIVOT = np.array([0.03, 0.01, 0.0])
ALL, STANDING = np.ones(6, bool), np.array([False, False, True, True, True, False])


def seen(motion: Pose, body: np.ndarray) -> np.ndarray:
    placed = (body - PIVOT) @ motion.rotation.T + PIVOT + motion.translation_m
    return CAMERA.project(VIEW.apply(placed))


def twin(body, pixels, sigma, active, start):
    """Gauss-Newton with Tukey's weights, derivatives by central differences."""
    motion = start

    def residual(change: np.ndarray) -> np.ndarray:
        step = np.zeros(6)
        step[active] = change
        turned = Rotation.from_rotvec(step[:3]).as_matrix() @ motion.rotation
        return (seen(Pose(turned, motion.translation_m + step[3:]), body) - pixels) / sigma[:, None]

    none, scale = np.zeros(np.count_nonzero(active)), 1.0
    for iteration in range(8):
        here = residual(none)
        distance = np.linalg.norm(here, axis=1)
        if iteration < 5:
            scale = max(1.0, float(np.median(distance)) / 1.177)
        weight = np.clip(1 - (distance / (4.0 * scale)) ** 2, 0, None) ** 2
        jacobian = np.stack(
            [(residual(h) - residual(-h)) / 2e-6 for h in 1e-6 * np.eye(len(none))], axis=-1
        ).reshape(-1, len(none))
        both = np.repeat(weight, 2)[:, None]
        information = jacobian.T @ (both * jacobian)
        # Exactly the kernel's damping.
        information += 1e-9 * np.trace(information) * np.eye(len(none))
        step = np.zeros(6)
        step[active] = -np.linalg.solve(information, (both * jacobian).T @ here.ravel())
        motion = Pose(
            Rotation.from_rotvec(step[:3]).as_matrix() @ motion.rotation, motion.translation_m + step[3:]
        )
        if np.abs(step).max() < 2e-6:
            break
    inner = np.repeat(distance < 4.0 * min(scale, 2.0), 2)
    return motion, distance, min(scale, 2.0), jacobian[inner].T @ jacobian[inner]


def kernel(body, pixels, sigma, active, start):
    rotation, shift = start.rotation.copy(), start.translation_m.copy()
    distance, kept = np.zeros(len(body)), np.zeros((6, 6))
    scale = fit_motion(
        body, pixels, sigma, PIVOT, VIEW.rotation, VIEW.translation_m, lens_numbers(CAMERA), 4.0, 4, active,
        rotation, shift, distance, kept,
    )  # fmt: skip
    return rotation, shift, distance, scale, kept


def case(rng: np.random.Generator, active: np.ndarray):
    body = rng.uniform([0.03, -0.06, 0.0], [0.05, 0.08, 0.1], (60, 3))
    size = np.where(active, [0.05, 0.05, 0.1, 0.01, 0.01, 0.01], 0.0)
    true = rng.normal(0, size)
    motion = Pose.from_rotation_vector(true[:3], true[3:])
    sigma = rng.uniform(0.2, 0.4, 60)
    pixels = seen(motion, body) + sigma[:, None] * rng.standard_normal((60, 2))
    pixels[:9] += rng.normal(0, 15, (9, 2))
    return body, pixels, sigma, motion


@pytest.mark.parametrize("active", [ALL, STANDING], ids=["free", "standing"])
def test_the_kernel_equals_its_twin(active):
    rng = np.random.default_rng(11)
    for _ in range(4):
        body, pixels, sigma, true = case(rng, active)
        start = Pose.identity()
        rotation, shift, distance, scale, kept = kernel(body, pixels, sigma, active, start)
        motion, expected, expected_scale, information = twin(body, pixels, sigma, active, start)
        # Differences of the numerical derivatives (1e-7) move the last step by far less than its 2e-6.
        np.testing.assert_allclose(rotation, motion.rotation, atol=2e-6)
        np.testing.assert_allclose(shift, motion.translation_m, atol=2e-6)
        np.testing.assert_allclose(distance, expected, atol=2e-2)
        assert scale == pytest.approx(expected_scale, rel=1e-2)
        np.testing.assert_allclose(
            kept[np.ix_(active, active)], information, rtol=1e-3, atol=1e-3 * kept.max()
        )
        # 51 good points of 0.3 px at 0.4 m and f = 700 px: well within a millimetre, or half a degree.
        assert np.abs(shift - true.translation_m).max() < 2e-3
        assert Rotation.from_matrix(rotation @ true.rotation.T).magnitude() < 0.02


def test_without_outliers_it_is_the_least_squares_of_scipy():
    rng = np.random.default_rng(12)
    body, _, sigma, true = case(rng, ALL)
    pixels = seen(true, body) + 1e-3 * rng.standard_normal((60, 2))

    def residual(x: np.ndarray) -> np.ndarray:
        return ((seen(Pose.from_rotation_vector(x[:3], x[3:]), body) - pixels) / sigma[:, None]).ravel()

    best = least_squares(residual, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    rotation, shift, *_ = kernel(body, pixels, sigma, ALL, Pose.identity())
    # Residuals of 0.003 sigma weigh 1 - 1e-6: nothing is left of Tukey.
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(best[:3]).as_matrix(), atol=3e-6)
    np.testing.assert_allclose(shift, best[3:], atol=3e-6)


def test_no_fit_is_no_number():
    body = np.random.default_rng(1).uniform(0, 0.1, (20, 3))
    pixels = seen(Pose.identity(), body)
    behind = Pose(np.eye(3), np.array([0.0, 0, 0]) - VIEW.rotation.T @ np.array([0.0, 0, 5.0]))
    assert np.isnan(kernel(body, pixels, np.full(20, 0.3), ALL, behind)[3])
    assert np.isnan(kernel(body[:3], pixels[:3], np.full(3, 0.3), ALL, Pose.identity())[3])

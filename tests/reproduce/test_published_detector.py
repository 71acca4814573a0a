"""The detector as published (Alt 2016, 5.2): its code against plain NumPy, laws of the scores."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.reconstruction.plane_views import CAMERA, looking_down, plane_frame

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.reconstruction.fusion import SENSOR_NOISE, SpaceGrid
from visuohaptic.reproduce.worlds import (
    HELLINGER_WEIGHT,
    BackgroundModel,
    LocalViews,
    PublishedDetector,
    background_model,
    error_image,
)
from visuohaptic.reproduce.worlds._published_kernels import cast_rays
from visuohaptic.reproduce.worlds.published_detector import view_moments


def test_moments_and_reliability_equal_the_printed_formulas():
    rng = np.random.default_rng(1)
    spread = rng.uniform(0, 0.06, (48, 64))
    warped = (1 + spread * rng.standard_normal((8, 48, 64))).astype(np.float32)
    warped[rng.random(warped.shape) < 0.4] = np.inf
    noise = SENSOR_NOISE["kinect"]
    mean, sigma, score = view_moments(warped, noise, 3)
    values = np.where(np.isfinite(warped), warped, np.nan).astype(np.float64)
    enough = np.isfinite(warped).sum(axis=0) >= 3
    assert (score[~enough] == 0).all()
    values = values[:, enough]
    expected = np.nanmean(values, axis=0)
    np.testing.assert_allclose(mean[enough], expected, atol=1e-6)
    sigma_s = noise.sigma_m(expected)
    prime = np.maximum(np.nanstd(values, axis=0, ddof=1), sigma_s)
    np.testing.assert_allclose(sigma[enough], prime, rtol=1e-3)
    hellinger = 1 - np.sqrt(2 * sigma_s * prime / (sigma_s**2 + prime**2))
    np.testing.assert_allclose(score[enough], np.maximum(0, 1 - HELLINGER_WEIGHT * hellinger), atol=2e-3)
    assert 1 - HELLINGER_WEIGHT * (1 - math.sqrt(8 / 17)) == pytest.approx(0, abs=1e-12)


@settings(deadline=None)  # the first example loads SciPy
@given(st.floats(0.0, 6.0))
def test_error_score_rises_with_contradiction(sigmas):
    """erf mapped from [0.9, 1] to [0, 1]: nothing below 1.645 sigma."""
    shape = (CAMERA.height, CAMERA.width)
    ones = np.ones(shape, np.float32)
    model = BackgroundModel(ones, 0.01 * ones, ones, 8)
    depth_m = ((1 + 0.01 * sigmas) * ones).astype(np.float32)
    pose = Pose.identity()
    score = error_image(model, depth_m, CAMERA, pose, [pose] * 3)[20, 30]
    assert score == pytest.approx(max(0.0, (math.erf(sigmas / math.sqrt(2)) - 0.9) / 0.1), abs=2e-3)


def test_points_outside_the_models_view_are_no_error():
    shape = (CAMERA.height, CAMERA.width)
    ones = np.ones(shape, np.float32)
    model = BackgroundModel(ones, 0.01 * ones, ones, 8)
    away = Camera.pose_of_view((0, 0, -5), (0, 0, -10), (0, 1, 0))
    score = error_image(model, 1.5 * ones, CAMERA, Pose.identity(), [away] * 3)
    assert not score.any()


def test_rays_mark_what_dense_sampling_marks():
    rng = np.random.default_rng(2)
    volume = np.zeros((20, 16, 12), np.float32)
    origin, ends = np.array([-0.3, 0.1, 0.2]), rng.uniform(0, [1.0, 0.8, 0.6], (30, 3))
    low = np.zeros(3)
    cast_rays(origin, ends, np.ones(30, np.float32), low, 0.05, 3, volume)
    plain = np.zeros_like(volume)
    for end in ends:
        along = np.linspace(0, 1, 20001)[:, None]
        cells = np.floor((origin + along * (end - origin)) / 0.05).astype(int)
        cells = np.unique(cells[((cells >= 0) & (cells < volume.shape)).all(axis=1)], axis=0)
        plain[tuple(cells.T)] += 1
    # Corners cut by less than the sampling differ: at most a few of several hundred.
    assert np.count_nonzero(volume != plain) <= 0.01 * plain.sum()


def test_a_consistent_scene_has_no_errors():
    rng = np.random.default_rng(3)
    detector = PublishedDetector(SpaceGrid.around((-0.3, -0.3, 0), (0.3, 0.3, 0.3), 0.02))
    for i in range(30):
        score = detector.add(plane_frame(looking_down(0.02 * i), rng, 0.002))
        assert score is None or not score.any()
    assert detector.used > 10
    assert detector.regions() == ()


def test_jumps_of_the_pose_start_the_model_anew():
    detector = PublishedDetector(SpaceGrid.around((-0.3, -0.3, 0), (0.3, 0.3, 0.3), 0.02))
    for i in range(25):
        detector.add(plane_frame(looking_down(0.02 * i + (0.5 if i >= 20 else 0))))
    assert detector.skipped["pose jumps"] == 1
    assert detector.add(plane_frame(looking_down(1.02))) is None


def test_views_of_a_model_keep_the_gap():
    views = LocalViews()
    for i in range(60):
        views.add(plane_frame(looking_down(0.01 * i)))
    x = [view.T_world_camera.translation_m[0] for view in views.of_model()]
    assert len(x) == 8
    behind = 0.59 - np.array(x)
    assert behind.min() == pytest.approx(0.16, abs=0.006)
    assert behind.max() == pytest.approx(0.36, abs=0.006)


def test_a_model_needs_views():
    with pytest.raises(InputError, match="found no views"):
        background_model([], Pose.identity())

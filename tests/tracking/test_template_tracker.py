"""Templates in rendered sequences with known poses: accuracy, covariance, loss and return."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from visuohaptic.core import InputError, Reason
from visuohaptic.core.camera import Camera, Frame, Pose
from visuohaptic.tracking.points import apply_homography, estimate_homography
from visuohaptic.tracking.pose import estimate_plane_poses
from visuohaptic.tracking.templates import Template, TemplateTracker
from visuohaptic.tracking.templates.lens import lens_offset, lens_samples

CAMERA = Camera.simple(640, 480, 900.0)
LENS = Camera.simple(640, 480, 700.0, distortion=np.array([-0.25, 0.1, 0.001, -0.0005, 0.0]))


def tilted(vector_deg: object, translation_m: object) -> Pose:
    return Pose.from_rotation_vector(np.deg2rad(vector_deg), translation_m)


def render(view, template: Template, camera: Camera, pose: Pose, noise: float, rng: np.random.Generator):
    """What the camera sees of the template's plane, by casting a ray through every pixel."""
    y, x = np.mgrid[: camera.height, : camera.width].astype(float)
    rays = camera.rays(np.stack([x, y], -1))
    normal = pose.rotation[:, 2]
    depth = (pose.translation_m @ normal) / (rays @ normal)
    plane = (rays * depth[..., None] - pose.translation_m) @ pose.rotation
    rows, columns = template.image.shape
    u = plane[..., 0] / template.pixel_m + (columns - 1) / 2
    v = plane[..., 1] / template.pixel_m + (rows - 1) / 2
    image = view._sample(u, v)
    # Outside the template: a dull surface.
    outside = (u < -0.5) | (v < -0.5) | (u > columns - 0.5) | (v > rows - 0.5)
    image[outside] = 110.0
    return np.clip(np.round(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def scene(views):
    view = views.PlaneView.named("astronaut", 200)
    return view, Template.from_image("face", view.template, width_m=0.04)


def angle_deg(a: Pose, b: Pose) -> float:
    return float(np.rad2deg(Rotation.from_matrix(a.rotation.T @ b.rotation).magnitude()))


@pytest.mark.parametrize("camera", [CAMERA, LENS], ids=["pinhole", "lens"])
def test_pose_follows_a_moving_template(scene, camera: Camera) -> None:
    view, template = scene
    rng = np.random.default_rng(0)
    with TemplateTracker([template], camera, threaded=False) as tracker:
        for k in range(6):
            pose = tilted([25 - 2 * k, -20 + 3 * k, 5 * k], [-0.02 + 0.004 * k, 0.01, 0.20 + 0.005 * k])
            frame = Frame(render(view, template, camera, pose, 2.0, rng), 0.03 * k, k)
            (seen,) = tracker.update(frame)
            assert seen.valid, seen.detail
            assert not seen.ambiguous
            found = seen.T_camera_template
            sigma = np.sqrt(np.diag(seen.covariance))
            error = found.translation_m - pose.translation_m
            # Five declared sigmas, plus 1e-3 px of interpolation (0.3 um sideways, 10 um deep).
            assert (np.abs(error) < 5 * sigma[:3] + [5e-7, 5e-7, 1e-5]).all()
            assert angle_deg(found, pose) < 0.05


def test_declared_pose_covariance_is_the_scatter(scene) -> None:
    """Noise 5, 60 frames: mean Mahalanobis distance 6, so the ratio of sigmas is within 25 %."""
    view, template = scene
    rng = np.random.default_rng(1)
    pose = tilted([30, 10, 15], [0.01, -0.005, 0.22])
    clean = render(view, template, CAMERA, pose, 0.0, rng).astype(float)
    distances = []
    with TemplateTracker([template], CAMERA, threaded=False) as tracker:
        for k in range(60):
            noisy = np.clip(np.round(clean + rng.normal(0, 5, clean.shape)), 0, 255).astype(np.uint8)
            (seen,) = tracker.update(Frame(noisy, 0.03 * k, k))
            assert seen.valid
            found = seen.T_camera_template
            error = np.concatenate(
                [
                    found.translation_m - pose.translation_m,
                    Rotation.from_matrix(found.rotation @ pose.rotation.T).as_rotvec(),
                ]
            )
            distances.append(error @ np.linalg.solve(seen.covariance, error))
    # The mean of 60 chi^2 with 6 degrees of freedom scatters by 7 %, its root by 4 %.
    assert 0.8 < np.sqrt(np.mean(distances) / 6) < 1.25


def test_lost_template_is_found_again_and_said_to_be_lost(scene) -> None:
    view, template = scene
    rng = np.random.default_rng(2)
    pose = tilted([15, 5, 0], [0.0, 0.0, 0.2])
    other = tilted([10, -15, 30], [0.03, 0.01, 0.24])
    here = render(view, template, CAMERA, pose, 2, rng)
    there = render(view, template, CAMERA, other, 2, rng)
    empty = rng.integers(100, 120, here.shape, dtype=np.uint8)
    with TemplateTracker([template], CAMERA, threaded=False) as tracker:
        results = [
            tracker.update(Frame(image, 0.1 * k, k))[0]
            for k, image in enumerate([empty, here, empty, here, empty, empty, empty, empty, there])
        ]
    assert [result.valid for result in results] == [
        False,
        True,
        False,
        True,
        False,
        False,
        False,
        False,
        True,
    ]
    assert results[2].reason is Reason.LOST
    assert results[2].detail
    assert results[2].T_camera_template is None
    assert np.isnan(results[2].covariance).all()
    assert angle_deg(results[8].T_camera_template, other) < 0.05


def test_detection_in_its_own_thread_answers_in_a_later_frame(scene) -> None:
    view, template = scene
    rng = np.random.default_rng(3)
    image = render(view, template, CAMERA, tilted([15, 5, 0], [0.0, 0.0, 0.2]), 2, rng)
    tracker = TemplateTracker([template], CAMERA)
    try:
        (first,) = tracker.update(Frame(image, 0.0, 0))
        assert not first.valid  # the frame did not wait
        for k in range(1, 200):
            time.sleep(0.02)
            (seen,) = tracker.update(Frame(image, 0.1 * k, k))
            if seen.valid:
                break
        assert seen.valid
        assert not tracker._search.busy  # nothing is detected while nothing is lost
        (old,) = tracker.update(Frame(image, 0.0, 0))
        assert old.reason is Reason.STALE
    finally:
        tracker.close()
        tracker.close()


def test_tag_is_found_by_code_and_refined_on_all_pixels(views) -> None:
    tag = Template.from_tag(42, size_m=0.04)
    view = views.PlaneView(tag.image.astype(float), 0, (0, 0))
    rng = np.random.default_rng(4)
    pose = tilted([35, -10, 100], [0.02, 0.01, 0.25])
    image = render(view, tag, CAMERA, pose, 3, rng)
    with TemplateTracker([tag], CAMERA, threaded=False) as tracker:
        (seen,) = tracker.update(Frame(image, 0.0, 0))
    assert seen.valid, seen.detail
    sigma = np.sqrt(np.diag(seen.covariance))
    error = np.abs(seen.T_camera_template.translation_m - pose.translation_m)
    assert (error < 5 * sigma[:3] + [2e-6, 2e-6, 3e-5]).all()
    assert angle_deg(seen.T_camera_template, pose) < 0.1


def test_nearly_flat_far_view_is_called_ambiguous_and_covers_the_truth() -> None:
    """Small, far, noisy: both tilts fit. The covariance must span them."""
    camera = Camera.simple(640, 480, 700.0)
    points = 0.02 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    pose = tilted([8, 0, 0], [0.0, 0.0, 1.5])
    corners = camera.project(pose.apply(points))
    poses = estimate_plane_poses(camera, points, corners, np.eye(8) * 0.05**2)
    assert len(poses) == 2
    assert angle_deg(poses[0].T_camera_template, pose) < 0.01
    assert poses[1].chi2 < 10  # cannot be told apart by one frame
    assert angle_deg(poses[1].T_camera_template, tilted([-8, 0, 0], [0, 0, 1.5])) < 3


def test_flip_is_resolved_over_time(scene) -> None:
    """Evidence of many frames decides, although each alone could be wrong."""
    view, template = scene
    camera = Camera.simple(640, 480, 2500.0)
    rng = np.random.default_rng(5)
    pose = tilted([12, 6, 0], [0.0, 0.0, 1.4])  # 70 px wide, hardly any perspective
    clean = render(view, template, camera, pose, 0.0, rng).astype(float)
    last = None
    with TemplateTracker([template], camera, threaded=False) as tracker:
        for k in range(40):
            noisy = np.clip(np.round(clean + rng.normal(0, 6, clean.shape)), 0, 255).astype(np.uint8)
            (seen,) = tracker.update(Frame(noisy, 0.03 * k, k))
            if seen.valid:
                last = seen
    assert last is not None
    error = angle_deg(last.T_camera_template, pose)
    sigma = np.rad2deg(np.sqrt(np.trace(last.covariance[3:, 3:])))
    assert error < 3 * sigma + 0.5
    if not last.ambiguous:
        assert error < 5.0


def test_tilt_through_straight_on_keeps_its_direction(scene) -> None:
    """From +24 to -24 degrees: both tilts meet in the middle, and the evidence starts anew there."""
    view, template = scene
    rng = np.random.default_rng(6)
    with TemplateTracker([template], CAMERA, threaded=False) as tracker:
        for k, tilt_deg in enumerate(np.linspace(24, -24, 17)):
            pose = tilted([tilt_deg, 0, 0], [0.005, -0.004, 0.2])
            (seen,) = tracker.update(Frame(render(view, template, CAMERA, pose, 3, rng), 0.03 * k, k))
            assert seen.valid
            sigma = np.rad2deg(np.sqrt(np.trace(seen.covariance[3:, 3:])))
            assert angle_deg(seen.T_camera_template, pose) < 5 * sigma + 0.02


def test_bad_use_is_refused(scene) -> None:
    _, template = scene
    with pytest.raises(InputError, match="all different"):
        TemplateTracker([template, template], CAMERA)
    with (
        TemplateTracker([template], CAMERA, threaded=False) as tracker,
        pytest.raises(InputError, match="320 x 240 px, expected 640 x 480"),
    ):
        tracker.update(Frame(np.zeros((240, 320), np.uint8), 0.0, 0))


def test_the_lens_displacement_is_exact_up_to_the_border() -> None:
    """Between 17 x 17 samples; with samples repeated beyond the border it was up to .02 px off there."""
    tag, pose = Template.from_tag(3, size_m=0.06), tilted([20.0, -25.0, 40.0], [0.05, -0.04, 0.25])
    found = lens_offset(lens_samples(LENS, tag, pose), tag)
    rows, columns = tag.image.shape
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(float)
    seen = LENS.project(pose.apply(tag.points_m(pixels)))
    corners = LENS.project(pose.apply(tag.points_m(tag.esm.corners)))
    flat = apply_homography(estimate_homography(tag.esm.corners, corners), pixels)
    assert np.abs(seen - flat).max() > 0.3
    # A thousandth of a pixel is a fifth of the best standard deviation of a corner.
    assert np.abs(found.transpose(1, 2, 0) - (seen - flat)).max() < 1e-3

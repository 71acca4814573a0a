"""The band of signed distances: noise of poses, thin objects, and grazing incidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visuohaptic.core.camera import Camera
from visuohaptic.io.depth import DepthFrame
from visuohaptic.reconstruction import pipeline
from visuohaptic.reconstruction.fusion import SENSOR_NOISE, SpaceGrid, TsdfVolume
from visuohaptic.reconstruction.transparency import TrackedNoise, view_graph
from visuohaptic.reconstruction.transparency.evidence import MIN_ANGLE_RAD
from visuohaptic.simulation.tabletop import disturb_pose

from .scenes import view

CAMERA = Camera.simple(160, 120, 130.0)
MIDDLE_M = np.array([0.5, 0.5, 0.0])
GRID = SpaceGrid.around((0.3, 0.3, -0.05), (0.7, 0.7, 0.25), 0.005)
#: Spheres of 3 to 6 cm on the plate z = 0, and half sizes of boxes that stand on it.
BALLS = (((0.5, 0.5, 0.03), 0.03), ((0.42, 0.56, 0.02), 0.02), ((0.58, 0.42, 0.015), 0.015))
PLATE_M, THIN_PLATE_M = np.array([0.1, 0.01, 0.1]), np.array([0.1, 0.005, 0.1])


def views(camera: Camera, up_deg: float, count: int, spheres=(), half_m=None) -> list[DepthFrame]:
    """Exact views from a circle of 0.8 m around the middle, of spheres or of a box."""
    up, angles = np.radians(up_deg), 2 * np.pi * np.arange(count) / count
    level = np.column_stack([np.cos(angles), np.sin(angles), np.full(count, np.tan(up))])
    poses = [Camera.pose_of_view(tuple(eye), tuple(MIDDLE_M)) for eye in MIDDLE_M + 0.8 * np.cos(up) * level]
    frames = [replace(view(camera, pose, spheres), color=None) for pose in poses]
    if half_m is None:
        return frames
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    for k, frame in enumerate(frames):
        rays, eye = camera.rays(np.stack([u, v], axis=-1)) @ poses[k].rotation.T, poses[k].translation_m
        ends = [(MIDDLE_M + [0, 0, half_m[2]] + side * half_m - eye) / rays for side in (-1, 1)]
        first, last = np.minimum(*ends).max(axis=-1), np.maximum(*ends).min(axis=-1)
        depth_m = np.fmin(frame.depth_m, np.where(first < last, first, np.nan))
        frames[k] = replace(frame, depth_m=depth_m.astype(np.float32))
    return frames


def noisy(frames, seed: int) -> list[DepthFrame]:
    """With the depth noise of a Kinect, and poses off by 2 mm and 0.3 degrees."""
    rng, device = np.random.default_rng(seed), replace(SENSOR_NOISE["kinect"], tracking_m=0.0)
    poses = [disturb_pose(frame.T_world_camera, rng, 0.002, np.radians(0.3)) for frame in frames]
    noise = [device.sigma_m(f.depth_m) * rng.normal(size=f.depth_m.shape) for f in frames]
    return [
        replace(f, depth_m=(f.depth_m + e).astype(np.float32), T_world_camera=pose)
        for f, e, pose in zip(frames, noise, poses, strict=True)
    ]


def fused(frames, band_m: float):
    """Centres of the triangles within 15 cm of the middle, and their areas."""
    volume = TsdfVolume.around(GRID.low_m, GRID.high_m, GRID.voxel_m, truncation_m=band_m, color=False)
    volume.integrate_all(frames)
    mesh = volume.mesh(min_weight=0.0)
    centres = mesh.vertices_m[mesh.faces].mean(axis=1)
    near = (np.abs(centres - MIDDLE_M)[:, :2] < 0.15).all(axis=1)
    return centres[near], mesh.face_areas_m2[near]


def outside_m(points, spheres=(), half_m=None):
    """Signed distance of points from the nearest object or the plate."""
    gaps = [points[:, 2], *(np.linalg.norm(points - c, axis=1) - r for c, r in spheres)]
    if half_m is not None:
        beyond = np.abs(points - MIDDLE_M - [0, 0, half_m[2]]) - half_m
        gaps.append(np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0))
    return np.take_along_axis(np.array(gaps), np.abs(gaps).argmin(axis=0)[None], axis=0)[0]


def measured(frames) -> TrackedNoise:
    """Noise of camera and poses, as the detector measures it."""
    graph, apart_rad = view_graph(frames), MIN_ANGLE_RAD
    near = [graph.neighbours(i, 1, apart_rad) for i in range(len(frames))]
    return TrackedNoise.measured(frames, near, SENSOR_NOISE["kinect"])


def test_a_band_of_three_sigma_has_the_least_error():
    """With a fifth less, wrong poses make second surfaces; with a fifth more, a plate becomes thicker."""
    error_m2 = np.zeros(3)
    for seed in range(6):
        frames = noisy(views(CAMERA, 35.0, 24, half_m=PLATE_M), seed)
        band_m = pipeline._band_m(GRID, frames, measured(frames))
        for k, factor in enumerate((0.8, 1.0, 1.2)):
            points, areas = fused(frames, factor * band_m)
            error_m2[k] += np.average(outside_m(points, half_m=PLATE_M) ** 2, weights=areas)
    assert error_m2.argmin() == 1


def test_wrong_poses_that_are_not_refined_leave_one_table():
    for spheres, seed in ((BALLS, 1), ((), 2)):
        frames = noisy(views(CAMERA, 25.0, 24, spheres), seed)
        band_m = pipeline._band_m(GRID, frames, measured(frames))
        # The error of these poses along a ray: 2 mm, and 0.3 degrees of 0.8 m times the tangent of 65 degrees, 9 mm.
        assert 3 * 0.004 < band_m < 3 * 0.012
        points, areas = fused(frames, band_m)
        below = points[:, 2] < -0.01
        assert areas[below].sum() < 0.01 * areas.sum()


def test_a_band_of_two_voxels_keeps_a_thin_plate_thin_and_an_oblique_plane_exact():
    """A fifth more thickens the plate by 1.2 mm on each side; with a fifth less, ends of the edges of the grid are clipped."""
    exact = replace(TrackedNoise(SENSOR_NOISE["kinect"]), depth_sigma_m=0.001)
    frames = views(CAMERA, 25.0, 24, half_m=THIN_PLATE_M)
    band_m = pipeline._band_m(GRID, frames, exact)
    points, areas = fused(frames, band_m)
    plate = points[:, 2] > 0.03
    assert np.average(outside_m(points, half_m=THIN_PLATE_M)[plate], weights=areas[plate]) < 0.0007
    points, _ = fused(views(Camera.simple(640, 480, 2000.0), 30.0, 1), band_m)
    # The rest is that of the nearest pixel: 0.4 mm x tan 60 deg / sqrt(12) / 2 weights.
    assert np.sqrt(np.mean(points[:, 2] ** 2)) < 8e-5


def test_a_table_at_grazing_incidence_has_no_holes():
    """One view at incidences of up to 75 degrees (tangent 3.7); with a band of two voxels alone it has half of the area."""
    points, areas = fused(views(Camera.simple(640, 480, 520.0), 18.0, 1), 2 * GRID.voxel_m)
    assert areas.sum() == pytest.approx(0.3**2, rel=0.02)
    assert np.abs(points[:, 2]).max() < 0.5 * GRID.voxel_m


def test_a_single_view_has_the_noise_of_its_camera():
    frames = views(CAMERA, 35.0, 1)
    noise = measured(frames)
    assert np.isnan(noise.depth_sigma_m)
    assert pipeline._band_m(GRID, frames, noise) == max(3 * noise.sigma_m(np.array(0.8)), 2 * GRID.voxel_m)


def test_what_a_surface_hides_ends_without_a_surface():
    """A step from behind the band to free space that other views saw, and one that an oblique surface has between two voxels."""
    for value, other, seen in ((-1.5, 1.0, False), (-1.3, 0.9, True)):
        distance, weight = np.full((8, 8, 8), value), np.full((8, 8, 8), 1e-5)
        distance[:, :, 4:], weight[:, :, 4:] = other, 5.0
        distance[:, :2, 6:] = -0.5  # another surface, in the band
        volume = TsdfVolume(0.006, truncation_m=0.012, color=False)
        volume._places = np.zeros((1, 3), dtype=np.int64)
        # Stored cube by cube.
        volume._distance, volume._weight = (
            part.reshape(2, 4, 2, 4, 2, 4).transpose(0, 2, 4, 1, 3, 5).reshape(1, 8, 64).astype(np.float32)
            for part in (distance, weight)
        )
        places = volume.mesh(min_weight=0.0).vertices_m
        assert ((places[:, 1] > 0.02) & (places[:, 2] < 0.025)).any() == seen


@pytest.mark.parametrize("factor", [1.0, 2.0, 8.0])
def test_the_noise_of_an_unknown_camera_is_measured(factor):
    """A camera with once, twice and eight times the noise of a Kinect, with exact poses; views are steep, so that pixels do not matter."""
    rng, device = np.random.default_rng(5), replace(SENSOR_NOISE["kinect"], tracking_m=0.0)
    frames = [
        replace(
            f,
            depth_m=(
                f.depth_m + factor * device.sigma_m(f.depth_m) * rng.normal(size=f.depth_m.shape)
            ).astype(np.float32),
        )
        for f in views(CAMERA, 75.0, 8, BALLS)
    ]
    found = pipeline.measured_noise(frames)
    assert found.quadratic_per_m == pytest.approx(factor * device.quadratic_per_m, rel=0.2)
    assert found.edge_rad == SENSOR_NOISE["realsense_d435"].edge_rad


def test_views_without_a_common_surface_have_the_noise_of_a_kinect(caplog):
    assert pipeline.measured_noise(views(CAMERA, 35.0, 1), "odd") == SENSOR_NOISE["kinect"]
    assert "'odd' cannot be measured" in caplog.text

"""Rays against Snell's law and analytic scenes; the camera against what a flat world must show."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.simulation.tabletop import (
    GLASS,
    SCENE_KINDS,
    Box,
    DepthCamera,
    DepthCameraOptics,
    RefractingScene,
    Revolution,
    disturb_pose,
    glass_scene,
)
from visuohaptic.simulation.tabletop._refraction_kernels import trace_rays

WALL = Box((0, 0, 2.05), (6, 6, 0.1))


def trace(scene: RefractingScene, slopes_x, slopes_y):
    return trace_rays(
        np.zeros(3),
        np.eye(3),
        np.asarray(slopes_x, float),
        np.asarray(slopes_y, float),
        scene.solid_rows,
        scene.segment_rows,
        scene.box_rows,
    )


def test_a_plate_shifts_rays_as_snell_says():
    """Behind a plane plate of thickness t the ray is parallel, moved by t (tan a - tan b) across."""
    thickness = 0.1
    plate = Box((0, 0, 1.0), (4, 4, thickness), "glass", index=GLASS)
    slopes = np.linspace(-0.6, 0.6, 13)
    hit, found = trace(RefractingScene((), (WALL, plate)), slopes, [0.0])
    inside = np.tan(np.arcsin(np.sin(np.arctan(slopes)) / GLASS))
    assert hit.all()
    np.testing.assert_allclose(found[0, :, 0], slopes * (2.0 - thickness) + thickness * inside, atol=1e-12)
    np.testing.assert_allclose(found[0, 6, 3], (1 - ((GLASS - 1) / (GLASS + 1)) ** 2) ** 2, rtol=1e-12)


def test_a_solid_cylinder_bends_rays_as_two_refractions_do():
    """In the plane across the axis each refraction follows from the angle to the radius alone."""
    radius, distance = 0.05, 1.0
    rod = Revolution((0, distance, -1), np.array([[radius, 0], [radius, 2.0]]))
    wall = Box((0, 3.05, 0), (6, 0.1, 6))
    pose = Pose(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.zeros(3))  # looks along +y
    slopes = np.linspace(-0.03, 0.03, 7)
    scene = RefractingScene((rod,), (wall,))
    hit, found = trace_rays(
        np.zeros(3),
        pose.rotation,
        slopes,
        np.zeros(1),
        scene.solid_rows,
        scene.segment_rows,
        scene.box_rows,
    )
    assert hit.all()
    for slope, point in zip(slopes, found[0], strict=True):
        angle = math.atan(slope)
        lever = distance * math.sin(angle)  # distance of the ray from the axis
        outside, inside = math.asin(lever / radius), math.asin(lever / radius / GLASS)
        turn = 2 * (outside - inside)  # towards the axis
        out_angle = angle - turn
        # The lever of the leaving ray about the axis is the same, by symmetry.
        x = (lever + (3.0 - distance) * math.sin(out_angle)) / math.cos(out_angle)
        assert point[0] == pytest.approx(x, abs=1e-9)


def test_walls_of_no_contrast_do_nothing():
    """A hollow bottle of index 1 filled with air leaves every ray straight."""
    profile = np.array([[0.04, 0], [0.05, 0.1], [0.02, 0.2]])
    for more in ({}, {"fill": 0.5, "fill_index": 1.0}, {"squash": 0.7, "yaw_rad": 0.4}):
        bottle = Revolution((0.01, 0.02, 0.8), profile, index=1.0, wall_m=0.003, **more)
        slopes = np.linspace(-0.05, 0.05, 9)
        _, found = trace(RefractingScene((bottle,), (WALL,)), slopes, slopes)
        np.testing.assert_allclose(found[..., 0], np.broadcast_to(2 * slopes, (9, 9)), atol=1e-9)
        assert found[..., 6].max() >= 2, "the rays pass interfaces"


def test_mirror_reflects():
    # 1 m to the mirror, 2 m back: 3 m at slope 0.1.
    mirror = Box((0, 0, 1.05), (1, 1, 0.1), "mirror")
    behind = Box((0, 0, -1.05), (4, 4, 0.1))
    hit, found = trace(RefractingScene((), (mirror, behind)), [0.1], [0.0])
    assert hit.all()
    np.testing.assert_allclose(found[0, 0, :3], [0.3, 0, -1.0], atol=1e-12)


def test_a_wall_is_read_at_its_depth_with_the_declared_noise():
    sensor = DepthCamera.kinect(160)
    scene = RefractingScene((), (WALL,))
    exact = sensor.render(scene, Pose.identity())
    assert np.nanmax(np.abs(exact - 2.0)) < 1e-6
    assert np.isfinite(exact[5:-5, 5:-5]).all()
    noisy = sensor.render(scene, Pose.identity(), np.random.default_rng(1))
    per_px = 2.0**2 / (sensor.camera.focal_px * sensor.optics.baseline_m)
    declared = per_px * math.hypot(sensor.optics.noise_px, sensor.optics.step_px / math.sqrt(12))
    assert np.nanstd(noisy) == pytest.approx(declared, rel=0.15)  # 17000 pixels, neighbours correlated


def test_the_projectors_shadow_lies_where_geometry_puts_it():
    """A projector on the right (+x) leaves its shadow on the left of an object, as wide as the disparity step."""
    sensor = DepthCamera(Camera.simple(320, 40, 300.0), DepthCameraOptics(window_px=3, window_fraction=0.5))
    box = Box((0, 0, 1.0), (0.2, 4, 0.02))
    row = sensor.render(RefractingScene((), (WALL, box)), Pose.identity())[20]
    left = 159.5 - 300 * 0.1 / 0.99
    shadow = 300 * 0.075 * (1 / 0.99 - 1 / 2.0)
    holes = np.flatnonzero(np.isnan(row[5:315])) + 5
    assert abs(holes.min() - (left - shadow)) <= 2
    assert abs(holes.max() - left) <= 2
    assert np.isfinite(row[200:310]).all()


def test_glass_of_every_kind_is_missed_as_real_cameras_miss_it():
    """ClearGrasp's D435 pairs have 29-77 % invalid pixels on unfilled glass, 11-23 % on painted twins."""
    sensor = DepthCamera.kinect(320)
    fractions, twins = [], []
    for seed, kind in enumerate(SCENE_KINDS[:3]):
        scene = glass_scene(seed, kind=kind)
        pose = scene.poses[10]
        _, found = trace_rays(
            pose.translation_m,
            np.ascontiguousarray(pose.rotation),
            (np.arange(320) - 159.5) / 290,
            (np.arange(240) - 119.5) / 290,
            scene.scene.solid_rows,
            scene.scene.segment_rows,
            scene.scene.box_rows,
        )
        glass = found[..., 7] > 0
        fractions.append(np.isnan(sensor.render(scene.scene, pose, np.random.default_rng(0)))[glass].mean())
        twin = sensor.render(scene.scene.opaque_twin(), pose, np.random.default_rng(0))
        twins.append(np.isnan(twin)[glass].mean())
    assert all(0.25 < fraction < 0.8 for fraction in fractions), fractions
    assert max(twins) < 0.23


def test_scenes_follow_from_their_seed():
    a, b = glass_scene(7), glass_scene(7)
    assert a.kind == b.kind == "filled"
    np.testing.assert_array_equal(a.scene.segment_rows, b.scene.segment_rows)
    assert len(a.scene.solids) + len(a.scene.boxes) - 6 == 6
    inside = a.glass[0].foot_m + np.array([0, 0, 0.05])
    assert a.truth(inside)
    assert not a.truth(np.array([0.0, 0.0, 5.0]))
    pose = disturb_pose(a.poses[0], np.random.default_rng(0), 0.0, 0.0)
    assert pose is a.poses[0]

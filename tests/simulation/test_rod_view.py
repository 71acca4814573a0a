"""The rendered rod: pixel positions follow the camera model, occlusion is correct."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.simulation.beam import (
    Print,
    RodRenderer,
    RodRig,
    collage,
    hand_held,
    print_of_image,
    print_of_tag,
)
from visuohaptic.simulation.rendering import CameraEffects

SIZE = (400, 224)


def dots(level: float) -> dict[str, Print]:
    """Prints of 2 mm: their centroid is the projection of their centre."""
    return {name: Print(np.full((8, 8), level, np.float32), 0.002) for name in ("reference", "middle", "tip")}


@pytest.mark.parametrize("distortion", [np.zeros(5), np.array([-0.2, 0.1, 1e-3, -1e-3, 0.0])])
def test_prints_are_where_the_camera_projects_them(distortion):
    camera = Camera.simple(*SIZE, 450.0, distortion=distortion)
    rig = RodRig()
    effects = CameraEffects(blur_px=0.7)
    state = rig.rod.bend(np.array([0.2, 1.0, -0.6]), np.array([0.02, 0.0, 0.01]))
    view = hand_held(rig, 1.3)
    bright, dark = (
        RodRenderer(rig, camera, dots(level), effects).exact(state, view) for level in (200.0, 0.0)
    )
    difference = (bright - dark).astype(float)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    for pose in rig.poses(state, view).values():
        centre = camera.project(pose.translation_m)
        near = np.hypot(x - centre[0], y - centre[1]) < 12
        weight = difference * near
        found = np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()
        # A square of 3 px and 3 x 3 rays a pixel: a cell is 1/3 px, errors of its two edges cancel to a tenth.
        assert found == pytest.approx(centre, abs=0.05)
        # Its area by the inverse square of the distance, and the blur loses nothing.
        area = (0.002 * 450.0 / pose.translation_m[2]) ** 2 * abs(pose.rotation[2, 2])
        assert weight.sum() / 200.0 == pytest.approx(area, rel=0.15)


def test_a_print_seen_from_the_back_is_not_drawn():
    camera, rig = Camera.simple(*SIZE, 450.0), RodRig()
    state = rig.rod.bend(np.zeros(3))
    turned = RodRig(
        mounts={
            name: (xi, mount @ Pose(np.diag([1.0, -1, -1]), np.zeros(3)))
            for name, (xi, mount) in rig.mounts.items()
        }
    )
    pictures = [
        RodRenderer(turned, camera, dots(level), CameraEffects()).exact(state) for level in (0.0, 200.0)
    ]
    changed = np.abs(pictures[1] - pictures[0]) > 1
    reference = camera.project(rig.poses(state)["reference"].translation_m)
    rows, columns = np.nonzero(changed)
    assert np.hypot(columns - reference[0], rows - reference[1]).max() < 10


def test_the_same_seed_gives_the_same_picture():
    camera, rig = Camera.simple(*SIZE, 450.0), RodRig()
    prints = {name: print_of_tag(k, 0.04) for k, name in enumerate(("reference", "middle", "tip"))}
    renderer = RodRenderer(rig, camera, prints, CameraEffects(noise_sigma=3.0))
    state = rig.rod.bend(np.array([0, 1.0, 0]))
    first, again = (renderer.render(state, rng=np.random.default_rng(4)) for _ in range(2))
    other = renderer.render(state, rng=np.random.default_rng(5))
    np.testing.assert_array_equal(first, again)
    assert (first.astype(float) - other).std() == pytest.approx(3 * np.sqrt(2), rel=0.1)
    assert first.dtype == np.uint8
    assert first.shape == (SIZE[1], SIZE[0])


def test_a_hand_keeps_the_rod_in_the_picture():
    camera, rig = Camera.simple(1600, 896, 1800.0), RodRig()
    state = rig.rod.bend(np.zeros(3))
    # Of a 4 cm picture; a few pixels may leave for a moment.
    corner = np.array([[-0.02, -0.02, 0], [0.02, 0.02, 0]])
    for t_s in np.arange(0.0, 30.0, 0.4):
        view = hand_held(rig, t_s)
        for pose in rig.poses(state, view).values():
            pixels = camera.project(pose.apply(corner))
            assert (pixels > -60).all()
            assert (pixels < [1660, 956]).all()


def test_prints():
    tag = print_of_tag(7, 0.04)
    assert tag.width_m == pytest.approx(0.045)
    cells = tag.levels[24::48, 24::48]  # their middles, shifted by the margin of half a cell
    assert set(np.unique(tag.levels)) == {25.0, 215.0}
    assert (cells[0, :8] == 25.0).all()  # the border
    picture = collage(1)
    assert picture.shape == (320, 320)
    assert picture.std() > 30
    assert (collage(2) != picture).mean() > 0.9
    assert print_of_image(picture, 0.04).pixel_m == pytest.approx(0.04 / 1280)
    with pytest.raises(InputError, match="expected uint8"):
        print_of_image(picture.astype(float), 0.04)
    with pytest.raises(InputError, match=r"found prints \['tip'\]"):
        RodRenderer(RodRig(), Camera.simple(*SIZE, 450.0), {"tip": tag})

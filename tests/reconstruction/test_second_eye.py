"""The second eye of a camera that is named nowhere: shadows of boxes and cylinders by a ray caster of its own."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from visuohaptic.core.camera import Camera
from visuohaptic.reconstruction.transparency import RayImage
from visuohaptic.reconstruction.transparency.ray_readings import DROPPED, SAME, second_eye_m

from .glass_caster import Table, _opaque, random_table, ring

CAMERA, WINDOW_PX = Camera.simple(200, 150, 180.0), 3.0


def seen(table: Table, eye_m: float, rng: np.random.Generator) -> list[RayImage]:
    """What is opaque in six views; nothing is read where the second eye looks at something nearer, and at half of all steps."""
    v, u = np.mgrid[:150, :200].astype(float)
    found = []
    for pose in ring(6):
        rays, eye = CAMERA.rays(np.stack([u, v], axis=-1)) @ pose.rotation.T, pose.translation_m
        depth_m = _opaque(table, eye, rays)
        second = eye + eye_m * pose.rotation[:, 0]
        hidden = _opaque(table, second, eye + depth_m[..., None] * rays - second) < 0.99
        steps = np.zeros(depth_m.shape, bool)
        for shift in (-3, -2, -1, 1, 2, 3):  # a matching window fails on both sides of a step
            steps |= np.abs(depth_m - np.roll(depth_m, shift, axis=1)) > 0.05
        lost = hidden | (steps & (rng.random(steps.shape) < 0.5)) | (rng.random(steps.shape) < 0.01)
        none = np.zeros(depth_m.shape, np.float32)
        reading = np.where(lost, DROPPED, SAME).astype(np.uint8)
        # What other views see: windows of three pixels extend what is nearer by one.
        wide_m = cv2.erode(depth_m.astype(np.float32), np.ones((1, 3)))
        found.append(RayImage(reading, none.astype(np.uint16), wide_m, none, ~lost))
    return found


@pytest.mark.parametrize("eye_m", [-0.06, 0.0, 0.06, 0.095])
def test_the_second_eye_follows_from_the_shadows_of_opaque_things(eye_m):
    images = seen(random_table(np.random.default_rng(3)).opaque_twin(), eye_m, np.random.default_rng(5))
    # A shadow ends between two pixels, and 180 px (1 / 0.7 m - 1 / 0.9 m) are 57 px per metre of the baseline: half a pixel is 9 mm.
    assert second_eye_m(images, 180.0, WINDOW_PX) == pytest.approx(eye_m, abs=0.009)


def test_vessels_of_glass_cast_no_shadow_and_an_empty_floor_tells_nothing():
    """A camera without a second eye loses what is behind a glass, and beside it what is behind another one."""
    rng = np.random.default_rng(1)
    images = seen(Table(), 0.075, rng)
    for image in images:
        image.reading[40:110, 70:90] = image.reading[40:110, 100:120] = DROPPED
    # Known only to be between the limits, 0.1 m on either side: the mean of what is compared.
    assert abs(second_eye_m(images, 180.0, WINDOW_PX)) < 0.01


@pytest.mark.parametrize("eye_m", [-0.06, 0.06])
def test_few_edges_tell_the_side_and_no_short_baseline(eye_m):
    """Of a few rows the other side remains possible, and a mean over both would be a baseline in between."""
    found = []
    for seed in range(5):
        images = seen(
            random_table(np.random.default_rng(3)).opaque_twin(), eye_m, np.random.default_rng(seed)
        )
        for image in images:
            image.reading[10 * seed + 50 :] = image.reading[: 10 * seed + 46] = 0
        found.append(second_eye_m(images, 180.0, WINDOW_PX))
    assert np.median(found) == pytest.approx(eye_m, abs=0.015)

"""The container that the cameras see is the one whose ground truth is judged."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.core import Camera
from visuohaptic.demo.bottle import other_table_container, random_table_bottle, table_bottle
from visuohaptic.simulation.tabletop import DepthCamera
from visuohaptic.simulation.tabletop.glass_scenes import SCENE_KINDS, glass_scene


@pytest.mark.parametrize("make", [table_bottle, random_table_bottle, other_table_container])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_is_seen_as_high_as_it_is(make, seed):
    rngs = [np.random.default_rng([seed, k]) for k in range(1 if make is table_bottle else 2)]
    bottle = make(*rngs)
    # Towards the middle of its top, from the side so that the projector is not reflected; no noise, no steps.
    top = np.array([*bottle.foot_m, bottle.height_m])
    eye = top + np.array([0.15, 0.15, 0.6])
    camera = DepthCamera.kinect(240)
    depth_m = camera.render(bottle.scene, Camera.pose_of_view(tuple(eye), tuple(top)))
    row, column = (float(value) for value in camera.camera.matrix[[1, 0], 2])
    seen_m = np.nanmean(
        depth_m[math.floor(row) : math.ceil(row) + 1, math.floor(column) : math.ceil(column) + 1]
    )
    # The cap is 0.2 mm thick, so that it lies on the glass.
    assert seen_m == pytest.approx(np.linalg.norm(eye - top), abs=6e-4)


@pytest.mark.parametrize("kind", SCENE_KINDS)
@pytest.mark.parametrize("seed", range(6))
def test_caps_of_glass_scenes_end_where_the_glass_does(kind, seed):
    scene = glass_scene(seed, kind=kind)
    for glass in scene.glass:
        # A label or cap is thinner than half a millimetre.
        assert all(band.high_m <= glass.height_m + 5e-4 for band in glass.bands)

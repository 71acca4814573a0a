from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.sensing import fall_pushes, scenes

from visuohaptic.core import BaseState, Contact, ErrorBudget, EventKind, ForceProfile, InputError, Reason
from visuohaptic.core.camera import Frame
from visuohaptic.core.geometry import compose_2d
from visuohaptic.sensing.scene import SceneSettings, SceneTracker
from visuohaptic.simulation.rendering import Look, Surface

CONCRETE = Look(
    floor=Surface(112.0, 10.0, "concrete"), foam=Surface(175.0, 3.5, "foam"), body=Surface(52.0, 3.0, "metal"),
    face_contrast=0.3, shadow=0.4,
)  # fmt: skip


def profile(t_s, force_N=0.0, x_m=0.016, half_m=0.05, y_m=0.0):
    s = scenes.BACK[:, 1]
    delta = np.where(np.abs(s - y_m) < half_m, scenes.FRONT_M - x_m, 0.0) if force_N > 0 else 0 * s
    points = np.column_stack([scenes.FRONT_M - delta, s])
    k = np.flatnonzero(delta > 0)
    contacts = ()
    if len(k):
        sigma = np.full(len(k), 2e-5)
        contacts = (
            Contact(s[k[0]], s[k[-1]], force_N, ErrorBudget(), True, Reason.OK, points[k], sigma, delta[k]),
        )
    n = len(s)
    return ForceProfile(
        t_s, True, Reason.OK, force_N, ErrorBudget(), s, delta, np.full(n, 2e-5), np.zeros(n), np.zeros(n),
        np.ones(n, bool), contacts,
    )  # fmt: skip


def tracker():
    return SceneTracker(scenes.RIG.camera, scenes.RIG.T_camera_foam, scenes.BELOW_M)


@pytest.mark.parametrize("odometry", [False, True])
def test_the_platform_drives_an_arc(odometry):
    rng, render, scene = np.random.default_rng(0), scenes.renderer(look=CONCRETE), tracker()
    pose, step = np.zeros(3), np.array([0.004, 0.0, 0.008])
    ahead = np.array([0.17, 0.0, 0.0])
    first = compose_2d(pose, ahead)
    for i in range(40):
        if i:
            pose = compose_2d(pose, step)
        foam = compose_2d(pose, ahead)
        image = render.render(scenes.scene(i / 30, scenes.planar(*foam)), rng=rng)
        # Wheels that tell two per cent too much.
        state = BaseState(i / 30, *pose, 1.02 * 0.12, 0.24) if odometry else None
        found = scene.update(Frame(image, i / 30, i), base_state=state)
        if i:
            assert found.motion.valid
            assert found.floor_motion.valid
    c, s = np.cos(-first[2]), np.sin(-first[2])
    truth = np.array([[c, -s], [s, c]]) @ np.subtract(foam[:2], first[:2])
    way = 39 * 0.004
    # Floor: 1 % and 0.5 degrees over a metre; here over 16 cm.
    np.testing.assert_allclose(found.pose[:2], truth, atol=0.005 * way + 0.0005)
    assert found.pose[2] == pytest.approx(pose[2], abs=np.radians(0.25))
    assert found.proximity_m == np.inf


def test_an_object_that_turns_and_slips_while_it_is_pushed():
    rng, render, scene = np.random.default_rng(1), scenes.renderer(look=CONCRETE), tracker()
    kinds, angles = [], []
    for i in range(30):
        driven = 0.002 * i
        touched = i >= 8
        turn = 0.008 * max(0, i - 12)
        slide = 0.0007 * max(0, i - 12)
        x = 0.016 if touched else 0.016 + 0.002 * (8 - i)
        thing = scenes.box(x, slide, turn, (0.1, 0.1), grey=150.0)
        world = scenes.planar(driven, 0, 0)
        image = render.render(scenes.scene(i / 30, world, [thing], 0.004 if touched else 0.0), rng=rng)
        reading = profile(i / 30, 3.0 if touched else 0.0, half_m=0.045)
        found = scene.update(Frame(image, i / 30, i), reading, BaseState(i / 30, driven, 0, 0, 0.06, 0))
        kinds += [(e.kind, i) for e in found.events]
        if i >= 10:
            assert found.object_motion.valid
            angles.append(found.object_angle_rad - turn)
            assert found.object_motion.shift_m[1] == pytest.approx(slide, abs=0.0015)
    # Half a degree, on a box of 10 cm in an image of 800 columns.
    assert np.abs(angles).max() < np.radians(1.0)
    assert [k for k, _ in kinds] == [EventKind.SLIP]
    # 6 mm of slip are reached in frame 20.6; three sigma of the shift come on top.
    assert 20 <= kinds[0][1] <= 23
    for i in range(30, 52):
        image = render.render(scenes.scene(i / 30, scenes.planar(driven, 0, 0)), rng=rng)
        found = scene.update(Frame(image, i / 30, i), profile(i / 30))
    assert found.object_motion.reason is Reason.NOT_ZEROED, "the object was let go"


@pytest.mark.parametrize("seed", [0, 1, 8])
def test_falls_are_told_within_two_frames(seed):
    pytest.importorskip("mujoco")
    watched = fall_pushes.watch(seed)
    assert np.isfinite(watched.true_fall_s) == (seed % 2 == 0)
    assert np.isfinite(watched.told_fall_s) == np.isfinite(watched.true_fall_s)
    if seed % 2 == 0:
        assert abs(watched.told_fall_s - watched.true_fall_s) <= 2.5 * fall_pushes.FRAME_S
    else:
        assert abs(watched.turn_error_rad) < np.radians(2.0)


def test_a_frame_that_is_not_read_does_not_erase_the_force_before_it(monkeypatch):
    """The loss of the force is evidence of a fall; NaN compares false with everything."""
    scene, fractions = tracker(), []
    update = scene._object.update

    def recorded(*args, force_fraction, **more):
        fractions.append(force_fraction)
        return update(*args, force_fraction=force_fraction, **more)

    monkeypatch.setattr(scene._object, "update", recorded)
    grey = np.full((scenes.RIG.height_px, scenes.RIG.width_px), 128, np.uint8)
    for i, force_N in enumerate((4.0, np.nan, 1.0)):
        scene.update(Frame(grey, i / 30, i), replace(profile(i / 30), force_N=force_N))
    assert fractions == pytest.approx([1.0, 1.0, 1.0 / (4.0 * 0.97)])


def test_darkness_is_not_a_motion():
    scene = tracker()
    black = np.zeros((scenes.RIG.height_px, scenes.RIG.width_px), np.uint8)
    for i in range(3):
        found = scene.update(Frame(black, i / 30, i), profile(i / 30, 2.0))
    assert not found.motion.valid
    assert not found.object_motion.valid
    assert found.object_motion.reason is Reason.LOST
    assert np.isnan(found.object_angle_rad)


def test_what_cannot_be_used_is_refused():
    with pytest.raises(InputError, match="expected 800 x 448"):
        tracker().update(Frame(np.zeros((10, 10), np.uint8), 0.0, 0))
    with pytest.raises(InputError, match="floor_below_m"):
        SceneTracker(scenes.RIG.camera, scenes.RIG.T_camera_foam, -0.05)
    with pytest.raises(InputError, match="max_width_px: found 10, expected at least 100"):
        SceneSettings(max_width_px=10)

from __future__ import annotations

import numpy as np
import pytest
from tests.sensing import scenes
from tests.worlds import ground

from benchmarks import scene_evidence
from visuohaptic.core import InputError, Motion, Reason
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.core.camera.plane import PlaneView
from visuohaptic.core.geometry import relative_2d
from visuohaptic.sensing.scene import ObstacleDetector, ObstacleSettings
from visuohaptic.sensing.scene.obstacle_parallax import _over_slopes
from visuohaptic.simulation.foam import SensorRig
from visuohaptic.simulation.rendering import Look, Surface

FRAME_S = 1.0 / 30


def moved(index, motion, valid=True):
    """Motion since the frame before, known to a tenth of a millimetre."""
    reason = Reason.OK if valid else Reason.LOST
    covariance = np.diag([1e-4, 1e-4, 2e-4]) ** 2
    return Motion(index * FRAME_S, valid, reason, np.array(motion[:2]), float(motion[2]), covariance)


def follow(detector, world, poses):
    """What the detector says along a drive of the independent world, and the truth of the box."""
    said, before = [], poses[0]
    for i, pose in enumerate(poses):
        found = detector.update(world.image(pose, i * FRAME_S), moved(i, relative_2d(before, pose)))
        said.append((found, None if world.box is None else float(world.box[0] - pose[0])))
        before = pose
    return said


@pytest.mark.parametrize("floor", ["tiles", "grass"])
def test_a_box_is_seen_on_floors_that_look_like_anything(floor):
    """Each third frame of a drive: 1 cm apart, as a platform of 0.3 m/s would see them."""
    world = ground.drive(floor, 2, box=True)
    detector = ObstacleDetector(scene_evidence.floor_view(), 0.0)
    said = follow(detector, world, world.poses[:48:3])
    assert all(found.valid for found, _ in said[-6:])
    near = [(found, x) for found, x in said if found.valid and np.isfinite(found.proximity_m)]
    # 12 cm of drive from 0.43 m on; the lowest obstacle is promised at sight_m.
    assert near[0][1] > 0.30
    for found, x in near:
        # Faces turn by 0.03 rad under the view and their print has blobs of 2 cm: four declared sigmas.
        assert abs(found.proximity_m - x) < 4.0 * found.proximity_sigma_m
        assert 0.0005 < found.proximity_sigma_m < 0.005
        # Somewhere on its 12 cm, within a cell of 2 cm.
        assert abs(found.y_m - world.box[1]) < 0.08
    # The mask stands above the foot of the box, in its columns.
    found, x = near[-1]
    foot = scene_evidence.floor_view().project(np.array([x, world.box[1]])) / found.binning
    column = found.mask[:, round(float(foot[0]))]
    assert np.flatnonzero(column).max() == pytest.approx(foot[1], abs=3.0)
    assert not found.mask[:, :5].any()


def test_a_plain_box_as_bright_as_the_grass_is_placed_where_the_floor_ends():
    """The inside of its face says the same of every range, and its side outlines hardly more: a bin is 10 cm of range."""
    world = ground.drive("grass", 32, box=True, plain=True)
    detector = ObstacleDetector(scene_evidence.floor_view(), 0.0)
    said = [(found, x) for found, x in follow(detector, world, world.poses[::2]) if found.valid]
    near = [
        (found.proximity_m - x, found.proximity_sigma_m)
        for found, x in said
        if np.isfinite(found.proximity_m)
    ]
    # Seen at 31.4 cm; with correlated_bins 4.8 at 30.8 cm, with cells of a quarter of the width at 30.2 cm.
    assert max(x for found, x in said if np.isfinite(found.proximity_m)) > 0.311
    error, sigma = np.array(near).T
    # Half a cell of 8.7 mm. Sums over columns of the image, which vertical outlines cross, were 24 mm (rms) too far.
    assert np.abs(error).max() < 0.0044
    assert np.median(sigma) < 0.003
    # 1.0; 0.4 where the spread of the likelihood and the scatter of the ranges, two estimates of one error, are added.
    assert 0.65 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.3


def test_a_plain_box_on_brick_is_seen_by_its_outlines():
    """Its outlines lie between the cells: with cells as wide as the least obstacle it is not seen in all the drive."""
    world = ground.drive("brick", 18, box=True, plain=True)
    detector = ObstacleDetector(scene_evidence.floor_view(), 0.0)
    said = [(found.proximity_m - x, x) for found, x in follow(detector, world, world.poses) if found.valid]
    error, x = np.array([pair for pair in said if np.isfinite(pair[0])]).T
    assert x.max() > 0.22  # 22.7 cm; a frame is 4.7 mm of the drive
    assert np.abs(error).max() < 0.0044  # half a cell


def test_joints_along_the_drive_are_no_obstacle():
    """They look the same in all frames, so that an error of interpolation would count again and again."""
    rig = SensorRig(width_px=800, height_px=448, focal_px=900.0)
    view = PlaneView(rig.camera, rig.T_camera_foam @ Pose(np.eye(3), np.array([0.0, 0.0, -0.05])))
    # Each pixel is the mean of 3 x 3 rays on planks of 9 cm with dark joints of 1.5 mm.
    v, u = np.meshgrid((np.arange(3 * 448) - 1) / 3, (np.arange(3 * 800) - 1) / 3, indexing="ij")
    rotation, origin = view.T_camera_plane.rotation, view.T_camera_plane.translation_m
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(rig.camera.matrix).T @ rotation
    eye = -rotation.T @ origin
    joint = (eye[1] - eye[2] * rays[..., 1] / rays[..., 2] + 0.06) % 0.09 < 0.0015
    planks = 130.0 - 70.0 * joint.reshape(448, 3, 800, 3).mean(axis=(1, 3))
    detector, rng = ObstacleDetector(view), np.random.default_rng(0)
    for i in range(24):
        image = np.clip(planks + rng.normal(0.0, 2.0, planks.shape), 0, 255).astype(np.uint8)
        found = detector.update(image, moved(i, (0.004, 0.0, 0.0)))
    assert found.valid
    assert found.proximity_m == np.inf


def test_ends_of_planks_of_other_brightness_are_no_obstacle():
    """A step across the drive: the floor enlarges its surroundings between the frames, the squares of the local means stay."""
    angle, eye, rng = np.deg2rad(30.0), np.array([-0.12, 0.0, 0.3]), np.random.default_rng(0)
    ahead = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    right = np.array([0.0, -1.0, 0.0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    view = PlaneView(Camera.simple(320, 240, 260.0), Pose(rotation, -rotation @ eye))
    # Each pixel is the mean of 3 x 3 rays on planks of 7 x 60 cm, whose brightness differs by a seventh (rms).
    v, u = np.meshgrid((np.arange(3 * 240) - 1) / 3, (np.arange(3 * 320) - 1) / 3, indexing="ij")
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(view.camera.matrix).T @ rotation
    along = np.minimum(eye[2] / np.maximum(-rays[..., 2], 1e-6), 20.0)
    x, y = along * rays[..., 0] + eye[0], along * rays[..., 1]
    plank = np.floor(y / 0.07).astype(int) % 64
    start, grey = rng.uniform(0.0, 0.6, 64)[plank], rng.normal(150.0, 21.0, (64, 64))
    detector = ObstacleDetector(view)
    for i in range(40):
        image = grey[plank, np.floor((x + start + 0.02 * i) / 0.6).astype(int) % 64]
        image = image.reshape(240, 3, 320, 3).mean(axis=(1, 3)) + rng.normal(0.0, 1.6, (240, 320))
        found = detector.update(np.clip(image, 0, 255).astype(np.uint8), moved(i, (0.02, 0.0, 0.0)))
        assert not found.valid or found.proximity_m == np.inf
    assert found.valid


def test_a_turned_face_is_placed_in_its_middle():
    """Vertical lines of a face whose ranges lie on a line have their likeliest sum at the range in their middle."""
    away = np.linspace(-20.0, 20.0, 100)  # in half cells of 4 mm
    ranges, middle, slope = np.arange(40.0), 21.0, 0.3
    lines = 2.0 - 0.5 * ((ranges[:, None] - middle - slope * away) / 2.0) ** 2
    # Beside the face there is floor, which faces at the ranges far behind explain badly, and at those near hardly worse.
    lines[:, np.abs(away) > 12.0] = -0.1 * ranges[:, None]
    each = _over_slopes(lines, away)
    assert each.argmax() == 21
    # Of the slopes one is right: the likelihood is that of 60 lines, each of which is 2 half cells wide.
    assert 2 * each[21] - each[20] - each[22] == pytest.approx(60 / 4.0, rel=0.2)


def test_joints_of_tiles_and_a_walking_shadow_are_no_obstacles():
    world = ground.drive("tiles", 2, shadow=True)
    detector = ObstacleDetector(scene_evidence.floor_view(), 0.0)
    said = [found for found, _ in follow(detector, world, world.poses[::3])]
    assert sum(found.valid for found in said) >= 8
    assert all(found.proximity_m == np.inf for found in said if found.valid)
    assert not any(found.mask.any() for found in said)


def plain_view():
    camera = Camera.simple(200, 160, 160.0)
    # 0.3 m above the floor, looking down by 45 degrees.
    c = np.sqrt(0.5)
    rotation = np.array([[0, -1.0, 0], [-c, 0, -c], [c, 0, -c]])
    return PlaneView(camera, Pose(rotation, -rotation @ np.array([0.0, 0.0, 0.3])))


def test_noise_alone_is_no_obstacle():
    """Without any texture both planes say the same: ten minutes of such frames at the declared rate of 0.2 a minute."""
    rng = np.random.default_rng(0)
    detector = ObstacleDetector(plain_view(), 0.0, ObstacleSettings(max_columns=50))
    alarms = 0
    for i in range(300):
        image = np.clip(rng.normal(120.0, 4.0, (160, 200)), 0, 255).astype(np.uint8)
        found = detector.update(image, moved(i, (0.02, 0.0, 0.0)))
        alarms += found.valid and np.isfinite(found.proximity_m)
    assert found.valid
    assert alarms == 0


def test_a_platform_that_stands_or_is_lost_says_nothing():
    rng = np.random.default_rng(1)
    detector = ObstacleDetector(plain_view(), 0.0, ObstacleSettings(max_columns=50))
    image = rng.integers(90, 150, (160, 200)).astype(np.uint8)
    found = [detector.update(image, moved(i, (0.0, 0.0, 0.0))) for i in range(40)]
    assert {(f.valid, f.reason) for f in found} == {(False, Reason.NOT_ZEROED)}
    assert all(np.isnan(f.proximity_m) for f in found)
    for i in range(40, 80):
        found = detector.update(image, moved(i, (0.02, 0.0, 0.0)))
    assert found.valid
    found = [detector.update(image, moved(i, (0.0, 0.0, 0.0))) for i in range(80, 120)]
    # Since the last comparison: one second.
    assert found[25].valid
    assert (found[-1].valid, found[-1].reason) == (False, Reason.STALE)
    assert detector.update(image, moved(120, (0.06, 0.0, 0.0))).valid
    lost = detector.update(image, moved(121, (0.0, 0.0, 0.0), valid=False))
    assert (lost.valid, lost.reason) == (False, Reason.NOT_ZEROED)


@pytest.mark.parametrize("colour", [False, True])
def test_proximity_of_a_box_that_comes_nearer(colour):
    rig = SensorRig()
    look = Look(
        floor=Surface(112.0, 10.0, "concrete", (100.0, 112.0, 120.0)), face_contrast=0.3, colour=colour
    )
    render = scenes.renderer(rig, look)
    detector = ObstacleDetector(scenes.floor_view(rig), scenes.FRONT_M)
    rng = np.random.default_rng(0)
    found = {}
    for i in range(24):
        driven = 0.005 * i
        x = 0.18 - driven
        things = [scenes.box(x, 0.02, bgr=(40.0, 60.0, 160.0))]
        image = render.render(scenes.scene(0.0, scenes.planar(driven, 0, 0), things), rng=rng)
        found[x - scenes.FRONT_M] = detector.update(image, moved(i, (0.005 * (i > 0), 0.0, 0.0)))
    promised = [o for gap, o in found.items() if gap < detector.sight_m]
    assert len(promised) >= 2
    assert all(o.valid for o in promised)
    for gap, o in found.items():
        if gap < detector.sight_m or (o.valid and np.isfinite(o.proximity_m)):
            # The true drive is 5 mm a frame: only the parallax is uncertain.
            assert abs(o.proximity_m - gap) < 4.0 * o.proximity_sigma_m < 0.012


def test_a_free_floor_stays_free_while_the_platform_drives():
    rig = SensorRig()
    render = scenes.renderer(rig)
    detector = ObstacleDetector(scenes.floor_view(rig), scenes.FRONT_M)
    rng = np.random.default_rng(0)
    for i in range(20):
        image = render.render(scenes.scene(0.0, scenes.planar(0.006 * i, 0, 0)), rng=rng)
        found = detector.update(image, moved(i, (0.006 * (i > 0), 0.0, 0.0)))
    assert found.valid
    assert found.reason is Reason.OK
    assert found.proximity_m == np.inf


def test_what_cannot_be_used_is_refused():
    with pytest.raises(InputError, match=r"alarms_per_minute: found 0\.0, expected more than 0"):
        ObstacleSettings(alarms_per_minute=0.0)
    # A pixel is no more than one independent sample, and comparisons that never become stale are no state.
    with pytest.raises(InputError, match=r"correlated_bins: found 0\.0, expected at least 1"):
        ObstacleSettings(correlated_bins=0.0)
    with pytest.raises(InputError, match=r"stale_s: found nan, expected more than 0"):
        ObstacleSettings(stale_s=float("nan"))
    detector = ObstacleDetector(scenes.floor_view())
    with pytest.raises(InputError, match="expected 800 x 448"):
        detector.update(np.zeros((100, 100), np.uint8), moved(0, (0.0, 0.0, 0.0)))
    camera = Camera.simple(200, 160, 160.0)
    ahead = PlaneView(
        camera, Pose(np.array([[0, -1.0, 0], [0, 0, -1.0], [1.0, 0, 0]]), np.array([0, 0.04, 0]))
    )
    with pytest.raises(InputError, match=r"expected a camera above 0\.05 m that looks at the floor"):
        ObstacleDetector(ahead)

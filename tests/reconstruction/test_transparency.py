"""The detectors: kernels against plain NumPy, laws of the scores, a rendered scene, the command line."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from tests.reconstruction.plane_views import CAMERA, looking_down, plane_frame
from visuohaptic.cli.main import main
from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.core.files import save_yaml
from visuohaptic.io.depth import DepthFrame, write_depth, write_poses
from visuohaptic.io.meshes import read_ply
from visuohaptic.reconstruction.fusion import SENSOR_NOISE, SpaceGrid, sensor_noise, space_of_interest
from visuohaptic.reconstruction.transparency import (
    EvidenceDetector,
    TrackedNoise,
    ViewDepth,
    chance_of_finding,
    find_regions,
    intrinsics,
    ray_image,
    refine_poses,
    view_graph,
)
from visuohaptic.reconstruction.transparency._ray_kernels import projector_shadow
from visuohaptic.reconstruction.transparency._view_kernels import (
    plane_equations,
    smooth_points,
    warp_views,
)
from visuohaptic.reconstruction.transparency.pose_refinement import common_sigma_m
from visuohaptic.reconstruction.transparency.ray_evidence import RayEvidence
from visuohaptic.reconstruction.transparency.ray_readings import RayImage, reading_tables, surface_ratios
from visuohaptic.simulation.tabletop import DepthCamera, disturb_pose, glass_scene

SEED = 12  # a development seed: thin, 360 degrees


@pytest.fixture(scope="module")
def sequence():
    """Every fourth or fifth view of a development scene at quarter resolution."""
    scene = glass_scene(SEED, step_m=0.09)
    sensor = DepthCamera.kinect(200)
    frames = [
        DepthFrame(view.t_s, view.depth_m, None, view.true_T_world_camera, sensor.camera, i)
        for i, view in enumerate(scene.render(sensor, np.random.default_rng(0)))
    ]
    return scene, frames


def test_noise_is_that_of_the_equation():
    z = np.array([0.5, 1.0, 2.0])
    expected = np.sqrt((0.5 * 2.9e-3 * z**2) ** 2 + 0.01**2)
    np.testing.assert_allclose(SENSOR_NOISE["kinect"].sigma_m(z), expected, rtol=1e-12)
    assert sensor_noise("Intel RealSense D435i") is SENSOR_NOISE["realsense_d435"]
    with pytest.raises(InputError, match="expected one of kinect"):
        sensor_noise("abacus")


def test_warp_equals_plain_numpy_and_the_truth():
    rng = np.random.default_rng(0)
    frames = [plane_frame(looking_down(x)) for x in (-0.1, 0.0, 0.07)]
    here = looking_down(0.03)
    moved = np.array(
        [(here.inverse() @ frame.T_world_camera).matrix[:3] for frame in frames], dtype=np.float32
    )
    depths = np.stack([frame.depth_m for frame in frames])
    depths[1][rng.random(depths[1].shape) < 0.2] = np.nan
    warped = np.empty_like(depths)
    warp_views(depths, moved, *intrinsics(CAMERA), warped)
    for k, frame in enumerate(frames):
        plain = np.full(depths[k].shape, np.inf)
        rows, columns = np.nonzero(np.isfinite(depths[k]))
        rays = CAMERA.rays(np.column_stack([columns, rows]).astype(float))
        points = (here.inverse() @ frame.T_world_camera).apply(rays * depths[k][rows, columns, None])
        pixels = np.floor(CAMERA.project(points) + 0.5).astype(int)
        for (u, v), z in zip(pixels, points[:, 2], strict=True):
            if 0 <= u < CAMERA.width and 0 <= v < CAMERA.height:
                plain[v, u] = min(plain[v, u], z)
        same = np.isclose(warped[k], plain, atol=1e-4) | (np.isinf(warped[k]) & np.isinf(plain))
        assert same.mean() > 0.99  # float32 rounds a few points into the next pixel
    truth = plane_frame(here).depth_m
    seen = np.isfinite(warped)
    # A pixel's point may be half a pixel off: the plane's slope times that, z^2 / (f h) / 2.
    assert np.abs(warped - truth)[seen].max() < 0.5 * truth.max() ** 2 / (60 * 0.8) * 1.5


@pytest.mark.parametrize("side", [1, -1])
def test_shadow_is_on_the_far_side_of_the_projector(side):
    depth = np.full((1, 100), 2.0, np.float32)
    depth[0, 40:60] = 1.0
    shadow = np.zeros((1, 100), np.uint8)
    projector_shadow(depth, side * 20.0, 0.5, shadow)
    where = np.flatnonzero(shadow)
    width = 20 * (1 / 1.0 - 1 / 2.0)  # disparities' difference [px]
    assert abs(len(where) - width) <= 1
    assert where.max() == 39 if side > 0 else where.min() == 60


def test_region_of_a_box_of_voxels():
    grid = SpaceGrid(np.array([1.0, 2.0, 3.0]), (20, 20, 20), 0.01)
    score = np.zeros(grid.shape)
    score[5:10, 4:8, 3:9] = 0.5
    (region,) = find_regions(score, score > 0, grid, min_voxels=10)
    np.testing.assert_allclose(region.size_m, [0.05, 0.04, 0.06])
    np.testing.assert_allclose(region.centroid_m, [1.075, 2.06, 3.06])
    assert region.volume_m3 == pytest.approx(0.05 * 0.04 * 0.06)
    assert region.score == pytest.approx(0.5)
    assert region.contains(region.centroid_m + np.array([[0.0, 0, 0], [0.03, 0, 0]])).tolist() == [
        True,
        False,
    ]
    assert find_regions(score, score > 0, grid, min_voxels=1000) == ()


def test_refined_poses_are_better(sequence):
    scene, frames = sequence
    rng = np.random.default_rng(4)
    noisy = [
        replace(frame, T_world_camera=disturb_pose(frame.T_world_camera, rng, 0.003, math.radians(0.1)))
        for frame in frames[:20]
    ]

    def step_errors_m(views):
        """Of the motions between neighbours: a common shift of all views does no harm."""
        return [
            np.linalg.norm(
                (a.T_world_camera.inverse() @ b.T_world_camera).translation_m
                - (p.inverse() @ q).translation_m
            )
            for a, b, p, q in zip(views, views[1:], scene.poses, scene.poses[1:], strict=False)
        ]

    assert np.mean(step_errors_m(refine_poses(noisy))) < 0.6 * np.mean(step_errors_m(noisy))


def test_what_all_poses_are_off_together_follows_from_what_the_fit_moved_them():
    """The fit finds how poses differ, not their mean: that of eight poses off by 3 mm is off by 3 / sqrt(8)."""
    rng = np.random.default_rng(4)
    deviates = []
    for _ in range(150):
        shifts = rng.normal(0.0, 0.003, (8, 3))
        frames = [
            [plane_frame(Pose(np.eye(3), shift)) for shift in which]
            for which in (shifts, np.tile(shifts.mean(axis=0), (8, 1)))
        ]
        deviates.append(shifts.mean(axis=0) / common_sigma_m(*frames, np.array([0.1, 0.2, 0.5])))
    # Student's t with seven degrees of freedom has the variance 7 / 5; 450 of them, known to a tenth of it.
    assert np.mean(np.square(deviates)) == pytest.approx(7 / 5, abs=0.4)


def test_right_poses_stay_where_they_are(sequence):
    """No common drift: the surface must not move because its views were fitted to each other."""
    scene, frames = sequence
    told = [replace(f, T_world_camera=p) for f, p in zip(frames, scene.poses, strict=True)][:24]
    moved_m = [
        f.T_world_camera.translation_m - p.translation_m
        for f, p in zip(refine_poses(told), scene.poses, strict=False)
    ]
    assert np.linalg.norm(np.mean(moved_m, axis=0)) < 2e-4  # half a millimetre without the anchor


def test_glass_is_found_and_opaque_twins_are_not(sequence):
    scene, frames = sequence
    grid = SpaceGrid.around((-0.4, -0.4, 0.0), (0.4, 0.4, 0.3), 0.01)
    detector = EvidenceDetector(grid, SENSOR_NOISE["simulated"])
    detector.run(frames[::2])
    regions = detector.regions()
    centres = grid.centres_m(np.argwhere(np.ones(grid.shape, bool)))
    truth = scene.truth(centres)
    told = np.any([region.contains(centres) for region in regions], axis=0)
    assert 2 * (truth & told).sum() / (truth.sum() + told.sum()) > 0.4
    sensor = DepthCamera.kinect(200)
    twin = scene.scene.opaque_twin()
    painted = [
        replace(f, depth_m=sensor.render(twin, f.T_world_camera, np.random.default_rng(f.index)))
        for f in frames[:40:2]
    ]
    opaque = EvidenceDetector(grid, SENSOR_NOISE["simulated"])
    opaque.run(painted)
    assert opaque.regions() == ()


def test_readings_near_edges_are_another_context_than_those_away_from_them():
    camera = Camera.simple(160, 120, 300.0)
    depth_m = np.full((120, 160), 1.0, np.float32)
    depth_m[40:80, 60:100] = 0.8  # a box on a wall, edges at columns 60 and 100
    wrong_m = depth_m.copy()
    wrong_m[50:70, 60:100] = 0.9  # contradicts what the other views say, up to the edge
    pose = Pose.identity()
    noise = TrackedNoise(replace(SENSOR_NOISE["kinect"], edge_rad=5 / 300))
    others = [ViewDepth.of_frame(DepthFrame(0.1 * i, depth_m, None, pose, camera), noise) for i in range(4)]
    rays = ray_image(ViewDepth.of_frame(DepthFrame(1.0, wrong_m, None, pose, camera), noise), others, noise)
    assert (rays.reading[50:70, 60:100] == 2).all()  # farther
    assert (rays.reading[1:40, 1:-1] == 1).all()
    # The margin is 5 px and the place of a point, less than one; a step is seen by the pixels on both sides of it.
    away = np.unique(rays.code[55:65, 68:92])
    assert not np.isin(rays.code[50:70, [*range(60, 65), *range(95, 100)]], away).any()
    assert len(np.unique(rays.code[60, 60:80])) >= 3


@pytest.mark.parametrize("baseline_m", [0.05, -0.05])
def test_a_surface_that_the_second_eye_does_not_see_is_a_context_of_its_own(baseline_m):
    """In the shadow beside an object nothing can be read, whereas a step on the other side only mixes depths."""
    camera = Camera.simple(160, 120, 300.0)
    depth_m = np.full((120, 160), 1.0, np.float32)
    depth_m[40:80, 60:100] = 0.6
    noise = TrackedNoise(replace(SENSOR_NOISE["kinect"], baseline_m=baseline_m, edge_rad=1 / 300))
    own, *others = [
        ViewDepth.of_frame(DepthFrame(0.1 * i, depth_m, None, Pose.identity(), camera), noise)
        for i in range(5)
    ]
    code = ray_image(own, others, noise).code[60]
    # f b (1 / z - 1 / Z) = 10 px; one at either end is the step's.
    shadow = range(51, 59) if baseline_m > 0 else range(101, 109)
    assert len(np.unique(code[list(shadow)])) == 1
    other_step = range(97, 103) if baseline_m > 0 else range(57, 63)
    assert code[shadow[4]] not in code[list(other_step)]


@pytest.mark.parametrize("lost", [0.0, 0.25])
def test_drop_outs_beside_a_part_are_the_rate_of_the_surface_behind_it(lost):
    """Through a part half of the readings of a wall drop out; beside it none does (glass), or a quarter (polished metal)."""
    rng = np.random.default_rng([6, int(100 * lost)])
    depth_m, through = np.ones((48, 64), np.float32), np.zeros((5, 48, 64), dtype=bool)
    through[:1, 12:36, 16:48] = True
    frames, images = [], []
    for rays in through:
        reading = np.where(rng.random((48, 64)) < np.where(rays, 0.5, lost), 4, 1).astype(np.uint8)
        images.append(RayImage(reading, reading.astype(np.uint16), depth_m, depth_m, reading > 0))
        frames.append(DepthFrame(0.0, depth_m, None, Pose.identity(), CAMERA))
    tables = reading_tables([np.repeat([1, 4], [9500, 500]).astype(np.uint16)])
    added = surface_ratios(frames, images, through, np.ones_like(through), tables, 0.1)
    # Four views beside it, and a prior of one with the rate of the context: 500 of 10,000, and 50 rays of glass.
    rate = (4 * lost + 0.052) / 5
    inside, dropped = through[0], images[0].reading == 4
    assert np.median(added[0][inside & dropped]) == pytest.approx(np.log(0.052 / rate), abs=0.15)
    assert np.median(added[0][inside & ~dropped]) == pytest.approx(np.log(0.947 / (1 - rate)), abs=0.05)
    assert not added[0][~inside].any()
    assert not np.any(added[1:])


def test_the_false_alarm_rate_moves_the_threshold_and_is_checked(sequence):
    _, frames = sequence
    grid = SpaceGrid.around((-0.4, -0.4, 0.0), (0.4, 0.4, 0.3), 0.02)
    strict, loose = (EvidenceDetector(grid, false_alarm_rate=rate) for rate in (0.001, 0.1))
    for detector in (strict, loose):
        detector.run(frames[::8])
    # Bonferroni: a hundredth of the rate is log 100 more evidence.
    assert strict.threshold - loose.threshold == pytest.approx(math.log(100), abs=1e-9)
    np.testing.assert_allclose(strict.evidence, loose.evidence, atol=1e-5)
    with pytest.raises(InputError, match="expected between 0 and 1"):
        EvidenceDetector(grid, false_alarm_rate=0.0)
    with pytest.raises(InputError, match=r"found 1\.0, expected between 0 and 1 exclusive"):
        EvidenceDetector(grid, false_alarm_rate=1.0)


def test_the_chance_of_finding_rises_with_views_as_found_on_tables_of_an_independent_caster():
    views = np.array([0.0, 3.0, 8.0, 24.0])
    chance = chance_of_finding(views, 0.05, 12.4)
    assert (np.diff(chance) >= 0).all()
    # Three views give at most 3 log 20 = 9, less than the threshold; of even seeds, 8 views found 0.6, 24 found 0.9.
    assert chance[1] == 0
    assert 0.45 < chance[2] < 0.8
    assert chance[3] > 0.9


def test_views_from_one_place_count_as_one():
    frames = [plane_frame(looking_down(x)) for x in (0.0, 0.001, 0.002, 0.5)]
    weights = view_graph(frames).weights(math.radians(10.0))
    # Three at one place share the weight of one; a half metre beside, at a distance of 1 m, is another.
    assert weights[:3].sum() == pytest.approx(1.0, abs=0.02)
    assert weights[3] == pytest.approx(1.0)


def test_neighbours_do_not_depend_on_the_order_of_views():
    rng = np.random.default_rng(8)
    frames = [plane_frame(looking_down(x)) for x in np.linspace(-0.3, 0.3, 12)]
    order = rng.permutation(12)
    first = view_graph(frames).neighbours(5, 4, math.radians(4.0))
    graph = view_graph([frames[k] for k in order])
    again = graph.neighbours(int(np.flatnonzero(order == 5)[0]), 4, math.radians(4.0))
    assert {int(order[k]) for k in again} == set(first)


def test_many_near_views_are_compared_with_independent_ones_and_few_with_what_there_is():
    wide, independent, least = math.radians(60.0), math.radians(10.0), math.radians(4.0)
    graph = view_graph([plane_frame(looking_down(x)) for x in np.tan(np.linspace(-wide / 2, wide / 2, 61))])
    chosen = graph.neighbours(30, 4, independent, least)
    assert graph.angle_rad[np.ix_([30, *chosen], chosen)][~np.eye(5, 4, -1, dtype=bool)].min() >= independent
    # A sequence of 17 degrees has none that are independent of its middle, and some that are 4 degrees apart.
    few = view_graph([plane_frame(looking_down(x)) for x in np.tan(np.radians(np.linspace(-8.5, 8.5, 18)))])
    assert few.neighbours(9, 4, independent) == []
    assert few.neighbours(9, 4, independent, least) == few.neighbours(9, 4, least) != []


def test_space_of_interest_is_where_the_axes_meet(sequence):
    _, frames = sequence
    grid = space_of_interest(frames)
    middle = 0.5 * (grid.low_m + grid.high_m)
    np.testing.assert_allclose(middle, [0, 0, 0.07], atol=0.03)
    one = space_of_interest(frames[:1])
    assert (one.low_m < frames[0].T_world_camera.apply([0, 0, 0.9])).all()


def test_command_writes_the_three_files(sequence, tmp_path, capsys):
    _, frames = sequence
    scan = tmp_path / "scan"
    (scan / "depth").mkdir(parents=True)
    for frame in frames[::2]:
        write_depth(scan / "depth" / f"{frame.index:06d}.png", frame.depth_m, 1e-4)
    write_poses(scan / "poses.txt", [(frame.t_s, frame.T_world_camera) for frame in frames[::2]])
    frames[0].camera.save(scan / "camera.yaml")
    save_yaml(scan / "sequence.yaml", {"sensor": "simulated", "depth_scale_m": 1e-4, "camera": "camera.yaml"})
    words = ["reconstruct", str(scan), "--out", str(tmp_path / "out"), "--voxel-m", "0.01", "--json"]
    words += ["--space", "-0.4", "-0.4", "0", "0.4", "0.4", "0.3"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    clusters = json.loads((tmp_path / "out" / "regions.json").read_text())["clusters"]
    assert len(clusters) == len(told["regions"]) > 0
    assert {"hull", "centroid", "size", "score"} <= set(clusters[0])
    points = read_ply(tmp_path / "out" / "transparency.ply")
    assert len(points.vertices_m) == len(points.fields["score"]) > 0
    assert len(read_ply(tmp_path / "out" / "surface.ply").faces) > 1000
    assert main(["reconstruct", str(tmp_path / "nothing"), "--out", str(tmp_path)]) == 2


def test_a_reading_that_most_views_contradict_is_no_surface():
    """Two of eight views agree with a reading by chance behind glass; the other six see a nearer surface."""
    camera = Camera.simple(64, 48, 60.0)
    depths = np.full((9, 48, 64), 1.0, np.float32)
    patch = (slice(None), slice(18, 30), slice(24, 40))
    depths[0][patch[1:]] = 1.06
    depths[1:3][patch] = 1.06
    frames = [
        DepthFrame(0.0, d, None, Pose(np.eye(3), np.array([0.0, 0.0, 1e-4 * k])), camera)
        for k, d in enumerate(depths)
    ]
    noise = TrackedNoise(SENSOR_NOISE["kinect"])
    views = [ViewDepth.of_frame(frame, noise) for frame in frames]
    reading = ray_image(views[0], views[1:], noise).reading[patch[1:]]
    assert (reading == 2).mean() > 0.9  # farther than the surface that six views see


def test_what_the_second_eye_does_not_have_in_its_image_is_no_evidence():
    """A table from twelve sides within 86 degrees; a stereo camera of 5 cm matches nothing in its leftmost f b / z columns."""
    camera, rng = Camera.simple(160, 120, 140.0), np.random.default_rng(2)
    frames = []
    for k, turn in enumerate(np.linspace(0, 1.5, 12)):
        pose = Camera.pose_of_view((0.5 * np.cos(turn), 0.5 * np.sin(turn), 0.4), (0.0, 0.0, 0.0))
        columns, rows = np.meshgrid(np.arange(160.0), np.arange(120.0))
        rays = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2)).reshape(120, 160, 3)
        depth_m = -pose.translation_m[2] / (rays @ pose.rotation.T)[..., 2]
        lost = (columns < 140.0 * 0.05 / depth_m) | (rng.random(depth_m.shape) < 0.003)
        depth_m += 0.0038 * depth_m**2 * rng.standard_normal(depth_m.shape)
        frames.append(
            DepthFrame(0.1 * k, np.where(lost, np.nan, depth_m).astype(np.float32), None, pose, camera)
        )
    grid = SpaceGrid.around((-0.4, -0.4, 0.0), (0.4, 0.4, 0.3), 0.02)
    detector = EvidenceDetector(grid, SENSOR_NOISE["realsense_d435"])
    detector.run(frames)
    assert detector.report().compared == 12
    # Of one view a window holds several drop-outs of 0.3 % by chance, and no two views agree on one; strips together have 7.
    assert detector.evidence.max() < 3.0


@pytest.mark.parametrize("seed", range(4))
def test_sums_of_evidence_are_those_of_every_voxel_by_itself(seed):
    rng = np.random.default_rng([17, seed])
    camera = Camera.simple(60, 44, 50.0)
    eyes = [(0.5 * np.cos(a), 0.5 * np.sin(a), rng.uniform(0.1, 0.6)) for a in rng.uniform(0, 6, 5)]
    # One camera is in the volume, and sees some of it behind itself.
    poses = [Camera.pose_of_view(eye, (0.0, 0.0, 0.1)) for eye in (*eyes, (0.1, 0.05, 0.12))]
    frames = [DepthFrame(0.0, np.ones((44, 60), np.float32), None, pose, camera) for pose in poses]
    shape = (len(frames), 44, 60)
    limit_m = np.where(rng.random(shape) < 0.9, rng.uniform(0.3, 0.9, shape), 0.0).astype(np.float32)
    # Most of the images speaks against glass, so that some blocks are left out.
    found = np.full(shape, -1.0, np.float32)
    found[:, 16:26, 24:36] = rng.normal(0.5, 1.0, (len(frames), 10, 12))
    reaching = (0.1 * found - 0.02).astype(np.float32)
    weights = rng.uniform(0.3, 1.0, len(frames)).astype(np.float32)
    grid = SpaceGrid.around((-0.2, -0.21, -0.1), (0.2, 0.2, 0.26), 0.013)
    evidence, extent, seen = RayEvidence(frames, weights, limit_m, found, reaching).sums(grid)

    def each_by_itself(points_m):
        """Sums at points, and whether all of them are away from the edge of a pixel and from the end of a ray."""
        sums, plain = np.zeros((3, len(points_m))), np.ones(len(points_m), dtype=bool)
        for k, pose in enumerate(poses):
            local = pose.inverse().apply(points_m)
            place = camera.project(np.maximum(local, [-np.inf, -np.inf, 0.05])) + 0.5
            u, v = np.floor(place).astype(int).T
            held = (local[:, 2] > 0.05) & (u >= 0) & (v >= 0) & (u < 60) & (v < 44)
            plain &= ~held | (np.abs(place - np.rint(place)).min(axis=1) > 1e-4)
            at = v[held], u[held]
            plain[held] &= np.abs(local[held, 2] - limit_m[k][at]) > 1e-5
            held[held] = local[held, 2] < limit_m[k][at]
            at = v[held], u[held]
            sums[:, held] += weights[k] * np.array([found[k][at], reaching[k][at], np.ones(held.sum())])
        return sums, plain

    truth, same = each_by_itself(grid.centres_m(np.argwhere(np.ones(grid.shape, dtype=bool))))
    assert same.mean() > 0.99
    starts = [np.arange(0, size, 8) for size in grid.shape]
    middles = [0.5 * (start + np.minimum(start + 8, n)) for start, n in zip(starts, grid.shape, strict=True)]
    blocks = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1)
    at_blocks, plain = each_by_itself(grid.low_m + grid.voxel_m * blocks.reshape(-1, 3))
    np.testing.assert_allclose(seen.ravel()[plain], at_blocks[2][plain], atol=1e-5)
    either = ((truth[0] > 0) | (truth[1] > 0)) & same
    assert either.any()
    for ours, expected in zip((evidence.ravel(), extent.ravel()), truth[:2], strict=True):
        assert np.isclose(ours, expected, atol=1e-4)[either].mean() > 0.999
        # Elsewhere neither is positive, and what is told is no less than it is.
        assert ((ours <= 1e-4) | either | ~same).all()
        assert (ours >= expected - 1e-4)[same].mean() > 0.999
    left_out = ~np.isclose(evidence.ravel(), truth[0], atol=1e-4) & same
    assert left_out.sum() > 100


def test_equations_of_poses_are_the_derivative_of_the_distances_from_planes():
    rng = np.random.default_rng(31)
    camera = Camera.simple(40, 30, 35.0)
    poses = [Camera.pose_of_view((x, -0.6, 0.8), (0.0, 0.1 * x, 0.0)) for x in (-0.2, 0.1, 0.3)]
    row, column = np.mgrid[:30, :40]
    waves = [0.9 + 0.05 * np.sin(0.2 * a * column + 0.3 * b * row) for a, b in rng.uniform(0.3, 1.0, (3, 2))]
    # A step, and what is not measured, have no normal.
    depths = np.where(column < 30, waves, 1.2).astype(np.float32)
    depths[rng.random((3, 30, 40)) < 0.03] = np.nan
    surface = camera.rays(np.stack([column, row], axis=-1).reshape(-1, 2).astype(float)).reshape(30, 40, 3)
    surface = surface * depths[..., None]
    normals = np.full((3, 30, 40, 3), np.nan)
    right, down = (
        np.roll(surface, -2, axis) - np.roll(surface, 2, axis) for axis in (2, 1)
    )  # of the middle of the images
    normals[:, 2:-2, 2:-2] = np.cross(right, down)[:, 2:-2, 2:-2]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[np.maximum(np.abs(right[..., 2]), np.abs(down[..., 2])) > 0.1 * depths] = np.nan
    for depth, normal in zip(depths, normals, strict=True):
        found = np.empty((1200, 3))
        found = found[: smooth_points(depth, 1, 35.0, 35.0, *camera.matrix[:2, 2], found)]
        plain = np.isfinite(normal[..., 0]) & (depth > 0)
        assert 100 < len(found) < 1000
        np.testing.assert_allclose(
            camera.project(found), np.column_stack([column[plain], row[plain]]), atol=1e-9
        )
        np.testing.assert_allclose(found[:, 2], depth[plain])
    normals[~(depths > 0)] = np.nan
    points, firsts = rng.uniform((-0.4, -0.3, 0.7), (0.4, 0.3, 1.2), (60, 3)), np.array([0, 25, 40, 60])
    pairs, reach, (least, correlated) = np.array([[0, 1], [1, 0], [2, 0], [1, 2]]), 0.2, (5e-4, 2.0)
    squares, pulls = np.empty((4, 6, 6)), np.empty((4, 6))
    numbers = reach, 0.002, 0.001, 0.4, least, correlated
    places = pairs, points, firsts, 1, np.array([pose.matrix[:3] for pose in poses])
    plane_equations(*places, depths, 35.0, 35.0, *camera.matrix[:2, 2], *numbers, squares, pulls)
    for (i, k), square, pull in zip(pairs, squares, pulls, strict=True):
        here = points[firsts[i] : firsts[i + 1]]

        def distances(motion, i=i, k=k, here=here):
            """Of the points from the planes where they are seen at first, after a motion of the points in the world."""
            world = poses[i].apply(here)
            column, row = np.rint(camera.project(poses[k].inverse().apply(world))).astype(int).T
            held = (column >= 0) & (row >= 0) & (column < 40) & (row < 30)
            column, row = column[held], row[held]
            moved = Pose.from_rotation_vector(motion[:3], motion[3:]).apply(world[held])
            local = poses[k].inverse().apply(moved)
            seen = camera.rays(np.column_stack([column, row]).astype(float)) * depths[k, row, column, None]
            return ((local - seen) * normals[k, row, column]).sum(axis=1), local[:, 2]

        away, depth_m = distances(np.zeros(6))
        step = 1e-6 * np.eye(6)
        slopes = np.column_stack([(distances(s)[0] - distances(-s)[0]) / 2e-6 for s in step])
        used = np.abs(away) < reach
        sigma = math.sqrt(2) * (0.001 + 0.002 * (depth_m - 0.4) ** 2) + least
        weights = (1 / (1 + (away / (3 * sigma)) ** 2) / sigma)[used] ** 2 / correlated
        assert used.sum() >= 5
        scale = np.abs(square).max()
        np.testing.assert_allclose(square, (slopes[used].T * weights) @ slopes[used], atol=1e-5 * scale)
        np.testing.assert_allclose(pull, slopes[used].T @ (weights * away[used]), atol=1e-5 * scale)

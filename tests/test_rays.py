"""The ray caster of clear glass against formulas: Snell, Fresnel, a plane, a plate, a ball, stereo shadows, drop-outs."""

import numpy as np
import pytest

from tests.worlds.ray_objects import KINDS, PLAIN, can, random_vessel
from tests.worlds.ray_optics import CLEAR, Box, Revolved, cast, compile_scene, fresnel_transmission, refract
from tests.worlds.ray_scenes import FAMILIES, layout, sequence
from tests.worlds.rays import DepthCamera, Imperfections, World, look, read

#: Looks straight down: rows to the south.
DOWN = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])
SMALL = DepthCamera(96, 72, 83.0)


def _table(half_m: float = 3.0) -> Box:
    return Box(np.array([0, 0, -0.05]), np.array([half_m, half_m, 0.05]), 0.0, PLAIN)


def test_refraction_obeys_snell_and_is_total_beyond_the_critical_angle():
    rng = np.random.default_rng(0)
    for _ in range(200):
        before, behind = rng.uniform(1, 1.8, 2)
        angle = rng.uniform(0, np.pi / 2)
        x, y, z, mirrored = refract(np.sin(angle), 0.0, -np.cos(angle), 0.0, 0.0, 1.0, before / behind)
        assert np.hypot(x, z) == pytest.approx(1.0)
        assert y == 0.0
        assert mirrored == (before * np.sin(angle) > behind)
        if mirrored:
            assert (x, z) == pytest.approx((np.sin(angle), np.cos(angle)))
        else:
            assert behind * x == pytest.approx(before * np.sin(angle))
            assert z < 0


def test_fresnel_at_normal_incidence_and_at_brewsters_angle():
    assert fresnel_transmission(1.0, 1.0, 1.5) == pytest.approx(4 * 1.5 / 2.5**2)
    brewster = np.arctan(1.5)
    # There only the light across the plane is reflected: ((n^2 - 1) / (n^2 + 1))^2 of it.
    across = ((1.5**2 - 1) / (1.5**2 + 1)) ** 2
    assert fresnel_transmission(np.cos(brewster), 1.0, 1.5) == pytest.approx(1 - across / 2)
    assert fresnel_transmission(np.cos(0.8), 1.5, 1.0) == 0.0  # beyond 0.73 rad


def _solid(path: np.ndarray, position_m: tuple[float, float, float], index: float) -> Revolved:
    media = np.broadcast_to([1.0, index], (len(path) - 1, 2))
    pieces = np.concatenate([path[:-1], path[1:], media], axis=1)
    return Revolved(pieces, np.array(position_m), CLEAR)


def test_a_handle_touches_its_vessel_and_close_vessels_leave_a_gap():
    for seed in range(len(FAMILIES["close"])):
        plan = layout("close", 2 * seed)
        if len(plan.vessels) == 2:
            (a, b) = plan.vessels
            apart = np.hypot(*(a.position_m - b.position_m)[:2]) - a.outer[:, 0].max() - b.outer[:, 0].max()
            assert 0.02 <= apart <= 0.04, plan.kind
        for handle in (one for one in plan.objects if one.material == CLEAR):
            turn = np.linspace(0, 2 * np.pi, 60)
            rows = handle.pieces[:, :2]
            ring = np.stack(
                [np.outer(rows[:, 0], f(turn)) for f in (np.cos, np.sin)] + [np.outer(rows[:, 1], turn**0)],
                axis=-1,
            )
            points = ring.reshape(-1, 3) @ handle.rotation.T + handle.position_m
            assert points[:, 2].min() > 0.0
            assert 0 < plan.vessels[0].distance(points).min() < 0.004


def test_a_plate_shifts_a_ray_by_the_textbook_amount():
    thick, index = 0.02, 1.5
    plate = np.array([[0, 0], [2, 0], [2, thick], [0, thick]])
    scene = compile_scene([_solid(plate, (0, 0, 0.3), index)], [_table()])
    for angle in (0.0, 0.3, 0.7, 1.1):
        ray = np.array([[np.sin(angle), 0.0, -np.cos(angle)]])
        hit = cast(scene, np.array([0, 0, 0.5]), ray)
        inside = np.arcsin(np.sin(angle) / index)
        expected = (0.5 - thick) * np.tan(angle) + thick * np.tan(inside)
        assert hit.point_m[0] == pytest.approx([expected, 0, 0], abs=1e-6)
        assert hit.first[0] == 0
        assert hit.owner[0] == 1


def _through_ball(eye: np.ndarray, ray: np.ndarray, radius: float, index: float) -> np.ndarray:
    """Where a ray through a ball at the origin meets the plane z = -0.3, by vectors."""
    for ratio in (1 / index, index):
        b = eye @ ray
        root = np.sqrt(b * b - eye @ eye + radius**2)
        eye = eye + (-b - root if ratio < 1 else -b + root) * ray
        normal = eye / radius * (1 if ratio < 1 else -1)
        cosine = -normal @ ray
        ray = ratio * ray + (ratio * cosine - np.sqrt(1 - ratio**2 * (1 - cosine**2))) * normal
    return eye + ray * (-0.3 - eye[2]) / ray[2]


def test_a_ball_of_many_pieces_refracts_as_a_sphere():
    radius, index, eye = 0.05, 1.5, np.array([0.02, -0.01, 0.5])
    targets = np.random.default_rng(1).uniform(-0.03, 0.03, (50, 3)) * [1, 1, 0]
    rays = (targets - eye) / np.linalg.norm(targets - eye, axis=1, keepdims=True)
    expected = np.array([_through_ball(eye, ray, radius, index) for ray in rays])
    errors = []
    for count in (100, 200):
        angle = np.linspace(-np.pi / 2, np.pi / 2, count + 1)
        path = radius * np.column_stack([np.abs(np.cos(angle)), np.sin(angle)])
        box = Box(np.array([0, 0, -0.35]), np.array([3, 3, 0.05]), 0.0, PLAIN)
        hits = cast(compile_scene([_solid(path, (0, 0, 0), index)], [box]), eye, rays)
        errors.append(np.abs(hits.point_m - expected).max())
    # A facet's normal is off by half its angle, pi / 2 / count; two faces bend by half of that each, 0.3 m away.
    assert errors[0] < 0.3 * np.pi / 100
    assert errors[1] < 0.7 * errors[0]


@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_a_plane_has_its_depth(tilt):
    camera = DepthCamera()
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    rotation = turn @ DOWN
    eye = np.array([0.0, 0.0, 0.6])
    raw = look(World([], [_table()]), camera, eye, rotation)
    depth = camera.focal_px * camera.baseline_m / raw.disparity_px
    rays = camera.directions(rotation)
    expected = (-0.6 / rays[:, 2] * (rays @ rotation[:, 2])).reshape(depth.shape)
    inner = np.isfinite(depth)
    inner[:, :40] = False  # what the right eye does not see
    assert inner[1:-1, 40:-1].all()
    # Windows are exact to about a hundredth of a pixel on a tilted plane: 0.01 / 15.2 of the depth.
    assert np.abs(depth / expected - 1)[2:-2, 42:-2].max() < 0.002


def test_the_stereo_shadow_is_on_the_left_and_as_wide_as_its_disparities_differ():
    camera = DepthCamera()
    block = Box(np.array([0.02, 0, 0.1]), np.array([0.06, 0.08, 0.1]), 0.0, PLAIN)
    raw = look(World([], [_table(), block]), camera, np.array([0, 0, 0.6]), DOWN)
    row = raw.disparity_px[120]
    nothing = np.flatnonzero(np.isnan(row[30:])) + 30
    near = np.flatnonzero(raw.first_m[120] < 0.41)
    width = camera.focal_px * camera.baseline_m * (1 / 0.4 - 1 / 0.6)
    assert (nothing < near[0]).all()
    # Windows reach over an edge by one pixel on either side.
    assert len(nothing) == pytest.approx(width, abs=2.0)
    assert near[0] - nothing.max() <= 2


@pytest.mark.parametrize("lost", [0.45, 0.77])
def test_glass_loses_as_many_readings_as_asked_for_and_opaque_surfaces_hardly_any(lost):
    rng = np.random.default_rng(3)
    vessels = [random_vessel("bottle", rng, (-0.08, 0)), random_vessel("glass", rng, (0.08, 0))]
    world = World([vessel.solid() for vessel in vessels], [_table()])
    tilt = 0.6
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    raw = look(world, DepthCamera(), np.array([0, -0.35, 0.5]), turn @ DOWN)
    assert raw.glass.sum() > 2000
    depth = read([raw], Imperfections(lost_glass=lost, near_glass=0.0), rng)[0]
    # Highlights read the glass itself: some hundredths come back.
    assert np.isnan(depth[raw.glass]).mean() == pytest.approx(lost, abs=0.05)
    away = ~raw.glass & (np.abs(raw.quality - 1) < 0.01)
    assert np.isnan(depth[away]).mean() == pytest.approx(Imperfections().lost_opaque, abs=0.002)
    through = raw.glass & np.isfinite(depth)
    # What is read there is nearly always behind the glass.
    assert np.mean(depth[through] > raw.first_m[through]) > 0.9
    assert np.allclose(depth[np.isfinite(depth)] * 1000, np.rint(depth[np.isfinite(depth)] * 1000), atol=1e-3)


def test_a_black_can_drops_out_and_a_bright_one_does_not():
    for material, expected in ((0, (0.0, 0.05)), (1, (0.3, 0.8))):
        world = World([can(0.05, 0.1, (0, 0, 0), material)], [_table()])
        raw = look(world, DepthCamera(), np.array([0, 0, 0.6]), DOWN)
        depth = read([raw], Imperfections(), np.random.default_rng(0))[0]
        top = (raw.material == material) & (raw.first_m < 0.51)
        assert expected[0] <= np.isnan(depth[top]).mean() <= expected[1]


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_of_a_vessel_lies_on_its_surface(kind):
    rng = np.random.default_rng(2)
    vessel = random_vessel(kind, rng, (0.1, -0.1), filled=True)
    points = vessel.surface(rng, 300)
    assert vessel.distance(points).max() < 1e-9
    low, high = vessel.bounds_m
    assert ((points >= low - 1e-9) & (points <= high + 1e-9)).all()
    assert vessel.distance(np.array([[0.1, -0.1, 1.0]]))[0] > 0.5
    # Walls of 2.5 to 3 mm: the cavity keeps its distance from the outer side, but at the rim.
    flat = np.column_stack(
        [vessel.inner[2:-2, 0] + 0.1, np.full(len(vessel.inner) - 4, -0.1), vessel.inner[2:-2, 1]]
    )
    flat[:, 2] += vessel.position_m[2]
    wall = vessel.distance(flat)
    assert np.abs(np.median(wall) - vessel.wall_m) < 3e-4


def test_both_halves_of_the_seeds_have_all_kinds_and_scenes_are_repeatable():
    for family, kinds in FAMILIES.items():
        for half in (0, 1):
            assert {layout(family, half + 2 * k).kind for k in range(len(kinds))} == set(kinds)
    first, again = layout("clear", 4), layout("clear", 4)
    assert np.array_equal(first.T_world_camera, again.T_world_camera)
    assert not np.array_equal(first.T_world_camera, layout("clear", 5).T_world_camera)


def test_a_sequence_is_kept_and_its_views_keep_their_poses(tmp_path):
    whole = sequence("clear", 0, tmp_path, SMALL)
    kept = sequence("clear", 0, tmp_path, SMALL)
    assert len(list(tmp_path.iterdir())) == 1
    assert np.array_equal(whole.depth_m, kept.depth_m, equal_nan=True)
    assert whole.depth_m.shape == (48, 72, 96)
    assert len(whole.vessels) == 2
    few = whole.views(8, shuffle=True)
    for depth, pose in zip(few.depth_m, few.T_world_camera, strict=True):
        index = next(k for k in range(48) if np.array_equal(whole.T_world_camera[k], pose))
        assert index % 6 == 0
        assert np.array_equal(depth, whole.depth_m[index], equal_nan=True)
    off = whole.views(48, noise=(0.002, np.radians(0.3)))
    away = off.T_world_camera[:, :3, 3] - whole.T_world_camera[:, :3, 3]
    # 144 samples: the standard deviation is known to 6 %.
    assert away.std() == pytest.approx(0.002, rel=0.25)

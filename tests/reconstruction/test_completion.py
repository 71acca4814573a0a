"""Exploration of bottles with a known hidden wall: it converges, remains stable, and uses free space."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.reconstruction.scenes import part
from visuohaptic.cli.main import main
from visuohaptic.core import InputError
from visuohaptic.core.camera import Pose
from visuohaptic.io.meshes import read_ply
from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.reconstruction.completion import (
    Completion,
    CompletionSettings,
    HoleRegion,
    Touch,
    boundary_loops,
    fit_prior,
    fit_radial_mixture,
    fit_radial_model,
    load_hole_regions,
    radial_model,
    read_touches,
    support_band,
    wall_seen,
)
from visuohaptic.reconstruction.completion.touch import starts
from visuohaptic.reconstruction.surfaces import RbfSurface
from visuohaptic.simulation.tabletop import Bottle, random_bottle

SIGMA_M = 0.0003


def scene(bottle, shrink=0.9, hole=(0.27, 0.73)):
    low, high = hole[0] * bottle.height_m, hole[1] * bottle.height_m
    visible = SurfaceMesh(*bottle.mesh(0.0, low)).joined(SurfaceMesh(*bottle.mesh(high, bottle.height_m)))
    hidden, _ = bottle.mesh(low, high, caps=False)
    centre = hidden.mean(axis=0)
    return visible, HoleRegion.of_points(centre + shrink * (hidden - centre)), (low, high)


def rms_m(completion, bottle, hole_m):
    """Radial error of the surface's vertices in the hole."""
    points = completion.surface().vertices_m
    points = points[(points[:, 2] > hole_m[0]) & (points[:, 2] < hole_m[1])]
    wall = bottle.radius_m(np.arctan2(points[:, 1], points[:, 0]), points[:, 2])
    return float(np.sqrt(np.mean((np.hypot(points[:, 0], points[:, 1]) - wall) ** 2)))


def explore(bottle, rng, touches, **settings):
    visible, region, hole = scene(bottle)
    completion = Completion(visible, region, CompletionSettings(**settings))
    rms = [rms_m(completion, bottle, hole)]
    for _ in range(touches):
        plan = completion.next_touch()
        length = np.linalg.norm(plan.end_m - plan.start_m)
        contact = bottle.probe(plan.start_m, plan.direction, length, sigma_m=SIGMA_M, rng=rng)
        completion.add(Touch(contact, plan.start_m, plan.end_m, SIGMA_M))
        rms.append(rms_m(completion, bottle, hole))
    return completion, np.array(rms)


@pytest.mark.parametrize("seed", [4, 6])
def test_a_region_wider_than_the_bottle_does_not_push_its_wall_outwards(seed):
    bottle = random_bottle(np.random.default_rng(seed), "round")
    visible, exact, hole = scene(bottle, shrink=1.0)
    radius_m = np.hypot(*exact.hull_m[:, :2].T)
    wide_m = exact.hull_m.copy()
    # Windows of a Kinect with 240 columns at 1 m widened the region of a bottle on a table by 25 mm on each side.
    wide_m[:, :2] *= (1 + 0.025 / radius_m)[:, None]
    wide = Completion(visible, HoleRegion.of_points(wide_m))
    # The core of the wide region is outside the bottle: its error was 1.9 times that of the exact region for seed 6.
    assert rms_m(wide, bottle, hole) < 1.1 * rms_m(Completion(visible, exact), bottle, hole)
    same = exact.clipped(wide.axis_m, exact.hull_m)  # not wider than the walls
    np.testing.assert_allclose(same.distance_m(exact.hull_m), 0.0, atol=1e-7)
    reach_m = np.hypot(*(wide.band.walls_m[:, :2] - wide.axis_m).T).max()
    clipped_m = wide.region.clipped(wide.axis_m, wide.band.walls_m).hull_m
    assert np.hypot(*(clipped_m[:, :2] - wide.axis_m).T).max() <= reach_m + 1e-12
    assert wide.region.clipped(wide.axis_m, np.zeros((0, 3))) is wide.region


def bellied(kind="round"):
    """A bottle whose visible parts say nothing of its belly."""
    aspect = 1.0 if kind == "round" else 0.75
    return Bottle(
        kind,
        0.2,
        # The hole is from 0.054 to 0.146: the belly begins and ends within it.
        np.array([0.0, 0.065, 0.135, 0.16, 0.185, 0.2]),
        np.array([0.03, 0.03, 0.03, 0.028, 0.015, 0.015]),
        np.array([0.0, 0.012, 0.0, 0.0, 0.0]),
        aspect,
        0.8 if kind == "flattened" else 10.0,
    )


@pytest.mark.parametrize(("kind", "priors"), [("round", True), ("flattened", True), ("elliptic", False)])
def test_touches_find_a_hidden_belly(kind, priors):
    touches = 6 if priors else 12
    _, rms = explore(bellied(kind), np.random.default_rng(1), touches, use_priors=priors)
    assert rms[0] > 0.004  # the extension alone misses the belly of 12 mm
    # Mean square down to a tenth, as in Alt 2016, Fig. 5.8, is the root down to 0.32.
    assert rms[-1] < 0.32 * rms[0]


def test_the_priors_need_fewer_touches():
    _, with_priors = explore(bellied(), np.random.default_rng(1), 4)
    _, without = explore(bellied(), np.random.default_rng(1), 4, use_priors=False)
    assert with_priors[-1] < 0.7 * without[-1]


@pytest.mark.parametrize("seed", range(2))
def test_random_bottles_never_blow_up(seed):
    rng = np.random.default_rng([5, seed])
    completion, rms = explore(random_bottle(rng), rng, 8)
    assert rms.max() < max(1.5 * rms[0], 0.001)
    # Where the bands speak against a symmetry (seed 0: probability 0.13) its rings weigh little, and touches win less.
    gain = 0.5 if completion.prior.p_sweep > 0.5 else 0.6
    assert rms[-1] < max(gain * rms[0], 0.0007)


def test_contradicting_touches_at_one_place_do_not_tilt_the_surface():
    """The cause of the blow-up at touch 19 of object C: noise over a distance as small is a slope of one."""
    bottle = bellied()
    visible, region, hole = scene(bottle)
    completion = Completion(visible, region, CompletionSettings(use_priors=False))
    rng = np.random.default_rng(0)
    for z in (0.08, 0.1, 0.12):
        for angle in np.arange(5) * 2 * np.pi / 5:
            rho = float(bottle.radius_m(angle, z))
            completion.add(Touch(np.array([rho * np.cos(angle), rho * np.sin(angle), z]), sigma_m=0.0005))
    before = rms_m(completion, bottle, hole)
    for k in range(5):
        rho = float(bottle.radius_m(0.3, 0.1)) + (0.001 if k % 2 else -0.001)
        contact = np.array([rho * np.cos(0.3), rho * np.sin(0.3), 0.1]) + rng.normal(0, 1e-4, 3)
        completion.add(Touch(contact, sigma_m=0.0005))
        assert rms_m(completion, bottle, hole) < before + 0.0005
    # Interpolation of all touches is what tilted: the same centres without smoothing.
    visible_fit = completion._visible
    contacts = np.array([touch.contact_m for touch in completion.touches])
    exact = visible_fit.added(contacts, np.zeros(len(contacts)), 0.0)
    theta, z = (part.ravel() for part in np.meshgrid(np.linspace(0, 0.6, 30), np.linspace(0.085, 0.115, 15)))
    rho = bottle.radius_m(theta, z)
    wall = np.column_stack([rho * np.cos(theta), rho * np.sin(theta), z])
    smooth = np.linalg.norm(completion.implicit.gradient(wall), axis=1)
    tilted = np.linalg.norm(exact.gradient(wall), axis=1)
    # The slope of a distance is one; noise of 2 mm over 0.1 mm makes it many times that.
    assert np.ptp(tilted) > 3 * np.ptp(smooth)


def test_a_miss_keeps_the_surface_off_the_line_and_no_line_is_repeated():
    bottle = bellied()
    visible, region, _ = scene(bottle)
    completion = Completion(visible, region)
    plan = completion.next_touch()
    inner = plan.target_m + 0.008 * plan.direction
    assert completion.implicit(inner[None])[0] < 0
    completion.add(Touch(None, plan.start_m, inner))
    # Free points are held to a quarter of the off-surface distance, 5 % of the region.
    assert completion.implicit(inner[None])[0] > -0.25 * 0.05 * region.size_m
    again = completion.next_touch()
    assert np.linalg.norm(again.target_m - plan.target_m) > 0.003
    # Nor is a line whose contact was short of the target: others are 5 % of the region away.
    completion.add(Touch(again.target_m - 0.005 * again.direction, again.start_m, again.end_m, 0.02))
    way = completion.next_touch().target_m - again.start_m
    assert np.linalg.norm(np.cross(way, again.direction)) > 0.05 * region.size_m
    # What is behind a visible wall is not met from before it; the wall is.
    walls_m = completion.band.walls_m[:50]
    away = (walls_m[:, :2] - completion.axis_m) @ np.eye(2, 3)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    starts_m = walls_m + 0.05 * away
    assert not completion.band.in_front(walls_m - 0.012 * away, starts_m, 0.008).any()
    assert completion.band.in_front(walls_m, starts_m, 0.008).mean() > 0.9


def test_lines_to_several_targets_start_outside_each_at_its_height():
    targets = np.array([[0.13, 0.2, 0.1], [0.1, 0.24, 0.3], [0.07, 0.2, 0.2]])
    found = starts(targets, np.array([0.1, 0.2]), np.array([[0.15, 0.2, 0.0]]), 0.01)
    # The supports reach 5 cm and twice the clearance of 1 cm; one target is 4 cm from the axis, twice that is more.
    np.testing.assert_allclose(found, [[0.17, 0.2, 0.1], [0.1, 0.28, 0.3], [0.03, 0.2, 0.2]])


def test_the_line_is_level_points_at_the_axis_and_starts_outside():
    bottle = bellied("elliptic")
    visible, region, _ = scene(bottle)
    completion = Completion(visible, region)
    plan = completion.next_touch()
    assert abs(plan.direction[2]) < 1e-12
    assert np.linalg.norm(plan.direction) == pytest.approx(1.0)
    assert np.linalg.norm(np.cross(plan.end_m - plan.start_m, plan.target_m - plan.start_m)) < 1e-9
    assert np.linalg.norm(plan.end_m[:2]) < 0.001  # the axis of the bottle is that of z
    assert completion.implicit(plan.start_m[None])[0] > 0.01
    assert np.hypot(*plan.start_m[:2]) > np.hypot(*bottle.mesh()[0][:, :2].T).max()


def test_nothing_is_missing_below_the_table():
    """Only the upper half is seen: lines go to different heights of the wall, not again and again to its foot."""
    bottle = random_bottle(np.random.default_rng(4), "round")
    half_m, floor_m = 0.5 * bottle.height_m, 0.01
    hidden, _ = bottle.mesh(0.0, half_m, caps=False)
    completion = Completion(
        SurfaceMesh(*bottle.mesh(half_m, bottle.height_m)), HoleRegion.of_points(hidden), CompletionSettings(floor_m=floor_m)
    )  # fmt: skip
    heights = []
    for _ in range(5):
        plan = completion.next_touch()
        heights.append(float(plan.start_m[2]))
        contact = bottle.probe(plan.start_m, plan.direction, 1.0)
        completion.add(Touch(contact, plan.start_m, plan.end_m, SIGMA_M))
    assert min(heights) >= floor_m
    # Five lines over 45 mm and more: those of one height would be nine millimetres apart at least.
    assert np.diff(np.sort(heights)).max() > 0.1 * half_m
    found = completion.uncertainty()
    assert (found.mesh.vertices_m[found.missing, 2] >= floor_m).all()


def test_fingers_spread_and_keep_their_reach():
    visible, region, _ = scene(bellied())
    plans = Completion(visible, region).next_touches([(0.02, 0.08), (0.02, 0.08), (5.0, 6.0)])
    assert len(plans) == 3  # the last reaches nothing
    gaps = [np.linalg.norm(plan.start_m - plans[0].start_m) for plan in plans[1:]]
    assert all(0.02 <= gap <= 0.08 for gap in gaps)
    assert np.linalg.norm(plans[1].target_m - plans[2].target_m) > 0.01


def test_uncertainty_is_honest_and_stops_the_exploration():
    completion, rms = explore(bellied(), np.random.default_rng(1), 5)
    fresh = Completion(*scene(bellied())[:2])
    assert not fresh.done(1.0)  # never before the hidden part was touched
    assert completion.done(0.01)
    assert not completion.done(1e-5)
    # Within a factor of eight of the truth: it is the deviation of a smooth process, not of this bottle.
    assert 1 / 8 < completion.expected_error_m() / rms[-1] < 8


def test_the_deviation_is_that_of_vision_where_it_was_seen_and_larger_in_the_hole():
    bottle = bellied()
    visible, region, (low_m, high_m) = scene(bottle)
    completion = Completion(visible, region)
    completed = completion.completed()
    sigma_m = completion.sigma_m(completed.vertices_m)
    z = completed.vertices_m[:, 2]
    assert (sigma_m[(z < low_m - 0.01) | (z > high_m + 0.01)] == CompletionSettings().visual_sigma_m).all()
    middle = np.abs(z - 0.1) < 0.02
    assert sigma_m[middle].min() > 2 * CompletionSettings().visual_sigma_m  # the belly hides 12 mm


def test_a_surface_that_leaves_profile_and_cross_section_is_told_where_it_does():
    bottle = bellied("elliptic")
    visible, region, _ = scene(bottle)
    band = support_band(visible, region)
    prior = fit_prior(band.points_m, band.normals, 0.1)
    contacts = []
    for z in np.arange(0.06, 0.15, 0.01):
        rho = float(bottle.radius_m(np.array(1.0), np.array(z)))
        contacts.append((np.array([rho * np.cos(1.0), rho * np.sin(1.0), z]), 1e-4))
    theta, z = (part.ravel() for part in np.meshgrid(np.linspace(-3, 3, 40), np.linspace(0.075, 0.125, 20)))
    rho = bottle.radius_m(theta, z)
    dent_m = 0.004 * np.exp(-((theta / 0.4) ** 2) - ((z - 0.1) / 0.01) ** 2)

    def told(radius):
        points = np.column_stack([radius * np.cos(theta), radius * np.sin(theta), z])
        return fit_radial_mixture(prior, wall_seen(prior, band), contacts, region.size_m).deviation_m(points)

    # The wall is known to 0.1 mm every 10 mm: what is left is the fit of the cross-section.
    assert np.median(told(rho)) < 0.0008
    off_m = told(rho - dent_m)
    assert off_m[np.argmax(dent_m)] > 0.6 * dent_m.max()
    assert off_m[dent_m > 0.002].min() > 2 * np.median(off_m[dent_m < 1e-5])


def test_a_surface_without_triangles_is_refused():
    region = HoleRegion.of_points(np.random.default_rng(0).normal(size=(50, 3)))
    with pytest.raises(InputError, match="away from the surface"):
        support_band(SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int)), region)


def test_a_mirrored_contact_is_on_the_other_side_where_the_cross_section_changes():
    rng = np.random.default_rng(2)
    turn = 0.4
    theta = rng.uniform(-np.pi, np.pi, 600)
    low = np.arange(600) < 300
    z = np.where(low, rng.uniform(0.0, 0.04, 600), rng.uniform(0.14, 0.18, 600))

    def wall(angle, aspect):
        return 0.03 / np.sqrt(np.cos(angle - turn) ** 2 + (np.sin(angle - turn) / aspect) ** 2)

    rho = np.where(low, wall(theta, 0.7), wall(theta, 1.0))
    points = np.column_stack([rho * np.cos(theta), rho * np.sin(theta), z])
    normals = np.column_stack([np.cos(theta), np.sin(theta), 0 * z])
    prior = fit_prior(points, normals, 0.09)
    assert prior.p_mirror > 0.5 > prior.p_sweep
    contact = wall(turn + 0.8, 0.85) * np.array([np.cos(turn + 0.8), np.sin(turn + 0.8), 0.0]) + [0, 0, 0.09]
    mirrored, sigma_m = prior.mirrored(contact)
    # An ellipse has two mirror planes; in both the radius is that of the contact.
    angle = np.arctan2(mirrored[1], mirrored[0])
    gap_m = abs(np.hypot(*mirrored[:2]) - wall(angle, 0.85))
    assert gap_m < 3 * sigma_m
    assert sigma_m < 0.0015
    assert np.linalg.norm(mirrored - contact) > 0.01


def test_rings_of_an_improbable_symmetry_do_no_harm():
    """A flattened lower part under a lopsided upper one: a touch says little of the other side of its height."""

    def wall(theta, z):
        low = (np.abs(np.cos(theta) / 0.045) ** 4 + np.abs(np.sin(theta) / 0.03) ** 4) ** -0.25
        high = 0.032 * (1 + 0.25 * np.cos(theta - 0.5) + 0.08 * np.cos(3 * theta + 1))
        fraction = np.clip((z - 0.05) / 0.09, 0, 1)
        return (1 - fraction) * low + fraction * high

    visible = part(wall, 0.0, 0.054).joined(part(wall, 0.146, 0.2))
    hidden = part(wall, 0.054, 0.146).vertices_m
    region = HoleRegion.of_points(hidden.mean(axis=0) + 0.9 * (hidden - hidden.mean(axis=0)))
    each = [Completion(visible, region, CompletionSettings(use_priors=use)) for use in (True, False)]
    assert each[0].prior.p_sweep < 0.1
    assert each[0].prior.p_mirror < 0.5
    for z in (0.08, 0.1, 0.12):
        contact = np.array([wall(0.4, z) * np.cos(0.4), wall(0.4, z) * np.sin(0.4), z])
        for completion in each:
            completion.add(Touch(contact, sigma_m=SIGMA_M))
    # On the true wall the implicit function is zero: what it is instead is the error of the surface.
    rms = [float(np.sqrt(np.mean(completion.implicit(hidden) ** 2))) for completion in each]
    untouched = float(np.sqrt(np.mean(Completion(visible, region).implicit(hidden) ** 2)))
    assert rms[0] < untouched + SIGMA_M
    assert rms[0] < rms[1] + SIGMA_M


def test_touches_of_another_frame_are_registered():
    bottle = bellied()
    visible, region, hole = scene(bottle)
    pose = Pose.from_rotation_vector([0.1, -0.2, 2.0], [0.3, 0.1, -0.2])
    plain = Completion(visible, region)
    turned = Completion(visible, region, T_visual_haptic=pose)
    contact = np.array([float(bottle.radius_m(0.0, 0.1)), 0.0, 0.1])
    plain.add(Touch(contact))
    turned.add(Touch(pose.inverse().apply(contact)))
    assert rms_m(turned, bottle, hole) == pytest.approx(rms_m(plain, bottle, hole), rel=1e-3)


def test_symmetries_are_told_from_the_bands():
    found = {}
    for kind in ("round", "elliptic", "flattened"):
        visible, region, _ = scene(bellied(kind))
        band = support_band(visible, region)
        prior = fit_prior(band.points_m, band.normals, 0.1)
        assert prior is not None
        found[kind] = prior
        np.testing.assert_allclose(prior.axis_m, 0, atol=0.001)
    assert found["round"].p_rotation > 0.9
    assert found["elliptic"].p_rotation < 0.3
    assert found["elliptic"].p_mirror > 0.8
    # A contact tells the ring at its height: the cross-section of the bands at the radius that was touched.
    bottle, contact_m = (
        bellied("elliptic"),
        np.array([float(bellied("elliptic").radius_m(0.0, 0.1)), 0.0, 0.1]),
    )
    visible, region, _ = scene(bottle)
    seen = wall_seen(found["elliptic"], support_band(visible, region))
    process = fit_radial_mixture(found["elliptic"], seen, [(contact_m, 0.0005)], region.size_m)
    points, sigma = (of_ring[0] for of_ring in process.rings(contact_m[None]))
    off_m = np.hypot(points[:, 0], points[:, 1]) - bottle.radius_m(
        np.arctan2(points[:, 1], points[:, 0]), points[:, 2]
    )
    assert (np.abs(off_m) < 3 * sigma).all()
    assert sigma.max() < 0.004 < 0.3 * contact_m[0]


def test_rims_and_band_of_a_cut_bottle():
    visible, region, hole = scene(bellied())
    loops = boundary_loops(visible.welded())
    assert len(loops) == 2
    heights = sorted(float(visible.welded().vertices_m[loop, 2].mean()) for loop in loops)
    np.testing.assert_allclose(heights, hole, atol=1e-6)
    band = support_band(visible, region, max_points=200)
    assert 100 < len(band.points_m) <= 200
    # The region is a tenth smaller than the hole: 5 % of its height at both rims.
    assert band.gap_m == pytest.approx(0.05 * (hole[1] - hole[0]), abs=0.002)
    far = HoleRegion.of_points(region.hull_m + 5.0)
    with pytest.raises(InputError, match="away from the surface"):
        support_band(visible, far)
    # Four of 34 nodes along the surface: a region of 8 extents is still resolved, one of 9 is not.
    extent_m = float(np.ptp(visible.vertices_m, axis=0).max())
    wide, too_wide = (
        HoleRegion.of_points(region.hull_m * extents * extent_m / region.size_m) for extents in (8.0, 9.0)
    )
    assert support_band(visible, wide).gap_m >= 0
    with pytest.raises(InputError, match="expected at most"):
        support_band(visible, too_wide)


@pytest.fixture
def files(tmp_path):
    bottle = bellied()
    visible, region, _ = scene(bottle)
    visible.save(tmp_path / "model.ply")
    cluster = {"hull": region.hull_m.tolist(), "centroid": [0, 0, 0.1], "size": [0.1] * 3, "score": 0.9}
    (tmp_path / "regions.json").write_text(json.dumps({"clusters": [cluster]}))
    rho = float(bottle.radius_m(0.0, 0.1))
    (tmp_path / "touches.csv").write_text(
        f"x_m,y_m,z_m,start_x_m,start_y_m,start_z_m\n{rho},0,0.1,0.1,0,0.1\n0,{rho},0.1,0,0.1,0.1\n"
    )
    return tmp_path


def test_the_verb_completes_and_plans(files, capsys):
    words = ["complete", str(files / "model.ply"), "--region", str(files / "regions.json")]
    words += ["--touches", str(files / "touches.csv"), "--out", str(files / "done.ply"), "--next", "--json"]
    words += ["--plot", str(files / "done.png")]
    assert main(words) == 0
    assert (files / "done.png").read_bytes().startswith(b"\x89PNG")
    found = json.loads(capsys.readouterr().out)
    assert found["touches"] == 2
    assert len(found["next"]["target_m"]) == 3
    assert found["symmetry"]["rotation"] > 0.9
    completed = SurfaceMesh.load(files / "done.ply")
    assert (read_ply(files / "done.ply").fields["sigma_m"] > 0).all()
    middle = completed.vertices_m[np.abs(completed.vertices_m[:, 2] - 0.1) < 0.01]
    wall = bellied().radius_m(np.zeros(len(middle)), middle[:, 2])
    assert np.abs(np.hypot(middle[:, 0], middle[:, 1]) - wall).max() < 0.002


def test_the_verb_plans_for_several_fingers(files, capsys):
    words = ["complete", str(files / "model.ply"), "--region", str(files / "regions.json"), "--fingers", "3"]
    words += ["--out", str(files / "done.ply"), "--json"]
    assert main([*words, "--apart-m", "0.02", "0.08"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["fingers"][0] == found["next"]
    starts_m = np.array([plan["start_m"] for plan in found["fingers"]])
    assert len(starts_m) == 3
    apart_m = np.linalg.norm(starts_m[1:] - starts_m[0], axis=1)
    assert ((apart_m >= 0.02) & (apart_m <= 0.08)).all()
    assert main([*words, "--apart-m", "0.08", "0.02"]) == 2
    assert "expected 0 <= LOW < HIGH" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("regions.json", "{", "not valid JSON"),
        ("regions.json", '{"clusters": []}', "clusters"),
        (
            "regions.json",
            '{"clusters": [], "panes": [{"corners": [[0,0,0],[1,0,0],[1,0,1],[0,0,1]], "sigma": 0.01}]}',
            "flat panes (found 1)",
        ),
        ("regions.json", '{"clusters": [{"hull": [[0,0,0],[1,0,0],[0,1,0],[1,1,0]]}]}', "no volume"),
        ("regions.json", '{"clusters": [{"hull": [[0,0,0],[1,0,0],[0,1,0],[1,1,"NaN"]]}]}', "hull"),
        ("touches.csv", "a,b\n1,2\n", "missing: x_m, y_m, z_m"),
        ("touches.csv", "x_m,y_m,z_m\n1,2,x\n", "line 2"),
        ("touches.csv", "x_m,y_m,z_m\n,,\n", "expected start and end"),
        ("model.ply", "ply\n", "is not a PLY file"),
    ],
)
def test_bad_files_give_one_clear_line(files, capsys, name, text, said):
    (files / name).write_text(text)
    words = ["complete", str(files / "model.ply"), "--region", str(files / "regions.json")]
    words += ["--touches", str(files / "touches.csv"), "--out", str(files / "done.ply")]
    assert main(words) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1
    assert not (files / "done.ply").exists()


def test_tables_of_touches_are_read(files):
    touches = read_touches(files / "touches.csv")
    assert len(touches) == 2
    assert touches[0].start_m is not None
    assert touches[0].start_m.tolist() == pytest.approx([0.1, 0, 0.1])
    assert len(load_hole_regions(files / "regions.json")) == 1


def test_hulls_hold_the_points_whose_distance_says_so():
    rng = np.random.default_rng(3)
    region = HoleRegion.of_points(rng.normal(0.0, 0.05, (60, 3)))
    points = rng.uniform(-0.2, 0.2, (2000, 3))
    plain = (points @ region.planes[:, :3].T + region.planes[:, 3]).max(axis=1)
    assert np.allclose(region.distance_m(points), plain, atol=1e-12)
    for reach_m in (0.0, 0.03):
        assert np.array_equal(region.within(points, reach_m), plain <= reach_m)


def hidden_wall(bottle, contacts_at, rng):
    """A model of a bottle's wall from its bands and contacts at heights, and the region's size."""
    visible, region, _ = scene(bottle)
    band = support_band(visible, region)
    prior = fit_prior(band.points_m, band.normals, bottle.height_m / 2)
    contacts = []
    for z in contacts_at:
        theta = rng.uniform(-np.pi, np.pi)
        rho = float(bottle.radius_m(np.array(theta), np.array(z)))
        contacts.append((np.array([rho * np.cos(theta), rho * np.sin(theta), z]), SIGMA_M))
    return prior, wall_seen(prior, band), contacts, region.size_m


def test_the_variance_is_scaled_by_contacts_left_out():
    rng = np.random.default_rng(5)
    prior, seen, contacts, size_m = hidden_wall(bellied("elliptic"), np.linspace(0.06, 0.14, 6), rng)
    model = fit_radial_model(prior, seen, contacts, size_m)
    count = len(model.theta)
    rest_of = model.lower @ model.lower.T
    known = model.lower @ model.whitened
    pick = model.row[:, None] == np.arange(len(model.z_m))
    assert len(model.profiles) > 1
    assert sum(profile.fraction for profile in model.profiles) == pytest.approx(1.0)
    for profile in model.profiles:
        # Leaving one out by hand: the same parameters, one row and column less.
        of_p = profile.deviation**2 * (profile.lower @ profile.lower.T)
        covariance = rest_of + pick @ of_p @ pick.T
        squares = []
        for out in range(count - len(contacts), count):
            rest = np.delete(np.arange(count), out)
            weights = np.linalg.solve(covariance[np.ix_(rest, rest)], covariance[rest, out])
            variance = covariance[out, out] - weights @ covariance[rest, out]
            squares.append((known[out] - weights @ known[rest]) ** 2 / variance)
        scale = (8.0 * 0.2 + np.minimum(squares, 9.0).sum()) / (8.0 + len(contacts))
        assert profile.scale == pytest.approx(scale, rel=1e-5)


def test_what_is_expected_of_the_wall_is_kriging_by_each_process():
    """The plain formulas: one matrix of all places, and the mixture of the processes."""
    rng = np.random.default_rng(6)
    bottle = bellied("elliptic")
    prior, seen, contacts, size_m = hidden_wall(bottle, np.linspace(0.06, 0.14, 5), rng)
    model = fit_radial_model(prior, seen, contacts, size_m)
    # At the known heights p needs no formula of its own: all is in the model's matrices.
    rows = np.arange(len(model.z_m) - len(contacts), len(model.z_m))
    touched = np.array([contact for contact, _ in contacts])
    pick = (model.row[:, None] == np.arange(len(model.z_m))).astype(float)
    rest_of, known = model.lower @ model.lower.T, model.lower @ model.whitened
    noise = np.array([(sigma / np.hypot(*(contact[:2] - prior.axis_m))) ** 2 for contact, sigma in contacts])
    last = np.arange(len(model.theta) - len(contacts), len(model.theta))
    cross_rest = rest_of[last].copy()
    cross_rest[np.arange(len(contacts)), last] -= noise + 1e-10
    own_rest = rest_of[last, last] - noise - 1e-10
    mean_m, square_m2 = 0.0, 0.0
    for profile in model.profiles:
        of_p = profile.deviation**2 * (profile.lower @ profile.lower.T)
        covariance = rest_of + pick @ of_p @ pick.T
        cross = cross_rest + of_p[rows] @ pick.T
        solved = np.linalg.solve(covariance, cross.T)
        section = prior.section(np.arctan2(*(touched[:, :2] - prior.axis_m).T[::-1]), touched[:, 2])
        rho_m = np.exp(model.middle + section + known @ solved)
        variance = own_rest + of_p[rows, rows] - (cross * solved.T).sum(axis=1)
        mean_m = mean_m + profile.fraction * rho_m
        square_m2 = square_m2 + profile.fraction * rho_m**2 * (1 + profile.scale * variance)
    expected_m, sigma_m = model.expected(touched)
    # The correlation of p is made regular by 1e-8.
    assert np.allclose(expected_m, mean_m, rtol=1e-5)
    assert np.allclose(sigma_m, np.sqrt(square_m2 - mean_m**2), rtol=2e-2, atol=1e-6)


@pytest.mark.parametrize("kind", ["round", "elliptic", "flattened"])
def test_the_deviation_of_the_wall_is_that_of_the_process(kind):
    """Over many bottles the mean of the process is off by what it says, within a factor of the few bottles."""
    squares = []
    for seed in range(8):
        rng = np.random.default_rng([31, seed])
        bottle = random_bottle(rng, kind)
        heights = bottle.height_m * rng.uniform(0.29, 0.71, 6)
        model = fit_radial_model(*hidden_wall(bottle, heights, rng))
        theta, z = rng.uniform(-np.pi, np.pi, 300), bottle.height_m * rng.uniform(0.29, 0.71, 300)
        wall_m = bottle.radius_m(theta, z)
        expected_m, sigma_m = model.expected(
            np.column_stack([wall_m * np.cos(theta), wall_m * np.sin(theta), z])
        )
        squares.append(np.mean(((wall_m - expected_m) / sigma_m) ** 2))
    # The heights are the contacts' own chance: 8 objects leave a factor of two.
    assert 0.3 < np.sqrt(np.median(squares)) < 1.7


def test_errors_of_an_outline_are_as_alike_as_is_declared():
    """By the likelihood of the errors at nine heights of twelve bottles, with what a gripper adds to widths (.5 %, .8 mm)."""
    squares, gains = [], []
    for seed in range(12):
        rng = np.random.default_rng([33, seed])
        bottle = random_bottle(rng, "round")
        model = fit_radial_mixture(*hidden_wall(bottle, bottle.height_m * rng.uniform(0.29, 0.71, 4), rng))
        z_m = bottle.height_m * np.linspace(0.3, 0.7, 9)
        wall_m = bottle.radius_m(np.zeros(9), z_m)
        expected_m, _ = model.models[0].expected(np.column_stack([wall_m, 0 * wall_m, z_m]))
        errors = model.ring_errors(np.column_stack([expected_m, z_m]))
        root = np.linalg.cholesky(errors + np.diag((0.0004 / wall_m) ** 2 + 0.005**2))
        off, sigma = np.log(expected_m / wall_m), np.linalg.norm(root, axis=1)
        white = np.linalg.solve(root, off)
        squares.append(np.mean(white**2))
        apart = 0.5 * float(np.sum((off / sigma) ** 2 - white**2))
        gains.append(apart + float(np.log(sigma).sum() - np.log(np.diag(root)).sum()))
        # An outline that deviates from the expected one errs by this as well.
        both = [model.ring_errors(np.column_stack([f * expected_m, z_m])) for f in (0.95, 1 / 0.95)]
        assert np.allclose(np.mean(both, axis=0) - errors, np.log(0.95) ** 2, atol=1e-12)
    # Mean .83 and 2.1, standard deviations .19 and .5 of these means; with independent errors the gain is 0.
    assert 0.4 < np.mean(squares) < 1.4
    assert np.mean(gains) > 0.6


def test_the_wall_at_rims_is_as_uncertain_as_rims_are_wrong():
    """Errors drawn with the covariance of rims of a fused surface, and an exact surface, which has none."""
    squares, without, curled_fraction, exact_fraction = [], [], [], []
    for seed in range(6):
        rng = np.random.default_rng([32, seed])
        bottle = random_bottle(rng, "round")
        prior, seen, _, size_m = hidden_wall(bottle, [], rng)
        off = seen.rim @ rng.standard_normal(len(seen.z_m))
        curled = replace(seen, logs=seen.logs + off[seen.row])
        sigma = np.linalg.norm(seen.rim, axis=1)
        z = seen.z_m[sigma > 0.5 * sigma.max()]
        rho_m = bottle.radius_m(np.zeros(len(z)), z)
        points = np.column_stack([rho_m, np.zeros(len(z)), z])
        for wall, found in ((curled, squares), (replace(curled, rim=0 * seen.rim), without)):
            expected_m, sigma_m = fit_radial_model(prior, wall, (), size_m).expected(points)
            found.append(np.mean(((expected_m - rho_m) / sigma_m) ** 2))
        for wall, found in ((curled, curled_fraction), (seen, exact_fraction)):
            mixture = fit_radial_mixture(prior, wall, (), size_m)
            with_rims = [model.rim.any() for model in mixture.models]
            found.append(float(np.dot(with_rims, mixture.fractions)))
    # The rows of a rim err together: 12 rims leave a fifth. Without the errors of rims it is 12.
    assert 0.6 < np.sqrt(np.mean(squares)) < 1.4
    assert np.sqrt(np.mean(without)) > 5
    # The likelihood tells which of the two it is.
    assert np.median(curled_fraction) > 0.9
    assert max(exact_fraction) < 0.5


def test_a_wrong_rim_does_not_pull_the_touched_wall_along(monkeypatch):
    """The last cells of a band are anywhere in a half band of two cells, mostly inside of the wall, as in scans of clear bottles."""

    def near_the_rim_m(seed):
        rng = np.random.default_rng(seed)
        bottle = random_bottle(rng, "round")
        visible, region, (low_m, high_m) = scene(bottle)
        cell_m = support_band(visible, region).cell_m
        vertices_m = visible.vertices_m.copy()
        below = vertices_m[:, 2] <= low_m
        x, y, z = vertices_m[below].T
        sector = (np.arctan2(y, x) / (2 * np.pi) * 12).astype(int) % 12
        off_m = cell_m * rng.uniform(-0.5, 1.5, (12, 100))[sector, ((low_m - z) / cell_m).astype(int)]
        inward = off_m * np.exp(-(low_m - z) / cell_m) / np.maximum(np.hypot(x, y), 1e-9)
        vertices_m[below, :2] *= np.maximum(1 - inward, 0.5)[:, None]
        completion = Completion(replace(visible, vertices_m=vertices_m), region)
        for share, turn in ((0.2, 0.4), (0.5, 2.5), (0.8, 4.6)):
            z_m, outward = low_m + share * (high_m - low_m), np.array([np.cos(turn), np.sin(turn), 0.0])
            start_m = 0.2 * outward + [0, 0, z_m]
            contact_m = bottle.probe(start_m, -outward, 0.2, sigma_m=SIGMA_M, rng=rng)
            completion.add(Touch(contact_m, start_m, np.array([0, 0, z_m]), SIGMA_M))
        return rms_m(completion, bottle, (low_m, low_m + 2 * cell_m))

    with_rims = [near_the_rim_m(seed) for seed in (4, 12, 16)]
    monkeypatch.setattr(radial_model, "_RIMS", (0.0,))
    without = [near_the_rim_m(seed) for seed in (4, 12, 16)]
    # .92 of it, and less in each of them.
    assert np.linalg.norm(with_rims) < 0.95 * np.linalg.norm(without)
    assert np.less(with_rims, without).all()


def test_the_declared_deviation_of_a_round_hidden_wall_is_that_of_its_radius() -> None:
    """Where cross-sections are visible all around, the process of the radius gives the sigma."""
    bottle = bellied()
    visible, region, hole = scene(bottle)
    completion = Completion(visible, region)
    assert completion.radial is not None
    assert completion.radial is completion.radial  # fitted once
    found = completion.uncertainty()
    points, inside = found.mesh.vertices_m, found.missing
    inside = inside & (points[:, 2] > hole[0]) & (points[:, 2] < hole[1])
    np.testing.assert_allclose(
        found.sigma_m[inside], completion.radial.deviation_m(points[inside]), rtol=1e-12
    )
    # A touch on the belly: there the wall is known to about the error of the touch, all around.
    plan = completion.next_touch()
    contact = bottle.probe(plan.start_m, plan.direction, np.linalg.norm(plan.end_m - plan.start_m))
    completion.add(Touch(contact, plan.start_m, plan.end_m, SIGMA_M))
    round_m = contact[2] * np.array([0.0, 0.0, 1.0]) + np.hypot(*contact[:2]) * np.eye(3)[[0, 1]]
    assert (completion.radial.deviation_m(round_m) < 3 * SIGMA_M).all()


def test_contacts_that_tell_nothing_new_of_the_rims_do_not_factor_the_band_again(monkeypatch):
    factored, factor = [], RbfSurface._factor
    monkeypatch.setattr(RbfSurface, "_factor", lambda fit: (factored.append(fit), factor(fit)))
    _, rms = explore(random_bottle(np.random.default_rng(4), "round"), np.random.default_rng(4), 6)
    assert len(factored) == 2  # the scale of the process, and the band
    assert rms[-1] < 0.25 * rms[0]

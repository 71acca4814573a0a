"""Vessels that lean: outlines of a turned cylinder, their files, and refusal of a completion around an upright axis."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthFrame
from visuohaptic.reconstruction.body_completion import BodyCompletion
from visuohaptic.reconstruction.completion import load_hole_regions
from visuohaptic.reconstruction.fusion import SpaceGrid
from visuohaptic.reconstruction.mesh import SurfaceMesh
from visuohaptic.reconstruction.transparency import (
    UprightBody,
    find_regions,
    outline_rings,
    save_regions,
)
from visuohaptic.reconstruction.transparency.body_pairs import attached_part, without_body
from visuohaptic.reconstruction.transparency.outline_fit import OutlineView
from visuohaptic.reconstruction.transparency.outline_rings import settled
from visuohaptic.reconstruction.transparency.ray_readings import DROPPED, SAME

from .test_outline_fit import AXIS_M, HIGH_M, LOW_M, NOISE, RADIUS_M, fit, hit


def seen(
    lean_m: tuple[float, float],
    seed: int,
    spheres_m: Sequence[tuple[float, float, float]] = (),
    fine: int = 1,
) -> list[OutlineView]:
    """Twelve views of a cylinder that is turned about its middle, until the upper end of its axis has moved by the lean.

    Spheres of a radius of 12 mm are of glass, too. A camera may be finer than that of 160 x 120 pixels by a factor.
    """
    camera, noise = (
        Camera.simple(160 * fine, 120 * fine, 140.0 * fine),
        replace(NOISE, edge_rad=NOISE.edge_rad / fine),
    )
    rng, (rows, columns) = np.random.default_rng(seed), np.mgrid[0 : 120 * fine, 0 : 160 * fine]
    rays = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float)).reshape(
        *rows.shape, 3
    )
    way = np.array([-lean_m[1], lean_m[0], 0.0]) / max(float(np.hypot(*lean_m)), 1e-12)
    turned = Pose.from_rotation_vector(
        way * np.arcsin(np.hypot(*lean_m) / (HIGH_M - LOW_M)), np.zeros(3)
    ).rotation
    middle = np.array([*AXIS_M, 0.5 * (LOW_M + HIGH_M)])
    found = []
    for turn in np.linspace(0, 6, 12):
        pose = Camera.pose_of_view((0.6 * np.cos(turn), 0.6 * np.sin(turn), 0.55), (0.0, 0.0, 0.08))
        eye = turned.T @ (pose.translation_m - middle) + middle
        glass = hit(eye, rays @ pose.rotation.T @ turned)
        straight = rays @ pose.rotation.T
        straight /= np.linalg.norm(straight, axis=-1, keepdims=True)
        for sphere_m in spheres_m:
            away_m = np.array(sphere_m) - pose.translation_m
            glass |= np.linalg.norm(np.cross(straight, away_m), axis=-1) < 0.012
        dropped = rng.random(glass.shape) < np.where(glass, 0.5, 0.02)
        ratio = np.where(dropped, 3.2, -0.67).astype(np.float32)
        limit_m = np.full(glass.shape, 2.0, np.float32)
        reading = np.where(dropped, DROPPED, SAME).astype(np.uint8)
        frame = DepthFrame(0.0, limit_m, None, pose, camera)
        found.append(OutlineView.of_view(frame, reading, [ratio], limit_m, noise, 1.0))
    return found


@pytest.mark.parametrize("lean_m", [(0.05, 0.0), (-0.03, 0.04)])
def test_a_leaning_body_is_told_and_its_axis_follows(lean_m):
    views = seen(lean_m, 3)
    upright = fit(views, np.array([-0.06, -0.11, 0.06]), np.array([0.1, 0.05, 0.16]))
    assert upright is not None
    body = settled(views, upright, 0.02)
    # Half a window is 14 mm at the ends of an outline with two sides in twelve views; a lean has the error of both ends.
    assert np.array(body.lean_m) == pytest.approx(np.array(lean_m), abs=0.015)
    assert np.linalg.norm(body.axis_m - AXIS_M) < 0.006
    rise_m = np.sqrt((HIGH_M - LOW_M) ** 2 - np.dot(lean_m, lean_m))
    points_m = np.array([[*(AXIS_M + 0.4 * np.array(lean_m)), 0.5 * (LOW_M + HIGH_M) + 0.4 * rise_m]])
    assert body.contains(points_m).all()
    # The foot, as far below the body as this is high, is uncertain by the lean as well as by the place.
    foot_m, sigma_m = body.axis_at_m(2 * body.height_m[0] - body.height_m[1])
    assert (sigma_m > 1.5 * body.axis_sigma_m).all()
    true_m = AXIS_M - np.array(lean_m) / rise_m * (
        0.5 * (LOW_M + HIGH_M) - 2 * body.height_m[0] + body.height_m[1]
    )
    assert (np.abs(foot_m - true_m) < 3 * sigma_m).all()
    away_m = np.append(AXIS_M - np.array(lean_m), points_m[0, 2])
    assert not body.contains(away_m[None]).any()
    inside_m = body.points_m(0.01)
    high, low = (inside_m[k].mean(axis=0) for k in (inside_m[:, 2] > 0.13, inside_m[:, 2] < 0.08))
    # Ends at right angles to the axis take from the one side of each slice what they leave on the other.
    part = (high - low)[2] / (body.height_m[1] - body.height_m[0])
    assert (high - low)[:2] @ np.array(lean_m) > 0.5 * part * np.dot(lean_m, lean_m)


def test_an_axis_beyond_its_ends_has_the_deviation_of_place_and_lean_together():
    rng = np.random.default_rng(2)
    root = 1e-3 * rng.normal(size=(2, 2, 2))  # of place and lean (rows), along x and y
    draws = np.einsum("xij,xjn->xin", root, rng.standard_normal((2, 2, 100_000)))
    place_m, lean_m = draws[:, 0], draws[:, 1]
    ends_m = np.array([(place_m + part * lean_m).std(axis=1) for part in (-0.5, 0.5)])
    body = UprightBody(
        np.zeros(2), place_m.std(axis=1), (0.03, 0.03), 0.001, (0.05, 0.15), 80.0, ends_sigma_m=ends_m
    )
    for z_m in (0.0, 0.12, 0.3):
        expected_m = (place_m + (z_m - 0.1) / 0.1 * lean_m).std(axis=1)
        assert body.axis_at_m(z_m)[1] == pytest.approx(expected_m, rel=1e-6)


def test_upright_bodies_are_said_to_lean_as_rarely_as_stated():
    """Of twelve, at a rate of one in fifty, more than two lean once in 500 times."""
    leans = 0
    for seed in range(12):
        views = seen((0.0, 0.0), seed)
        body = UprightBody(AXIS_M, np.full(2, 0.002), (RADIUS_M, RADIUS_M), 0.002, (LOW_M, HIGH_M), 90.0)
        leans += any(settled(views, body, 0.02).lean_m)
    assert leans <= 2


@pytest.mark.parametrize("high_m", [0.0, 0.045])
def test_a_handle_neither_moves_a_vessel_nor_makes_it_lean(high_m):
    x, y = AXIS_M
    out_m = RADIUS_M + np.array([0.005, 0.02, 0.025, 0.025, 0.025, 0.02, 0.005])
    handle_m = [(x + r, y, z + high_m) for r, z in zip(out_m, np.linspace(0.055, 0.12, 7), strict=True)]
    views = seen((0.0, 0.0), 5, handle_m, fine=3)
    upright = UprightBody(AXIS_M, np.full(2, 0.002), (RADIUS_M, RADIUS_M), 0.002, (LOW_M, HIGH_M), 90.0)
    # Without a part beside it, the body leans, away from the axis by several of its deviations.
    alone = settled(views, upright, 0.02)
    assert any(alone.lean_m)
    assert np.abs((alone.axis_m - AXIS_M) / alone.axis_sigma_m).max() > 4
    part = attached_part(views, upright, alone, 12.0)
    assert part is not None
    # A ring is fitted by a cone: its middle is in the middle of the handle, to a half of its depth.
    assert part.axis_m == pytest.approx(AXIS_M + np.array([RADIUS_M + 0.0125, 0.0]), abs=0.0125)
    body = settled(without_body(views, part.shape_m), upright, 0.02)
    assert not any(body.lean_m)
    assert np.linalg.norm(body.axis_m - AXIS_M) < 0.002
    assert np.abs((body.axis_m - AXIS_M) / body.axis_sigma_m).max() < 3


def test_a_body_that_leans_is_no_upright_one_with_a_handle():
    views = seen((0.05, 0.0), 3)
    upright = fit(views, np.array([-0.06, -0.11, 0.06]), np.array([0.1, 0.05, 0.16]))
    assert upright is not None
    assert attached_part(views, upright, settled(views, upright, 0.02), 12.0) is None


def test_a_ridge_of_likelihood_is_the_deviation_of_the_place():
    """Where bodies from one place to another are as likely, the deviation is that of a uniform distribution; a factor widens a peak."""

    def ridge(shape_m: np.ndarray) -> float:
        over = np.maximum(np.abs(shape_m[:1] - 0.05) - 0.03, 0.0).sum() + np.abs(shape_m[1:] - 0.05).sum()
        return -50.0 + (float(over) / 1e-3) ** 2

    aside = np.array([0.03, *[0.05] * 5])
    samples = outline_rings._samples(ridge, [np.full(6, 0.05), aside], 1.0)
    assert samples[:, 0].mean() == pytest.approx(0.05, abs=0.012)
    assert samples[:, 0].std() == pytest.approx(0.06 / np.sqrt(12), rel=0.3)
    places = [np.full(6, 0.05)]
    narrow, wide = (
        outline_rings._samples(lambda s: -50.0 + 0.5 * float(((s - 0.05) ** 2).sum()) / 4e-6, places, factor)
        for factor in (1.0, 0.25)
    )
    # Of 24 shapes moved 133 times, about every tenth move is independent: 300 of each.
    assert narrow.std(axis=0).mean() == pytest.approx(2e-3, rel=0.15)
    assert wide.std(axis=0).mean() == pytest.approx(4e-3, rel=0.15)


def test_a_lean_is_saved_and_no_wall_is_completed_around_an_upright_axis(tmp_path):
    body = UprightBody(
        np.zeros(2), np.full(2, 0.004), (0.03, 0.03), 0.003, (0.05, 0.15), 80.0, lean_m=(0.05, 0.01),
        ends_sigma_m=np.array([[0.005, 0.006], [0.007, 0.004]]),
    )  # fmt: skip
    grid = SpaceGrid.around((-0.04, -0.04, 0.03), (0.04, 0.04, 0.15), 0.02)
    inside = np.ones((4, 4, 6), dtype=bool)
    (region,) = find_regions(inside.astype(float), inside, grid, min_voxels=1)
    save_regions(tmp_path / "regions.json", (replace(region, body=body),))
    (loaded,) = load_hole_regions(tmp_path / "regions.json")
    assert loaded.body is not None
    assert loaded.body.lean_m == body.lean_m
    assert loaded.body.axis_at_m(0.0)[1] == pytest.approx(body.axis_at_m(0.0)[1])
    assert np.degrees(body.lean_rad) == pytest.approx(27.0, abs=0.1)  # atan(hypot(50, 10) / 100)
    table = SurfaceMesh(np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match="leans by 27 degrees, expected an upright one"):
        BodyCompletion.standing(table, loaded.body, 0.15)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"height": [0.15, 0.15]}, "clusters.0.height: expected the lower end before the upper end"),
        ({"height": [0.15, 0.05]}, "clusters.0.height: expected the lower end before the upper end"),
        ({"ends_sigma": [[0.01, -0.01], [0.01, 0.01]]}, "clusters.0.ends_sigma.0.1: found -0.01"),
    ],
)
def test_a_body_without_a_height_or_with_negative_deviations_is_refused(tmp_path, entry, said):
    body = {"axis": [0, 0], "axis_sigma": [0, 0], "radius": [0.03, 0.03], "radius_sigma": 0, "height": [0, 1]}
    hull = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    path = tmp_path / "regions.json"
    path.write_text(json.dumps({"clusters": [{"hull": hull} | body | entry]}))
    with pytest.raises(InputError, match=re.escape(f"{path}: {said}")):
        load_hole_regions(path)

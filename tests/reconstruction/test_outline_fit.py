"""Upright bodies through the outlines of several views, generated independently of the library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthFrame
from visuohaptic.reconstruction.fusion import DepthNoise, SpaceGrid
from visuohaptic.reconstruction.transparency import body_pairs, evidence
from visuohaptic.reconstruction.transparency._outline_kernels import outline_sums
from visuohaptic.reconstruction.transparency.body_pairs import disjoint_bodies, fit_pair, without_body
from visuohaptic.reconstruction.transparency.evidence import EvidenceDetector
from visuohaptic.reconstruction.transparency.outline_fit import (
    Outlines,
    OutlineView,
    UprightBody,
    body_evidence,
    fit_bodies,
)
from visuohaptic.reconstruction.transparency.outline_rings import outline_rings
from visuohaptic.reconstruction.transparency.ray_readings import (
    CONTEXTS,
    DROPPED,
    FAR,
    KINDS,
    NEAR,
    SAME,
    RayImage,
)
from visuohaptic.reconstruction.transparency.regions import (
    agreement_evidence,
    passing_evidence,
    seen_behind,
)
from visuohaptic.reconstruction.vessel_shapes import end_circles

#: x, y of the axis, radius and height of the body, which stands at z = 0.05 [m].
AXIS_M, RADIUS_M, LOW_M, HIGH_M = np.array([0.02, -0.03]), 0.035, 0.05, 0.17
CAMERA = Camera.simple(160, 120, 140.0)
#: One eye; an edge is mixed over one pixel, readings over five.
NOISE = DepthNoise(1e-3, edge_rad=1 / 140)


def hit(origin: np.ndarray, rays: np.ndarray, axis_m: np.ndarray = AXIS_M) -> np.ndarray:
    """Whether rays meet the cylinder: quadric of its wall between both ends, and the disc on top."""
    offset, flat = origin[:2] - axis_m, rays[..., :2]
    a, b, c = (flat**2).sum(-1), 2 * flat @ offset, offset @ offset - RADIUS_M**2
    root = np.sqrt(np.maximum(b**2 - 4 * a * c, 0.0))
    wall = np.zeros(rays.shape[:2], dtype=bool)
    for sign in (-1, 1):
        z = origin[2] + (-b + sign * root) / (2 * a) * rays[..., 2]
        wall |= (b**2 > 4 * a * c) & (z > LOW_M) & (z < HIGH_M)
    top = origin[:2] + (HIGH_M - origin[2]) / rays[..., 2:] * flat
    return wall | (((top - axis_m) ** 2).sum(-1) < RADIUS_M**2)


def table_depth_m(eye: np.ndarray, pose: Pose) -> np.ndarray:
    """Depth of the table, z = 0, in every pixel."""
    rows, columns = np.mgrid[0:120, 0:160]
    rays = CAMERA.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
    # A ray of depth one moves by these along z.
    return (eye[2] / -(rays @ pose.rotation.T)[:, 2] * rays[:, 2]).reshape(120, 160)


def views(
    rng: np.random.Generator,
    turns: np.ndarray,
    lost: float,
    axes_m: Sequence[np.ndarray] = (AXIS_M,),
    *,
    eye_m: float = 0.0,
    told_m: float = 0.0,
) -> list[OutlineView]:
    """Eight in ten readings beside the body, and a part of those through it, say that there is no glass.

    The second eye is at ``eye_m``; the views are told that it is at ``told_m``.
    """
    rows, columns = np.mgrid[0:120, 0:160]
    found = []
    for turn in turns:
        eye = np.array([0.6 * np.cos(turn), 0.6 * np.sin(turn), 0.55])
        pose = Camera.pose_of_view(tuple(eye), (0.0, 0.0, 0.08))
        rays = CAMERA.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float)).reshape(
            120, 160, 3
        )
        glass = np.any([hit(eye, rays @ pose.rotation.T, axis_m) for axis_m in axes_m], axis=0)
        # The second eye looks at the same point of the background, at a depth of 2 m.
        second = eye + eye_m * pose.rotation[:, 0]
        glass |= np.any([hit(second, eye + 2 * rays @ pose.rotation.T - second, a) for a in axes_m], axis=0)
        dropped = rng.random(glass.shape) < np.where(glass, lost, 0.02)
        # ln(0.5 / 0.02) and ln(0.5 / 0.98) of readings that are lost with 0.5 behind glass and 0.02 elsewhere.
        ratio = np.where(dropped, 3.2, -0.67).astype(np.float32)
        limit_m = np.full(glass.shape, 2.0, np.float32)
        frame = DepthFrame(0.0, limit_m, None, pose, CAMERA)
        reading = np.where(dropped, DROPPED, SAME).astype(np.uint8)
        noise = replace(NOISE, baseline_m=told_m)
        found.append(OutlineView.of_view(frame, reading, [ratio], limit_m, noise, 1.0))
    return found


def fit(seen: list[OutlineView], low_m: np.ndarray, high_m: np.ndarray) -> UprightBody | None:
    """The likeliest body where every voxel of a box tells the same."""
    x, y, z = (np.arange(low, high, 0.01) for low, high in zip(low_m, high_m, strict=True))
    points_m = np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)
    return next(iter(fit_bodies(seen, points_m, np.ones(len(points_m)))), None)


@pytest.mark.parametrize("first", [0, 8])
def test_what_is_outside_of_an_image_is_no_evidence(first):
    """Images that end in the middle of the body: as whole images without evidence there, and the body is still where it is."""
    seen = views(np.random.default_rng(3), np.linspace(0, 6.0, 12), 0.5)
    kept = slice(first, first + seen[0].evidence.shape[1] // 2)
    cut, blind = [], []
    for view in seen:
        fx, fy, cx, cy = view.matrix
        parts = (part[:, kept] for part in (view.evidence, view.changed, view.limit_m))
        evidence, changed, limit_m = (np.ascontiguousarray(part) for part in parts)
        matrix = (fx, fy, cx - first, cy)
        cut.append(replace(view, evidence=evidence, changed=changed, limit_m=limit_m, matrix=matrix))
        told = np.zeros_like(view.evidence)
        told[:, kept] = evidence
        blind.append(replace(view, evidence=told))
    middle_m = np.array([*AXIS_M, 0.11])
    ends = [np.array([AXIS_M[0] + x, AXIS_M[1], r, r, LOW_M, HIGH_M]) for x, r in ((0, 0.035), (0.03, 0.06))]
    for end in ends:
        own, other = (Outlines(some, middle_m).log_likelihood(end, 0.0) for some in (cut, blind))
        np.testing.assert_allclose(own, other, atol=1e-4)
    body = fit(cut, np.array([-0.05, -0.08, 0.08]), np.array([0.05, 0.03, 0.2]))
    assert body is not None
    # Of the two edges of every outline about one is left.
    assert np.linalg.norm(body.axis_m - AXIS_M) < 0.0035 * np.sqrt(2)


@pytest.mark.parametrize(("count", "arc_rad"), [(12, 6.0), (8, 2.5)])
def test_the_axis_follows_from_the_outlines(count, arc_rad):
    rng = np.random.default_rng(count)
    seen = views(rng, np.linspace(0, arc_rad, count), 0.5)
    # The part that was found reaches 3 cm away from the cameras' side and has no foot.
    body = fit(seen, np.array([-0.05, -0.08, 0.08]), np.array([0.05, 0.03, 0.2]))
    assert body is not None
    # Half a window is 2.5 px, 14 mm: eight outlines with two sides each know their middle to a fourth of that.
    assert np.linalg.norm(body.axis_m - AXIS_M) < 0.0035
    assert np.all(np.abs(body.axis_m - AXIS_M) < 4 * body.axis_sigma_m)
    assert body.axis_sigma_m.max() < 0.005
    # Windows widen an outline by up to a half of them.
    assert abs(np.mean(body.radius_m) - RADIUS_M) < 0.014
    assert body.evidence > 50


def test_noise_without_outline_holds_no_body():
    """As many lost readings inside a body as beside it are no evidence for one: ln(places / rate) is about 12."""
    seen = views(np.random.default_rng(1), np.linspace(0, 6, 12), 0.02)
    body = fit(seen, np.array([-0.05, -0.08, 0.08]), np.array([0.05, 0.03, 0.2]))
    assert body is None or body.evidence < 5


def test_from_one_side_the_distance_is_known_less_well_than_the_bearing():
    """Eight views within 34 degrees: a body farther away is nearly one that stands higher.

    They tell the two apart by how much their sights differ, 0.17 rad on average, against the whole outline across it.
    """
    seen = views(np.random.default_rng(5), np.linspace(-0.3, 0.3, 8), 0.5)
    body = fit(seen, np.array([-0.05, -0.08, 0.08]), np.array([0.05, 0.03, 0.2]))
    assert body is not None
    along, across = body.axis_sigma_m
    assert along > 2.5 * across


def test_a_search_is_repeated_on_both_sides_in_turns_until_it_gains_nothing(monkeypatch):
    """A simplex collapses on a ridge: here after 10 mm, so that only one from the other side goes on."""
    sides = []

    def step(cost, best, *_, options):
        sides.append(int(np.sign(options["initial_simplex"][1, 0] - best[0])))
        end = best - (0.01 if best[0] > 0.025 and sides[-2:] != [sides[-1]] * 2 else 0.0)
        return SimpleNamespace(x=end, fun=cost(end))

    monkeypatch.setattr("scipy.optimize.minimize", step)
    monkeypatch.setattr(Outlines, "cost", lambda self, body, *_: 100.0 * body[0])
    outlines, start, rest = object.__new__(Outlines), np.full(6, 0.05), (0.0, np.zeros(3))
    outlines._told = ()
    assert outlines.search(start, *rest) == pytest.approx(np.full(6, 0.04))
    assert sides == [1]
    assert outlines.search(start, *rest, side=-1) == pytest.approx(np.full(6, 0.02))
    assert sides == [1, -1, 1, -1, 1]


@pytest.mark.parametrize(
    "low_high_m",
    [
        ((-0.05, -0.1, 0.01), (0.07, 0.02, 0.08)),
        ((0.06, -0.06, 0.03), (0.13, 0.02, 0.08)),
        ((0.085, -0.0425, 0.04), (0.115, 0.0025, 0.08)),
    ],
)
def test_a_bowl_of_which_only_the_rim_shows_is_found_whole(low_high_m):
    """Readings are lost within 7 mm of a circle of 75 mm at a height of 65 mm, the part that was found is half of it, 7 cm, or 4.5."""
    rng = np.random.default_rng(7)
    middle, radius, height = np.array([0.03, -0.02]), 0.075, 0.065
    rows, columns = np.mgrid[0:120, 0:160]
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float)
    seen = []
    for turn in np.linspace(0, 3.5, 10):
        eye = np.array([0.6 * np.cos(turn), 0.6 * np.sin(turn), 0.5])
        pose = Camera.pose_of_view(tuple(eye), (0.0, 0.0, 0.05))
        rays = CAMERA.rays(pixels).reshape(120, 160, 3) @ pose.rotation.T
        at_rim = eye[:2] + (height - eye[2]) / rays[..., 2:] * rays[..., :2]
        rim = np.abs(np.linalg.norm(at_rim - middle, axis=-1) - radius) < 0.007
        lost = rng.random(rim.shape) < np.where(rim, 0.7, 0.02)
        ratio = np.where(lost, 3.2, -0.67).astype(np.float32)
        limit_m = np.full(rim.shape, 2.0, np.float32)
        frame = DepthFrame(0.0, limit_m, None, pose, CAMERA)
        reading = np.where(lost, DROPPED, SAME).astype(np.uint8)
        seen.append(OutlineView.of_view(frame, reading, [ratio], limit_m, NOISE, 1.0))
    body = fit(seen, *map(np.array, low_high_m))
    assert body is not None
    # Half a window is 2.5 px, 13 mm; an arc of the rim has its middle 50 mm away, and a fourth of the width.
    assert np.linalg.norm(body.axis_m - middle) < 0.013
    assert np.all(np.abs(body.axis_m - middle) < 4 * body.axis_sigma_m)
    # Windows widen an outline by up to a half of them.
    assert abs(max(body.radius_m) - radius) < 0.02


def test_views_that_count_half_each_tell_no_more_than_one_and_few_views_less_than_their_scatter():
    rng, seen = np.random.default_rng(3), []
    for view in views(np.random.default_rng(3), np.linspace(0, 4, 7), 0.5):
        motion = view.T_camera_world.copy()
        motion[:, 3] += rng.normal(0, 0.012, 3)
        seen.append(replace(view, T_camera_world=motion))
    box = np.array([-0.05, -0.08, 0.08]), np.array([0.05, 0.03, 0.2])
    once, whole = fit(seen, *box), fit([*seen, *seen], *box)
    halves = fit([replace(view, weight=0.5) for view in [*seen, *seen]], *box)
    assert once is not None
    assert whole is not None
    assert halves is not None
    assert halves.axis_m == pytest.approx(once.axis_m, abs=1e-4)
    assert halves.axis_sigma_m == pytest.approx(once.axis_sigma_m, rel=0.02)
    # Of seven views with four numbers fitted the scatter counts 7 / 3, of fourteen 14 / 10: twice the views halve the variance,
    # and their scatter is 0.6 of what it was. The rest of the variance is that of the likelihood.
    assert (whole.axis_sigma_m**2 < 0.48 * once.axis_sigma_m**2).all()
    assert (whole.axis_sigma_m**2 > 0.29 * once.axis_sigma_m**2).all()


def test_of_a_body_that_holds_the_camera_nothing_is_said():
    (view,) = views(np.random.default_rng(0), np.zeros(1), 0.5)
    around_eye = np.array([0.3, 0.0, 0.4, 0.4, 0.1, 0.4])
    assert Outlines([view], np.array([0.0, 0.0, 0.1])).log_likelihood(around_eye, 0.7).tolist() == [0.0]


def test_a_part_is_one_region_where_its_body_is():
    """What few views pass above a body hangs in the air: it is no region of its own, and does not move that of the body."""
    detector = EvidenceDetector(SpaceGrid.around((-0.1, -0.1, 0.0), (0.1, 0.1, 0.3), 0.01))
    part = np.zeros(detector.grid.shape, dtype=bool)
    part[7:13, 7:13, 4:14] = part[4:16, 4:16, 22:30] = True
    body = UprightBody(np.zeros(2), np.full(2, 0.003), (0.035, 0.035), 0.002, (0.03, 0.14), 60.0)
    detector._accept(part, [body], (slice(0, 20), slice(0, 20), slice(0, 30)))
    (region,) = detector.regions()
    assert region.centroid_m == pytest.approx([0.0, 0.0, 0.09], abs=0.006)
    assert region.body is body


@pytest.mark.parametrize("seed", range(3))
def test_sums_of_outlines_are_those_of_drawn_polygons(seed):
    """Apart: points of both circles, their hull filled at eight times the resolution."""
    import cv2

    rng = np.random.default_rng(seed)
    evidence = rng.standard_normal((120, 160)) + 0.3
    pose = Camera.pose_of_view((0.5, 0.1, 0.4), (0.0, 0.0, 0.08))
    matrix = np.array([CAMERA.matrix[0, 0], CAMERA.matrix[1, 1], CAMERA.matrix[0, 2], CAMERA.matrix[1, 2]])
    body = np.array(
        [*rng.uniform(-0.03, 0.03, 2), *rng.uniform(0.02, 0.06, 2), 0.02, rng.uniform(0.06, 0.15)]
    )
    sums = np.pad(np.cumsum(evidence, axis=1), ((0, 0), (1, 0)))[None]
    limits, motion = np.full((1, 120, 160), 2.0, np.float32), pose.inverse().matrix[:3][None]
    found = np.empty(1)
    corners_m = end_circles(body, 16)
    outline_sums(corners_m, sums, limits, motion, matrix[None], np.zeros(1), np.ones(1), found)
    ring = 2 * np.pi * np.arange(16) / 16
    points = np.concatenate(
        [
            np.column_stack([body[0] + r * np.cos(ring), body[1] + r * np.sin(ring), np.full(16, z)])
            for r, z in zip(body[2:4], body[4:], strict=True)
        ]
    )
    local = pose.inverse().apply(points)
    pixel = np.column_stack(
        [matrix[0] * local[:, 0] / local[:, 2] + matrix[2], matrix[1] * local[:, 1] / local[:, 2] + matrix[3]]
    )
    fine = np.zeros((960, 1280), np.uint8)
    cv2.fillConvexPoly(
        fine, np.rint(cv2.convexHull((8 * (pixel + 0.5)).astype(np.float32))).astype(np.int32), 1
    )
    cover = fine.reshape(120, 8, 160, 8).mean(axis=(1, 3))
    # The border, 80 to 150 px long, is drawn to a sixteenth of a pixel, and sums of rows take it at their middle.
    assert found[0] == pytest.approx(float((cover * evidence).sum()), abs=0.15 * np.sqrt(150) + 0.02 * 150)


@pytest.mark.parametrize("side", [1, -1])
def test_the_second_eye_sees_the_background_beside_a_body_and_not_that_behind_its_middle(side):
    """Next to a wall no view sees the wall behind the body beside it: its depth is unknown there."""
    rng = np.random.default_rng(4)
    sums = np.pad(np.cumsum(rng.standard_normal((120, 160)), axis=1), ((0, 0), (1, 0)))[None]
    motion = Camera.pose_of_view((0.5, 0.0, 0.1), (0.0, 0.0, 0.1)).inverse().matrix[:3][None]
    matrix = np.array([[CAMERA.matrix[0, 0], CAMERA.matrix[1, 1], CAMERA.matrix[0, 2], CAMERA.matrix[1, 2]]])
    body, reach = np.array([0.0, 0.0, 0.03, 0.03, 0.05, 0.15]), side * np.full(1, 7.0)
    known = np.full((1, 120, 160), 0.6, np.float32)
    unknown = known.copy()
    unknown[:, :, 73:87] = 0.0  # the body is from column 71 to 88
    near = np.full_like(known, 0.5)
    found = np.empty((3, 1))
    for limits, total in zip((known, unknown, near), found, strict=True):
        outline_sums(end_circles(body, 16), sums, limits, motion, matrix, reach, np.ones(1), total)
    assert found[0] == found[1] != found[2]


def test_a_part_that_trails_away_from_the_body_does_not_move_it():
    """Voxels that few rays pass behind a body have little evidence each and reach to half a metre from it."""
    seen = views(np.random.default_rng(8), np.linspace(0, 2.5, 8), 0.5)
    trail = np.linspace(0, 1, 300)[:, None] * np.array([-0.5, -0.4, 0.4])
    around = np.random.default_rng(9).uniform(-1, 1, (200, 3)) * np.array([0.03, 0.03, 0.05])
    middle_m = np.array([*AXIS_M, 0.12])
    points_m = middle_m + np.concatenate([trail, around])
    told = np.concatenate([np.full(300, 9.0), np.full(200, 20.0)])
    body = fit_bodies(seen, points_m, told)[0]
    # As where the part is no larger than the body.
    assert np.linalg.norm(body.axis_m - AXIS_M) < 0.0035
    assert body.height_m[1] == pytest.approx(HIGH_M, abs=0.014)


#: Axes of two vessels with 40 mm between their walls, 11 cm apart in the direction of the middle of the views [m].
ROW_M = (np.array([0.055, 0.0]), np.array([-0.055, 0.0]))


@pytest.mark.parametrize("axes_m", [ROW_M, ROW_M[:1]])
def test_two_vessels_in_a_row_are_two_bodies_and_one_is_one(axes_m):
    """Within 80 degrees about the line through both axes, a wide body covers both; a single vessel has no second beside it."""
    seen = views(np.random.default_rng(11), np.linspace(-0.7, 0.7, 12), 0.5, axes_m)
    x, y, z = (np.arange(*ends, 0.01) for ends in ((-0.1, 0.1), (-0.05, 0.05), (0.05, 0.17)))
    points_m = np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)
    told = seen, points_m, np.ones(len(points_m))
    found = disjoint_bodies(seen, [*fit_bodies(*told), *fit_pair(*told)], 12.0)
    assert len(found) == len(axes_m)
    for axis_m in axes_m:
        away = [body.axis_m - axis_m for body in found]
        nearest = min(range(len(found)), key=lambda k: np.hypot(*away[k]))
        assert np.hypot(*away[nearest]) < 0.006
        assert np.all(np.abs(away[nearest]) < 4 * found[nearest].axis_sigma_m)


def test_a_second_body_counts_with_the_rays_that_miss_the_first():
    """A body around a vessel that is slightly smaller than it explains nothing that the vessel does not."""
    seen = views(np.random.default_rng(2), np.linspace(0, 6, 9), 0.5)
    body = fit(seen, np.array([-0.05, -0.08, 0.08]), np.array([0.05, 0.03, 0.2]))
    assert body is not None
    # It does not meet the first one, but where they overlap in the images it has no rays of its own.
    behind = replace(body, axis_m=body.axis_m + np.array([0.0, 0.08]))
    alone = float(body_evidence(seen, behind).sum())
    assert disjoint_bodies(seen, [body, replace(body, radius_m=(0.03, 0.03))], 1.0) == [body]
    assert disjoint_bodies(seen, [body, replace(behind, evidence=alone)], 1.0) == [body]
    assert disjoint_bodies(seen, [], 1.0) == []


@pytest.mark.parametrize(("showing", "found"), [(9, True), (2, False)])
def test_no_two_views_alone_show_a_body(showing, found):
    """A mirror or a black edge drops out over a whole outline in one or two views, glass in most: their evidence is bounded."""
    turns = np.linspace(0, 6, 9)
    seen = views(np.random.default_rng(2), turns[:showing], 1.0)
    seen += views(np.random.default_rng(3), turns[showing:], 0.02)
    place = np.full(2, 0.002), (RADIUS_M, RADIUS_M), 0.002, (LOW_M, HIGH_M), 90.0
    body = UprightBody(AXIS_M, *place)
    none, each = np.zeros((9, 1, 1), np.float32), body_evidence(seen, body)
    bounded = evidence.RayEvidence((), np.ones(9, np.float32), none, none, none).bounded(each, 0.05)
    assert each.sum() > 30
    # At most ln((.9 R + .1) / (.95 + .05 R)) of each view, 2.9 for a large R.
    assert (bounded > 12.0) is found
    assert bounded < 2.9 * showing


def test_a_piece_of_a_rim_is_no_body_of_its_own(monkeypatch):
    """Where 5 cm of a rim show, a rod of the smallest radius fits them: it would stand 8 cm from the bowl's middle."""
    place = np.zeros(2), np.full(2, 0.003)
    rod, cup = (
        UprightBody(*place, radius_m, 0.002, (0.0, 0.06), told)
        for radius_m, told in (((0.011, 0.018), 30.0), ((0.013, 0.018), 20.0))
    )
    monkeypatch.setattr(body_pairs, "fit_bodies", lambda *_: [rod, cup])
    monkeypatch.setattr(body_pairs, "fit_pair", lambda *_: [])
    detector = EvidenceDetector(SpaceGrid.around((-0.1, -0.1, 0.0), (0.1, 0.1, 0.2), 0.01))
    part = np.ones((10, 10, 10), bool)
    # Half of the edge of the smallest object is 15 mm.
    assert detector._fit(part, np.ones(part.shape, np.float32), (slice(0, 10),) * 3) == [cup]


@pytest.mark.parametrize("opening", [0.0, 0.7])
def test_the_search_of_a_body_is_the_downhill_simplex(opening):
    """Apart: that of scipy, on the same likelihood."""
    from scipy.optimize import minimize

    outlines = Outlines(views(np.random.default_rng(3), np.linspace(0, 5, 9), 0.5), np.array([*AXIS_M, 0.08]))
    bounds_m, start = np.array([0.01, 0.02, 0.12]), np.array([0.02, -0.03, 0.05, 0.045, 0.06, 0.09])
    simplex = np.vstack([start, start + 0.012 * np.diag([1, 1, 0.5, 0.5, -1, -1])])
    options = {"initial_simplex": simplex, "maxfev": 400, "xatol": 3e-4, "fatol": 1e-2}
    apart = minimize(outlines.cost, start, (opening, bounds_m), "Nelder-Mead", options=options)
    ours = outlines.search(start, opening, bounds_m)
    # The middle of the corners is summed in another order.
    np.testing.assert_allclose(ours, apart.x, atol=3e-4)
    assert outlines.cost(ours, opening, bounds_m) == pytest.approx(apart.fun, abs=1e-2)
    assert apart.fun < outlines.cost(start, opening, bounds_m) - 1
    told = outlines.log_likelihood(ours, opening)
    assert outlines.cost(ours, opening, bounds_m) == pytest.approx(-told.sum(), abs=1e-9)
    # What is no body has no likelihood.
    assert outlines.cost(np.array([0, 0, 0.005, 0.04, 0.0, 0.1]), opening, bounds_m) == pytest.approx(1e3)


@pytest.mark.parametrize("both", [True, False])
def test_what_else_founds_a_part_is_left_to_itself(both):
    """Two cylinders in one part, 11 cm apart: by rays that pass the first by, the second is as strong, or nothing tells of it."""
    grid = SpaceGrid.around((-0.12, -0.06, 0.0), (0.12, 0.06, 0.16), 0.01)
    turns = np.linspace(0, 6, 12)
    poses = [Camera.pose_of_view((0.6 * np.cos(a), 0.6 * np.sin(a), 0.5), (0.0, 0.0, 0.08)) for a in turns]
    limit_m = np.full((len(poses), 120, 160), 2.0, np.float32)
    frames = [DepthFrame(0.0, limit_m[0], None, pose, CAMERA) for pose in poses]
    points_m = grid.centres_m(np.argwhere(np.ones(grid.shape, dtype=bool)))
    near, far = (np.hypot(*(points_m[:, :2] - [x, 0.0]).T) < 0.03 for x in (-0.055, 0.055))
    told = np.full(limit_m.shape, -2.0, np.float32)
    for cylinder in (near, far) if both else (near,):
        for k, pose in enumerate(poses):
            column, row = np.rint(CAMERA.project(pose.inverse().apply(points_m[cylinder]))).astype(int).T
            told[k, row, column] = 2.0
    detector = EvidenceDetector(grid)
    detector.threshold = 12.0
    weights = np.ones(len(poses), np.float32)
    detector._rays = evidence.RayEvidence(frames, weights, limit_m, told, 0.02 * told)
    part = (near | far).reshape(grid.shape)
    body = UprightBody(np.array([-0.055, 0.0]), np.full(2, 0.003), (0.03, 0.03), 0.002, (0.0, 0.16), 60.0)
    taken = detector._accept(part, [body], tuple(slice(0, n) for n in grid.shape))
    assert np.array_equal(taken, near.reshape(grid.shape) if both else part)
    (region,) = detector.regions()
    assert region.body is body


def test_a_second_body_by_the_rays_that_miss_the_first_is_a_region_of_its_own():
    """From one side two vessels in a row overlap; the voxels left by the rays beside the first may hold too little evidence."""
    seen = views(np.random.default_rng(11), np.linspace(-0.5, 0.5, 12), 0.5, ROW_M)
    first, second = (
        UprightBody(axis_m, np.full(2, 0.003), (RADIUS_M, RADIUS_M), 0.002, (LOW_M, HIGH_M), 60.0)
        for axis_m in ROW_M
    )
    hidden = replace(second, height_m=(LOW_M, LOW_M + 0.02), radius_m=(0.02, 0.02))
    grid = SpaceGrid.around((-0.12, -0.06, 0.0), (0.12, 0.06, 0.2), 0.01)
    detector = EvidenceDetector(grid)
    detector.threshold, detector._outlines = 12.0, seen
    detector._rays = replace(detector._rays, weights=np.ones(12, np.float32))
    rest = without_body(seen, first.shape_m)
    alone, beside_first = (detector._rays.bounded(body_evidence(of, second), 0.05) for of in (seen, rest))
    assert 12.0 < beside_first < alone
    assert detector._rays.bounded(body_evidence(rest, hidden), 0.05) < 12.0
    part = np.ones(grid.shape, bool)
    box = tuple(slice(0, n) for n in grid.shape)
    assert np.array_equal(detector._accept(part, [first, second], box), part)
    # A body that meets an accepted one is none.
    detector._accept(part, [replace(second)], box)
    regions = detector.regions()
    assert [region.body for region in regions] == [first, second]
    for region in regions:
        assert np.hypot(*(region.centroid_m[:2] - region.body.axis_m)) < grid.voxel_m


def test_a_part_whose_voxels_are_a_fragment_of_the_rim_is_the_whole_body():
    grid = SpaceGrid.around((-0.12, -0.12, 0.0), (0.12, 0.12, 0.1), 0.01)
    detector = EvidenceDetector(grid)
    detector._rays = replace(detector._rays, weights=np.ones(12, np.float32))
    bowl = UprightBody(np.array([0.01, -0.02]), np.full(2, 0.002), (0.06, 0.075), 0.002, (0.02, 0.06), 60.0)
    part = bowl.contains(points_m := grid.centres_m(np.argwhere(np.ones(grid.shape, bool))))
    part &= (points_m[:, 0] > 0.05) & (points_m[:, 2] > 0.04)
    detector._accept(part.reshape(grid.shape), [bowl], tuple(slice(0, n) for n in grid.shape))
    (region,) = detector.regions()
    assert np.hypot(*(region.centroid_m[:2] - bowl.axis_m)) < 0.5 * grid.voxel_m
    assert region.size_m == pytest.approx([0.15, 0.15, 0.04], abs=2 * grid.voxel_m)


@pytest.mark.parametrize("body", ["clear", "black", "mirror"])
def test_a_place_is_tested_with_the_rates_of_the_rays_beside_it(body):
    """A vessel in a tenth of what eight views know raises the rates that it is compared with; an opaque body lets nothing pass.

    Half of what is read in a mirror agrees with no other view.
    """
    rng, (rows, columns) = np.random.default_rng(5), np.mgrid[0:120, 0:160]
    known = np.hypot(columns - 80, rows - 60) < 34
    frames, images = [], []
    for turn in np.linspace(0, 6, 9)[:8]:
        eye = np.array([0.6 * np.cos(turn), 0.6 * np.sin(turn), 0.55])
        pose = Camera.pose_of_view(tuple(eye), (*AXIS_M, 0.11))
        rays = CAMERA.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
        glass = hit(eye, rays.reshape(120, 160, 3) @ pose.rotation.T)
        dropped = rng.random(glass.shape) < np.where(glass, 0.5, 0.02)
        depth_m = np.where(known, table_depth_m(eye, pose), 0.0).astype(np.float32)
        limit_m = np.maximum(depth_m - np.float32(0.01), 0)
        # What remains of the readings lies behind a clear body, or on an opaque one.
        read = np.where(dropped, DROPPED, np.where(glass & (body == "black"), NEAR, SAME))
        alone = glass & (body == "mirror") & (rng.random(glass.shape) < 0.5)
        reading = np.where(known & ~alone, read, 0).astype(np.uint8)
        frames.append(DepthFrame(0.0, depth_m, None, pose, CAMERA))
        images.append(RayImage(reading, reading.astype(np.uint16), depth_m, limit_m, known))
    detector = EvidenceDetector(SpaceGrid.around((-0.08, -0.13, 0.0), (0.12, 0.07, 0.2), 0.01), NOISE)
    limit_m = np.stack([image.limit_m for image in images])
    # At 0.75 m a radius of 15 mm is 3 px.
    detector._images, detector._matching_px, detector._object_px = images, NOISE.window_px(140.0), [7] * 8
    detector._rays = replace(detector._rays, frames=frames, weights=np.ones(8, np.float32), limit_m=limit_m)
    detector._sum(limit_m > 0, first=True)
    peak = tuple(int(k) for k in np.unravel_index(detector.evidence.argmax(), detector.grid.shape))
    if body == "mirror":
        assert not detector._take_held_out(limit_m)
        return
    if body == "black":
        # What remains of the readings of a black body is on it, so that no rates of other rays make it glass.
        assert not detector._take(peak)
        return
    assert not detector._take()
    assert detector._take_held_out(limit_m)
    assert [np.hypot(*(region.body.axis_m - AXIS_M)) < 0.01 for region in detector.regions()] == [True]


@pytest.mark.parametrize("shown", [True, False])
def test_what_is_behind_a_body_is_what_rays_beside_it_see(shown):
    """A third of the rays reads the table behind the body, or a place above it that readings at a mirror agree on by chance."""
    rng, frames, images = np.random.default_rng(8), [], []
    for turn in np.linspace(0, 6, 9)[:8]:
        eye = np.array([0.6 * np.cos(turn), 0.6 * np.sin(turn), 0.55])
        pose = Camera.pose_of_view(tuple(eye), (*AXIS_M, 0.11))
        rows, columns = np.mgrid[0:120, 0:160]
        rays = CAMERA.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
        inside = hit(eye, rays.reshape(120, 160, 3) @ pose.rotation.T)
        depth_m = table_depth_m(eye, pose).astype(np.float32)
        agreed = inside & (rng.random(inside.shape) < 1 / 3)
        # Half-way between the axis of the body and the table.
        depth_m[agreed] = depth_m[agreed] if shown else np.linalg.norm(eye - [*AXIS_M, 0.11]) + 0.05
        reading = np.where(inside & ~agreed, DROPPED, SAME).astype(np.uint8)
        frames.append(DepthFrame(0.0, depth_m, None, pose, CAMERA))
        image = RayImage(reading, reading.astype(np.uint16), depth_m, depth_m - np.float32(0.01), inside)
        images.append(image)
    limit_m = np.stack([image.limit_m for image in images])
    tables = np.zeros((4, 5 * CONTEXTS), np.float32)
    tables[:, FAR] = np.log(KINDS[:, 1] / 0.01)
    rays = evidence.RayEvidence(frames, np.ones(8, np.float32), limit_m, limit_m, limit_m)
    body = UprightBody(AXIS_M, np.full(2, 0.002), (RADIUS_M, RADIUS_M), 0.002, (LOW_M, HIGH_M), 60.0)
    found = seen_behind(body, rays, images, tables, 5.0, 0.005)
    # Even at a false-alarm rate of 1 %, an opaque body reads nothing behind it.
    assert bool(found > np.log(100)) is shown


@pytest.mark.parametrize(
    ("passing", "wrong", "glass"), [(0.25, 0.01, True), (0.25, 0.2, False), (0.0, 0.01, False)]
)
def test_an_opaque_body_reads_what_is_behind_it_no_more_often_than_misreadings(passing, wrong, glass):
    """Log-ratio of binomial probabilities, the rate of the one uniform: against an integral in steps."""
    rng, weights = np.random.default_rng(2), np.array([0.5, 1.0])
    codes = [
        np.where(rng.random(60) < passing, rng.choice([SAME, FAR], 60), DROPPED).astype(np.uint16)
        for _ in weights
    ]
    tables = np.zeros((4, 5 * CONTEXTS), np.float32)
    tables[:, FAR] = np.log(KINDS[:, 1] / wrong)
    found = passing_evidence(codes, weights, tables)
    behind, none = (
        sum(w * (few == (c == DROPPED)).sum() for w, c in zip(weights, codes, strict=True))
        for few in (False, True)
    )
    rate = (np.arange(20000) + 0.5) / 20000
    clear = np.mean(np.exp(behind * np.log(rate / wrong) + none * np.log((1 - rate) / (1 - wrong))))
    assert found == pytest.approx(np.log(clear), abs=1e-3)
    assert (found > 9.6) is glass
    assert passing_evidence([code[:0] for code in codes], weights, tables) == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("inside", "beside", "alone"),
    [
        ((3.0, 27.0), (12.0, 88.0), False),
        ((4.0, 26.0), (10.0, 90.0), False),
        ((15.0, 15.0), (10.0, 90.0), True),
    ],
)
def test_surfaces_behind_a_body_are_unknown_as_often_as_beside_it(inside, beside, alone):
    """Ratio of the probabilities with one rate and with two, both uniform: against integrals in steps."""
    rate = (np.arange(20000) + 0.5) / 20000

    def mean(unknown, known):
        return np.log(np.mean(np.exp(unknown * np.log(rate) + known * np.log(1 - rate))))

    ratio = mean(*np.add(inside, beside)) - mean(*inside) - mean(*beside)
    found = agreement_evidence(np.array([inside, beside]))
    assert found == pytest.approx(
        min(ratio, 0.0) if inside[0] / inside[1] > beside[0] / beside[1] else 0.0, abs=1e-3
    )
    assert (found < 0) is alone


def bottle_views(rng: np.random.Generator, shift_m: float) -> list[OutlineView]:
    """A bottle of discs: 35 mm below 14 cm, 15 mm from there to 20 cm, ``shift_m`` aside; 9 of 10 readings change through it."""
    import cv2

    ring, found = np.linspace(0, 2 * np.pi, 60), []
    for turn in np.linspace(0, 6, 12):
        pose = Camera.pose_of_view((0.6 * np.cos(turn), 0.6 * np.sin(turn), 0.55), (0.0, 0.0, 0.1))
        mask = np.zeros((960, 1280), np.uint8)
        for z_m in np.arange(0.0, 0.2, 0.002):
            radius_m = 0.035 if z_m < 0.14 else 0.015
            circle = np.column_stack(
                [radius_m * np.cos(ring) + shift_m, radius_m * np.sin(ring), 0 * ring + z_m]
            )
            pixels = CAMERA.project(pose.inverse().apply(circle))
            cv2.fillConvexPoly(mask, np.rint(8 * (pixels + 0.5)).astype(np.int32), 1)
        glass = rng.random((120, 160)) < mask.reshape(120, 8, 160, 8).mean(axis=(1, 3))
        changed = rng.random(glass.shape) < np.where(glass, 0.9, 0.03)
        limit_m = np.full(glass.shape, 2.0, np.float32)
        told = np.where(changed, DROPPED, SAME).astype(np.uint8), [np.zeros_like(limit_m)], limit_m
        found.append(OutlineView.of_view(DepthFrame(0.0, limit_m, None, pose, CAMERA), *told, NOISE, 1.0))
    return found


def test_rings_of_an_outline_follow_a_shoulder_and_a_neck():
    """A pixel is 6 mm wide, and from 43 degrees above, the shoulder hides the neck's first 18 mm of the outline."""
    body = UprightBody(np.zeros(2), np.full(2, 0.003), (0.04, 0.025), 0.002, (0.05, 0.2), 90.0)
    rings = outline_rings(bottle_views(np.random.default_rng(1), 0.0), body, 0.0, 12.0)
    off_m = rings.radius_m - np.where(rings.z_m < 0.14, 0.035, 0.015)
    low, neck = rings.z_m < 0.13, rings.z_m > 0.165
    assert min(low.sum(), neck.sum()) >= 2
    # A fifth of a pixel on average: the shares of changed readings, not the half of a window, place the edge.
    assert abs(off_m[low].mean()) < 0.0012
    assert abs(off_m[neck].mean()) < 0.0025
    assert np.all(np.abs(off_m[low | neck]) < 3 * rings.sigma_m[low | neck])
    # Sides are weighed alike: beside the axis the width stays what it is, and it is known less well.
    aside = outline_rings(bottle_views(np.random.default_rng(1), 0.004), body, 0.0, 12.0)
    assert abs((aside.radius_m - 0.035)[aside.z_m < 0.13].mean()) < 0.0015
    assert rings.common_m == 0.0
    nothing = [
        replace(view, changed=-np.abs(view.changed)) for view in bottle_views(np.random.default_rng(1), 0.0)
    ]
    assert len(outline_rings(nothing, body, 0.0, 12.0).z_m) == 0

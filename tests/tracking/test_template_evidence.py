"""The views used as evidence for templates: correct poses, occlusion and measurement."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from tests.worlds import views

from benchmarks import templates_evidence
from visuohaptic.tracking.templates import Template, detect_templates

pytest.importorskip("skimage")


def test_a_tilted_square_is_foreshortened_as_a_pinhole_does() -> None:
    """Middle at the centre of the image, tilt about x: depth of a point is distance + y sin(tilt)."""
    tilt, scale = np.deg2rad(60), 1.2
    centre = 0.5 * (np.array(views.SIZE) - 1)
    found = views.pinhole(tilt, 0.0, 0.0, scale, centre)
    y = np.array([-60.0, 0.0, 80.0])
    points = views.mapped(
        found, np.column_stack([np.full(3, 0.5 * (views.SIDE - 1)), y + 0.5 * (views.SIDE - 1)])
    )
    distance = views.FOCAL_PX / scale
    expected = centre[1] + views.FOCAL_PX * y * np.cos(tilt) / (distance + y * np.sin(tilt))
    assert np.allclose(points[:, 0], centre[0])
    assert np.allclose(points[:, 1], expected)


@pytest.fixture(scope="module")
def drawn() -> list[views.View]:
    return [views.view(seed) for seed in range(0, 50, 2)]


def test_the_template_is_in_the_image_where_the_homography_says(drawn) -> None:
    checked = 0
    for seen in drawn:
        assert 0.0 <= seen.covered <= 0.42  # the mask is sampled with whole pixels
        assert np.allclose(
            seen.corners, views.mapped(seen.homography, np.array([[0, 0], [199, 0], [199, 199], [0, 199]]))
        )
        if seen.covered > 0.25 or seen.tilt_rad > 0.7:
            continue
        scores = {}
        for shift in (-1.5, 0.0, 1.5):
            moved = np.array([[1, 0, shift], [0, 1, shift], [0, 0, 1.0]]) @ seen.homography
            back = cv2.warpPerspective(seen.image, np.linalg.inv(moved), (views.SIDE, views.SIDE)).astype(
                float
            )
            soft = (
                cv2.GaussianBlur(a.astype(float), (0, 0), 1.5)[20:-20, 20:-20] for a in (seen.template, back)
            )
            scores[shift] = np.corrcoef(*(a.ravel() for a in soft))[0, 1]
        # Shadows, bright spots and what covers it lower all three alike.
        assert max(scores, key=lambda shift: scores[shift]) == 0.0
        checked += 1
    assert checked >= 3


def test_views_are_drawn_over_the_whole_range(drawn) -> None:
    tilt, covered = (np.array([getattr(one, name) for one in drawn]) for name in ("tilt_rad", "covered"))
    assert tilt.min() < np.deg2rad(15)
    assert tilt.max() > np.deg2rad(50)
    assert (covered > 0.2).sum() >= 3
    assert np.array_equal(views.view(2).image, drawn[1].image)


def test_wrong_and_valid_is_counted() -> None:
    base = {"tilt_deg": 10.0, "covered": 0.1, "start_px": 1.0, "reason": "", "chi2": 1.0}
    rows = [
        base | {"valid": True, "worst_px": 2.1},
        base | {"valid": True, "worst_px": 1.9},
        base | {"valid": False, "worst_px": 30.0},
        base | {"valid": True, "worst_px": float("nan")},
    ]
    wrong, followed, honest = templates_evidence.figures(rows)
    assert wrong["ours"] == 50.0
    assert followed["ours"] == 25.0
    assert honest["ours"] == 1.0


def test_a_slice_of_the_campaign_runs(tmp_path) -> None:
    rows = templates_evidence.campaign(count=4, report=tmp_path / "views.jsonl")
    assert len(rows) == 4
    assert rows == templates_evidence.campaign(count=4, report=tmp_path / "views.jsonl")


def test_covered_and_unevenly_lit_views_are_followed(drawn) -> None:
    """Of 25 views at most one is kept valid beyond 2 px, nine of ten are right and valid, and errors are as declared."""
    rows = [templates_evidence.measure(seen) for seen in drawn]
    right = [row["valid"] and row["worst_px"] <= templates_evidence.WRONG_PX for row in rows]
    assert sum(row["valid"] for row in rows) - sum(right) <= 1
    assert sum(right) >= 22
    # chi^2 of 8 degrees of freedom has a median of 0.92 x 8 and a standard deviation of 0.5 x 8: the median of 22 or
    # more is good to 0.13, here three of them. The blur that nobody told made it 2.4 when it was not estimated.
    assert 0.92 - 0.4 < np.median([row["chi2"] for row, good in zip(rows, right, strict=True) if good]) < 1.32


def test_a_template_that_folds_to_a_strip_is_not_kept() -> None:
    """Every sample of a strip of 12 px is explained by the same few pixels, and its blocks agree."""
    row = templates_evidence.measure(views.view(296))
    assert not row["valid"] or row["worst_px"] <= templates_evidence.WRONG_PX


#: Those of the even seeds below 100 that are tilted by more than 45 degrees.
STEEP = (12, 16, 26, 34, 38, 42, 44, 46, 50, 52, 56, 66, 76, 84, 86, 96, 98)


def test_images_that_are_tilted_by_more_than_45_degrees_are_found(drawn) -> None:
    """Of 17 views, covered and unevenly lit, 13; by features of the image as it is 8. Two views fewer are another CPU's."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * (views.SIDE - 1)
    found = []
    for seed in STEEP:
        seen = drawn[seed // 2] if seed < 50 else views.view(seed)
        assert seen.tilt_rad > np.deg2rad(45)
        template = Template.from_image("picture", seen.template, width_m=0.1)
        detection = detect_templates((template,), seen.image).get("picture")
        off = np.inf if detection is None else views.mapped(detection.homography, square) - seen.corners
        found.append(float(np.abs(off).max()) < 12.0)
    assert sum(found) >= 11


def test_a_place_that_the_better_blur_does_not_confirm_is_not_valid() -> None:
    """Two columns of texture: a lattice fits itself, shifted along it, until the image is taken as blurred as it is."""
    row = templates_evidence.measure(views.view(347))
    assert not row["valid"] or row["worst_px"] <= templates_evidence.WRONG_PX

"""Scores of shapes with analytically known scores."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.core import InputError, StiffnessMap
from visuohaptic.grasping import ScoreParameters, deformation_score, grasp_scores

from .objects import box_map, tube_map


def test_a_flat_perpendicular_contact_scores_one_and_half_a_finger_a_half():
    found = box_map(0.03, 0.1, 1e4)
    scores = grasp_scores(found, 10.0)
    points = found.vertices_m
    inner = (np.abs(points[:, 1]) < 0.002) & (np.abs(points[:, 2] - 0.05) < 0.03)
    # F is towards the axis; a vertex off y = 0 is pushed at slightly askew.
    np.testing.assert_allclose(scores.perpendicular[inner], 1.0, atol=3e-3)
    np.testing.assert_allclose(scores.curvature[inner], 1.0, atol=1e-9)
    # Disc of samples 1.7 mm apart: the rule errs by a percent or two at the cusp in its middle.
    np.testing.assert_allclose(scores.contact[inner], 1.0, atol=0.03)
    edge = (np.abs(points[:, 1]) < 0.002) & (points[:, 2] > 0.0999)
    np.testing.assert_allclose(scores.overlap[edge], 0.5, atol=0.03)


def test_the_printed_mean_of_the_factor_is_a_fifth():
    """Why (6.6) is divided by the sum of the factors: by their number no score exceeds w_n / 5."""
    r = np.sqrt((np.arange(100_000) + 0.5) / 100_000)
    assert np.mean(1 - np.sqrt(r)) == pytest.approx(0.2, abs=1e-4)


@pytest.mark.parametrize("radius_m", [0.016, 0.035, 0.05])
def test_curvature_of_a_tube(radius_m):
    """z = -x^2 / (2 R) + ...: the fitted coefficient is that of a circle within 10 mm."""
    found = tube_map(radius_m, 0.05, 1e4, around=64)
    scores = grasp_scores(found, 10.0)
    middle = np.abs(found.vertices_m[:, 2] - 0.025) < 0.012
    # The fourth order of the circle, 3 x^4 / (24 R^3), adds up to d^2 / (4 R^2) of its second.
    expected = 1 - 5e-3 / (2 * radius_m)
    spare = 5e-3 / (2 * radius_m) * (0.01 / radius_m) ** 2 / 4 + 2e-3
    np.testing.assert_allclose(scores.curvature[middle], expected, atol=spare)


def test_height_and_deformation_follow_their_formulas():
    found = tube_map(0.03, 0.1, 4000.0)
    scores = grasp_scores(found, 16.0)
    np.testing.assert_allclose(scores.height, 0.5 + 0.5 * found.vertices_m[:, 2] / 0.1, atol=1e-12)
    np.testing.assert_allclose(scores.deformation_m, 0.004)
    np.testing.assert_allclose(scores.deformation, 0.5 - 0.5 * np.tanh(5 * (0.8 - 1)))
    np.testing.assert_allclose(
        scores.total, scores.contact * scores.curvature * scores.height * scores.deformation
    )


def test_a_point_without_faces_is_no_part_of_the_height():
    plain = tube_map(0.03, 0.1, 4000.0, around=32)
    points = np.concatenate([plain.vertices_m, [[0.0, 0.0, 0.3]]])
    count = len(points)
    more = StiffnessMap(points, plain.faces, np.full(count, 4000.0), np.full(count, np.nan))
    found = grasp_scores(more, 16.0).height[: count - 1]
    np.testing.assert_allclose(found, grasp_scores(plain, 16.0).height, rtol=1e-12)


def test_what_is_held_does_not_deform_and_what_has_nothing_opposite_scores_nothing():
    parameters = ScoreParameters()
    score = deformation_score(np.array([0.0, np.nan, np.inf, 0.005]), parameters)
    # (1 + tanh 5) / 2 at rest.
    np.testing.assert_allclose(score, [1.0, 0.0, 0.0, 0.5], atol=5e-5)
    found = box_map(0.03, 0.1, 1e4)
    half = len(found.vertices_m) // 2
    alone = StiffnessMap(
        found.vertices_m,
        found.faces[: len(found.faces) // 2],
        found.stiffness_N_per_m,
        found.stiffness_sigma_N_per_m,
    )
    scores = grasp_scores(alone, 5.0, axis_point_m=(0.0, 0.0))
    assert not scores.tips.valid[:half].any()
    assert (scores.pair == 0).all()


def test_faces_that_look_inwards_make_no_difference():
    found = tube_map(0.03, 0.08, 4000.0, around=48)
    turned = StiffnessMap(
        found.vertices_m, found.faces[:, ::-1], found.stiffness_N_per_m, found.stiffness_sigma_N_per_m
    )
    np.testing.assert_allclose(grasp_scores(found, 9.0).pair, grasp_scores(turned, 9.0).pair, atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(
    angle=st.floats(0, 2 * np.pi),
    scale=st.floats(0.7, 1.5),
    force=st.floats(0.1, 100),
    stretch=st.floats(0.5, 1.0),
)
def test_scores_stay_in_range_and_turn_with_the_object(angle, scale, force, stretch):
    found = tube_map(0.03 * scale, 0.05, 3000.0, around=32)
    points = found.vertices_m * [1.0, stretch, 1.0]
    c, s = np.cos(angle), np.sin(angle)
    turned = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    both = [
        grasp_scores(
            StiffnessMap(p, found.faces, found.stiffness_N_per_m, found.stiffness_sigma_N_per_m),
            force,
            axis_point_m=(0.0, 0.0),
        )
        for p in (points, turned)
    ]
    for name in ("contact", "curvature", "height", "deformation", "total", "pair"):
        values = getattr(both[0], name)
        assert ((values >= 0) & (values <= 1)).all()
    # Pairs at the very edge of the neighbourhood may fall in or out by rounding; their weight is 0.
    np.testing.assert_allclose(both[0].total, both[1].total, atol=1e-2)


def test_bad_numbers_are_refused():
    with pytest.raises(InputError, match="force_N: found 0"):
        grasp_scores(tube_map(0.03, 0.05, 1e3, around=16), 0.0)
    with pytest.raises(InputError, match="height_weight: found 2"):
        ScoreParameters(height_weight=2)
    with pytest.raises(InputError, match="neighbourhood_m: found -1"):
        ScoreParameters(neighbourhood_m=-1)

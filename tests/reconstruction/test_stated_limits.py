"""What the constants of reconstruction are said to be, computed by other means."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm

from visuohaptic.core import InputError
from visuohaptic.reconstruction import SurfaceMesh, body_completion, pipeline
from visuohaptic.reconstruction.completion import discrete_symmetry, hole
from visuohaptic.reconstruction.completion.symmetry import _probability
from visuohaptic.reconstruction.completion.touch_registration import register_touches
from visuohaptic.reconstruction.fusion import _fusion_view
from visuohaptic.reconstruction.transparency import outline_fit, ray_readings


def test_a_rim_is_anywhere_within_its_cell() -> None:
    place = np.random.default_rng(1).random(50_000)
    assert pytest.approx(place.std(), rel=0.02) == hole._RIM


def test_the_odds_of_a_symmetry_are_those_of_twelve_objects_of_fifteen() -> None:
    """The mean of the posterior of a rate with a uniform prior, by quadrature."""
    rate = (np.arange(20_000) + 0.5) / 20_000
    weight = rate**12 * (1.0 - rate) ** 3
    mean = float((rate * weight).sum() / weight.sum())
    assert mean / (1.0 - mean) == pytest.approx(discrete_symmetry._ODDS, rel=0.01)


def test_one_draw_in_five_knows_a_half_to_a_fortieth() -> None:
    kept = np.random.default_rng(1).random((4000, body_completion._DRAWS // 5)) < 0.5
    assert kept.mean(axis=1).std() == pytest.approx(1 / 40, rel=0.05)


def test_depths_that_agree_are_missed_once_in_a_hundred() -> None:
    assert 2.0 * norm.sf(ray_readings._WIDTH) == pytest.approx(0.01, abs=0.004)


def test_a_part_of_a_rim_has_the_radius_of_its_circle() -> None:
    """Half, a quarter, a sixth and a tenth of a circle, by the distance of the two ends of the arc."""
    for part, radius in zip((2, 4, 6, 10), outline_fit._CHORDS, strict=True):
        ends = np.exp(1j * np.array([0.0, 2.0 * math.pi / part]))
        assert radius == pytest.approx(1.0 / abs(ends[1] - ends[0]), rel=0.01)


def test_both_ends_of_a_grazed_edge_are_observed() -> None:
    """A ray at the incidence up to which cameras have readings leaves a voxel behind the surface after 1 / cos of it."""
    at_deepest = 1.0 / math.cos(math.atan(_fusion_view.GRAZING_SLOPE))
    assert at_deepest - 1.0 < _fusion_view.GRAZING_VOXELS <= at_deepest
    assert math.degrees(math.atan(_fusion_view.GRAZING_SLOPE)) == pytest.approx(76.0, abs=2.0)


@pytest.mark.parametrize(("contacts", "enough"), [(5, False), (6, True)])
def test_six_contacts_determine_a_rigid_motion(contacts: int, enough: bool) -> None:
    """Each contact gives one distance along a normal; three translations and three rotations."""
    vertices = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    touched = SurfaceMesh(vertices, faces).sampled(contacts, np.random.default_rng(1))[0]
    if enough:
        register_touches(touched, SurfaceMesh(vertices, faces))
        return
    with pytest.raises(InputError):
        register_touches(touched, SurfaceMesh(vertices, faces))


@pytest.mark.parametrize(("residual", "probable"), [(0.028, True), (0.032, False)])
def test_a_symmetry_is_as_probable_as_not_at_three_hundredths(residual: float, probable: bool) -> None:
    assert (_probability(residual) > 0.5) == probable


def test_depth_in_millimetres_is_rounded() -> None:
    depth_m = np.random.default_rng(1).uniform(0.5, 1.0, 50_000)
    assert pytest.approx((np.round(depth_m, 3) - depth_m).std(), rel=0.02) == pipeline._MIN_SIGMA_M

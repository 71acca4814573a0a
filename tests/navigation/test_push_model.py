"""Loads and patches are in equilibrium; unstable bodies are rejected."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.core.geometry import polygon_area, polygon_centroid
from visuohaptic.navigation.pushing import PushModel, load_of_feet, patch_points

SQUARE = 0.15 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
ELL = np.array([[0, 0], [0.4, 0], [0.4, 0.1], [0.1, 0.1], [0.1, 0.3], [0, 0.3]], dtype=float)


@settings(max_examples=50, deadline=None)
@given(st.integers(3, 12), st.integers(0, 10_000))
def test_loads_of_feet_balance_force_and_moments(count, seed):
    rng = np.random.default_rng(seed)
    feet = rng.uniform(-0.3, 0.3, (count, 2))
    if np.linalg.matrix_rank(feet - feet[0], tol=1e-3) < 2:
        return
    centre = feet.mean(axis=0)
    load = load_of_feet(feet, tuple(centre))
    assert load.sum() == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(load @ feet, centre, atol=1e-9)


def test_a_thing_that_would_tip_is_refused():
    with pytest.raises(InputError, match="foot 0 would be lifted"):
        load_of_feet(SQUARE[:3], (0.2, 0.2))
    with pytest.raises(InputError, match="all feet on one line"):
        load_of_feet(np.array([[0, 0], [1, 1], [2, 2]]))


@pytest.mark.parametrize("outline", [SQUARE, ELL])
def test_a_patch_has_the_centroid_of_its_outline(outline):
    points, load = patch_points(outline)
    assert polygon_area(outline) > 0
    np.testing.assert_allclose(load @ points, polygon_centroid(outline), atol=1e-12)


def test_the_lever_of_a_disc_and_of_a_square_are_those_of_even_pressure():
    # Mean distance from the centre: 2/3 R of a disc, 0.7652 a of a square of half side a.
    assert PushModel.disc(0.2).lever_m == pytest.approx(0.2 * 2 / 3, rel=0.01)
    assert PushModel.patch(SQUARE).lever_m == pytest.approx(0.7652 * 0.15, rel=0.02)


def test_loads_are_fractions_of_their_sum():
    """Twice the load on every foot is the same body: its centre is that of the lower edge, which carries two thirds."""
    load = np.array([2.0, 2.0, 1.0, 1.0])
    model = PushModel(SQUARE, SQUARE, load)
    np.testing.assert_allclose(model.load, load / 6)
    np.testing.assert_allclose(model.centre_m, [0.0, -0.05], atol=1e-12)


def test_a_clockwise_outline_is_turned_round():
    assert polygon_area(PushModel.patch(SQUARE[::-1]).outline_m) > 0


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"outline_m": np.zeros((0, 2))}, "outline_m"),
        ({"support_m": np.zeros((4, 3))}, "support_m"),
        ({"load": np.array([1.0, -1.0, 1.0, 1.0])}, "fractions >= 0"),
        ({"contact_friction": np.nan}, "contact_friction"),
    ],
)
def test_what_makes_no_sense_is_named(change, text):
    good = {"outline_m": SQUARE, "support_m": SQUARE, "load": np.ones(4), "contact_friction": 0.2}
    with pytest.raises(InputError, match=text):
        PushModel(**{**good, **change})

"""What hidden foam may do, and errors that the zero has, too."""

from __future__ import annotations

import numpy as np

from visuohaptic.sensing.foam.deflection import fill_gaps, with_cancelled_texture
from visuohaptic.sensing.foam.posterior import EdgeStates
from visuohaptic.sensing.foam.strip import StripGeometry

GEOMETRY = StripGeometry.straight(0.25, 0.02)
K = len(GEOMETRY.s_m)
SIGMA = np.full(K, 1e-5)


def filled(delta, hidden):
    """The contour with an occluder on some of its points."""
    probability = np.zeros((K, 4))
    probability[:, 0], probability[hidden] = 1.0, [0.0, 0.0, 1.0, 0.0]
    states = EdgeStates(probability, np.zeros((K, K)), np.zeros((K, 5)))
    return fill_gaps(GEOMETRY, delta, SIGMA, SIGMA, 0.0 * SIGMA, delta, states)


def test_what_is_hidden_is_bounded_by_what_it_draws_along(continuum, reference_law) -> None:
    # As sharp as a pencil: whatever is blunter draws more foam along beside it.
    presses = continuum.press(
        reference_law, continuum.cylinder(0.006), (0.001, 0.003), length=0.05, fine=6e-4, rows=8
    )
    for depth, _, s, delta in presses:
        for half_m in (0.005, 0.008, 0.012):
            contour = np.interp(np.abs(GEOMETRY.s_m), s, delta)
            found = filled(contour, np.abs(GEOMETRY.s_m) < half_m)
            assert found.gap
            assert (found.hidden_m[~found.seen] >= contour[~found.seen]).all(), (depth, half_m)


def test_a_finger_beside_nothing_hides_little_and_a_hand_hides_anything(material) -> None:
    force = [
        filled(np.zeros(K), np.abs(GEOMETRY.s_m) < half_m).hidden_force_N(material, GEOMETRY.s_m)
        for half_m in (0.007, 0.04)
    ]
    # 5 points of 3 mm, at most 9 mm from the last one seen: 10 um exp(9 / 3) each at 0.1 N per mm and point.
    assert force[0] < 5 * 0.1 * 0.01 * np.exp(9 / 3)
    assert force[1] > 0.5


def test_a_gap_at_the_end_of_the_strip_is_bounded_from_one_side() -> None:
    found = filled(np.zeros(K), np.arange(K) < 4)
    assert np.all(np.diff(found.hidden_m[:4]) < 0.0)
    assert np.isfinite(found.delta_m).all()


def test_two_points_are_bridged_and_not_hidden() -> None:
    delta = 0.004 * np.exp(-np.maximum(np.abs(GEOMETRY.s_m) - 0.01, 0.0) / 0.006)
    found = filled(delta, np.isin(np.arange(K), (45, 46)))
    assert not found.gap
    assert (np.abs(found.delta_m - delta) < 3.0 * found.sigma_m)[45:47].all()


def test_texture_that_the_zero_has_too_cancels() -> None:
    rng = np.random.default_rng(4)
    noise, texture = np.full(K, 5e-6), 3e-5
    pixel, clean = np.full(K, 2e-4), np.ones(K, dtype=bool)
    declared = np.full(K, np.hypot(5e-6, texture))
    rest = 5e-6 * rng.standard_normal(K)
    sigma = with_cancelled_texture(rest, declared, noise, clean, pixel)
    # Its scatter over 81 second differences is known to a fifth.
    assert np.median(sigma) < 1.5 * 5e-6
    moved = np.where(np.abs(GEOMETRY.s_m) < 0.02, 0.003, rest)
    sigma = with_cancelled_texture(moved, declared, noise, clean, pixel)
    np.testing.assert_allclose(sigma[np.abs(GEOMETRY.s_m) < 0.02], declared[0], rtol=1e-6)
    # Another light at every point: nothing cancels.
    changed = np.hypot(5e-6, texture) * rng.standard_normal(K)
    sigma = with_cancelled_texture(changed, declared, noise, clean, pixel)
    assert 0.7 < np.median(sigma) / declared[0] < 1.4

"""The rigid motion of the reference contour, against motions applied to its points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visuohaptic.sensing.foam.strip._reference import fit_motion, motion_basis


def _contour(bent: bool) -> tuple[np.ndarray, np.ndarray]:
    if bent:
        angle = np.linspace(-0.7, 0.7, 85)
        outward = np.column_stack([np.sin(angle), -np.cos(angle)])
        return np.array([800.0, 1500.0]) + 1000.0 * outward, outward
    return np.column_stack([np.linspace(100, 1500, 85), np.full(85, 600.0)]), np.tile([0.0, -1.0], (85, 1))


def _basis(points: np.ndarray, outward: np.ndarray) -> np.ndarray:
    return motion_basis(points, outward, points.mean(axis=0), 700.0)


@given(
    dx=st.floats(-5, 5),
    dy=st.floats(-5, 5),
    turn=st.floats(-0.005, 0.005),
    zoom=st.floats(-0.005, 0.005),
    bent=st.booleans(),
)
def test_small_similarity_motions_are_recovered(dx, dy, turn, zoom, bent) -> None:
    points, outward = _contour(bent)
    centre = points.mean(axis=0)
    rotation = np.array([[1 + zoom, -turn], [turn, 1 + zoom]])
    moved = (points - centre) @ rotation.T + centre + [dx, dy]
    # What a tracker sees: how far the moved contour lies along each point's own line.
    shift = np.einsum("ki,ki->k", moved - points, outward)
    motion = fit_motion(_basis(points, outward), shift, np.full(85, 0.03), np.ones(85, dtype=bool))
    assert motion is not None
    # The prior of 20 px pulls by less than 0.03^2 / 20^2 of the motion; the fit is exact otherwise.
    assert np.abs(_basis(points, outward) @ motion.parameters - shift).max() < 1e-3


def test_a_third_covered_does_not_move_it() -> None:
    rng = np.random.default_rng(3)
    points, outward = _contour(bent=False)
    shift = 1.5 + 0.03 * rng.standard_normal(85)
    shift[10:38] = rng.uniform(-10, 10, 28)
    motion = fit_motion(_basis(points, outward), shift, np.full(85, 0.03), np.ones(85, dtype=bool))
    assert motion is not None
    fitted = _basis(points, outward) @ motion.parameters
    # 57 good points of 0.03 px, extrapolated over the covered third: a few hundredths at most.
    assert np.abs(fitted - 1.5).max() < 0.05


def test_declared_sigma_is_the_scatter() -> None:
    rng = np.random.default_rng(4)
    points, outward = _contour(bent=True)
    basis = _basis(points, outward)
    ratios = []
    for _ in range(300):
        motion = fit_motion(basis, 0.05 * rng.standard_normal(85), np.full(85, 0.05), np.ones(85, dtype=bool))
        assert motion is not None
        middle = basis[42]
        ratios.append(middle @ motion.parameters / np.sqrt(middle @ motion.covariance @ middle))
    # 300 draws know a standard deviation to 4 %; Tukey's weights cost 5 % efficiency.
    assert np.std(ratios) == pytest.approx(1.0, abs=0.15)


def test_too_few_points_are_no_motion() -> None:
    points, outward = _contour(bent=False)
    usable = np.zeros(85, dtype=bool)
    usable[:5] = True
    assert fit_motion(_basis(points, outward), np.zeros(85), np.ones(85), usable) is None

"""Triangles are closed where they must be, and face outwards."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.viewer import columns, pressure_colours, prism


@pytest.mark.parametrize("direction", [1, -1])
def test_a_prism_has_the_volume_of_its_outline_and_height(direction):
    """Divergence theorem: without a bottom at z = 0, the flux of (0, 0, z) is the volume; 24 corners."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)[::direction]
    vertices, faces = prism(np.column_stack([np.cos(angle), np.sin(angle)]), 0.5)
    corners = vertices[faces]
    normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flux = np.sum(normal[:, 2] * corners[:, :, 2].mean(axis=1))
    assert flux == pytest.approx(0.5 * 12 * np.sin(2 * np.pi / 24))
    # Sides look away from the axis.
    sides = normal[:, 2] == 0
    assert (np.sum(normal[sides, :2] * corners[sides].mean(axis=1)[:, :2], axis=1) > 0).all()


def test_columns_fill_the_strip():
    s_m = np.linspace(-0.1, 0.1, 41)
    back_m, front_m = np.column_stack([0 * s_m, s_m]), np.column_stack([0 * s_m + 0.04, s_m])
    positions_m, quaternions, sizes_m = columns(back_m, front_m, 0.05)
    np.testing.assert_allclose(positions_m, np.column_stack([0 * s_m + 0.02, s_m, 0 * s_m - 0.05]))
    np.testing.assert_allclose(quaternions, np.tile([1, 0, 0, 0], (41, 1)))
    np.testing.assert_allclose(sizes_m, np.tile([0.04, 0.005, 0.05], (41, 1)))


def test_columns_of_a_bent_strip_point_outwards():
    angle = np.linspace(-0.5, 0.5, 21)
    outwards = np.column_stack([np.cos(angle), np.sin(angle)])
    _, quaternions, sizes_m = columns(0.2 * outwards, 0.24 * outwards, 0.05)
    np.testing.assert_allclose(2 * np.arctan2(quaternions[:, 3], quaternions[:, 0]), angle)
    np.testing.assert_allclose(sizes_m[:, 0], 0.04)


def test_colours_go_from_pale_to_red_and_are_grey_when_unknown():
    colours = pressure_colours(np.array([0.0, 5e3, 1e6, np.nan]), 5e3)
    np.testing.assert_array_equal(colours[1], colours[2])
    assert colours[0].sum() > colours[1].sum()
    np.testing.assert_array_equal(colours[3], [150, 150, 150])


def test_bad_shapes_are_refused():
    with pytest.raises(InputError, match=r"finite numbers \(n, 2\), n >= 3"):
        prism(np.zeros((2, 2)), 1.0)
    with pytest.raises(InputError, match=r"expected numbers \(K, 2\)"):
        columns(np.zeros((3, 2)), np.zeros((4, 2)), 0.05)

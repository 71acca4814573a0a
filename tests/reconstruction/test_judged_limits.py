"""Limits of surfaces and depth images, from both sides."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtri

from visuohaptic.reconstruction.completion.outline import axial_part, measured_outline
from visuohaptic.reconstruction.mesh import SurfaceMesh
from visuohaptic.reconstruction.odometry.depth_edges import _steps
from visuohaptic.reconstruction.pipeline import _band_m


def _face(z_m: float, normal_z: float) -> SurfaceMesh:
    """A triangle around x = 0.03 m whose normal has this vertical part."""
    tilt = math.asin(normal_z)
    up, side = np.array([-math.sin(tilt), 0.0, math.cos(tilt)]), np.array([0.0, 1.0, 0.0])
    corners = np.array([0.03, 0.0, z_m]) + 1e-4 * np.array([side, up - side, -up])
    return SurfaceMesh(corners, np.array([[0, 1, 2]]))


@pytest.mark.parametrize(
    ("z_m", "normal_z", "kept"),
    [(0.0037, 0.0, False), (0.0043, 0.0, True), (0.05, -0.28, True), (0.05, -0.32, False)],
)
def test_a_wall_is_above_the_table_and_does_not_look_down(z_m: float, normal_z: float, kept: bool) -> None:
    """Fusion rounds the foot over 4 mm, and closes the lower edge of a label."""
    mesh = _face(z_m, normal_z)
    assert mesh.face_normals[0, 2] == pytest.approx(normal_z, abs=1e-6)
    assert (len(axial_part(mesh, np.zeros(2), 0.1).faces) == 1) == kept


def _rings(*rings: tuple[float, float, int]) -> SurfaceMesh:
    """Rings of vertices: radius, height [m], and number."""
    parts = []
    for radius, z, count in rings:
        angle = 2.0 * np.pi * np.arange(count) / count
        parts.append(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, z)]))
    points = np.vstack(parts)
    k = np.arange(len(points))
    return SurfaceMesh(points, np.column_stack([k, np.roll(k, -1), np.roll(k, -2)]))


@pytest.mark.parametrize(("count", "measured"), [(5, False), (6, True)])
def test_a_slice_of_an_outline_has_six_vertices(count: int, measured: bool) -> None:
    found = measured_outline(
        _rings((0.03, 0.02, 40), (0.04, 0.044, count), (0.03, 0.1, 40)), np.zeros(2), 0.1
    )
    assert bool((np.abs(found[:, 0] - 0.04) < 1e-9).any()) == measured


@pytest.mark.parametrize(("below_m", "wall"), [(0.0027, False), (0.0033, True)])
def test_the_uppermost_three_millimetres_may_be_the_lid(below_m: float, wall: bool) -> None:
    """Three ticks of depth at half a metre."""
    rings = _rings((0.03, 0.02, 40), (0.02, 0.103 - below_m, 40), (0.03, 0.103, 40))
    assert bool((np.abs(measured_outline(rings, np.zeros(2), 0.1)[:, 0] - 0.02) < 1e-9).any()) == wall


def _step(behind_m: float, gap: int, focal_px: float) -> bool:
    """A row of 200 pixels: one metre, some without reading, the farther surface to the left."""
    row = np.ones((1, 200), np.float32)
    row[0, :50] = behind_m
    row[0, 50 : 49 + gap] = np.nan
    return bool(_steps(row, focal_px)[0, 49 + gap])


def test_a_step_is_a_twentieth_of_the_depth_beyond_what_a_grazing_surface_rises() -> None:
    """Up to 73 degrees off the line of sight, one pixel is its tangent; a shadow is a twentieth of the image wide."""
    assert not _step(1.046, 1, 1e6)
    assert _step(1.054, 1, 1e6)
    rise = math.tan(math.radians(73.1)) * 10 / 500.0
    assert not _step(1.05 + 0.93 * rise, 10, 500.0)
    assert _step(1.05 + 1.07 * rise, 10, 500.0)
    assert _step(1.5, 10, 500.0)
    assert not _step(1.5, 11, 500.0)


def test_a_band_is_exceeded_by_one_of_740_readings_and_contains_an_edge_of_the_grid() -> None:
    """Beyond a surface, by a normal error; an edge that crosses it at 60 degrees is two voxels long along the ray."""
    grid: Any = SimpleNamespace(low_m=np.zeros(3), high_m=np.zeros(3), voxel_m=0.006)
    frame: Any = SimpleNamespace(T_world_camera=SimpleNamespace(translation_m=np.array([1.0, 0.0, 0.0])))
    for sigma_m, expected_m in (
        (0.01, 0.01 * float(-ndtri(1 / 740))),
        (0.001, 0.006 / math.cos(math.radians(60.0))),
    ):
        noise: Any = SimpleNamespace(depth_sigma_m=sigma_m)
        assert _band_m(grid, [frame], noise) == pytest.approx(expected_m, rel=0.01)

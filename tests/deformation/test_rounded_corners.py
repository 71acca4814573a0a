"""Stiffness at the rounded corners of a carton, where a wall resists most, against elements with transverse shear."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csc_array

from visuohaptic.core.geometry import vertex_normals
from visuohaptic.deformation.shells import IsotropicMaterial, ShellMesh, ShellModel
from visuohaptic.reproduce.worlds.mitc4 import mitc4_factor, mitc4_stiffness

HALF_m, CORNER_m, HEIGHT_m, AT_m = 0.035, 0.006, 0.08, 0.05
PATCH_m = 0.004


def graded(length: float, first: float) -> np.ndarray:
    """Places from 0, whose distances grow by a quarter up to 4 mm."""
    places, step = [0.0], first
    while places[-1] < length:
        places.append(places[-1] + step)
        step = min(1.25 * step, 0.004)
    return np.array(places) * length / places[-1]


def section(along_m: np.ndarray) -> np.ndarray:
    """Points (n, 2) of a quarter of the section, from the middle of its corner (at 45 degrees) to that of the next [m]."""
    arc, side = 0.25 * np.pi * CORNER_m, 2 * (HALF_m - CORNER_m)
    angle = (
        0.25 * np.pi + np.minimum(along_m, arc) / CORNER_m + np.maximum(along_m - arc - side, 0) / CORNER_m
    )
    centre = HALF_m - CORNER_m - np.clip(along_m - arc, 0, side)
    return np.stack([centre + CORNER_m * np.cos(angle), HALF_m - CORNER_m + CORNER_m * np.sin(angle)], axis=1)


def carton(first: float) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Vertices, quadrilaterals, their number around, and the row that is pressed."""
    quarter = 0.5 * np.pi * CORNER_m + 2 * (HALF_m - CORNER_m)
    fine, coarse = graded(0.5 * quarter, first), np.linspace(0, 0.5 * quarter, 25)
    away = section(np.concatenate([fine[:-1], 0.5 * quarter + coarse[:-1]]))
    back = section(np.concatenate([coarse[:-1], quarter - fine[::-1][:-1]])) @ np.array([[0, 1], [-1, 0]])
    half = np.concatenate([away, back])
    outline = np.concatenate([half, -half])
    up, down = graded(HEIGHT_m - AT_m, first), graded(AT_m, first)
    heights = np.concatenate([AT_m - down[::-1], AT_m + up[1:]])
    count = len(outline)
    points = np.concatenate([np.column_stack([outline, np.full(count, z)]) for z in heights])
    row, column = (x.ravel() for x in np.mgrid[: len(heights) - 1, :count])
    low, side = row * count + column, row * count + (column + 1) % count
    return points, np.stack([low, side, side + count, low + count], axis=1), count, len(down) - 1


@pytest.mark.parametrize("thickness", [0.0005, 0.001])
def test_a_corner_under_a_fingertip_is_as_stiff_as_with_transverse_shear(thickness: float) -> None:
    """Two patches of 4 mm across the diagonal. Under a point, the other code is softer without limit, by ln(1 / size)."""
    points, quads, count, row = carton(0.001)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    material = IsotropicMaterial(2.8e9, 0.38)
    fixed = np.zeros((len(points), 6), dtype=bool)
    fixed[:count] = True
    sides = points[faces]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
    share = np.bincount(faces.ravel(), np.repeat(area, 3) / 3)
    load = np.zeros((len(points), 6))
    tips = row * count, row * count + count // 2
    towards = (points[tips[1]] - points[tips[0]]) / np.linalg.norm(points[tips[1]] - points[tips[0]])
    for tip, sign in zip(tips, (1.0, -1.0), strict=True):
        pressed = share * (np.linalg.norm(points - points[tip], axis=1) <= PATCH_m)
        load[:, :3] += sign * (pressed / pressed.sum())[:, None] * towards
    matrices = mitc4_stiffness(points, quads, vertex_normals(points, quads), thickness, material)
    expected = load.ravel() @ mitc4_factor(points, quads, matrices, fixed).solve(load.ravel())
    model = ShellModel(ShellMesh(points, faces, thickness), material, fixed=range(count))
    found = model.factor().compliance(model.free_loads(csc_array(load.reshape(-1, 1))))[0]
    # Shear is 2 % of it.
    assert found == pytest.approx(expected, rel=0.02)

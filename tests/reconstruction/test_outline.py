"""Outline of a mesh of revolution compared with its generating profile."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.reconstruction.completion import axial_part, measured_outline, standing_object, wall_seen

AXIS = np.array([0.3, -0.1])


def cone(top_m: float = 0.2, rings: int = 101, around: int = 24) -> SurfaceMesh:
    """Radius falls from 40 mm to 20 mm over the height."""
    z = np.linspace(0.0, top_m, rings)
    radius = 0.04 - 0.1 * z
    angle = 2.0 * np.pi * np.arange(around) / around
    points = np.stack(
        [
            AXIS[0] + radius[:, None] * np.cos(angle),
            AXIS[1] + radius[:, None] * np.sin(angle),
            np.broadcast_to(z[:, None], (rings, around)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    ring, turn = np.divmod(np.arange((rings - 1) * around), around)
    a, b = ring * around + turn, ring * around + (turn + 1) % around
    faces = np.concatenate(
        [np.column_stack([a, b, b + around]), np.column_stack([a, b + around, a + around])]
    )
    return SurfaceMesh(points, faces)


def test_the_outline_is_the_profile() -> None:
    outline = measured_outline(cone(), AXIS, 0.06)
    assert outline[0, 1] == 0.0
    assert outline[-1, 1] == pytest.approx(0.2, abs=0.002)
    inner = outline[1:-1]
    # A slice of 8 mm mixes radii by 0.4 mm to either side; its median is that of its middle.
    assert inner[:, 0] == pytest.approx(0.04 - 0.1 * inner[:, 1], abs=2e-4)


def test_only_what_is_near_the_axis_and_above_the_table_counts() -> None:
    part = axial_part(cone(), AXIS, 0.035)
    middle = part.vertices_m[part.faces].mean(axis=1)
    assert len(part.faces) > 0
    assert np.hypot(*(middle[:, :2] - AXIS).T).max() < 0.035
    assert middle[:, 2].min() > 0.004


def test_where_no_wall_is_seen_there_is_no_outline() -> None:
    """Nothing within reach; a top alone; and a ring, whose radius is repeated at foot and top."""
    whole = cone()
    assert measured_outline(whole, AXIS + 1.0, 0.06).shape == (0, 2)
    height_m = whole.vertices_m[whole.faces].mean(axis=1)[:, 2]
    assert measured_outline(whole.submesh(np.flatnonzero(height_m > 0.198)), AXIS, 0.06).shape == (0, 2)
    ring = measured_outline(whole.submesh(np.flatnonzero(abs(height_m - 0.1) < 0.012)), AXIS, 0.06)
    assert ring[[0, -1], 0] == pytest.approx(ring[[1, -2], 0])
    assert ring[1:-1, 0] == pytest.approx(0.04 - 0.1 * ring[1:-1, 1], abs=5e-4)


@pytest.mark.parametrize("ratio", [1.0, 0.74])
def test_what_stands_near_a_place_is_found_and_round_or_not(ratio: float) -> None:
    mesh = cone()
    across = AXIS + (mesh.vertices_m[:, :2] - AXIS) @ np.diag([1.0, ratio])
    mesh = SurfaceMesh(np.column_stack([across, mesh.vertices_m[:, 2]]), mesh.faces)
    axis, squash, wide_rad = standing_object(mesh, AXIS + np.array([0.05, -0.04]), 0.12, 0.065)
    assert axis == pytest.approx(AXIS, abs=3e-4)
    assert squash == pytest.approx(ratio, abs=0.01)
    assert ratio == 1.0 or wide_rad == pytest.approx(0.0, abs=0.01)
    assert not np.isfinite(standing_object(mesh, AXIS + 1.0, 0.12, 0.065)[0]).any()


def test_readings_of_a_cone_refer_to_the_height_of_their_row():
    """Sectors that are seen at other heights have the same level: the slope within a row is removed, exactly for a line."""
    rng = np.random.default_rng(4)
    theta, z_m = rng.uniform(-np.pi, np.pi, 600), rng.uniform(0.02, 0.08, 600)
    z_m += 0.01 * np.sign(theta)
    rho_m = np.exp(-3.0 + 2.0 * z_m)
    walls_m = np.column_stack([rho_m * np.cos(theta) + AXIS[0], rho_m * np.sin(theta) + AXIS[1], z_m])
    band = SimpleNamespace(
        walls_m=walls_m, rim_sigma_m=np.zeros(600), normals=np.zeros((600, 3)), cell_m=0.003
    )
    prior = SimpleNamespace(
        axis_m=AXIS, heights_m=np.array([0.04, 0.07]), section=lambda theta, z_m: np.zeros(len(theta))
    )
    seen = wall_seen(prior, band)
    np.testing.assert_allclose(seen.logs, -3.0 + 2.0 * seen.z_m[seen.row], atol=1e-9)

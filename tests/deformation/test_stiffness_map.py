"""The map of every pinch against one solve per pinch, symmetry, and another theory."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.deformation.shapes import tube_mesh
from visuohaptic.deformation.shells import (
    DualTips,
    IsotropicMaterial,
    RevolutionShell,
    ShellMesh,
    ShellModel,
    dual_tip_compliance,
    dual_tip_map,
    opposing_points,
    pinch_stiffness,
    tip_loads,
)
from visuohaptic.deformation.shells.stiffness_map import bent_loads

from .assembly import stiffness_matrix

PLASTIC = IsotropicMaterial(2.5e9, 0.38)


def ellipse_tube(around=23, along=8, long=0.045, short=0.025):
    """An odd number of columns: nothing faces a vertex exactly."""
    mesh = tube_mesh(1.0, 0.1, 0.0005, around=around, along=along)
    return ShellMesh(mesh.vertices_m * [long, short, 1], mesh.faces, 0.0005, mesh.fraction)


def test_opposite_is_across_the_axis_at_the_same_height():
    mesh = ellipse_tube()
    tips = opposing_points(mesh, axis_point_m=(0.0, 0.0))
    assert tips.valid.all()
    second = np.einsum("mk,mki->mi", tips.weights, mesh.vertices_m[tips.second])
    first = mesh.vertices_m[tips.first]
    assert second[:, 2] == pytest.approx(first[:, 2], abs=1e-12)
    assert tips.weights.sum(axis=1) == pytest.approx(1)
    assert np.all(tips.weights >= 0)
    # First tip, axis and second tip are on one line, the axis between.
    side = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    assert np.abs(side).max() < 1e-12
    assert np.all(np.einsum("mi,mi->m", first[:, :2], second[:, :2]) < 0)


def test_the_map_equals_one_solve_per_pinch():
    mesh = ellipse_tube()
    model = ShellModel(mesh, PLASTIC, range(23))
    tips = opposing_points(mesh, axis_point_m=(0.0, 0.0))
    found = dual_tip_map(model, tips)
    loads = tip_loads(model.nodes, tips, model.mesh.vertices_m).toarray()
    for which in range(25, len(tips), 17):
        load = loads[:, which].reshape(-1, 6)
        expected = 2 / np.sum(load * model.solve(load))
        assert found[which] == pytest.approx(expected, rel=1e-8)
    assert np.all(np.isinf(found[:23]))


def test_a_round_tube_is_equally_stiff_round_the_ring_and_as_the_series_says():
    around, along = 48, 40
    model = ShellModel(tube_mesh(0.035, 0.2, 0.0005, around=around, along=along), PLASTIC, range(around))
    rings = dual_tip_map(model).reshape(along + 1, around)
    # Crossed cells leave no direction preferred: what remains is rounding.
    assert np.ptp(rings[1:], axis=1).max() < 1e-8 * rings[1:].max()
    height = np.linspace(0, 0.2, 81)
    series = pinch_stiffness(RevolutionShell(np.full(81, 0.035), height, 0.0005), PLASTIC)
    middle = slice(12, 36)
    # This mesh is coarse (4.6 x 5 mm): 2.5 %.
    assert rings[middle, 0] == pytest.approx(series[2 * 12 : 2 * 36 : 2], rel=0.025)


def test_stiffness_goes_with_the_modulus_and_nearly_the_square_of_the_wall():
    mesh = ellipse_tube(24)
    base = dual_tip_map(ShellModel(mesh, PLASTIC, range(24)))[24:]
    stiffer = dual_tip_map(ShellModel(mesh, IsotropicMaterial(5e9, 0.38), range(24)))[24:]
    assert stiffer == pytest.approx(2 * base, rel=1e-8)
    thicker = ShellMesh(mesh.vertices_m, mesh.faces, 0.00055, mesh.fraction)
    power = np.log(dual_tip_map(ShellModel(thicker, PLASTIC, range(24)))[24:] / base) / np.log(1.1)
    assert np.all((power > 1.5) & (power < 3.0))


def test_gas_is_one_rank_one_term():
    """Compliances of the closed container from one extra solve equal a full update of the matrix."""
    mesh = ellipse_tube(24)
    model = ShellModel(mesh, PLASTIC, range(24))
    tips = opposing_points(mesh, np.arange(24, len(mesh.vertices_m), 31))
    loads = tip_loads(model.nodes, tips, model.mesh.vertices_m).toarray()
    a = model.volume_gradient()
    kappa = 1e5 / 3e-4
    w = model.solve(a).ravel()
    fraction = loads.T @ w
    closed = dual_tip_compliance(model, tips) - fraction**2 / (1 / kappa + a.ravel() @ w)
    free = model.free
    dense = stiffness_matrix(model).toarray()[np.ix_(free, free)]
    dense += kappa * np.outer(a.ravel()[free], a.ravel()[free])
    expected = np.diag(loads[free].T @ np.linalg.solve(dense, loads[free]))
    assert closed == pytest.approx(expected, rel=1e-6)


def test_points_without_anything_opposite_are_marked():
    rng = np.random.default_rng(0)
    vertices = np.vstack([rng.uniform(0.5, 1, size=(3, 3)), [[0, 0, 0.5]]])
    mesh = ShellMesh(vertices, np.array([[0, 1, 2]]), 0.01)
    tips = opposing_points(mesh, axis_point_m=(0.0, 0.0))
    assert not tips.valid.any()
    with pytest.raises(InputError, match="no point has a wall across the height axis"):
        dual_tip_map(ShellModel(mesh, PLASTIC, [0]), tips)


def test_loads_inside_a_face_do_the_work_of_any_rigid_motion() -> None:
    """Moments and forces of the cubic add up to the force at its place."""
    mesh = tube_mesh(0.03, 0.1, 0.0005, around=12, along=8)
    tips = opposing_points(mesh, np.arange(36, 48), axis_point_m=(0.002, -0.003))
    assert (tips.weights.max(axis=1) < 0.99).any()
    rng = np.random.default_rng(8)
    motion, spin = rng.normal(size=(2, 3))
    moved = np.zeros((len(mesh.vertices_m), 6))
    moved[:, :3] = motion + np.cross(spin, mesh.vertices_m)
    moved[:, 3:] = spin
    loads = tip_loads(len(moved), tips, mesh.vertices_m)
    places = np.einsum("mk,mki->mi", tips.weights, mesh.vertices_m[tips.second])
    wanted = np.einsum(
        "mi,mi->m", tips.direction, np.cross(spin, mesh.vertices_m[tips.first]) - np.cross(spin, places)
    )
    np.testing.assert_allclose(loads.T @ moved.ravel(), wanted, atol=1e-12)
    # On an edge of a face it is the cubic of Hermite: at the middle the slopes count by an eighth.
    face = mesh.faces[40]
    half = DualTips(
        np.array([0]), face[None], np.array([[0.5, 0.5, 0.0]]), np.array([[1.0, 0.0, 0.0]]), np.array([True])
    )
    bent = bent_loads(half, mesh.vertices_m)[0]
    a, b, c = mesh.vertices_m[face]
    normal = np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a))
    np.testing.assert_allclose(bent[0, 3:], normal[0] * np.cross(b - a, normal) / 8, atol=1e-15)
    np.testing.assert_allclose(bent[1, 3:], normal[0] * np.cross(a - b, normal) / 8, atol=1e-15)
    np.testing.assert_allclose(bent[2], 0.0, atol=1e-15)


def test_loads_inside_a_face_do_the_work_of_any_constant_curvature() -> None:
    """The cubic of Bazeley et al. contains all quadratic deflections, of which height and slope at the corners are known."""
    rng = np.random.default_rng(6)
    for _ in range(5):
        flat = rng.normal(size=(3, 2))
        curvature, slope = rng.normal(size=(2, 2)), rng.normal(size=2)
        weights = rng.dirichlet([2.0, 2.0, 2.0])
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        corners = flat @ axes[:, :2].T
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        direction = rng.normal(size=3)
        one = DualTips(np.array([0]), np.array([[0, 1, 2]]), weights[None], direction[None], np.array([True]))

        def height(at, curvature=curvature, slope=slope):
            return np.einsum("...i,ij,...j->...", at, curvature, at) + at @ slope

        gradient = (flat @ (curvature + curvature.T) + slope) @ axes[:, :2].T
        motion = np.hstack([height(flat)[:, None] * normal, np.cross(gradient, normal)])
        work = (bent_loads(one, corners)[0] * motion).sum()
        assert work == pytest.approx(direction @ normal * height(weights @ flat), abs=1e-12)

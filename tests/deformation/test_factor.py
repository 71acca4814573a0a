"""Ordering and factor against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_array
from scipy.spatial import Delaunay

from visuohaptic.core import InputError
from visuohaptic.deformation.shapes import grid_faces
from visuohaptic.deformation.shells import factorise, front_tree
from visuohaptic.deformation.shells.factor import BLOCK_PIVOTS

from .assembly import assembled


def problem(seed, nodes, dofs=2):
    """A random triangulation and positive definite element matrices on it."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(size=(nodes, 3))
    faces = Delaunay(points[:, :2]).simplices
    root = rng.normal(size=(len(faces), 3 * dofs, 3 * dofs))
    diagonal = 0.1 + rng.uniform(size=(nodes, dofs))
    return rng, points, faces, root @ root.transpose(0, 2, 1), diagonal


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.integers(4, 90), st.integers(1, 12))
def test_every_node_is_eliminated_once_and_fronts_hold_their_elements(seed, nodes, leaf):
    _, points, faces, _, _ = problem(seed, nodes)
    tree = front_tree(points, faces, leaf)
    assert np.array_equal(np.sort(tree.order), np.arange(nodes))
    assert np.array_equal(tree.order[tree.place], np.arange(nodes))
    assert np.array_equal(np.sort(np.concatenate(tree.elements)), np.arange(len(faces)))
    for front in range(tree.fronts):
        pivots = np.arange(tree.first[front], tree.first[front + 1])
        border = tree.border[tree.offset[front] : tree.offset[front + 1]]
        assert np.all(np.diff(border) > 0)
        local = np.concatenate([pivots, border])
        assert np.array_equal(tree.place[faces[tree.elements[front]]], local[tree.element_local[front]])
        if border.size:
            above = tree.parent[front]
            whole = np.concatenate(
                [
                    np.arange(tree.first[above], tree.first[above + 1]),
                    tree.border[tree.offset[above] : tree.offset[above + 1]],
                ]
            )
            assert above > front
            assert np.array_equal(
                whole[tree.border_local[tree.offset[front] : tree.offset[front + 1]]], border
            )


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.integers(4, 60), st.integers(2, 10), st.booleans())
def test_solve_compliance_and_coupling_equal_dense_algebra(seed, nodes, leaf, definite):
    rng, points, faces, matrices, diagonal = problem(seed, nodes)
    if not definite:
        matrices = matrices - 0.3 * np.abs(matrices).max() * np.eye(6)
    dense = assembled(matrices, faces, nodes, diagonal).toarray()
    factor = factorise(front_tree(points, faces, leaf), matrices, diagonal, definite=definite)
    right = rng.normal(size=(2 * nodes, 3))
    found = factor.solve(right)
    # Backward error: pivoting stays inside the fronts, so an indefinite one may lose some digits.
    scale = np.abs(dense).sum(axis=1).max() * np.abs(found).max() + np.abs(right).max()
    assert np.abs(dense @ found - right).max() < (1e-12 if definite else 1e-7) * scale
    if not definite:
        assert factor.negative == np.linalg.slogdet(dense)[0]
        with pytest.raises(InputError, match="not positive definite"):
            factor.compliance(csc_array(right))
        return
    loads = right * (rng.uniform(size=right.shape) < 0.1)
    expected = loads.T @ np.linalg.solve(dense, loads)
    assert factor.coupling(csc_array(loads)) == pytest.approx(expected, rel=1e-8, abs=1e-12)
    assert factor.compliance(csc_array(loads)) == pytest.approx(np.diag(expected), rel=1e-8, abs=1e-12)


@pytest.mark.parametrize("columns", [60, 600])
def test_large_fronts_divided_by_blocks_equal_dense_algebra(columns):
    """Fronts of more than two blocks of pivots, with fewer and with more columns than pivots."""
    rng, points, faces, matrices, diagonal = problem(7, 400)
    tree = front_tree(points, faces, leaf=90)
    bordered = np.diff(tree.offset) > 0
    assert (2 * np.diff(tree.first)[bordered]).max() > 2 * BLOCK_PIVOTS
    dense = assembled(matrices, faces, 400, diagonal).toarray()
    factor = factorise(tree, matrices, diagonal)
    loads = rng.normal(size=(800, columns)) * (rng.uniform(size=(800, columns)) < 0.02)
    solved = np.linalg.solve(dense, loads)
    np.testing.assert_allclose(factor.solve(loads), solved, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(factor.compliance(csc_array(loads)), np.sum(loads * solved, axis=0), rtol=1e-9)


def test_unsymmetric_matrices():
    rng, points, faces, matrices, diagonal = problem(3, 50)
    matrices = matrices + 0.5 * rng.normal(size=matrices.shape)
    dense = assembled(matrices, faces, 50, diagonal).toarray()
    factor = factorise(front_tree(points, faces, 6), matrices, diagonal, definite=False)
    right = rng.normal(size=100)
    assert dense @ factor.solve(right) == pytest.approx(right, abs=1e-8)


def test_many_columns_are_worked_off_in_blocks(monkeypatch):
    import visuohaptic.deformation.shells.factor as module

    _, points, faces, matrices, diagonal = problem(8, 60)
    factor = factorise(front_tree(points, faces, 6), matrices, diagonal)
    loads = csc_array(np.eye(120))
    whole = factor.compliance(loads)
    monkeypatch.setattr(module, "BLOCK_COLUMNS", 7)
    assert factor.compliance(loads) == pytest.approx(whole, rel=1e-12)


def test_a_long_strip_fills_linearly():
    """Cuts go across a strip, never along it."""
    entries = []
    for columns in (100, 200):
        row, column = np.mgrid[:5, : columns + 1]
        points = np.stack([column.ravel(), row.ravel(), 0 * row.ravel()], axis=1).astype(float)
        tree = front_tree(points, grid_faces(columns, 4))
        pivots, outside = np.diff(tree.first), np.diff(tree.offset)
        # Of the lower triangle, with dense fronts.
        entries.append(int(np.sum(pivots * (pivots + 1) // 2 + pivots * outside)))
    assert entries[1] < 2.2 * entries[0]

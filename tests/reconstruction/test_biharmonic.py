"""Biharmonic distance against all eigenpairs of a dense solver, and its symmetries."""

from __future__ import annotations

import numpy as np
import pytest
import robust_laplacian
from scipy.linalg import eigh

from visuohaptic.core import InputError
from visuohaptic.reconstruction.surfaces import BiharmonicMesh
from visuohaptic.simulation.tabletop import random_bottle


def bottle_mesh(seed, step_m=0.016):
    rng = np.random.default_rng(seed)
    bottle = random_bottle(rng)
    vertices, faces = bottle.mesh(0.0, bottle.height_m, step_m=step_m)
    return vertices + rng.normal(0, 2e-4, vertices.shape), faces, rng


def dense(vertices, faces):
    """All pairs by the definition: sum over eigenpairs without the constant one."""
    extent = np.ptp(vertices, axis=0).max()
    stiffness, mass = robust_laplacian.mesh_laplacian(vertices / extent, faces)
    area = mass.diagonal()
    values, vectors = eigh(stiffness.toarray() / area.sum(), np.diag(area / area.sum()))
    embedding = vectors[:, 1:] / values[1:]
    return np.linalg.norm(embedding[:, None] - embedding[None], axis=2)


def test_columns_equal_the_sum_over_all_eigenpairs():
    vertices, faces, rng = bottle_mesh(0)
    expected = dense(vertices, faces)
    mesh = BiharmonicMesh(vertices, faces)
    x, y = rng.choice(len(vertices), 20), rng.choice(len(vertices), 30)
    # The shift of 1e-7 beside a smallest eigenvalue of about 10.
    np.testing.assert_allclose(mesh.distance(x, y), expected[np.ix_(x, y)], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_the_score_names_the_least_supported_vertex(seed):
    vertices, faces, rng = bottle_mesh(seed)
    expected = dense(vertices, faces)
    low, high = np.quantile(vertices[:, 2], [0.3, 0.7])
    known = np.flatnonzero((vertices[:, 2] < low) | (vertices[:, 2] > high))
    supports = np.union1d(rng.choice(known, 40), rng.choice(len(vertices), seed))
    score = BiharmonicMesh(vertices, faces).score(supports)
    truth = expected[:, supports].min(axis=1)
    assert int(np.argmax(score)) == int(np.argmax(truth))
    assert np.corrcoef(score, truth)[0, 1] > 0.99
    assert (score[supports] == 0).all()


def test_distance_is_a_metric_and_knows_no_frame():
    vertices, faces, rng = bottle_mesh(1)
    mesh = BiharmonicMesh(vertices, faces)
    chosen = rng.choice(len(vertices), 12, replace=False)
    d = mesh.distance(chosen, chosen)
    np.testing.assert_allclose(d, d.T, atol=1e-9)
    assert np.abs(np.diag(d)).max() < 1e-6
    assert (d[:, None] <= d[:, :, None] + d[None] + 1e-9).all()
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    moved = BiharmonicMesh(3 * vertices @ turn.T + 1.0, faces)
    # The extent of the box changes with the turn: distances scale alike.
    other = moved.distance(chosen, chosen)
    ratio = other[d > 0.01] / d[d > 0.01]
    assert np.ptp(ratio) < 1e-3 * ratio.mean()


def test_errors_say_what_is_wrong():
    vertices, faces, _ = bottle_mesh(0, 0.02)
    with pytest.raises(InputError, match="no supports"):
        BiharmonicMesh(vertices, faces).score(np.array([], dtype=int))
    with pytest.raises(InputError, match="expected a surface"):
        BiharmonicMesh(vertices[:3], faces[:1])

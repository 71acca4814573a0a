"""Biharmonic distance on a mesh, and the distance of each vertex from known points.

    d(x, y)^2 = sum_k (phi_k(x) - phi_k(y))^2 / lambda_k^2

over the eigenpairs of the Laplacian except the constant one (Lipman, Rustamov
and Funkhouser 2010; Alt 2016, Eq. 5.6, is printed without the squares). It
equals the norm of the difference of two columns of the pseudo-inverse, so one
sparse solve gives an exact column. The score of all vertices (Eq. 5.7) needs few
eigenpairs, because their weights fall with the squared eigenvalue.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core import InputError, one_blas_thread

#: Number of eigenpairs of the embedding.
MODES = 40
#: Candidates for the least supported vertex, and supports near each, whose distances are computed exactly.
_CANDIDATES, _NEIGHBOURS = 16, 6


class BiharmonicMesh:
    """A mesh with the factored Laplacian for biharmonic distances.

    Parameters
    ----------
    vertices_m, faces
        Vertices (v, 3) [m] and triangles (f, 3); slivers and open boundaries are allowed.

    Raises
    ------
    InputError
        Fewer than eight vertices.
    """

    @one_blas_thread()
    def __init__(self, vertices_m: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        import robust_laplacian
        from scipy.sparse import diags
        from scipy.sparse.linalg import splu

        vertices = np.ascontiguousarray(vertices_m, dtype=np.float64)
        if len(vertices) < 8 or not len(faces):
            raise InputError("BiharmonicMesh", f"found {len(vertices)} vertices, expected a surface")
        # Scale to unit size, so that eigenvalues are about 1 and the shift below has the same effect on all meshes.
        self.extent_m = float(np.ptp(vertices, axis=0).max())
        stiffness, mass = robust_laplacian.mesh_laplacian(
            vertices / self.extent_m, np.ascontiguousarray(faces, dtype=np.int64)
        )
        area = np.asarray(mass.diagonal())
        area = np.maximum(area, 1e-9 * area.max())
        self.area: Float[np.ndarray, "v"] = area / area.sum()  #: area fraction of each vertex
        # The shift makes the matrix regular; the constant component is removed from every column.
        shifted = (stiffness / area.sum() + diags(1e-7 * self.area)).tocsc()
        options = {"SymmetricMode": True, "DiagPivotThresh": 0.0}
        self._factor: Any = splu(shifted, permc_spec="MMD_AT_PLUS_A", options=options)
        self._stiffness = stiffness / area.sum()
        self._embed(vertices, min(MODES, len(vertices) // 4))

    def _centred(self, columns: Float[np.ndarray, "v k"]) -> Float[np.ndarray, "v k"]:
        return columns - self.area @ columns

    def _embed(self, vertices: Float[np.ndarray, "v 3"], modes: int) -> None:
        """Smallest eigenpairs by two steps of block inverse iteration and Rayleigh-Ritz."""
        from scipy.linalg import eigh

        rng = np.random.default_rng(0)
        block = self._centred(rng.standard_normal((len(vertices), modes + 12)))
        # The residual of the higher modes after one step is negligible: weights fall with the squared eigenvalue.
        block = self._centred(self._factor.solve(self.area[:, None] * block))
        basis, _ = np.linalg.qr(np.sqrt(self.area)[:, None] * block)
        block = basis / np.sqrt(self.area)[:, None]
        block = self._centred(self._factor.solve(self.area[:, None] * block))
        small, inner = block.T @ (self._stiffness @ block), block.T @ (self.area[:, None] * block)
        values, vectors = eigh(small, inner)
        kept = values > 1e-6
        values, vectors = values[kept][:modes], vectors[:, kept][:, :modes]
        #: Coordinates whose Euclidean distance approximates the biharmonic distance.
        self.embedding: Float[np.ndarray, "v k"] = (block @ vectors) / values

    def columns(self, index: Int[np.ndarray, "k"]) -> Float[np.ndarray, "v k"]:
        """Exact columns of the pseudo-inverse; their area-weighted distance is the biharmonic distance.

        Parameters
        ----------
        index
            Vertices (k).
        """
        right = np.zeros((len(self.area), len(index)))
        right[index, np.arange(len(index))] = 1.0
        right -= self.area[:, None]
        return self._centred(self._factor.solve(right))

    def distance(self, x: Int[np.ndarray, "k"], y: Int[np.ndarray, "m"]) -> Float[np.ndarray, "k m"]:
        """Exact biharmonic distance between vertices, for the mesh scaled to extent 1 and area 1.

        Parameters
        ----------
        x, y
            Vertices (k) and (m).
        """
        a, b = self.columns(x), self.columns(y)
        weighted = self.area[:, None] * b
        square = (self.area @ (a * a))[:, None] + (weighted * b).sum(axis=0) - 2 * (a.T @ weighted)
        return np.sqrt(np.maximum(square, 0.0))

    @one_blas_thread()
    def score(self, supports: Int[np.ndarray, "s"]) -> Float[np.ndarray, "v"]:
        """Distance of every vertex from the nearest support (Eq. 5.7); exact for the largest distances.

        Parameters
        ----------
        supports
            Vertices (s) with known position.

        Raises
        ------
        InputError
            There are no supports.
        """
        from scipy.spatial import cKDTree

        supports = np.unique(np.asarray(supports, dtype=np.int64))
        if not len(supports):
            raise InputError("BiharmonicMesh.score", "found no supports, expected at least one")
        neighbours = min(_NEIGHBOURS, len(supports))
        gaps, near = cKDTree(self.embedding[supports]).query(self.embedding, k=neighbours)
        gaps, near = gaps.reshape(len(gaps), -1), near.reshape(len(near), -1)
        score = gaps[:, 0].copy()
        candidates = np.argsort(score)[-_CANDIDATES:]
        others = np.unique(near[candidates])
        exact = self.distance(candidates, supports[others]).min(axis=1)
        # The truncation error is similar everywhere: scale all other vertices by the ratio at the candidates.
        ratio = float(np.median(exact / np.maximum(score[candidates], 1e-15)))
        score *= ratio
        below = np.setdiff1d(np.arange(len(score)), candidates)
        score[candidates] = exact
        score[below] = np.minimum(score[below], exact.max())
        score[supports] = 0.0
        return score

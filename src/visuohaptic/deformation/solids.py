"""Quadratic tetrahedra through scikit-fem, for what is not thin and to check shells against 3D."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ..errors import InputError, MissingExtraError
from .material import IsotropicMaterial
from .tetrahedra import SolidMesh

__all__ = ["quadratic_compliance"]


def quadratic_compliance(
    solid: SolidMesh,
    material: IsotropicMaterial | str,
    fixed: Bool[np.ndarray, "n"],
    forces_N: Float[np.ndarray, "n 3"],
) -> float:
    """``f . u`` [N m] of linear elasticity with ten-node tetrahedra.

    Parameters
    ----------
    solid
        Corner nodes; middles of the edges are added.
    material
        Of the whole body.
    fixed
        Corner nodes that are held; edges between held corners are held too.
    forces_N
        At the corner nodes.

    Raises
    ------
    MissingExtraError
        scikit-fem is not installed.
    """
    try:
        import skfem
        from skfem.models.elasticity import linear_elasticity
    except ImportError as error:
        raise MissingExtraError("scikit-fem", "elastic", "quadratic solids") from error
    from scipy.sparse.linalg import splu

    fixed = np.asarray(fixed, dtype=bool)
    if not fixed.any():
        raise InputError("quadratic_compliance", "nothing is held", field="fixed")
    mesh = skfem.MeshTet(solid.points_m.T.copy(), solid.tetrahedra.T.copy())
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP2()))
    stiffness: Any = linear_elasticity(*IsotropicMaterial.of(material).lame_Pa).assemble(basis).tocsc()
    load = np.zeros(basis.N)
    load[basis.nodal_dofs] = np.asarray(forces_N, dtype=float).T
    held_edges = fixed[mesh.edges].all(axis=0)
    held = np.concatenate([basis.nodal_dofs[:, fixed].ravel(), basis.edge_dofs[:, held_edges].ravel()])
    free = np.setdiff1d(np.arange(basis.N), held)
    inner = stiffness[free][:, free].tocsc()
    solver = splu(inner, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return float(load[free] @ solver.solve(load[free]))

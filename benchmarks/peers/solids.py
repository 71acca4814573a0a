"""Quadratic tetrahedra by scikit-fem, for thick bodies and for checking shells against 3D elements."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from benchmarks.peers.tetrahedra import SolidMesh, wall_tetrahedra
from jaxtyping import Bool, Float

from visuohaptic.core import InputError, MissingExtraError
from visuohaptic.deformation.shapes import ShellObject
from visuohaptic.deformation.shells import IsotropicMaterial, ShellMesh, opposing_points

__all__ = ["quadratic_compliance", "solid_stiffness"]


def solid_stiffness(thing: ShellObject, vertices: Sequence[int]) -> Float[np.ndarray, " m"]:
    """Stiffness [N/m] of dual-tip pinches with the wall as a solid, for walls that are not thin.

    Parameters
    ----------
    thing
        Container; its wall is filled with two layers of ten-node tetrahedra.
    vertices
        First tips. The force acts on the middle of the wall, as on a shell: on a solid a point
        force on the surface has no finite displacement, it only grows with a finer mesh.

    Notes
    -----
    Shells are right to about t / R, the wall's thickness by its radius. On thin walls these
    tetrahedra need cells of a few thicknesses; take the shell there.

    Raises
    ------
    InputError
        The wall folds over itself, or there is no wall across from a vertex.
    MissingExtraError
        scikit-fem is not installed.
    """
    once = thing.covers_once
    mesh = ShellMesh(thing.mesh.vertices_m, thing.mesh.faces[once], np.asarray(thing.mesh.thickness_m)[once])
    layers = 2
    solid = wall_tetrahedra(mesh, layers)
    tips = opposing_points(mesh, np.asarray(vertices, dtype=np.int64), axis_point_m=thing.axis_point_m)
    if not tips.valid.all():
        raise InputError(
            "solid_stiffness", f"no wall across from vertex {vertices[int(np.argmin(tips.valid))]}"
        )
    forces = np.zeros((len(solid.points_m), 3, len(tips)))
    for pair in range(len(tips)):
        forces[solid.through(int(tips.first[pair]))[layers // 2], :, pair] += tips.direction[pair]
        for corner, weight in zip(tips.second[pair], tips.weights[pair], strict=True):
            forces[solid.through(int(corner))[layers // 2], :, pair] -= weight * tips.direction[pair]
    fixed = np.repeat(thing.fixed, layers + 1)
    with np.errstate(divide="ignore"):
        out: np.ndarray = 2.0 / quadratic_compliance(solid, thing.material, fixed, forces)
    return out


def quadratic_compliance(
    solid: SolidMesh,
    material: IsotropicMaterial | str,
    fixed: Bool[np.ndarray, " n"],
    forces_N: Float[np.ndarray, "n 3 *m"],
) -> Any:
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
        At the corner nodes; one load case, or m of them: the result is then an array (m,).

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
    forces = np.asarray(forces_N, dtype=float)
    load = np.zeros((basis.N, *forces.shape[2:]))
    load[basis.nodal_dofs] = np.swapaxes(forces, 0, 1)
    held_edges = fixed[mesh.edges].all(axis=0)
    held = np.concatenate([basis.nodal_dofs[:, fixed].ravel(), basis.edge_dofs[:, held_edges].ravel()])
    free = np.setdiff1d(np.arange(basis.N), held)
    inner = stiffness[free][:, free].tocsc()
    solver = splu(inner, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    found = np.sum(load[free] * solver.solve(load[free]), axis=0)
    return float(found) if forces.ndim == 2 else found

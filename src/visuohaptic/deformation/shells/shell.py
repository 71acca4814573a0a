"""Thin walls: linear shell model of a triangle mesh with a thickness (Alt 2016, Sec. 6.1.3).

Linear tetrahedra, the published method, are 2 to 17 times too stiff on a bottle's wall. Flat shell
triangles (discrete Kirchhoff bending, optimal membrane with drilling degrees of freedom) are accurate to one percent
with a fraction of the unknowns, on any triangle mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.errors import InputError
from ...core.geometry import area_vectors
from ...core.objects import Material
from ...core.ranges import POSITIVE, above, check_numbers, finite_array
from .factor import Factor, factorise
from .laminate import Laminate, wall_directions
from .ordering import FrontTree, front_tree
from .shell_material import IsotropicMaterial

#: A triangle is rejected if its height is below this fraction of its longest side.
FLATTEST = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ShellMesh:
    """The mid-surface of a wall; z is the height axis by convention, faces are oriented outwards."""

    vertices_m: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    thickness_m: Float[np.ndarray, "f"] | float  #: of each face; a scalar is repeated
    #: Fraction of its area that a face represents: 1, or 0.5 where each cell of a structured mesh is
    #: covered by the triangles of both diagonals, which avoids a preferred direction.
    fraction: Float[np.ndarray, "f"] | float = 1.0

    def __post_init__(self) -> None:
        where = "ShellMesh"
        vertices = finite_array(where, self.vertices_m, None, 3, field="vertices_m")
        faces = np.ascontiguousarray(self.faces, dtype=np.int64)
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise InputError(where, f"found shape {faces.shape}, expected (f, 3), f > 0", field="faces")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError(
                where,
                f"found indices {faces.min()} to {faces.max()}, expected 0 to {len(vertices) - 1}",
                field="faces",
            )
        sides = vertices[faces[:, [1, 2, 0]]] - vertices[faces]
        longest = np.einsum("fij,fij->fi", sides, sides).max(axis=1)
        doubled = np.linalg.norm(np.cross(sides[:, 0], -sides[:, 2]), axis=1)
        thin = doubled <= FLATTEST * longest
        if thin.any():
            face = int(np.argmax(thin))
            corner = ", ".join(f"{value:.4g}" for value in vertices[faces[face, 0]])
            raise InputError(
                where,
                f"{np.count_nonzero(thin)} triangles without area, the first is face {face} at ({corner}) m",
                field="faces",
                remedy="remesh or merge vertices",
            )
        thickness = np.broadcast_to(np.asarray(self.thickness_m, dtype=float), len(faces)).copy()
        check_numbers(where, POSITIVE, thickness_m=thickness)
        fraction = np.broadcast_to(np.asarray(self.fraction, dtype=float), len(faces)).copy()
        check_numbers(where, above(0, 1), fraction=fraction)
        object.__setattr__(self, "vertices_m", vertices)
        object.__setattr__(self, "faces", faces)
        object.__setattr__(self, "thickness_m", thickness)
        object.__setattr__(self, "fraction", fraction)


def plane_stress(material: IsotropicMaterial) -> Float[np.ndarray, "3 3"]:
    """Stress for unit in-plane strain (xx, yy, 2 xy) of an isotropic material [Pa].

    Parameters
    ----------
    material
        Elastic constants.
    """
    nu = material.poisson_ratio
    return (
        material.youngs_modulus_Pa
        / (1 - nu * nu)
        * np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, (1 - nu) / 2]])
    )


class ShellModel:
    """A linear elastic shell with supports.

    Parameters
    ----------
    mesh
        Mid-surface and thickness.
    material
        Material of the whole wall: constants, plies, a material of the library, or its name.
    fixed
        Supports: vertex numbers or a mask (v,) of vertices that are clamped in all six
        degrees of freedom, or a mask (v, 6) of single degrees of freedom (displacements x, y, z, then rotations).
    springs
        Elastic base: N/m and N m/rad by vertex and degree of freedom, or None.

    Examples
    --------
    >>> from visuohaptic.deformation import tube_mesh
    >>> model = ShellModel(tube_mesh(0.035, 0.2, 0.0005, around=24, along=24), "PET", fixed=range(24))
    >>> model.solve(np.zeros((model.nodes, 6))).shape
    (600, 6)
    """

    def __init__(
        self,
        mesh: ShellMesh,
        material: IsotropicMaterial | Laminate | Material | str,
        fixed: Any,
        *,
        springs: Float[np.ndarray, "v 6"] | None = None,
    ) -> None:
        self.mesh = mesh
        self.material = material if isinstance(material, Laminate) else IsotropicMaterial.of(material)
        self.fixed = _held(fixed, len(mesh.vertices_m))
        self.springs = None if springs is None else np.asarray(springs, dtype=float)
        if self.springs is not None and self.springs.shape != self.fixed.shape:
            raise InputError(
                "ShellModel", f"found {self.springs.shape}, expected {self.fixed.shape}", field="springs"
            )
        if not self.fixed.any() and self.springs is None:
            raise InputError(
                "ShellModel", "no vertex is clamped", field="fixed", remedy="clamp the vertices of the base"
            )

    def with_wall(
        self, thickness_m: Float[np.ndarray, "f"], material: IsotropicMaterial | Laminate
    ) -> ShellModel:
        """The same mesh and supports with another wall; the elimination order is kept.

        Parameters
        ----------
        thickness_m
            Of each face.
        material
            Of the whole wall.
        """
        other = ShellModel(
            replace(self.mesh, thickness_m=thickness_m), material, self.fixed, springs=self.springs
        )
        other.__dict__["tree"] = self.tree
        return other

    @property
    def nodes(self) -> int:
        """Number of vertices, each with six degrees of freedom."""
        return len(self.mesh.vertices_m)

    @property
    def sections(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Membrane and plate stiffness of each face (f, 3, 3), the membrane's beta_0 (f,), coupling (f or 0, 3, 3)."""
        mesh, material = self.mesh, self.material
        thickness = np.asarray(mesh.thickness_m)[:, None, None]
        wall = np.asarray(mesh.fraction)[:, None, None] * thickness
        # Felippa 2003: beta_0 = (1 - 4 nu^2) / 2 is optimal in bending; bounded away from zero for stability.
        beta0 = np.full(len(thickness), max(0.5 * (1 - 4 * material.poisson_ratio**2), 0.01))
        if isinstance(material, IsotropicMaterial):
            stress = plane_stress(material)
            return wall * stress, wall * thickness**2 / 12 * stress, beta0, np.zeros((0, 3, 3))
        a, b, d = wall_directions(mesh.vertices_m, mesh.faces, material.sections)
        return wall * a, wall * thickness**2 * d, beta0, wall * thickness * b

    @cached_property
    def element_matrices(self) -> Float[np.ndarray, "f 18 18"]:
        """Element stiffness in the global frame, without the supports."""
        from . import _shell_kernels as kernels

        frames, _, local = kernels.element_frames(self.mesh.vertices_m, self.mesh.faces, *self.sections)
        return kernels.rotate_elements(frames, local)

    @cached_property
    def tree(self) -> FrontTree:
        """Elimination order; depends on the mesh only."""
        return front_tree(self.mesh.vertices_m, self.mesh.faces)

    @cached_property
    def free(self) -> Bool[np.ndarray, "n"]:
        """Free degrees of freedom, node by node."""
        return ~self.fixed.ravel()

    @cached_property
    def support_diagonal(self) -> Float[np.ndarray, "v 6"]:
        """Addition to the diagonal: springs, and a one for each fixed degree of freedom."""
        used = np.zeros(self.nodes, dtype=bool)
        used[self.mesh.faces] = True
        held = self.fixed | ~used[:, None]
        return np.where(held, 1.0, 0.0 if self.springs is None else self.springs)

    def factor(self) -> Factor:
        """The factorised stiffness of the supported shell; computed once."""
        return self._factor

    @cached_property
    def _factor(self) -> Factor:
        from . import _front_kernels

        matrices = self.element_matrices.copy()
        _front_kernels.constrain(matrices, self.mesh.faces, self.fixed)
        return factorise(self.tree, matrices, self.support_diagonal)

    def solve(self, loads: Float[np.ndarray, "v 6 *m"]) -> Float[np.ndarray, "v 6 *m"]:
        """Displacements [m] and rotations [rad] under forces [N] and moments [N m] at the vertices.

        Loads on fixed degrees of freedom go into the support. One load (v, 6) or several (v, 6, m).

        Parameters
        ----------
        loads
            Forces and moments (v, 6), or m loads (v, 6, m).

        Raises
        ------
        InputError
            Wrong shape.
        """
        loads = np.asarray(loads, dtype=float)
        if loads.shape[:2] != (self.nodes, 6):
            raise InputError("loads", f"found shape {loads.shape}, expected ({self.nodes}, 6) or more loads")
        free = self.fixed[..., None] if loads.ndim == 3 else self.fixed
        right = np.where(free, 0.0, loads)
        return self.factor().solve(right.reshape(6 * self.nodes, -1)).reshape(loads.shape)

    def free_loads(self, loads: Any) -> Any:
        """Sparse loads without the part on fixed degrees of freedom.

        Parameters
        ----------
        loads
            Sparse array (6 v, m), one load per column.
        """
        from scipy.sparse import diags_array

        out = (diags_array(self.free.astype(float)) @ loads).tocsc()
        out.eliminate_zeros()
        return out

    def volume_gradient(self) -> Float[np.ndarray, "v 6"]:
        """a = dV/du, the gradient of the enclosed volume by each degree of freedom [m^2]; zero where fixed.

        A gauge pressure p inside loads the wall with ``p a``, so an enclosed gas adds the rank-one term
        ``kappa a a^T`` to the stiffness.
        """
        out = np.zeros((self.nodes, 6))
        out[:, :3] = volume_gradient(self.mesh.vertices_m, self.mesh.faces, self.mesh.fraction)
        out[self.fixed] = 0.0
        return out


def enclosed_volume(
    vertices_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    fraction: Float[np.ndarray, "f"] | float = 1.0,
) -> float:
    """Volume inside a closed surface with outward orientation [m^3].

    An open mouth should first be closed by faces: otherwise this is the volume with cones to
    the origin.

    Parameters
    ----------
    vertices_m
        Vertices [m].
    faces
        Triangles with outward orientation.
    fraction
        Fraction of each face that counts, see :class:`ShellMesh`.
    """
    a, b, c = (vertices_m[faces[:, k]] for k in range(3))
    return float(np.sum(fraction * np.einsum("fi,fi->f", a, np.cross(b, c))) / 6)


def volume_gradient(
    vertices_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    fraction: Float[np.ndarray, "f"] | float = 1.0,
) -> Float[np.ndarray, "v 3"]:
    """A third of the area vectors of the faces around each vertex [m^2] (Alt 2016, Eq. (6.1)).

    This is the exact gradient of the enclosed volume of a closed mesh. At the rim of an open one it is
    the load of a pressure on the wall alone.

    Parameters
    ----------
    vertices_m, faces, fraction
        As of :func:`enclosed_volume`.
    """
    third = area_vectors(vertices_m, faces) / 3 * np.broadcast_to(fraction, len(faces))[:, None]
    out = np.zeros_like(vertices_m)
    for k in range(3):
        np.add.at(out, faces[:, k], third)
    return out


def _held(fixed: Any, nodes: int) -> Bool[np.ndarray, "v 6"]:
    found = np.asarray(list(fixed) if isinstance(fixed, (range, set)) else fixed)
    out = np.zeros((nodes, 6), dtype=bool)
    if found.dtype == bool and found.shape in ((nodes,), (nodes, 6)):
        out[:] = found if found.ndim == 2 else found[:, None]
    elif found.ndim == 1 and (found.size == 0 or np.issubdtype(found.dtype, np.integer)):
        if found.size and (found.min() < 0 or found.max() >= nodes):
            raise InputError(
                "ShellModel", f"found vertex {found.max()}, expected 0 to {nodes - 1}", field="fixed"
            )
        out[found.astype(np.int64)] = True
    else:
        raise InputError(
            "ShellModel",
            f"found {found.dtype} of shape {found.shape}, "
            f"expected vertex numbers or a mask ({nodes},) or ({nodes}, 6)",
            field="fixed",
        )
    return out

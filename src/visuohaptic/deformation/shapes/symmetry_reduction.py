"""Reduction of an object by symmetry: a quarter or a half if object and pinch are mirror-symmetric.

The symmetry is detected in the mesh, never assumed. The removed part is replaced by boundary
conditions on the plane of the cut: no displacement across it, no rotation about the axes in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ..shells.laminate import Laminate
from ..shells.shell import ShellMesh, ShellModel
from .mesher import ShellObject

#: Vertices and their images may differ by this fraction of the object's size.
TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class SymmetricPart:
    """A part that represents ``copies`` copies of itself.

    Vertex v of the whole object is at ``signs[v] * points[image[v]]`` with the part's points.
    """

    whole: ShellObject  #: with its height axis at x = y = 0
    model: ShellModel  #: of the part
    copies: int  #: 4, 2, or 1
    faces: Bool[np.ndarray, "f"]  #: of the whole that are the part's
    image: Int[np.ndarray, "v"]  #: vertex of the part for each of the whole
    signs: Float[np.ndarray, "v 3"]  #: +1 or -1 for x, y, z

    @cached_property
    def lid(self) -> tuple[Int[np.ndarray, "l 3"], Float[np.ndarray, "l 3 3"]]:
        """The lid of the whole object in vertices of the part, and the signs of its corners."""
        return self.image[self.whole.lid], self.signs[self.whole.lid]

    def with_wall(self, container: ShellObject, angle_rad: float) -> SymmetricPart:
        """The same part of a container that differs in thickness, in the same proportion everywhere, or material.

        Parameters
        ----------
        container
            The other container.
        angle_rad
            As of :func:`symmetric_part`.
        """
        whole = turned(container, angle_rad)
        model = self.model.with_wall(np.asarray(whole.mesh.thickness_m)[self.faces], whole.material)
        return replace(self, whole=whole, model=model)

    def expand(self, points_m: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "v 3"]:
        """Points of the whole object from those of the part.

        Parameters
        ----------
        points_m
            Points or displacements of the part's vertices [m].
        """
        out: np.ndarray = points_m[self.image] * self.signs
        return out

    def gather(self, values: Float[np.ndarray, "v 6"]) -> Float[np.ndarray, "p 6"]:
        """Forces on the whole object, summed over the copies, on the part (work-conjugate to its displacements).

        Parameters
        ----------
        values
            Forces and moments at the vertices of the whole [N], [N m].
        """
        out = np.zeros((self.model.nodes, 6))
        # Moments are axial vectors: a mirror keeps the component across it and inverts the others.
        turning = self.signs[:, [1, 0, 0]] * self.signs[:, [2, 2, 1]]
        np.add.at(out, self.image, values * np.hstack([self.signs, turning]))
        return out


def turned(container: ShellObject, angle_rad: float) -> ShellObject:
    """The object with its axis at x = y = 0, rotated so that the direction ``angle_rad`` becomes x+.

    Parameters
    ----------
    container
        Parametric or imported container.
    angle_rad
        About the height axis, from x+ towards y+ [rad].
    """
    mesh = container.mesh
    points = mesh.vertices_m - np.array([*container.axis_point_m, 0.0])
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    # Quarter turns are exact: planes through the axis stay planes.
    cosine, sine = (0.0 if abs(value) < 1e-12 else float(value) for value in (cosine, sine))
    points[:, :2] = points[:, :2] @ np.array([[cosine, -sine], [sine, cosine]])
    mesh = ShellMesh(points, mesh.faces, mesh.thickness_m, mesh.fraction)
    return replace(container, mesh=mesh, axis_point_m=(0.0, 0.0))


def symmetric_part(
    container: ShellObject, *, angle_rad: float = 0.0, reduce: bool = True, one_way: bool = False
) -> SymmetricPart:
    """The smallest part that is required for pinches along the direction ``angle_rad``.

    Parameters
    ----------
    container
        The object.
    angle_rad
        Direction of the pinch about the height axis, from x+ towards y+; it is x+ of the part.
    reduce
        False keeps the whole object.
    one_way
        Halve each cell of a structured mesh along one diagonal only: half the triangles. The mirror images of a part
        compensate the preferred direction; the result differs by the discretisation error.
    """
    whole = turned(container, angle_rad)
    mesh = whole.mesh
    count = len(mesh.vertices_m)
    near = TOLERANCE * float(np.ptp(mesh.vertices_m, axis=0).max())
    signs = np.ones((count, 3))
    image = np.arange(count)
    planes = []
    for axis in (0, 1):
        other = _image(whole, axis) if reduce else None
        if other is None or not _halves(mesh, axis, near):
            continue
        planes.append(axis)
        away = mesh.vertices_m[:, axis] < -near
        signs[away, axis] = -1.0
        # Compose the images: first over one plane, then over the other.
        image = np.where(away[image], other[image], image)
    inside = np.ones(count, dtype=bool)
    for axis in planes:
        inside &= mesh.vertices_m[:, axis] >= -near
    kept = inside[mesh.faces].all(axis=1)
    fraction = np.asarray(mesh.fraction)
    if one_way:
        kept &= whole.covers_once
        fraction = np.ones_like(fraction)
    number = np.cumsum(inside) - 1
    points = mesh.vertices_m[inside]
    fixed = np.repeat(whole.fixed[inside][:, None], 6, axis=1)
    for axis in planes:
        flat = np.abs(points[:, axis]) <= near
        points[flat, axis] = 0.0
        held = [axis, 3 + (1 - axis), 5]
        fixed[np.ix_(flat, held)] = True
    springs = None
    if whole.springs is not None:
        # Vertices on a plane of the cut belong to several copies.
        springs = whole.springs[inside] * np.bincount(number[image])[:, None] / 2 ** len(planes)
    part = ShellMesh(points, number[mesh.faces[kept]], np.asarray(mesh.thickness_m)[kept], fraction[kept])
    return SymmetricPart(
        whole,
        ShellModel(part, whole.material, fixed, springs=springs),
        2 ** len(planes),
        kept,
        number[image],
        signs,
    )


def is_round(container: ShellObject) -> bool:
    """Whether a container is invariant under the rotations that its mesh allows, at least a quarter turn.

    Images of its vertices fall on vertices with the same wall.

    Parameters
    ----------
    container
        Parametric or imported container.
    """
    whole = turned(container, 0.0)
    points = whole.mesh.vertices_m
    size = float(np.ptp(points, axis=0).max())
    # A square is also invariant under its reflections and a quarter turn: test the radii of rings.
    radius = np.hypot(points[:, 0], points[:, 1])
    level = np.round(points[:, 2] / (1e-6 * size)).astype(np.int64)
    order = np.lexsort((radius, level))
    starts = np.flatnonzero(np.concatenate([[True], np.diff(level[order]) != 0]))
    least = np.minimum.reduceat(radius[order], starts)
    most = np.maximum.reduceat(radius[order], starts)
    # A cap adds its own vertices to the level of its ring.
    counts = np.diff(np.append(starts, len(order)))
    wall = counts == np.bincount(counts).argmax()
    even = bool((most - least < TOLERANCE * size)[wall].mean() > 0.95)
    quarter = points[:, [1, 0, 2]] * np.array([-1.0, 1.0, 1.0])
    return even and _falls_on(whole, quarter) is not None


def _image(container: ShellObject, axis: int) -> Int[np.ndarray, "v"] | None:
    if isinstance(container.material, Laminate) and not container.material.mirrored:
        return None
    mirrored = container.mesh.vertices_m.copy()
    mirrored[:, axis] *= -1.0
    return _falls_on(container, mirrored)


def _falls_on(container: ShellObject, moved: Float[np.ndarray, "v 3"]) -> Int[np.ndarray, "v"] | None:
    """The vertex at each transformed vertex, if wall and support there are the same."""
    from scipy.spatial import cKDTree

    mesh = container.mesh
    sides = mesh.vertices_m[mesh.faces[:, 1:]] - mesh.vertices_m[mesh.faces[:, :1]]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) * np.asarray(mesh.fraction)
    weight = np.bincount(mesh.faces.ravel(), np.repeat(area * mesh.thickness_m, 3), minlength=len(moved))
    away, other = cKDTree(mesh.vertices_m).query(moved)
    if not away.max() < TOLERANCE * float(np.ptp(mesh.vertices_m, axis=0).max()):
        return None
    same_wall = np.allclose(weight[other], weight, rtol=1e-4, atol=1e-9 * weight.max())
    same_base = bool((container.fixed[other] == container.fixed).all())
    if container.springs is not None:
        size = float(container.springs.max())
        same_base &= bool(
            np.allclose(container.springs[other], container.springs, rtol=1e-6, atol=1e-9 * size)
        )
    one_to_one = len(np.unique(other)) == len(other)
    found: np.ndarray = other
    return found if same_wall and same_base and one_to_one else None


def _halves(mesh: ShellMesh, axis: int, near: float) -> Bool[np.ndarray, ""]:
    """Whether the plane intersects no face."""
    reach = mesh.vertices_m[mesh.faces, axis]
    return ((reach >= -near).all(axis=1) ^ (reach <= near).all(axis=1)).all()

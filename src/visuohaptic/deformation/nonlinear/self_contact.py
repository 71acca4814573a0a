"""Detection of self-contact: the shell model has no contact forces, so a curve has to end there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...core.geometry import area_vectors, vertex_normals
from ..shapes.mesher import ShellObject
from ..shells.stiffness_map import DualTips, opposing_points
from .equilibrium_path import EquilibriumPath

#: Walls are in contact when their distance is below the wall thickness, at most this [m].
TOUCH_m = 1e-3
#: An initially narrow gap counts as closed when this fraction of it is left.
REST_FRACTION = 0.25
#: Cosine of the angle between two normals that face each other.
FACING = -0.2
#: Maximum number of tested pairs; more than enough to find a relevant one.
MAX_PAIRS = 20_000


def wall_gap_m(points_m: Float[np.ndarray, "v 3"], tips: DualTips) -> Float[np.ndarray, "m"]:
    """Distance of the walls at each pair along the pinch; negative after interpenetration [m].

    Parameters
    ----------
    points_m
        Vertices, deformed or not [m].
    tips
        The m pairs.
    """
    second = np.einsum("mk,mki->mi", tips.weights, points_m[tips.second])
    out: np.ndarray = np.einsum("mi,mi->m", tips.direction, second - points_m[tips.first])
    return out


class SelfContactGuard:
    """Detects self-contact anywhere in a deformed state of an object.

    Across the axis, the gap between each vertex and the opposite wall is signed, so that walls that have
    interpenetrated within one step are detected. Elsewhere, self-contact is a vertex that is closer to a face
    than the wall thickness while their normals face each other, or an edge that intersects a face.
    """

    def __init__(self, container: ShellObject) -> None:
        """Precompute what does not change with the deformation.


        Parameters
        ----------
        container
            Undeformed container.
        """
        mesh = container.mesh
        self.rest_m = mesh.vertices_m
        self.faces = np.ascontiguousarray(container.surface_faces)
        self.wall_m = np.asarray(mesh.thickness_m)[container.covers_once]
        sides = np.sort(self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        self.edges = np.unique(sides, axis=0)
        ends = self.rest_m[self.edges]
        self._cell_m = float(np.mean(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)))
        found = opposing_points(mesh, axis_point_m=container.axis_point_m)
        self._across = found.take(found.valid)
        self._min_m = np.minimum(
            min(float(self.wall_m.max()), TOUCH_m), REST_FRACTION * wall_gap_m(self.rest_m, self._across)
        )
        self._always: set[tuple[int, int]] | None = None

    def vertex(self, points_m: Float[np.ndarray, "v 3"]) -> int | None:
        """A vertex in self-contact, or None.

        Parameters
        ----------
        points_m
            Vertices of the whole object; a rigid motion is allowed.
        """
        short = wall_gap_m(points_m, self._across) - self._min_m
        if len(short) and short.min() < 0:
            return int(self._across.first[np.argmin(short)])
        vertex, face, distance = self._meetings(points_m)
        if not vertex.size:
            return None
        through = distance == 0
        counts = through | self._facing(points_m, vertex, face, distance)
        if through.any():
            if self._always is None:
                before = self._meetings(self.rest_m)
                some = before[2] == 0
                self._always = set(zip(before[0][some].tolist(), before[1][some].tolist(), strict=True))
            for k in np.flatnonzero(through):
                counts[k] = (int(vertex[k]), int(face[k])) not in self._always
        return int(vertex[np.argmax(counts)]) if counts.any() else None

    def cut(
        self,
        path: EquilibriumPath,
        walls_m: Sequence[Float[np.ndarray, "v 3"]],
        places_m: Float[np.ndarray, "v 3"],
    ) -> EquilibriumPath:
        """A path up to its first state in self-contact, with the reason.

        Parameters
        ----------
        path
            Equilibria.
        walls_m
            Vertices of the whole object at each of them.
        places_m
            Undeformed vertices, in the frame of the reason.
        """
        for count, (point, wall) in enumerate(zip(path.points, walls_m, strict=True)):
            met = self.vertex(wall)
            if met is not None:
                place = ", ".join(f"{value:.4g}" for value in places_m[met])
                reason = f"the walls touch before a deformation of {point.control_m:.4g} m, at ({place}) m"
                return EquilibriumPath(path.points[:count], False, reason)
        return path

    def _meetings(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        from . import _touch_kernels as kernels

        near = min(float(self.wall_m.max()), TOUCH_m)
        # At most a few million cells, even for a long and thin object.
        cell = max(self._cell_m, float(np.prod(np.ptp(points_m, axis=0) + 2 * near) / 1e6) ** (1 / 3))
        points = np.ascontiguousarray(points_m)
        return kernels.meetings(points, self.faces, self.edges, near, cell, MAX_PAIRS)

    def _facing(
        self, points_m: np.ndarray, vertex: np.ndarray, face: np.ndarray, distance: np.ndarray
    ) -> np.ndarray:
        from . import _touch_kernels as kernels

        second = area_vectors(points_m, self.faces[face])
        cosine = np.einsum("pi,pi->p", vertex_normals(points_m, self.faces)[vertex], second)
        cosine /= np.maximum(np.linalg.norm(second, axis=1), 1e-300)
        before = kernels.distances(np.ascontiguousarray(self.rest_m), self.faces, vertex, face)
        limit = np.minimum(np.minimum(self.wall_m[face], TOUCH_m), REST_FRACTION * before)
        out: np.ndarray = (cosine < FACING) & (distance < limit)
        return out

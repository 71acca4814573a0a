"""Scores of two-finger grasps at every point of a surface (Alt 2016, Sec. 6.2, Eqs. (6.6)-(6.9)).

Each surface point X represents one grasp: a finger at X, a finger at the opposite point across the height
axis, both pushing with the same force along the line between them. Four scores, clamped to 0..1 and
multiplied, rate whether the contact is perpendicular, the surface flat or concave, the point high, and
the deformation small. Where the dissertation is ambiguous or misprinted:

- (6.6) divides by the number of neighbours. The factor ``1 - sqrt(r / d)`` has the mean 1/5 over a
  disc, so that no grasp could reach ``S_G > 0.5``. Here it is divided by the sum of the factors: a flat,
  perpendicular contact scores w_n.
- "Partial overlap is penalised": the contact score is multiplied with the fraction of the finger's
  disc (with the same factors) that has wall in front of it.
- The unit of the curvature is not printed. With w_c = 5 and centimetres, no surface with a radius below
  5 cm reaches 0.5, and no bottle does; in millimetres a ridge of 2.5 mm radius scores 0.
  Therefore ``curvature_unit_m`` is 1 mm.
- ``min(p20, p02)`` depends on the rotation of x and y; the smaller principal value does not.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import NON_NEGATIVE, POSITIVE, InputError, Ranged, StiffnessMap, within
from ..core.geometry import vertex_normals
from ..deformation.shells.shell import ShellMesh
from ..deformation.shells.stiffness_map import DualTips, opposing_points

#: Minimum number of points for the fit of a second-order polynomial.
MIN_NEIGHBOURS = 10


@dataclass(frozen=True, slots=True)
class ScoreParameters(Ranged):
    """Coefficients of the scores; defaults are those of the dissertation."""

    contact_weight: float = field(default=1.0, metadata=NON_NEGATIVE)  #: w_n
    curvature_weight: float = field(default=5.0, metadata=NON_NEGATIVE)  #: w_c
    height_weight: float = field(default=0.5, metadata=within(0, 1))  #: w_h
    deformation_weight: float = field(default=5.0, metadata=NON_NEGATIVE)  #: w_d
    max_deformation_m: float = field(default=0.005, metadata=POSITIVE)  #: delta_max
    #: d: radius of the contact area of a finger, depending on the alignment accuracy of the arm
    neighbourhood_m: float = field(default=0.01, metadata=POSITIVE)
    curvature_unit_m: float = field(default=0.001, metadata=POSITIVE)  #: w_c multiplies 1 / this


@dataclass(frozen=True, slots=True, eq=False)
class GraspScores:
    """Scores 0..1 of each vertex, and their intermediate values."""

    contact: Float[np.ndarray, "v"]  #: S_n, including the overlap
    curvature: Float[np.ndarray, "v"]  #: S_c
    height: Float[np.ndarray, "v"]  #: S_h
    deformation: Float[np.ndarray, "v"]  #: S_d
    overlap: Float[np.ndarray, "v"]  #: fraction of the finger that has wall in front of it
    perpendicular: Float[np.ndarray, "v"]  #: weighted mean of F . n around the point, -1..1
    tips: DualTips  #: position of the other finger
    deformation_m: Float[np.ndarray, "v"]  #: expected deformation of one side under the force

    @property
    def total(self) -> Float[np.ndarray, "v"]:
        """S_G of the point alone, as printed."""
        out: np.ndarray = self.contact * self.curvature * self.height * self.deformation
        return np.where(self.tips.valid, out, 0.0)

    @property
    def pair(self) -> Float[np.ndarray, "v"]:
        """S_G of both fingers: the smaller one of the point and its opposite."""
        return np.where(self.tips.valid, np.minimum(self.total, self.opposite(self.total)), 0.0)

    @property
    def slant_rad(self) -> Float[np.ndarray, "v"]:
        """Larger angle of the two fingers between force and inward normal."""
        cosine = np.minimum(self.perpendicular, self.opposite(self.perpendicular))
        return np.arccos(np.clip(cosine, -1, 1))

    def opposite(self, values: Float[np.ndarray, "v"]) -> Float[np.ndarray, "v"]:
        """Values of a map at the other finger of each vertex.

        Parameters
        ----------
        values
            One per vertex.
        """
        out: np.ndarray = np.einsum("mk,mk->m", self.tips.weights, values[self.tips.second])
        return out


def grasp_scores(
    surface: StiffnessMap,
    force_N: float | Float[np.ndarray, "v"],
    parameters: ScoreParameters | None = None,
    *,
    axis_point_m: tuple[float, float] | None = None,
    tips: DualTips | None = None,
) -> GraspScores:
    """Score every vertex of a stiffness map.

    Parameters
    ----------
    surface
        Physical local stiffness [N/m], z up. Infinite stiffness means no deformation.
    force_N
        F_G, of each finger; one number, or one per vertex.
    parameters
        Those of the dissertation by default.
    axis_point_m
        x and y of the height axis; the centre of the bounding box by default.
    tips
        Pairs of contacts of the map; across the height axis by default.
    """
    force = np.broadcast_to(np.asarray(force_N, dtype=float), surface.stiffness_N_per_m.shape)
    if not (force > 0).all():
        raise InputError("grasp_scores", f"found {force.min()} N, expected > 0", field="force_N")
    p = parameters or ScoreParameters()
    faces = _outward_faces(surface)
    mesh = ShellMesh(surface.vertices_m, faces, 1e-3)
    tips = tips or opposing_points(mesh, axis_point_m=axis_point_m)
    normal = vertex_normals(mesh.vertices_m, mesh.faces)
    perpendicular, overlap = _contact(mesh, normal, tips.direction, p.neighbourhood_m)
    bend = _smallest_quadratic(mesh, normal, p.neighbourhood_m)
    used = mesh.vertices_m[faces, 2]
    height = (mesh.vertices_m[:, 2] - used.min()) / np.ptp(used)
    with np.errstate(divide="ignore", invalid="ignore"):
        deformation_m = force / surface.stiffness_N_per_m
    return GraspScores(
        contact=_clamped(p.contact_weight * perpendicular * overlap),
        curvature=_clamped(1 + p.curvature_weight * p.curvature_unit_m * bend),
        height=_clamped(1 - p.height_weight + p.height_weight * height),
        deformation=deformation_score(deformation_m, p),
        overlap=overlap,
        perpendicular=perpendicular,
        tips=tips,
        deformation_m=deformation_m,
    )


def deformation_score(
    deformation_m: Float[np.ndarray, "v"], parameters: ScoreParameters
) -> Float[np.ndarray, "v"]:
    """S_d, Eq. (6.8): 1 for small deformations, 1/2 at delta_max; 0 if unknown.

    Parameters
    ----------
    deformation_m
        Expected deformation of one side [m].
    parameters
        Weight w_d and bound delta_max.
    """
    excess = deformation_m / parameters.max_deformation_m - 1
    score = 0.5 - 0.5 * np.tanh(parameters.deformation_weight * excess)
    return np.nan_to_num(_clamped(score), nan=0.0)


def _outward_faces(surface: StiffnessMap) -> Int[np.ndarray, "f 3"]:
    """Faces with normals away from the height axis, independent of the orientation in the file."""
    points, faces = surface.vertices_m, np.asarray(surface.faces)
    if not len(faces):
        raise InputError("grasp_scores", "the map has no faces", field="faces")
    a, b, c = (points[faces[:, k]] for k in range(3))
    used = points[np.unique(faces)]
    away = (a + b + c) / 3 - 0.5 * (used.min(axis=0) + used.max(axis=0))
    flux = float(np.einsum("fi,fi->", np.cross(b - a, c - a)[:, :2], away[:, :2]))
    return faces if flux >= 0 else faces[:, ::-1].copy()


def _contact(
    mesh: ShellMesh, normal: Float[np.ndarray, "v 3"], direction: Float[np.ndarray, "v 3"], d: float
) -> tuple[Float[np.ndarray, "v"], Float[np.ndarray, "v"]]:
    """Weighted mean of F . n around each vertex, and the fraction of the disc that has wall in front of it."""
    places, normals, area = _samples(mesh, (d / 6) ** 2)
    count = len(mesh.vertices_m)
    mean_top, mean_low, covered = np.zeros(count), np.zeros(count), np.zeros(count)
    # On a curved wall, the edge of the finger's disc is further away than d.
    for vertex, sample in _neighbours(mesh.vertices_m, places, 1.25 * d):
        away = places[sample] - mesh.vertices_m[vertex]
        force = direction[vertex]
        along = np.einsum("pi,pi->p", away, force)
        square = np.einsum("pi,pi->p", away, away)
        facing = -np.einsum("pi,pi->p", force, normals[sample])
        # Walls with the opposite orientation are those of the other finger.
        same = np.einsum("pi,pi->p", normals[sample], normal[vertex]) > 0
        weight = np.where(same, area[sample] * _factor(np.sqrt(square) / d), 0.0)
        mean_top += np.bincount(vertex, weight * facing, count)
        mean_low += np.bincount(vertex, weight, count)
        aside = np.sqrt(np.maximum(square - along**2, 0.0))
        shown = np.where(same, area[sample] * np.maximum(facing, 0.0) * _factor(aside / d), 0.0)
        covered += np.bincount(vertex, shown, count)
    mean = mean_top / np.maximum(mean_low, 1e-300)
    # The integral of 1 - sqrt(r / d) over the disc is pi d^2 / 5.
    return np.clip(mean, -1.0, 1.0), _clamped(covered / (np.pi * d * d / 5))


def _smallest_quadratic(
    mesh: ShellMesh, normal: Float[np.ndarray, "v 3"], d: float
) -> Float[np.ndarray, "v"]:
    """Smaller principal value of p20, p11, p02 around each vertex [1/m]; 0 is flat, < 0 is convex."""
    points = mesh.vertices_m
    count = len(points)
    first, second = _tangents(normal)
    moments, right = np.zeros((count, 36)), np.zeros((count, 6))
    used = np.unique(mesh.faces)
    for vertex, other in _neighbours(points, points[used], d, fewest=MIN_NEIGHBOURS):
        away = points[used[other]] - points[vertex]
        same = np.einsum("pi,pi->p", normal[used[other]], normal[vertex]) > 0
        x = np.einsum("pi,pi->p", away, first[vertex]) / d
        y = np.einsum("pi,pi->p", away, second[vertex]) / d
        z = np.einsum("pi,pi->p", away, normal[vertex]) / d
        basis = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=1) * same[:, None]
        for i in range(6):
            right[:, i] += np.bincount(vertex, basis[:, i] * z, count)
            for j in range(6):
                moments[:, 6 * i + j] += np.bincount(vertex, basis[:, i] * basis[:, j], count)
    matrix = moments.reshape(count, 6, 6)
    # Where points are collinear, the polynomial is regularised to be flat across the line.
    ridge = 1e-9 * np.trace(matrix, axis1=1, axis2=2)[:, None, None] * np.eye(6) + 1e-12 * np.eye(6)
    p20, p11, p02 = np.linalg.solve(matrix + ridge, right[..., None])[:, :3, 0].T
    return (0.5 * (p20 + p02) - np.hypot(0.5 * (p20 - p02), 0.5 * p11)) / d


def _samples(
    mesh: ShellMesh, max_m2: float
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s 3"], Float[np.ndarray, "s"]]:
    """Points distributed over the surface, each for at most ``max_m2``, with normals and areas."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    doubled = np.cross(b - a, c - a)
    area = 0.5 * np.linalg.norm(doubled, axis=1)
    unit = doubled / np.maximum(2 * area, 1e-300)[:, None]
    pieces = np.clip(np.ceil(np.sqrt(area / max_m2)).astype(int), 1, 64)
    places, normals, areas = [], [], []
    for n in np.unique(pieces):
        some = pieces == n
        for fraction in _centroids(int(n)):
            places.append(fraction[0] * a[some] + fraction[1] * b[some] + fraction[2] * c[some])
            normals.append(unit[some])
            areas.append(area[some] / n**2)
    return np.concatenate(places), np.concatenate(normals), np.concatenate(areas)


def _centroids(n: int) -> Float[np.ndarray, "m 3"]:
    """Barycentric centroids of the n^2 equal parts of a triangle."""
    out = []
    for i in range(n):
        for j in range(n - i):
            out.append((i + 1 / 3, j + 1 / 3))
            if i + j < n - 1:
                out.append((i + 2 / 3, j + 2 / 3))
    uv = np.array(out) / n
    return np.column_stack([uv, 1 - uv.sum(axis=1)])


def _neighbours(
    points: Float[np.ndarray, "v 3"], places: Float[np.ndarray, "s 3"], radius: float, fewest: int = 0
) -> list[tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]]:
    """Pairs (point, location) within a radius, in chunks; at least ``fewest`` locations of each point."""
    from scipy.spatial import cKDTree

    tree, out = cKDTree(places), []
    step = 4096
    for begin in range(0, len(points), step):
        some = points[begin : begin + step]
        found = cKDTree(some).sparse_distance_matrix(tree, radius, output_type="coo_matrix")
        vertex, place = found.row.astype(np.int64), found.col.astype(np.int64)
        few = np.flatnonzero(np.bincount(vertex, minlength=len(some)) < fewest)
        if len(few):
            keep = ~np.isin(vertex, few)
            nearest = tree.query(some[few], k=min(fewest, len(places)))[1].reshape(len(few), -1)
            vertex = np.concatenate([vertex[keep], np.repeat(few, nearest.shape[1])])
            place = np.concatenate([place[keep], nearest.ravel()])
        out.append((vertex + begin, place))
    return out


def _tangents(normal: Float[np.ndarray, "v 3"]) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
    upright: Bool[np.ndarray, "v"] = np.abs(normal[:, 2]) > 0.9
    aid = np.where(upright[:, None], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    first = np.cross(aid, normal)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    return first, np.cross(normal, first)


def _factor(fraction: Float[np.ndarray, "p"]) -> Float[np.ndarray, "p"]:
    return np.maximum(1 - np.sqrt(fraction), 0.0)


def _clamped(score: Float[np.ndarray, "v"]) -> Float[np.ndarray, "v"]:
    """l of Eq. (6.9)."""
    return np.clip(score, 0.0, 1.0)

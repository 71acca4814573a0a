"""Inner side of an open container: its wall as an offset of the outer side by a thickness seen elsewhere.

Of a bowl or a cup the cameras see parts of both sides of one wall. Where only one is seen, the other is at the thickness of the
wall: log t is a Gaussian process over the places of the wall, known where two opposite surfaces are seen, with an unknown
mean. Correlation length and deviation are averaged by their likelihood. The hypothesis competes with that of a solid, whose
inner surfaces are clutter: their distances from the outer side are then uniformly distributed up to the size of the region.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ..mesh import SurfaceMesh
from .discrete_symmetry import even_subset
from .hole import SupportBand, boundary_loops
from .hole_region import HoleRegion
from .uncertainty import matern

#: Grids of correlation lengths (in sizes of the region) and of deviations of log t; uniform prior.
_LENGTHS, _DEVIATIONS = (0.3, 0.6, 1.2), (0.05, 0.1, 0.2, 0.4, 0.8)
#: Variance of the unknown mean of log t.
_MEAN = 2.0**2
#: Distance between places where the thickness is read, in sizes of the region.
_STEP = 0.08
#: Maximum cosine between the normals of the two sides of a wall.
_OPPOSITE = -0.8
#: Width of the zone beside its rims in which a fused surface curls, in cells.
_CURL = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class OpenShell:
    """Thickness of a wall of which parts of both sides are seen."""

    places_m: Float[np.ndarray, "n 3"]  #: points of the outer side where the thickness is read [m]
    logs: Float[np.ndarray, "n"]  #: log of the thickness in metres
    noise: Float[np.ndarray, "n"]  #: variance of each
    size_m: float  #: size of the region [m]
    weights: Float[np.ndarray, "p"]  #: posterior probability of each process
    evidence: float  #: log Bayes factor against a solid
    visible: SurfaceMesh  #: visible surface, both sides
    opening: HoleRegion  #: the space below the visible rim
    near_m: float  #: edge of a pair of triangles of the visible surface [m]

    @classmethod
    def seen(
        cls, visual: SurfaceMesh, band: SupportBand, outer: HoleRegion, region: HoleRegion, sigma_m: float
    ) -> OpenShell | None:
        """The wall whose two sides are seen near a region; ``None`` if a solid is more probable.

        Parameters
        ----------
        visual
            Visible surface.
        band
            Known points of the outer side.
        outer
            Convex hull of the object near the region.
        region
            Where the surface is missing.
        sigma_m
            Standard deviation of the visible surface [m].
        """
        from scipy.spatial import cKDTree

        if (opening := _opening(band, region)) is None:
            return None
        size_m, middle = region.size_m, visual.vertices_m[visual.faces].mean(axis=1)
        hollow_m = _CURL * band.cell_m
        near = np.flatnonzero(outer.within(middle) & (visual.face_areas_m2 > 0))
        if not len(near):
            return None
        foot = band.tree.query(middle[near])[1]
        way, normals = band.samples_m[foot] - middle[near], band.sample_normals[foot]
        thick_m = (way * normals).sum(axis=1)
        aside = np.linalg.norm(way - thick_m[:, None] * normals, axis=1)
        opposite = (visual.face_normals[near] * normals).sum(axis=1) < _OPPOSITE
        inner = opposite & (thick_m > 2 * sigma_m) & (aside < band.spacing_m)
        chosen = np.flatnonzero(inner)
        if not len(chosen):
            return None
        welded = visual.welded()
        rims_m = welded.vertices_m[np.concatenate([*boundary_loops(welded), np.zeros(0, dtype=np.int64)])]
        curled = cKDTree(rims_m).query(middle[near[chosen]])[0] < hollow_m if len(rims_m) else np.False_
        before = middle[near[chosen]] + hollow_m * visual.face_normals[near[chosen]]
        chosen = chosen[_open_above(opening, middle, before, band.cell_m) & ~curled]
        read = even_subset(middle[near], chosen, _STEP * size_m)
        if not len(read):
            return None
        logs, places_m = np.log(thick_m[read]), band.samples_m[foot[read]]
        noise = 2 * (sigma_m / thick_m[read]) ** 2
        likelihoods = _likelihoods(places_m, logs, noise, size_m)
        best = likelihoods.max()
        weights = np.exp(likelihoods - best)
        evidence = best + float(np.log(weights.mean()) + (np.log(size_m) - logs).sum())
        if evidence < 0:
            return None
        weights /= weights.sum()
        return cls(places_m, logs, noise, size_m, weights, evidence, visual, opening, band.cell_m)

    def inner(
        self, outside: SurfaceMesh, region: HoleRegion, gap_m: float
    ) -> tuple[SurfaceMesh, Float[np.ndarray, "v"]]:
        """The hidden inner side at the thickness from an outer side, and its standard deviation from it [m].

        Parameters
        ----------
        outside
            Estimated outer side.
        region
            Where the surface is missing.
        gap_m
            Growth of the region at which it reaches the visible surface [m].
        """
        from scipy.spatial import cKDTree

        thick_m, spread = self.thickness(outside.vertices_m)
        vertices_m = outside.vertices_m - thick_m[:, None] * outside.vertex_normals
        mesh = SurfaceMesh(vertices_m, outside.faces[:, ::-1])
        # A wall of unknown thickness has no inner side.
        kept = (spread < 1.0)[mesh.faces].all(axis=1)
        kept &= (mesh.face_normals * outside.face_normals).sum(axis=1) < _OPPOSITE
        middle = vertices_m[mesh.faces].mean(axis=1)
        kept &= region.within(middle, gap_m)
        seen_m = self.visible.vertices_m[self.visible.faces].mean(axis=1)
        kept &= cKDTree(seen_m).query(middle)[0] > 2 * self.near_m
        rows = np.flatnonzero(kept)
        before = middle[rows] + _CURL * self.near_m * mesh.face_normals[rows]
        rows = rows[_open_above(self.opening, seen_m, before, self.near_m)]
        used = np.unique(mesh.faces[rows])
        return mesh.submesh(rows), (thick_m * spread)[used]

    def thickness(
        self, places_m: Float[np.ndarray, "m 3"]
    ) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
        """Median thickness at points of the outer side [m], and the standard deviation of its logarithm.

        Parameters
        ----------
        places_m
            Points (m, 3) [m].
        """
        mean, square = np.zeros((2, len(places_m)))
        gap = np.linalg.norm(self.places_m[:, None] - self.places_m, axis=2) / self.size_m
        across = np.linalg.norm(self.places_m[:, None] - places_m, axis=2) / self.size_m
        middle = self.logs.mean()
        for (length, deviation), weight in zip(_processes(), self.weights, strict=True):
            if weight < 1e-3:
                continue
            lower = _factor(gap, self.noise, length, deviation)
            half = np.linalg.solve(lower, deviation**2 * matern(across, length) + _MEAN)
            one = np.linalg.solve(lower, self.logs - middle) @ half
            variance = deviation**2 + _MEAN - (half**2).sum(axis=0)
            mean += weight * one
            square += weight * (one**2 + np.maximum(variance, 0.0))
        return np.exp(middle + mean), np.sqrt(np.maximum(square - mean**2, 0.0))


def _opening(band: SupportBand, region: HoleRegion) -> HoleRegion | None:
    """The space below the part of the visible outer side that is above the region; ``None`` if the region is the top.

    Without such a rim what is seen inside may be seen through a glass wall, which refracts.
    """
    upper_m = band.samples_m[band.samples_m[:, 2] > region.hull_m[:, 2].max()]
    below_m = upper_m - [0.0, 0.0, 2 * region.size_m]
    try:
        return HoleRegion.of_points(np.vstack([upper_m, below_m]))
    except InputError:
        return None


def _open_above(
    opening: HoleRegion,
    surface_m: Float[np.ndarray, "f 3"],
    points_m: Float[np.ndarray, "n 3"],
    near_m: float,
) -> Bool[np.ndarray, "n"]:
    """Whether points are below the opening, without a visible surface above them."""
    from scipy.spatial import cKDTree

    columns = cKDTree(surface_m[:, :2]).query_ball_point(points_m[:, :2], near_m)
    found = opening.within(points_m)
    for k in np.flatnonzero(found):
        found[k] = not (surface_m[columns[k], 2] > points_m[k, 2]).any()
    return found


def _processes() -> list[tuple[float, float]]:
    return [(length, deviation) for length in _LENGTHS for deviation in _DEVIATIONS]


def _factor(gap: np.ndarray, noise: np.ndarray, length: float, deviation: float) -> np.ndarray:
    found: np.ndarray = np.linalg.cholesky(deviation**2 * matern(gap, length) + _MEAN + np.diag(noise + 1e-8))
    return found


def _likelihoods(
    places_m: Float[np.ndarray, "n 3"],
    logs: Float[np.ndarray, "n"],
    noise: Float[np.ndarray, "n"],
    size_m: float,
) -> Float[np.ndarray, "p"]:
    """Log-likelihood of the thicknesses by each process."""
    gap = np.linalg.norm(places_m[:, None] - places_m, axis=2) / size_m
    off = logs - np.log(0.05 * size_m)
    found = []
    for length, deviation in _processes():
        lower = _factor(gap, noise, length, deviation)
        white = np.linalg.solve(lower, off)
        found.append(-0.5 * white @ white - np.log(np.diag(lower)).sum())
    return np.array(found) - 0.5 * len(off) * np.log(2 * np.pi)

"""Flat panes of glass, upright or level: rectangles that show at a shallow angle only.

A pane returns every ray to its direction, so that a camera reads what is behind it, about a third of the thickness too near. It shows where it reflects
more than it lets pass: by Fresnel's equations, of light that passes twice, from the projector and to the camera, .85 pass at right angles to it, .72 at an
incidence of 60 degrees, .53 at 70 and .21 at 80. How much is needed depends on camera and room, so that the angle a from which on a pane shows is unknown,
with a uniform prior. The likelihood ratio of a pane is the mean over a of the product over the views beyond a of

    [(1 - d) R + d] / [(1 - e) + e R]

with R the likelihood ratio of all windows inside its outline, and d and e as for a place (:mod:`..evidence`): like each factor, it exceeds a threshold t
by chance with a probability of at most 1 / t. A rectangle is sought where the views that are oblique to one of several orientations show glass, and found by maximum
likelihood (e = 0). It must be likelier than glass that shows in all views: an opaque thing whose readings are missing is not read through from anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...fusion.volume import SpaceGrid
from ..outline_fit import Outlines, OutlineView
from ..ray_evidence import HIDDEN, RayEvidence

#: Angles of incidence from which on a pane may show: it reflects least, and almost alike, up to 45 degrees.
_ANGLES = np.radians(np.arange(45.0, 90.0, 5.0))
#: Number of directions of upright panes, so that a start is at most two first steps of the fit off; cosine of the angle of incidence below which a view is oblique.
_DIRECTIONS, _OBLIQUE = 8, 0.5
#: Number of starts, minimum half of an edge [m], and first steps of the place, direction, and halves of the edges [m, rad].
_SEARCHES, _MIN_HALF_M, _STEPS = 3, 0.04, np.array([0.012, 0.012, 0.012, 0.1, 0.02, 0.02])


@dataclass(frozen=True, slots=True, eq=False)
class Pane:
    """A flat rectangular sheet of glass."""

    corners_m: Float[np.ndarray, "4 3"]  #: in order around it, world [m]
    sigma_m: float  #: standard deviation of its place along its normal [m]
    evidence: float  #: of all views [nat]

    def points_m(self, spacing_m: float) -> Float[np.ndarray, "n 3"]:
        """Points of the sheet on a grid (n, 3) [m].

        Parameters
        ----------
        spacing_m
            Maximum spacing of the points along each edge [m].
        """
        edges = self.corners_m[[1, 3]] - self.corners_m[0]
        a, b = (np.linspace(0, 1, math.ceil(float(np.linalg.norm(edge)) / spacing_m) + 1) for edge in edges)
        sheet_m = (a[:, None, None] * edges[0] + b[:, None] * edges[1]).reshape(-1, 3)
        return np.asarray(self.corners_m[0] + sheet_m)


def _axes(direction: float, level: bool) -> Float[np.ndarray, "2 3"]:
    """Unit vectors along both edges of a level or upright rectangle."""
    c, s = math.cos(direction), math.sin(direction)
    return np.array([[c, s, 0.0], [-s, c, 0.0] if level else [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class _Fit:
    """Likelihood of rectangles of one kind; a shape is x, y, z of the middle, direction, and halves of both edges [m, rad]."""

    hull: Callable[[np.ndarray], np.ndarray]  #: evidence inside the outlines of corners, of each view [nat]
    weights: Float[np.ndarray, "views"]
    eyes_m: Float[np.ndarray, "views 3"]
    level: bool

    def corners_m(self, shape: np.ndarray) -> Float[np.ndarray, "4 3"]:
        """Corners in order around the rectangle [m]."""
        edges = shape[4:, None] * _axes(shape[3], self.level)
        return np.asarray(shape[:3] + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ edges)

    def each(self, shape: np.ndarray, look_alike: float = 0.0) -> np.ndarray:
        """Log-likelihood ratio of glass in every view, bounded with a fraction of windows that look like it [nat]."""
        ratio = self.hull(self.corners_m(shape)) / self.weights
        shown = np.logaddexp(math.log1p(-HIDDEN) + ratio, math.log(HIDDEN))
        if look_alike:
            shown -= np.logaddexp(math.log1p(-look_alike), math.log(look_alike) + ratio)
        return np.asarray(self.weights * shown)

    def evidence(self, shape: np.ndarray, look_alike: float = 0.0) -> float:
        """Log-likelihood ratio of a pane [nat]."""
        told = self._oblique(shape) @ self.each(shape, look_alike)
        return float(np.logaddexp.reduce(told)) - math.log(len(_ANGLES))

    def _oblique(self, shape: np.ndarray) -> np.ndarray:
        """Which views are beyond each of the angles (angles, views)."""
        sight = shape[:3] - self.eyes_m
        cosine = np.abs(sight @ np.cross(*_axes(shape[3], self.level))) / np.linalg.norm(sight, axis=1)
        return cosine < np.cos(_ANGLES)[:, None]

    def cost(self, shape: np.ndarray) -> float:
        """Negative log-likelihood ratio [nat]; 1000 for a smaller rectangle."""
        return 1e3 if shape[4:].min() < _MIN_HALF_M else -self.evidence(shape)

    def best(self, shape: np.ndarray) -> np.ndarray:
        """The rectangle of maximum likelihood near a start."""
        from scipy.optimize import minimize

        for side in (1, -1):
            simplex = np.vstack([shape, shape + side * np.diag(_STEPS)])
            told = {"initial_simplex": simplex, "maxfev": 400, "xatol": 3e-4, "fatol": 1e-2}
            shape = minimize(self.cost, shape, method="Nelder-Mead", options=told).x
        return shape

    def sigma_m(self, shape: np.ndarray, step_m: float) -> float:
        """Standard deviation along the normal, as of a body's axis; NaN where the likelihood has no maximum [m]."""
        way = np.append(step_m * np.cross(*_axes(shape[3], self.level)), np.zeros(3))
        oblique = self._oblique(shape)
        shows = oblique[(oblique @ self.each(shape)).argmax()]
        ahead, here, back = (self.each(shape + k * way) * shows for k in (1, 0, -1))
        curvature = float((2 * here - ahead - back).sum()) / step_m**2
        slopes = (ahead - back) / (2 * step_m)
        count = np.count_nonzero(slopes)
        if curvature <= 0 or count < 2:
            return math.nan
        squares = float((slopes**2 / self.weights).sum()) * count / (count - 1)
        return math.sqrt(squares / curvature**2 + 1 / curvature)


def _starts(
    rays: RayEvidence, grid: SpaceGrid, eyes_m: np.ndarray, even: float
) -> list[tuple[np.ndarray, bool]]:
    """Rectangles around the places where the views that are oblique to an orientation show glass."""
    from scipy import ndimage

    sight = 0.5 * (grid.low_m + grid.high_m) - eyes_m
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    found = []
    for k in range(_DIRECTIONS + 1):
        level, direction = k == _DIRECTIONS, math.pi * (k % _DIRECTIONS) / _DIRECTIONS
        axes = _axes(direction, level)
        normal = np.cross(*axes)
        chosen = np.flatnonzero(np.abs(sight @ normal) < _OBLIQUE).tolist()
        if len(chosen) < 2:
            continue
        weights, limit_m, on_ray = (each[chosen] for each in (rays.weights, rays.limit_m, rays.on_ray))
        oblique = RayEvidence([rays.frames[i] for i in chosen], weights, limit_m, on_ray, on_ray)
        evidence = oblique.sums(grid)[0]
        if evidence.max() < even:
            continue
        labels, _ = ndimage.label(evidence > 0.5 * evidence.max(), np.ones((3, 3, 3)))
        peak = np.array(np.unravel_index(evidence.argmax(), evidence.shape))
        part = grid.centres_m(np.argwhere(labels == labels[tuple(peak)]))
        middle = grid.centres_m(peak[None])[0]
        part = part[np.abs((part - middle) @ normal) < 1.5 * grid.voxel_m]
        ends = np.array([(part @ axes.T).min(axis=0), (part @ axes.T).max(axis=0)])
        place = normal * (middle @ normal) + ends.mean(axis=0) @ axes
        halves = np.maximum(0.5 * np.ptp(ends, axis=0) + 0.5 * grid.voxel_m, 1.5 * _MIN_HALF_M)
        found.append((np.array([*place, direction, *halves]), level))
    return found


def find_panes(
    views: Sequence[OutlineView],
    views_beside: Callable[[np.ndarray], Sequence[OutlineView]],
    rays: RayEvidence,
    grid: SpaceGrid,
    threshold: float,
    look_alike: float,
    object_m: float,
) -> tuple[Pane, ...]:
    """Panes, likeliest first, each by the rays that no part before it explains.

    Parameters
    ----------
    views, views_beside
        Outlines of all views, and a function of points (n, 3) [m]: the same with the rates of the surface behind these.
    rays
        Rays of all views, whose ``limit_m`` becomes 0 where a pane explains them.
    grid
        Space of interest.
    threshold
        Minimum evidence of a part in one of the places of the space [nat].
    look_alike
        Fraction of all windows that look like glass.
    object_m
        Size of the smallest object, and of a place [m].
    """
    size = np.maximum(np.rint((grid.high_m - grid.low_m) / object_m), 1).astype(int).tolist()
    places = SpaceGrid(grid.low_m, (size[0], size[1], size[2]), object_m)
    eyes_m = np.array([frame.T_world_camera.translation_m for frame in rays.frames])
    threshold += math.log(_DIRECTIONS + 1)
    found: list[Pane] = []
    while (best := _find(views, rays, places, eyes_m, threshold, look_alike)) is not None:
        fit, shape = best
        windows_m = [v.window_px / v.matrix[0] * (v.T_camera_world[2] @ [*shape[:3], 1.0]) for v in views]
        sigma_m = fit.sigma_m(shape, 0.5 * float(np.median(windows_m)))
        pane = Pane(fit.corners_m(shape), sigma_m, fit.evidence(shape, look_alike))
        points_m = pane.points_m(grid.voxel_m)
        own = rays.through(points_m, grid.voxel_m) & (rays.limit_m > 0)
        # Evidence of rays beside it only, where the second eye would see it: no ray is left to explain.
        if not own.any():
            break
        # As for bodies, also with the rates of the surface behind it.
        beside = replace(fit, hull=Outlines(views_beside(points_m), shape[:3]).inside)
        if beside.evidence(shape, look_alike) >= threshold and math.isfinite(sigma_m):
            found.append(pane)
        rays.limit_m[own] = 0.0
    return tuple(found)


def _find(
    views: Sequence[OutlineView],
    rays: RayEvidence,
    places: SpaceGrid,
    eyes_m: np.ndarray,
    threshold: float,
    look_alike: float,
) -> tuple[_Fit, np.ndarray] | None:
    """The likeliest rectangle above the threshold that shows as a pane does rather than in all views alike."""
    fits, best, least = [], None, 0.0
    for start, level in _starts(rays, places, eyes_m, math.log(math.prod(places.shape))):
        fits.append((_Fit(Outlines(views, start[:3]).inside, rays.weights, eyes_m, level), start))
    for fit, start in sorted(fits, key=lambda one: one[0].cost(one[1]))[:_SEARCHES]:
        shape = fit.best(start)
        # Likeliest at the minimum size: what is left of the rays beside another part.
        if shape[4:].min() < _MIN_HALF_M + _STEPS[4]:
            continue
        fit = replace(fit, hull=Outlines(views, shape[:3]).inside)
        alike = -float(fit.each(shape).sum())
        if fit.evidence(shape, look_alike) >= threshold and (cost := fit.cost(shape)) < min(least, alike):
            best, least = (fit, shape), cost
    return best

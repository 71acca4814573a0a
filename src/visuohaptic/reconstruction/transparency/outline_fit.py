"""Position of a transparent part: an upright body fitted to its outlines by maximum likelihood.

Voxels that only rays through glass pass extend away from the cameras and into parts that the glass shades, so that their centroid is wrong by about a
centimetre. The outline in each view is sharper: windows of readings inside it have the distribution of glass, or show no effect, because walls
refract little in the middle and near to the background; windows outside have the distribution of the sequence. A truncated cone with a vertical axis
is fitted to the outlines of all views. The second eye of the camera looks past the body, too: where its line of sight crosses the body, matching
fails beside the outline, by the difference between the disparities of the body and of the background.

The covariance of the axis is robust against a misspecified likelihood (Huber 1967; White 1982): H^-1 (sum of g g^T) H^-1 with H the curvature of the
total and g the gradient of each view, both by differences over half of the matching window of the camera; over shorter steps the noise of single
readings dominates. Views from the same direction have correlated errors, so g g^T of a view is divided by its weight. The gradients at the fit are
smaller than at the true parameters, corrected by the factor n / (n - k) (MacKinnon and White 1985). From one side only, a farther and higher body
looks the same, so the height is estimated jointly with the axis if the likelihood has a maximum in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int8, UInt8

from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import DepthNoise
from ..vessel_shapes import UprightBody as UprightBody
from ..vessel_shapes import end_circles
from .view_geometry import intrinsics

#: Number of points on each of the two bounding circles of a body.
_CORNERS = 16
#: Probability that a window inside the outline shows no effect of the glass.
_HIDDEN = 0.5
#: Fraction of the radius inside which there is no evidence: 0 for a closed body, 0.7 for an open bowl (rim and wall only).
OPEN = (0.0, 0.7)
#: Initial steps of positions, radii and heights [m]; maximum evaluations; tolerances of size [m] and cost [nat].
STEP_M, _MAX_STEPS, _NEAR_M, _ALIKE = 0.012, 400, 3e-4, 1e-2
#: Sides of the first simplex, in initial steps.
_SIMPLEX = np.array([1, 1, 0.5, 0.5, -1, -1, 1, 1])
#: Radii of the initial bodies around strong voxels, in initial steps.
RADII = (2, 3, 5)
#: Number of directions in which the axis of a bowl is tried from a fragment of its rim, and maximum number of initial bodies of
#: each kind (the likeliest, apart from each other) from which the search starts.
TURNS, SEARCHES = 8, 4
#: Radii of the rims of which a part may be the half, a quarter, a sixth or a tenth, in widths of the part: 1 / (2 sin(arc / 2)).
_CHORDS = (0.5, 0.71, 1.0, 1.62)
#: Minimum radius and height of a body [m].
MIN_RADIUS_M, MIN_HEIGHT_M = 0.01, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class OutlineView:
    """Log-likelihood ratios of each pixel of a view for each kind of glass, thinned to independent readings."""

    evidence: Float32[np.ndarray, "h w"]  #: log-likelihood ratio of the window around each pixel [nat]
    changed: Int8[np.ndarray, "h w"]  #: 1: not the surface that other views see, -1: this one, 0: unknown
    limit_m: Float32[np.ndarray, "h w"]  #: depth up to which each ray is evidence [m]
    T_camera_world: Float[np.ndarray, "3 4"]
    matrix: tuple[float, float, float, float]  #: fx, fy, cx, cy of the thinned image [px]
    baseline_m: float  #: baseline of the second eye along the rows [m]
    window_px: float  #: matching window in the thinned image [px]
    edge_px: float  #: margin around edges in which depths are mixed, in the thinned image [px]
    weight: float  #: weight of the view, in independent views

    @classmethod
    def of_view(
        cls,
        frame: DepthFrame,
        reading: UInt8[np.ndarray, "h w"],
        log_ratios: Sequence[Float32[np.ndarray, "h w"]],
        limit_m: Float32[np.ndarray, "h w"],
        noise: DepthNoise,
        weight: float,
        stride: int = 1,
    ) -> OutlineView:
        """Thin a view to a spacing of a quarter of the matching window.

        Parameters
        ----------
        frame
            View.
        reading
            See :attr:`~.ray_readings.RayImage.reading`.
        log_ratios
            Log-likelihood ratio of every reading (h, w), for each kind of glass [nat].
        limit_m
            Depth up to which each ray is evidence (h, w) [m]; not copied, so that later changes remove explained rays.
        noise
            Noise of the camera: baseline of its second eye, and matching window whose readings count as one.
        weight
            Weight of the view, in independent views.
        stride
            Pixels of the camera per pixel of the view.
        """
        import cv2

        window_px = noise.window_px(frame.camera.focal_px, stride)
        step, width = max(1, int(window_px) // 4), round(window_px)
        ratio = np.mean(
            [cv2.exp(cv2.blur(part, (width, width))[::step, ::step]) for part in log_ratios], axis=0
        )
        evidence = np.log((1 - _HIDDEN) * ratio + _HIDDEN) * (step / window_px) ** 2
        fx, fy, cx, cy = (float(value) / step for value in intrinsics(frame.camera))
        changed = np.array([0, -1, 1, 1, 1], np.int8)[reading[::step, ::step]]
        told = evidence.astype(np.float32), changed, limit_m[::step, ::step]
        edge_px = noise.edge_px(stride * frame.camera.focal_px) / (stride * step)
        sizes = noise.baseline_m, window_px / step, edge_px
        return cls(*told, frame.T_world_camera.inverse().matrix[:3], (fx, fy, cx, cy), *sizes, weight)


class Outlines:
    """Cumulative row sums of the evidence of all views, for rays that end behind a place."""

    def __init__(self, views: Sequence[OutlineView], middle_m: Float[np.ndarray, "3"]) -> None:
        """Sum the rows.

        Parameters
        ----------
        views, middle_m
            Views, and a place (3): rays that end in front of it are no evidence [m].
        """
        self.matrices = np.array([view.matrix for view in views])
        reach = np.array([view.matrix[0] * view.baseline_m for view in views])
        self._motions = np.array([view.T_camera_world for view in views])
        self.weights = np.array([view.weight for view in views])
        self._limits = np.stack([view.limit_m for view in views])
        away_m = self._motions[:, 2] @ np.append(middle_m, 1.0)
        told = np.where(self._limits > away_m[:, None, None], np.stack([view.evidence for view in views]), 0)
        sums = np.pad(np.cumsum(told, axis=2, dtype=np.float64), ((0, 0), (0, 0), (1, 0)))
        self._told = (sums, self._limits, self._motions, self.matrices, reach, self.weights)

    def cost(self, body: Float[np.ndarray, "n"], opening: float, bounds_m: Float[np.ndarray, "3"]) -> float:
        """Negative log-likelihood ratio of a body against no body [nat]; 1000 outside the bounds.

        Parameters
        ----------
        body, opening
            As of :meth:`log_likelihood`.
        bounds_m
            Minimum radius, minimum height and maximum radius [m].
        """
        narrow, wide, height = min(body[2], body[3]), max(body[2], body[3]), body[5] - body[4]
        # An open body is at most half as high as wide: into a taller one no view looks from above alone.
        if narrow < bounds_m[0] or height < bounds_m[1] or wide > bounds_m[2] or (opening and height > wide):
            return 1e3
        return -float(self.log_likelihood(body, opening).sum())

    def search(
        self, best: Float[np.ndarray, "n"], opening: float, bounds_m: Float[np.ndarray, "3"], side: int = 0
    ) -> Float[np.ndarray, "n"]:
        """The body of maximum likelihood, by one local search, or until searches on both sides in turns, this one first, gain nothing.

        Seen from one side, a farther, higher and wider body looks almost the same: on this ridge a simplex collapses.

        Parameters
        ----------
        best, opening
            Start, as of :meth:`log_likelihood`.
        bounds_m
            See :meth:`cost`.
        side
            1 or -1: the first side of the searches in turns; 0: one local search.
        """
        from scipy.optimize import minimize

        once, side, gain, least = not side, side or 1, np.inf, self.cost(best, opening, bounds_m)
        options: dict[str, Any] = {"maxfev": _MAX_STEPS, "xatol": _NEAR_M, "fatol": _ALIKE}
        while gain > _ALIKE:
            options["initial_simplex"] = np.vstack(
                [best, best + side * STEP_M * np.diag(_SIMPLEX[: len(best)])]
            )
            found = minimize(self.cost, best, (opening, bounds_m), "Nelder-Mead", options=options)
            best, side, before, least = found.x, -side, least, float(found.fun)
            gain = 0.0 if once else before - least
        return best

    def log_likelihood(self, body: Float[np.ndarray, "n"], opening: float) -> Float[np.ndarray, "views"]:
        """Log-likelihood ratio of a body (x, y of the axis, both radii, both heights, and a lean [m]) against no body, of each view [nat].

        Parameters
        ----------
        body
            See above (6 or 8).
        opening
            Fraction of the radius inside which there is no evidence.
        """
        found = self.inside(end_circles(body, _CORNERS))
        if opening > 0:
            # A body that reaches the camera has no evidence, nor has its opening.
            found -= np.where(found != 0, self.inside(end_circles(body, _CORNERS, opening)), 0.0)
        return found

    def inside(self, corners_m: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "views"]:
        """Sum of the evidence inside the outlines of the convex hull of points, of each view [nat].

        Parameters
        ----------
        corners_m
            Points (p, 3) [m].
        """
        from ._outline_kernels import outline_sums

        found = np.empty(len(self.weights))
        outline_sums(corners_m, *self._told, found)
        return found

    def window_m(self, window_px: float, middle_m: Float[np.ndarray, "3"]) -> float:
        """Width of a matching window at a point, median over the views [m].

        Parameters
        ----------
        window_px, middle_m
            Matching window in the thinned images [px], and the point (3) [m].
        """
        return float(
            np.median(window_px * (self._motions[:, 2] @ np.append(middle_m, 1.0)) / self.matrices[:, 0])
        )


def fit_bodies(
    views: Sequence[OutlineView], points_m: Float[np.ndarray, "n 3"], evidence: Float[np.ndarray, "n"]
) -> list[UprightBody]:
    """Fit upright bodies to a part; returns the maxima of the likelihood, likeliest first, which may share the part.

    Parameters
    ----------
    views
        All views.
    points_m
        Centres (n, 3) of the voxels of the part [m].
    evidence
        Evidence of each voxel (n) [nat].
    """
    bounds_m = body_bounds_m(points_m)
    outlines = Outlines(views, points_m[evidence.argmax()])
    strong_m = points_m[evidence > 0.5 * evidence.max()]
    starts = [(start, opening) for opening in OPEN for start in _starts(strong_m, opening)]
    starts += [(start, OPEN[1]) for start in _rims(points_m.min(axis=0), points_m.max(axis=0))]
    bodies: list[UprightBody] = []
    ends: list[tuple[np.ndarray, float]] = []
    for start, opening in _apart(sorted(starts, key=lambda one: outlines.cost(one[0], one[1], bounds_m))):
        # Recompute the row sums for this start: rays that end in front of it are no evidence.
        outlines = Outlines(views, np.array([*start[:2], 0.5 * (start[4] + start[5])]))
        best = outlines.search(start, opening, bounds_m)
        # Results nearer than half of the minimum radius belong to the same maximum.
        if any(kind == opening and np.hypot(*(best - end)[:2]) < 0.5 * MIN_RADIUS_M for end, kind in ends):
            continue
        best = outlines.search(best, opening, bounds_m, side=-1)
        ends.append((best, opening))
        bodies += _bodies(outlines, best, opening, bounds_m, views[0].window_px)
    return sorted(bodies, key=lambda body: -body.evidence)


def body_bounds_m(points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """Minimum radius, minimum height and maximum radius of bodies in a part [m].

    Parameters
    ----------
    points_m
        Centres (n, 3) of the voxels of the part [m].
    """
    # A part is at least a twelfth of a rim, whose chord is half of the radius: wider bodies would include surrounding objects.
    widest_m = max(2 * float(np.ptp(points_m, axis=0)[:2].max()), 4 * MIN_RADIUS_M)
    return np.array([MIN_RADIUS_M, MIN_HEIGHT_M, widest_m])


def fit_beside(
    views: Sequence[OutlineView], start: Float[np.ndarray, "6"], bounds_m: Float[np.ndarray, "3"]
) -> list[UprightBody]:
    """The closed body of maximum likelihood near a start; none where the likelihood has no maximum.

    Parameters
    ----------
    views
        Views, without the rays through other bodies.
    start
        x, y of the axis, lower and upper radius, lower and upper height [m].
    bounds_m
        See :func:`body_bounds_m`.
    """
    outlines = Outlines(views, np.array([*start[:2], 0.5 * (start[4] + start[5])]))
    best = outlines.search(start[:6], OPEN[0], bounds_m, side=1)
    return _bodies(outlines, best, OPEN[0], bounds_m, views[0].window_px)


def _bodies(
    outlines: Outlines, best: np.ndarray, opening: float, bounds_m: np.ndarray, window_px: float
) -> list[UprightBody]:
    """The body at a maximum of the likelihood; none if it has no evidence or no maximum."""
    told = covariance(outlines, best, opening, window_px)
    if (least := outlines.cost(best, opening, bounds_m)) >= 0 or told is None:
        return []
    sigma = np.sqrt(np.diag(told[0]))
    x, y, low_r, high_r, low_z, high_z = (float(value) for value in best[:6])
    place = np.array([x, y]), sigma[:2]
    return [UprightBody(*place, (low_r, high_r), float(sigma[2]), (low_z, high_z), -least)]


def body_evidence(views: Sequence[OutlineView], body: UprightBody) -> Float[np.ndarray, "views"]:
    """Log-likelihood ratio of a body against no body, closed or open, whichever is likelier, of each view [nat].

    Parameters
    ----------
    views, body
        All views, and the body.
    """
    outlines = Outlines(views, np.array([*body.axis_m, np.mean(body.height_m)]))
    return max((outlines.log_likelihood(body.shape_m, opening) for opening in OPEN), key=np.sum)


def _apart(starts: Sequence[tuple[np.ndarray, float]]) -> list[tuple[np.ndarray, float]]:
    """The best starts of each kind whose axes are outside each other's bodies."""
    chosen: list[tuple[np.ndarray, float]] = []
    for start, opening in starts:
        alike = [other for other, kind in chosen if kind == opening]
        near = (np.hypot(*(start - other)[:2]) < max(start[3], other[3]) for other in alike)
        if len(alike) < SEARCHES and not any(near):
            chosen.append((start, opening))
    return chosen


def _starts(strong_m: Float[np.ndarray, "n 3"], opening: float) -> list[Float[np.ndarray, "6"]]:
    """Initial bodies around the strong voxels of a part, with the height range of these voxels."""
    found = []
    cell_m = 2 * STEP_M
    for axis in cell_m * np.unique(np.round(strong_m[:, :2] / cell_m), axis=0):
        away_m = np.hypot(*(strong_m[:, :2] - axis).T)
        for radius in STEP_M * np.array(RADII):
            near_m = strong_m[away_m < radius, 2]
            low_z, high_z = near_m.min(), max(near_m.max(), near_m.min() + 2 * MIN_HEIGHT_M)
            foot = max(low_z, high_z - 0.5 * radius) if opening > 0 else low_z
            found.append(np.array([*axis, radius, radius, foot, high_z]))
    return found


def _rims(low_m: Float[np.ndarray, "3"], high_m: Float[np.ndarray, "3"]) -> list[Float[np.ndarray, "6"]]:
    """Initial open bodies of whose rim the part is a half or a smaller fragment, see ``_CHORDS``."""
    middle, width_m = 0.5 * (low_m + high_m), float((high_m - low_m)[:2].max())
    found = []
    for radius, turn in product(width_m * np.array(_CHORDS), np.arange(TURNS) * 2 * np.pi / TURNS):
        axis = middle[:2] + radius * np.array([np.cos(turn), np.sin(turn)])
        found.append(np.array([*axis, radius, radius, high_m[2] - 0.5 * radius, high_m[2]]))
    return found


def covariance(
    outlines: Outlines, body: Float[np.ndarray, "n"], opening: float, window_px: float
) -> tuple[Float[np.ndarray, "k k"], float] | None:
    """Covariance of x, y, the common radius and a lean [m2], and the factor of its log-likelihood ratios.

    The covariance of a misspecified likelihood is larger than its inverse curvature; a likelihood ratio is multiplied by the inverse of the mean
    eigenvalue of their quotient (Pauli, Racugno and Ventura 2011).

    Parameters
    ----------
    outlines, body, opening
        See :meth:`Outlines.log_likelihood`; the body is at a maximum.
    window_px
        Matching window in the thinned images [px].

    Returns
    -------
    Covariance and factor; ``None`` where the likelihood has no maximum in one of them.
    """
    middle_m = np.array([body[0], body[1], 0.5 * (body[4] + body[5])])
    step_m = 0.5 * outlines.window_m(window_px, middle_m)
    x, y, low_r, high_r, low_z, high_z, *lean = step_m * np.eye(len(body))
    ways = [x, y, low_r + high_r, *lean, low_z + high_z]

    def each(step: np.ndarray) -> np.ndarray:
        return outlines.log_likelihood(body + step, opening)

    ahead, back = ([each(sign * way) for way in ways] for sign in (1, -1))
    here = each(0.0 * x)
    slopes = np.array([(a - b) / (2 * step_m) for a, b in zip(ahead, back, strict=True)])
    bends = [float((2 * here - a - b).sum()) for a, b in zip(ahead, back, strict=True)]
    curvature = np.diag(bends)
    for i, j in combinations(range(len(ways)), 2):
        # Over all four corners: of two, what is no parabola over half a window makes maxima of leaning bodies look like saddles.
        corners = sum(m * n * each(m * ways[i] + n * ways[j]) for m, n in product((-1, 1), repeat=2))
        curvature[i, j] = curvature[j, i] = -0.25 * float(np.sum(corners))
    curvature /= step_m**2
    known = len(ways) - 1
    for count in (len(ways), known):
        if np.linalg.eigvalsh(curvature[:count, :count])[0] > 0:
            inverse = np.linalg.inv(curvature[:count, :count])
            weights, slopes = outlines.weights, slopes[:count]
            independent = float(weights[slopes.any(axis=0)].sum())
            squares = (slopes / weights) @ slopes.T * independent / max(independent - count, 1.0)
            # Not below the covariance of the likelihood itself: a few views may agree by chance.
            found: np.ndarray = inverse @ squares @ inverse + inverse
            return found[:known, :known], count / float(np.trace(curvature[:count, :count] @ found))
    return None

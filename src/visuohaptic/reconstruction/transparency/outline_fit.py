"""Where a transparent part stands: an upright body by the likelihood of its outlines.

Voxels that only rays through glass pass reach away from the cameras and into what else the glass shades, so that their
middle is a centimetre off. The outline in every view is sharper: windows of readings inside it are those of glass, or show
nothing of it, as walls bend little in the middle and near to what is behind them; beside it they are those of the sequence.
A truncated cone with its axis along z is laid through the outlines of all views by maximum likelihood. The second eye of
the camera looks past the body, too: where its line of sight crosses it nothing is matched beside the outline, as far as the
disparities of the body and of what is behind it differ.

The deviation of the axis is that of a likelihood which is wrong in detail (Huber 1967; White 1982): H^-1 (sum of g g^T) H^-1
with H the curvature of the whole, g the slope of each view, over half of the camera's matching window: over less it is the
roughness of single readings. Views that share a direction err alike, so that g g^T of a view counts 1 / weight; the slopes at
the fit are smaller than at the truth by what was fitted, n / (n - k) (MacKinnon and White 1985). Seen from one side a body farther away is nearly one that stands higher, so that the height is
unknown with the axis, where the likelihood has a maximum in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import DepthNoise
from .background import intrinsics

__all__ = ["OutlineView", "UprightBody", "fit_bodies"]

#: Points of each of the two circles that bound a body.
_CORNERS = 16
#: Probability that a window inside the outline shows nothing of the glass.
_HIDDEN = 0.5
#: Fraction of the radius within which nothing is said of a body: of none, or of an open bowl, of which only rim and wall show.
_OPEN = (0.0, 0.7)
#: First steps of the search of places, radii and heights [m]; evaluations of a search; the size and the differences that end it.
_STEP_M, _MAX_STEPS, _NEAR_M, _ALIKE = 0.012, 400, 3e-4, 1e-2
#: Radii of bodies that are tried around strong voxels, in first steps: a search goes by half of one, and several times.
_RADII = (2, 3, 5)
#: Directions in which the middle of a bowl is sought from a piece of its rim, and how many of the likeliest bodies are searched
#: from, of each kind and apart from each other.
_TURNS, _SEARCHES = 8, 4
#: Smallest radius and height of a body [m].
_MIN_RADIUS_M, _MIN_HEIGHT_M = 0.01, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class OutlineView:
    """What each pixel of a view says for kinds of glass, thinned to independent readings."""

    evidence: Float32[
        np.ndarray, "kinds h w"
    ]  #: log-likelihood ratios per pixel, by how much of it shows [nat]
    limit_m: Float32[np.ndarray, "h w"]  #: depth up to which each ray is evidence [m]
    T_camera_world: Float[np.ndarray, "3 4"]
    matrix: tuple[float, float, float, float]  #: fx, fy, cx, cy of the thinned image [px]
    baseline_m: float  #: of the second eye along the rows
    window_px: float  #: matching window in the thinned image
    weight: float  #: part of an independent view

    @classmethod
    def of_view(
        cls,
        frame: DepthFrame,
        log_ratios: Sequence[Float32[np.ndarray, "h w"]],
        limit_m: Float32[np.ndarray, "h w"],
        noise: DepthNoise,
        weight: float,
        stride: int = 1,
    ) -> OutlineView:
        """Thin a view to a quarter of a window.

        Parameters
        ----------
        frame
            View.
        log_ratios
            Log-likelihood ratio of every reading (h, w), for each kind of glass [nat].
        limit_m
            Depth up to which each ray is evidence (h, w) [m]; not copied, so that what is explained later counts no more.
        noise
            Of the camera: where its second eye is, and the window whose readings count as one.
        weight
            Part of an independent view.
        stride
            Pixels of the camera from one pixel of the view to the next.
        """
        import cv2

        window_px = noise.window_px(frame.camera.focal_px, stride)
        step, width = max(1, int(window_px) // 4), round(window_px)
        ratio = np.mean(
            [cv2.exp(cv2.blur(part, (width, width))[::step, ::step]) for part in log_ratios], axis=0
        )
        evidence = np.log((1 - _HIDDEN) * ratio + _HIDDEN) * (step / window_px) ** 2
        fx, fy, cx, cy = (float(value) / step for value in intrinsics(frame.camera))
        motion = frame.T_world_camera.inverse().matrix[:3]
        thinned = evidence.astype(np.float32)
        matrix = (fx, fy, cx, cy)
        return cls(
            thinned, limit_m[::step, ::step], motion, matrix, noise.baseline_m, window_px / step, weight
        )


class _Outlines:
    """All views as the sums of their rows, of rays that end behind a place."""

    def __init__(self, views: Sequence[OutlineView], middle_m: Float[np.ndarray, "3"]) -> None:
        self.matrices = np.array([view.matrix for view in views])
        self._reach = np.array([view.matrix[0] * view.baseline_m for view in views])
        self._motions = np.array([view.T_camera_world for view in views])
        self.weights = np.array([view.weight for view in views])
        self._limits = np.stack([view.limit_m for view in views])
        away_m = self._motions[:, 2] @ np.append(middle_m, 1.0)
        told = np.where(self._limits > away_m[:, None, None], np.stack([view.evidence for view in views]), 0)
        sums = np.pad(np.cumsum(told, axis=2, dtype=np.float64), ((0, 0), (0, 0), (1, 0)))
        self._told = (_CORNERS, sums, self._limits, self._motions, self.matrices, self._reach, self.weights)

    def cost(self, body: Float[np.ndarray, "6"], opening: float, bounds_m: Float[np.ndarray, "3"]) -> float:
        """Negative log-likelihood of a body against nothing; 1000 where it is none [nat].

        Parameters
        ----------
        body, opening
            As of :meth:`log_likelihood`.
        bounds_m
            Least radius and height, largest radius [m].
        """
        from ._outline_kernels import outline_cost

        return float(outline_cost(body, opening, bounds_m, *self._told, np.empty(len(self.weights))))

    def search(
        self, start: Float[np.ndarray, "6"], opening: float, bounds_m: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "6"]:
        """The likeliest body, from another one on; see :meth:`cost`."""
        from ._outline_kernels import search_outline

        simplex = np.vstack([start, start + _STEP_M * np.diag([1, 1, 0.5, 0.5, -1, -1])])
        search_outline(simplex, _MAX_STEPS, _NEAR_M, _ALIKE, opening, bounds_m, *self._told)
        best: Float[np.ndarray, "6"] = simplex[0]
        return best

    def log_likelihood(self, body: Float[np.ndarray, "6"], opening: float) -> Float[np.ndarray, "views"]:
        """Of a body against nothing, of each view [nat].

        Parameters
        ----------
        body
            x, y of the axis, lower and upper radius, lower and upper height [m].
        opening
            Fraction of the radius within which nothing is said.
        """
        from ._outline_kernels import outline_ratios

        found = np.empty(len(self.weights))
        outline_ratios(body, opening, *self._told, found)
        return found

    def window_m(self, window_px: float, middle_m: Float[np.ndarray, "3"]) -> float:
        """Width of a window at a place, in the median of the views [m]."""
        return float(
            np.median(window_px * (self._motions[:, 2] @ np.append(middle_m, 1.0)) / self.matrices[:, 0])
        )


@dataclass(frozen=True, slots=True, eq=False)
class UprightBody:
    """An upright truncated cone, and how well the place of its axis is known."""

    axis_m: Float[np.ndarray, "2"]  #: x, y of its axis [m]
    axis_sigma_m: Float[np.ndarray, "2"]  #: their standard deviations [m]
    radius_m: tuple[float, float]  #: lower and upper [m]
    radius_sigma_m: float  #: standard deviation of both together [m]
    height_m: tuple[float, float]  #: z of its lower and upper end [m]
    evidence: float  #: log-likelihood ratio against nothing [nat]

    def meets(self, other: UprightBody) -> bool:
        """Whether two bodies are in each other, by the means of their radii: solids are not.

        Parameters
        ----------
        other
            The other body.
        """
        apart_m = float(np.hypot(*(self.axis_m - other.axis_m)))
        return apart_m < 0.5 * (sum(self.radius_m) + sum(other.radius_m))

    def points_m(self, voxel_m: float) -> Float[np.ndarray, "n 3"]:
        """Points inside it, a voxel apart (n, 3) [m].

        Parameters
        ----------
        voxel_m
            Distance of the points along each axis [m].
        """
        reach = max(self.radius_m)
        side = np.arange(-reach, reach + voxel_m, voxel_m)
        x, y, z = np.meshgrid(
            self.axis_m[0] + side, self.axis_m[1] + side, np.arange(*self.height_m, voxel_m), indexing="ij"
        )
        found: Float[np.ndarray, "n 3"] = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
        return found[self.contains(found)]

    def contains(self, points_m: Float[np.ndarray, "n 3"], margin_m: float = 0.0) -> Bool[np.ndarray, "n"]:
        """Whether points are in it.

        Parameters
        ----------
        points_m
            Points (n, 3) [m].
        margin_m
            Growth of its radii and of its height at both ends [m].
        """
        z_m, (low_m, high_m) = points_m[:, 2], self.height_m
        away_m = np.hypot(*(points_m[:, :2] - self.axis_m).T)
        inside: Bool[np.ndarray, "n"] = away_m <= np.interp(z_m, self.height_m, self.radius_m) + margin_m
        return inside & (z_m >= low_m - margin_m) & (z_m <= high_m + margin_m)


def fit_bodies(
    views: Sequence[OutlineView], points_m: Float[np.ndarray, "n 3"], evidence: Float[np.ndarray, "n"]
) -> list[UprightBody]:
    """Upright bodies where a part was found, likeliest first: maxima of the likelihood, of which several may share the part.

    Parameters
    ----------
    views
        All views.
    points_m
        Centres (n, 3) of the voxels of the part [m].
    evidence
        Of each voxel (n) [nat].
    """
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    # A part is a sixth of a rim at least: wider bodies swallow what stands around.
    widest_m = max(float((high_m - low_m)[:2].max()), 4 * _MIN_RADIUS_M)
    bounds_m = np.array([_MIN_RADIUS_M, _MIN_HEIGHT_M, widest_m])
    outlines = _Outlines(views, points_m[evidence.argmax()])
    strong_m = points_m[evidence > 0.5 * evidence.max()]
    starts = [(start, opening) for opening in _OPEN for start in _starts(strong_m, opening)]
    starts += [(start, _OPEN[1]) for start in _rims(low_m, high_m)]
    bodies: list[UprightBody] = []
    ends: list[tuple[np.ndarray, float]] = []
    for start, opening in _apart(sorted(starts, key=lambda one: outlines.cost(one[0], one[1], bounds_m))):
        # Rays end before what is farther than the strongest voxel.
        outlines = _Outlines(views, np.array([*start[:2], 0.5 * (start[4] + start[5])]))
        best = outlines.search(start, opening, bounds_m)
        # Two ends nearer than half of the narrowest body are beside one maximum.
        if any(kind == opening and np.hypot(*(best - end)[:2]) < 0.5 * _MIN_RADIUS_M for end, kind in ends):
            continue
        # A simplex that has collapsed beside the maximum finds it from where it is.
        best = outlines.search(best, opening, bounds_m)
        ends.append((best, opening))
        covariance = _covariance(outlines, best, opening, views[0].window_px)
        if (least := outlines.cost(best, opening, bounds_m)) < 0 and covariance is not None:
            sigma = np.sqrt(np.diag(covariance))
            x, y, low_r, high_r, low_z, high_z = (float(value) for value in best)
            place = np.array([x, y]), sigma[:2]
            bodies.append(UprightBody(*place, (low_r, high_r), float(sigma[2]), (low_z, high_z), -least))
    return sorted(bodies, key=lambda body: -body.evidence)


def _apart(starts: Sequence[tuple[np.ndarray, float]]) -> list[tuple[np.ndarray, float]]:
    """The first of each kind whose axes are not in each other."""
    chosen: list[tuple[np.ndarray, float]] = []
    for start, opening in starts:
        alike = [other for other, kind in chosen if kind == opening]
        near = (np.hypot(*(start - other)[:2]) < max(start[3], other[3]) for other in alike)
        if len(alike) < _SEARCHES and not any(near):
            chosen.append((start, opening))
    return chosen


def _starts(strong_m: Float[np.ndarray, "n 3"], opening: float) -> list[Float[np.ndarray, "6"]]:
    """Bodies around the strong voxels of a part, as high as these are there."""
    found = []
    cell_m = 2 * _STEP_M
    for axis in cell_m * np.unique(np.round(strong_m[:, :2] / cell_m), axis=0):
        away_m = np.hypot(*(strong_m[:, :2] - axis).T)
        for radius in _STEP_M * np.array(_RADII):
            near_m = strong_m[away_m < radius, 2]
            low_z, high_z = near_m.min(), max(near_m.max(), near_m.min() + 2 * _MIN_HEIGHT_M)
            foot = max(low_z, high_z - 0.5 * radius) if opening > 0 else low_z
            found.append(np.array([*axis, radius, radius, foot, high_z]))
    return found


def _rims(low_m: Float[np.ndarray, "3"], high_m: Float[np.ndarray, "3"]) -> list[Float[np.ndarray, "6"]]:
    """Open bodies of which a part is a piece of the rim: half of it, or a quarter."""
    middle, width_m = 0.5 * (low_m + high_m), float((high_m - low_m)[:2].max())
    found = []
    for radius, turn in product((0.5 * width_m, 0.75 * width_m), np.arange(_TURNS) * 2 * np.pi / _TURNS):
        axis = middle[:2] + radius * np.array([np.cos(turn), np.sin(turn)])
        found.append(np.array([*axis, radius, radius, high_m[2] - 0.5 * radius, high_m[2]]))
    return found


def _covariance(
    outlines: _Outlines, body: Float[np.ndarray, "6"], opening: float, window_px: float
) -> Float[np.ndarray, "3 3"] | None:
    """Of x, y and both radii together [m2]; ``None`` where the likelihood has no maximum in one of them."""
    middle_m = np.array([body[0], body[1], 0.5 * (body[4] + body[5])])
    step_m = 0.5 * outlines.window_m(window_px, middle_m)
    ways = step_m * np.array([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 1, 0, 0], [0, 0, 0, 0, 1, 1]])

    def each(step: np.ndarray) -> np.ndarray:
        return outlines.log_likelihood(body + step, opening)

    ahead, back = ([each(sign * way) for way in ways] for sign in (1, -1))
    here = each(np.zeros(6))
    slopes = np.array([(a - b) / (2 * step_m) for a, b in zip(ahead, back, strict=True)])
    bends = [float((2 * here - a - b).sum()) for a, b in zip(ahead, back, strict=True)]
    curvature = np.diag(bends)
    for i, j in combinations(range(len(ways)), 2):
        both = float((2 * here - each(ways[i] + ways[j]) - each(-ways[i] - ways[j])).sum())
        curvature[i, j] = curvature[j, i] = 0.5 * (both - bends[i] - bends[j])
    curvature /= step_m**2
    for count in (4, 3):
        if np.linalg.eigvalsh(curvature[:count, :count])[0] > 0:
            inverse = np.linalg.inv(curvature[:count, :count])
            weights, slopes = outlines.weights, slopes[:count]
            independent = float(weights[slopes.any(axis=0)].sum())
            squares = (slopes / weights) @ slopes.T * independent / max(independent - count, 1.0)
            # No better than the likelihood itself says: a few views may agree by chance.
            found: np.ndarray = inverse @ squares @ inverse + inverse
            return found[:3, :3]
    return None

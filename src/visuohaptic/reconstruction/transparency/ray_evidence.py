"""Evidence of the rays of all views in a volume: of what the camera reads, and of the scores of a network of the user's own.

The reliability of the scores (:mod:`visuohaptic.io.depth.pixel_model`) is learned from the geometry of the sequence.

A score s is the mean over a window of the size of the smallest object, in levels whose upper tails halve. Its rates are

- P(s | nothing transparent) the rates of all windows, without those through glass;
- P(s | glass) the rates of the windows through what is glass by the readings of depth, each window with the probability of that,
  each view one observation; before any, all levels are equally probable.

S, the sum of the log-likelihood ratios over independent views, is not the evidence: a network that takes an opaque object for glass
does so in every view, and one that overlooks a glass does so in every view. The evidence of the scores for a place is

    log [((1 - d) exp S + d) / ((1 - e) + e exp S)]

with d = 1/2 the probability that a glass is overlooked (uniform prior), and e the smallest fraction of places at which scores may look like
glass for any cause, such that the mean of the ratio over all places of the scene is at most one: then the probability that readings and
scores together exceed log(N / a) at a place remains at most a / N (Markov's inequality; the errors of the readings at opaque places
do not depend on the scores), however many objects fool the network, and however alike the views. At least it is log d: scores
never reject what the readings show.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...core import Pose
from ...io.depth.depth_sequence import DepthFrame
from ..fusion._fusion_view import over_tiles
from ..fusion.volume import SpaceGrid
from .view_geometry import back_motions, intrinsics

#: Minimum fraction of windows that look like glass, for causes outside the model, and iterations of its estimate.
LOOK_ALIKE, _ROUNDS = 0.05, 12
#: Probability that a view through glass shows no effect of it.
HIDDEN = 0.1
#: Fraction of the rays beside the axis of glass that still pass it; see :mod:`.evidence`.
_BESIDE = 0.85
#: Probability that a model overlooks a glass in all views: uniform prior.
_OVERLOOKED = 0.5
#: Maximum absolute sum of log-likelihood ratios; beyond it the evidence is at its bounds [nat].
_LARGEST = 50.0


@dataclass(frozen=True, slots=True, eq=False)
class RayEvidence:
    """Evidence of the rays of all views."""

    frames: Sequence[DepthFrame]  #: views of one camera
    weights: Float32[np.ndarray, "n"]  #: weight of each view, in independent views
    limit_m: Float32[np.ndarray, "n h w"]  #: depth up to which each ray is evidence; 0: no evidence [m]
    on_ray: Float32[np.ndarray, "n h w"]  #: evidence for glass on the ray [nat]
    at_voxel: Float32[np.ndarray, "n h w"]  #: evidence for glass here rather than beside [nat]
    scores: ScoreEvidence | None = None  #: further evidence, of a network

    @classmethod
    def of_ratios(
        cls,
        frames: Sequence[DepthFrame],
        weights: Float32[np.ndarray, "n"],
        limit_m: Float32[np.ndarray, "n h w"],
        ratios: Float32[np.ndarray, "n h w"],
        look_alike: float,
    ) -> RayEvidence:
        """Compute the evidence from likelihood ratios of windows.

        Parameters
        ----------
        frames
            Views of one camera.
        weights
            Weight of each view, in independent views (n).
        limit_m
            Depth up to which each ray is evidence (n, h, w) [m]; not copied.
        ratios
            Likelihood ratio of the window around every pixel (n, h, w).
        look_alike
            Fraction of all windows that look like glass.
        """
        return cls(frames, weights, limit_m, _log_ratio(ratios, look_alike), _log_ratio(ratios, _BESIDE))

    def sums(
        self, grid: SpaceGrid
    ) -> tuple[Float32[np.ndarray, "x y z"], Float32[np.ndarray, "x y z"], Float32[np.ndarray, "a b c"]]:
        """Both kinds of evidence of every voxel, the first with that of the scores [nat], and the weight of the views with evidence for each block of voxels.

        Where neither kind can be positive, both are upper bounds.

        Parameters
        ----------
        grid
            Grid of the volume.
        """
        from ._evidence_kernels import EDGE, sum_evidence

        rays = self.limit_m, self.on_ray, self.at_voxel
        told = [np.where(self.limit_m > 0, each, np.float32(-np.inf)) for each in rays[1:]]
        bounds = [over_tiles(np.minimum, self.limit_m, EDGE)]
        bounds += [over_tiles(np.maximum, each, EDGE) for each in (self.limit_m, *told)]
        views = back_motions(Pose.identity(), [frame.T_world_camera for frame in self.frames])
        camera = intrinsics(self.frames[0].camera) if self.frames else np.zeros(4, np.float32)
        blocks = tuple(-(-size // EDGE) for size in grid.shape)
        sums = [np.empty(shape, np.float32) for shape in (grid.shape, grid.shape, blocks)]
        place = grid.low_m.astype(np.float32), np.float32(grid.voxel_m)
        sum_evidence(*rays, self.weights, views, *camera, *bounds, *place, *sums)
        return (sums[0] + self.scores.sums(grid) if self.scores else sums[0]), sums[1], sums[2]

    def scored(self, points_m: Float[np.ndarray, "n 3"]) -> float:
        """Evidence of the scores for a body, 0 without scores [nat].

        Parameters
        ----------
        points_m
            Points (n, 3) inside the body [m].
        """
        return self.scores.of_body(points_m) if self.scores else 0.0

    def passed(
        self, number: int, points_m: Float[np.ndarray, "n 3"], voxel_m: float
    ) -> Bool[np.ndarray, "h w"]:
        """Mask of the rays of a view that pass through voxels.

        Parameters
        ----------
        number
            Index of the view.
        points_m
            Centres (n, 3) of voxels in the world [m].
        voxel_m
            Edge of the voxels [m].
        """
        import cv2

        camera = self.frames[number].camera
        local = self.frames[number].T_world_camera.inverse().apply(points_m)
        local = local[local[:, 2] > 0.05]
        found = np.zeros(self.limit_m.shape[1:], np.uint8)
        fx, fy, cx, cy = intrinsics(camera)
        u = np.rint(fx * local[:, 0] / local[:, 2] + cx).astype(int)
        v = np.rint(fy * local[:, 1] / local[:, 2] + cy).astype(int)
        held = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        found[v[held], u[held]] = 1
        reach = int(np.ceil(camera.focal_px * voxel_m / float(local[:, 2].min(initial=np.inf)))) + 1
        return cv2.dilate(found, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0

    def through(self, points_m: Float[np.ndarray, "n 3"], voxel_m: float) -> Bool[np.ndarray, "n h w"]:
        """Masks of the rays of all views that pass through voxels.

        Parameters
        ----------
        points_m, voxel_m
            See :meth:`passed`.
        """
        found = [self.passed(k, points_m, voxel_m) for k in range(len(self.limit_m))]
        return np.array(found, dtype=bool).reshape(self.limit_m.shape)

    def bounded(self, each: Float[np.ndarray, "n"], look_alike: float) -> float:
        """Evidence of all views for a body, that of each bounded as for a voxel: no single view is decisive [nat].

        Parameters
        ----------
        each
            Log-likelihood ratio of the body in every view (n) [nat].
        look_alike
            Fraction of all windows that look like glass.
        """
        ratio = np.exp(np.minimum(each / self.weights, 30.0)).astype(np.float32)
        return float(self.weights @ _log_ratio(ratio[:, None, None], look_alike).ravel())


@dataclass(frozen=True, slots=True, eq=False)
class ScoreEvidence:
    """Evidence of the scores of all views."""

    rays: RayEvidence  #: views, with the log-likelihood ratio of the score of each window
    fraction: float  #: fraction of places at which the scores may look like glass for any cause

    @classmethod
    def learned(
        cls,
        scores: Sequence[Float32[np.ndarray, "h w"]],
        object_px: Sequence[int],
        rays: RayEvidence,
        read: Bool[np.ndarray, "n h w"],
        excess: Float32[np.ndarray, "x y z"],
        grid: SpaceGrid,
        object_m: float,
    ) -> ScoreEvidence:
        """Learn the rates of the scores with and without glass.

        Parameters
        ----------
        scores
            Score of every pixel of each view; NaN: none.
        object_px
            Edge of the window of the smallest object in each view [px].
        rays
            Evidence of the readings of the same views; not copied.
        read
            Rays from which the rates are learned, with those through accepted parts.
        excess
            Evidence of every voxel by the readings, 0 where glass is as probable as none [nat].
        grid
            Grid of the volume.
        object_m
            Size of the smallest object [m].
        """
        glass = _glass_probability(rays, excess, grid)
        glass[read & (rays.limit_m == 0)] = 1.0
        size = np.maximum(np.rint((grid.high_m - grid.low_m) / object_m), 1).astype(int).tolist()
        places = SpaceGrid(grid.low_m, (size[0], size[1], size[2]), object_m)
        windows = np.stack([_window_mean(*of_view) for of_view in zip(scores, object_px, strict=True)])
        known = np.isfinite(windows) & read
        ratio = np.zeros_like(windows)
        area = float(np.mean(object_px)) ** 2
        if np.count_nonzero(known) > area:
            level, count = _levels(windows, known, area)
            without = np.full(count, 1 / count)
            without += np.bincount(level[known], weights=1 - glass[known], minlength=count) / area
            with_glass = np.full(count, 1 / count)
            for here, seen, p, weight in zip(level, known, glass, rays.weights, strict=True):
                if (total := float(p[seen].sum())) > 0:
                    rates = np.bincount(here[seen], weights=p[seen], minlength=count) / total
                    with_glass += float(weight) * float(p[seen].max()) * rates
            table = np.log(with_glass / with_glass.sum()) - np.log(without / without.sum())
            ratio[known] = table[level[known]]
        found = cls(replace(rays, on_ray=ratio, at_voxel=ratio), 1.0)
        sums = found.rays.sums(places)[0]
        return replace(found, fraction=_fair_fraction(sums[sums != 0].astype(np.float64)))

    def sums(self, grid: SpaceGrid) -> Float32[np.ndarray, "x y z"]:
        """Evidence of every voxel [nat].

        Parameters
        ----------
        grid
            Grid of the volume.
        """
        return self._bounded(self.rays.sums(grid)[0])

    def of_body(self, points_m: Float[np.ndarray, "n 3"]) -> float:
        """Evidence for glass in a body: the mean of its points in each view [nat].

        Parameters
        ----------
        points_m
            Points (n, 3) inside the body [m].
        """
        total = 0.0
        for k, weight in enumerate(self.rays.weights):
            inside = self.rays.passed(k, points_m, 0.0) & (self.rays.limit_m[k] > 0)
            total += float(weight) * float(self.rays.on_ray[k][inside].mean()) if inside.any() else 0.0
        return float(self._bounded(np.array([total], np.float32))[0])

    def _bounded(self, sums: Float32[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n"]:
        return np.asarray(np.log(_ratio(sums, self.fraction)), np.float32)


def _log_ratio(ratio: Float32[np.ndarray, "n h w"], elsewhere: float) -> Float32[np.ndarray, "n h w"]:
    """Evidence of windows for glass here, with the probability ``elsewhere`` of glass elsewhere [nat]."""
    import cv2

    found = np.empty_like(ratio)
    # One view after the other: the arrays of one stay in the cache.
    for view, evidence in zip(ratio, found, strict=True):
        cv2.log(((1 - HIDDEN) * view + HIDDEN) / ((1 - elsewhere) + elsewhere * view), evidence)
    return found


def look_alike_fraction(ratios: Float[np.ndarray, "n"], least: float = LOOK_ALIKE) -> float:
    """Fraction of windows or places that look like glass, by maximum likelihood (EM).

    Parameters
    ----------
    ratios
        Likelihood ratio of glass for each of them.
    least
        Minimum fraction.
    """
    fraction = LOOK_ALIKE
    for _ in range(_ROUNDS if len(ratios) else 0):
        fraction = float(np.mean(fraction * ratios / ((1 - fraction) + fraction * ratios)))
    return max(fraction, least)


def _glass_probability(
    rays: RayEvidence, excess: Float32[np.ndarray, "x y z"], grid: SpaceGrid
) -> Float32[np.ndarray, "n h w"]:
    """Probability that the ray of a pixel passes glass: that of the most probable voxel on it."""
    from scipy.special import expit

    found = np.zeros_like(rays.limit_m)
    # From the least to the most probable, in steps of one nat; below one in a thousand a voxel is not counted.
    for nats in range(-7, 8):
        last = math.inf if nats == 7 else nats + 1
        cells = np.argwhere((excess >= nats) & (excess < last))
        for k in range(len(found)) if len(cells) else ():
            found[k][rays.passed(k, grid.centres_m(cells), grid.voxel_m)] = expit(nats + 0.5)
    return found


def _window_mean(score: Float32[np.ndarray, "h w"], edge_px: int) -> Float32[np.ndarray, "h w"]:
    """Mean of the known scores in the window around every pixel; NaN if fewer than half are known."""
    import cv2

    known = np.isfinite(score)
    size, border = (edge_px, edge_px), cv2.BORDER_REFLECT_101
    share = cv2.boxFilter(known.astype(np.float32), -1, size, borderType=border)
    mean = cv2.boxFilter(np.where(known, score, np.float32(0)), -1, size, borderType=border)
    return np.where(share >= 0.5, mean / np.maximum(share, np.float32(0.5)), np.float32(np.nan))


def _levels(windows: Float32[np.ndarray, "n h w"], known: np.ndarray, area: float) -> tuple[np.ndarray, int]:
    """Level of every window, and their number: upper tails that halve, down to one independent window."""
    values = windows[known]
    halvings = int(math.log2(max(len(values) / area, 2.0)))
    limits = np.unique(np.quantile(values, 1 - 0.5 ** np.arange(1, halvings + 1)))
    limits = limits[limits < values.max()]
    return np.searchsorted(limits, windows), len(limits) + 1


def _ratio(sums: Float[np.ndarray, "*n"], fraction: float) -> Float[np.ndarray, "*n"]:
    """Ratio of the probabilities of the scores at a place with glass and at an arbitrary one, from S [nat]."""
    ratio = np.exp(np.clip(sums, -_LARGEST, _LARGEST))
    return ((1 - _OVERLOOKED) * ratio + _OVERLOOKED) / ((1 - fraction) + fraction * ratio)


def _fair_fraction(sums: Float[np.ndarray, "n"]) -> float:
    """Smallest fraction, at least one place, at which the mean ratio of all places is at most one."""
    # Steps of 5 %; at 1 - d the ratio is one everywhere, and the scores show nothing.
    fraction = 1 / max(len(sums), 2)
    while fraction < 1 - _OVERLOOKED and _ratio(sums, fraction).mean() > 1:
        fraction *= 1.05
    return min(fraction, 1 - _OVERLOOKED)

"""Prediction of hidden surface from a discrete symmetry: a half turn about an upright axis, or an upright mirror plane.

Boxes, cans and bottles have a twofold rotational symmetry, most household objects a mirror symmetry in some upright
plane (Bohg et al. 2011, "Mind the gap"). The pose of the axis or plane, and the deviation from exact symmetry, are
inferred with a mixture likelihood: a surface point mapped by the symmetry lies on the surface again up to that deviation, or
it has no counterpart and is uniformly distributed in the region. Mapped points in unobserved space are uninformative.
Contacts and visible surface points have the same likelihood. The null hypothesis is no symmetry: all points are uniform.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from .hole import SupportBand
from .hole_region import HoleRegion
from .rbf_centres import Centres
from .symmetry import MAX_WALL_NZ

#: Steps of the grid of each symmetry on both sides of the middle, along both of its parameters.
_STEPS = 10
#: Cells of lower probability, relative to the likeliest, are not divided further.
_UNLIKELY = 1e-3
#: Deviations from exact symmetry that are compared, in sizes of the region; uniform prior.
_DEVIATIONS = np.geomspace(0.002, 0.1, 7)
#: Prior odds of each symmetry: 12 of 15 scanned household objects have both (rule of succession).
_ODDS = 13 / 4
#: Probability that a point has no counterpart.
_ALONE = 0.1
#: Minimum distance between the points of the likelihood, in sizes of the region: nearer points have correlated errors.
_APART = 0.15
#: Distance between the points that are mapped to the hidden side, in sizes of the region.
_STEP = 0.06
#: Central fraction of the missing heights in which a wall has to be visible.
_SAME = 0.6
#: Mapped points farther than this from the visible surface count as beside it, in sizes of the region.
_FAR = 0.2
#: Standard deviation of the normals of a fused surface [rad].
_ROUGH_RAD = 0.15
#: Points with a larger standard deviation are not used, in sizes of the region.
_USELESS = 0.1


class DiscreteSymmetry:
    """Prediction of the hidden side from the visible one.

    Parameters
    ----------
    band
        Known points around the hole.
    region
        Where the surface is missing.
    outer
        Convex hull of the visible surface and the missing region.
    """

    def __init__(self, band: SupportBand, region: HoleRegion, outer: HoleRegion) -> None:
        from scipy.spatial import cKDTree

        self.band, self.region, self.outer = band, region, outer
        size_m, z_m = region.size_m, band.samples_m[:, 2]
        # Points near the foot may belong to the table; horizontal surfaces are invariant under every such map.
        above = (z_m > outer.hull_m[:, 2].min() + 0.02 * size_m) & outer.within(band.samples_m, self.spread_m)
        self._seen = even_subset(band.samples_m, np.flatnonzero(above), _STEP * size_m)
        walls = self._seen[np.abs(band.sample_normals[self._seen, 2]) < MAX_WALL_NZ]
        low_m, high_m = region.hull_m[:, 2].min(), region.hull_m[:, 2].max()
        level = np.abs(z_m[walls] - 0.5 * (low_m + high_m)) < 0.5 * _SAME * (high_m - low_m)
        self._tests = even_subset(band.samples_m, walls, _APART * size_m)[: None if level.any() else 0]
        self._side = cKDTree(np.hstack([band.samples_m, _APART * size_m * band.sample_normals]))

    @property
    def spread_m(self) -> float:
        """Standard deviation of the sides of the hull [m]: the region is approximate, too small by up to the gap."""
        return self.band.gap_m + 0.05 * self.region.size_m

    @property
    def possible(self) -> bool:
        """Whether a wall is visible at the missing heights; without one no symmetry can be inferred."""
        return len(self._tests) > 0

    def put(self, contacts_m: Sequence[tuple[Float[np.ndarray, "3"], float]], into: Centres) -> None:
        """Append points of the hidden surface with their standard deviations; none without a symmetry.

        Parameters
        ----------
        contacts_m
            Contacts (3) and their standard deviations [m].
        into
            Centres to append to.
        """
        touched_m = np.array([[*contact, sigma] for contact, sigma in contacts_m]).reshape(-1, 4)
        # Both symmetries may hold: they are independent hypotheses.
        for kind in ("half turn", "mirror"):
            evidence, maps, modes, variance = self._posterior(kind, touched_m)
            # All points of a symmetry hold or none: an improbable one has no part in them.
            held = 1 / (1 + np.exp(-evidence) / _ODDS)
            for weights in modes if held > 0.5 else ():
                self._put(maps, weights, variance, held * weights.sum(), into)

    def _posterior(
        self, kind: str, touched_m: Float[np.ndarray, "n 4"]
    ) -> tuple[float, tuple[np.ndarray, np.ndarray], list[np.ndarray], float]:
        """Log Bayes factor against no symmetry, maps with their probabilities by mode, variance of the symmetry [m2].

        Contacts are given with their standard deviations. Likely cells of the grid are divided until they are finer than the
        smallest deviation: a cell of the first grid holds the axis millimetres from where exact contacts have it. The factor is that
        of the first grid: to a fraction of a millimetre, some parts of any smooth body agree under some map.
        """
        box = self.outer.hull_m.min(axis=0)[:2], self.outer.hull_m.max(axis=0)[:2]
        middle, spread, size_m = 0.5 * (box[0] + box[1]), self.spread_m, self.region.size_m
        turns = kind == "half turn"
        # The directions of mirror planes are a circle: half of a step remains on both sides.
        step = np.array([3.0 / _STEPS if turns else np.pi / (2 * _STEPS + 1) / spread, 3.0 / _STEPS])
        ways = np.mgrid[-_STEPS : _STEPS + 1, -_STEPS : _STEPS + 1].reshape(2, -1).T
        cells, total, evidence = ways * step, 0.0, 0.0
        tests_m, normals = self.band.samples_m[self._tests], self.band.sample_normals[self._tests]
        while True:
            maps = _maps(kind, cells[:, 0], cells[:, 1], middle, spread)
            # Rounding to the cell moves a point by up to one step either way, uniformly distributed.
            arm = 1.0 if turns else 0.35 * size_m
            rounded_m = float(np.hypot(arm * step[0], step[1])) * spread * 2 / np.sqrt(12)
            sigma_m = np.hypot(_DEVIATIONS * size_m, rounded_m)
            prior = -0.5 * (cells[:, 1] ** 2 + (cells[:, 0] ** 2 if turns else 0.0))
            total = total or float(np.log(np.exp(prior).sum() * len(_DEVIATIONS)))
            joint = self._likelihood(maps, tests_m, sigma_m, normals) + (prior - total)[:, None]
            joint += self._likelihood(maps, touched_m[:, :3], np.hypot(sigma_m, touched_m[:, 3:]))
            best = float(joint.max())
            each = np.exp(joint - best)
            evidence = evidence or best + float(np.log(each.sum()))
            weights = each.sum(axis=1) / each.sum()
            likely = weights > _UNLIKELY * weights.max()
            # A posterior of more cells is wider than one of them.
            if rounded_m < _DEVIATIONS[0] * size_m or likely.sum() > len(ways) / 9:
                break
            step = step / 3
            cells = (cells[likely][:, None] + np.mgrid[-1:2, -1:2].reshape(2, -1).T * step).reshape(-1, 2)
            total += float(np.log(9))
        variance = float(each.sum(axis=0) @ sigma_m**2 / each.sum())
        parts = _modes(cells / step, likely, None if turns else np.pi / spread / step[0])
        modes = [np.where(part, weights, 0.0) for part in parts]
        return evidence, maps, modes, variance

    def _likelihood(
        self,
        maps: tuple[np.ndarray, np.ndarray],
        points_m: Float[np.ndarray, "n 3"],
        sigma_m: Float[np.ndarray, "#n s"] | Float[np.ndarray, "s"],
        normals: Float[np.ndarray, "n 3"] | None = None,
    ) -> Float[np.ndarray, "h s"]:
        """Log-likelihood ratio of each map and deviation against no symmetry; contacts have no normals."""
        turned = np.einsum("hij,nj->hni", maps[0], points_m[:, :2]) + maps[1][:, None]
        moved = np.concatenate(
            [turned, np.broadcast_to(points_m[:, 2:], (*turned.shape[:2], 1))], axis=2
        ).reshape(-1, 3)
        # Match to the nearest point with a similar normal: both faces of an edge are near. Unmatched points are beside.
        places, tree, turned_normals = moved, self.band.tree, None
        if normals is not None:
            flat = np.einsum("hij,nj->hni", maps[0], normals[:, :2])
            level = np.broadcast_to(normals[:, 2:], (*flat.shape[:2], 1))
            turned_normals = np.concatenate([flat, level], axis=2).reshape(-1, 3)
            places = np.hstack([moved, _APART * self.region.size_m * turned_normals])
            tree = self._side
        near = tree.query(places, eps=0.1, distance_upper_bound=_FAR * self.region.size_m)[1]
        far = near == len(self.band.samples_m)
        near[far] = 0
        angle = np.zeros(len(moved))
        if turned_normals is not None:
            angle = np.arccos(np.clip((turned_normals * self.band.sample_normals[near]).sum(axis=1), -1, 1))
        way = moved - self.band.samples_m[near]
        plane = np.abs((way * self.band.sample_normals[near]).sum(axis=1))
        beside = far | (np.sqrt(np.maximum((way**2).sum(axis=1) - plane**2, 0.0)) > self.band.spacing_m)
        if sigma_m.ndim == 2:
            sigma_m = np.tile(sigma_m, (len(turned), 1))
        density = np.exp(-0.5 * (plane[:, None] / sigma_m) ** 2 - 0.5 * (angle[:, None] / _ROUGH_RAD) ** 2)
        density /= np.sqrt(2 * np.pi) * sigma_m
        ratio = (1 - _ALONE) * density * self.region.size_m + _ALONE
        # Unobserved space is uninformative inside the hull of the object; outside the hull there is no surface.
        outside_m = np.maximum(self.outer.distance_m(moved[beside]), 0.0)
        ratio[beside] = ((1 - _ALONE) * np.exp(-0.5 * (outside_m / self.spread_m) ** 2) + _ALONE)[:, None]
        found: np.ndarray = np.log(ratio).reshape(len(turned), -1, sigma_m.shape[-1]).sum(axis=1)
        return found

    def _put(
        self,
        maps: tuple[np.ndarray, np.ndarray],
        weights: np.ndarray,
        variance: float,
        held: float,
        into: Centres,
    ) -> None:
        """Append the visible points mapped by the likely maps, where nothing is visible."""
        likely = np.flatnonzero(weights > _UNLIKELY * weights.max())
        fraction = weights[likely] / weights[likely].sum()
        points_m = self.band.samples_m[self._seen]
        turned = np.einsum("hij,nj->hni", maps[0][likely], points_m[:, :2]) + maps[1][likely][:, None]
        mean = np.einsum("h,hni->ni", fraction, turned)
        top = maps[0][likely[int(fraction.argmax())]]
        normals = self.band.sample_normals[self._seen, :2] @ top.T
        across = ((turned - mean) * normals).sum(axis=2) ** 2
        sigma_m = np.sqrt((variance + fraction @ across) / max(held, 1e-12))
        points = np.column_stack([mean, points_m[:, 2]])
        used = (
            (sigma_m < _USELESS * self.region.size_m)
            & self.band.away(points)
            & self.outer.within(points, sigma_m.min())
        )
        for k in np.flatnonzero(used):
            into.put(points[k], 0.0, float(sigma_m[k]))


def even_subset(
    points_m: Float[np.ndarray, "n 3"], chosen: Int[np.ndarray, "k"], apart_m: float
) -> Int[np.ndarray, "m"]:
    """Greedy subset of the chosen points with a minimum distance from each other, in the given order.

    Parameters
    ----------
    points_m
        Points (n, 3) [m].
    chosen
        Indices (k) of the candidates.
    apart_m
        Minimum distance [m].
    """
    from scipy.spatial import cKDTree

    left = np.ones(len(chosen), dtype=bool)
    tree = cKDTree(points_m[chosen])
    kept = []
    for k in range(len(chosen)):
        if left[k]:
            kept.append(chosen[k])
            left[tree.query_ball_point(points_m[chosen[k]], apart_m)] = False
    return np.array(kept, dtype=np.int64)


def _modes(
    cells: Float[np.ndarray, "h 2"], likely: Bool[np.ndarray, "h"], around: float | None
) -> list[Bool[np.ndarray, "h"]]:
    """Likely cells, in steps, that touch each other: several symmetries of one kind may hold.

    ``around`` is the number of steps after which a plane is the same again, with the opposite offset.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    rows = np.flatnonzero(likely)
    here = cells[rows]
    tree, same = cKDTree(here), [here] if around is None else [here, [around, 0.0] + here * [1.0, -1.0]]
    near = [tree.query_ball_point(places, 1.5) for places in same]
    pairs = np.array([(k, other) for found in near for k in range(len(rows)) for other in found[k]])
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(rows), len(rows)))
    count, part = connected_components(graph, directed=False)
    mode = np.full(len(cells), -1)
    mode[rows] = part
    return [mode == k for k in range(count)]


def _maps(
    kind: str, first: np.ndarray, second: np.ndarray, middle: Float[np.ndarray, "2"], spread_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Matrices (h, 2, 2) and translations (h, 2) of the maps in the horizontal plane."""
    if kind == "half turn":
        return np.tile(-np.eye(2), (len(first), 1, 1)), 2 * (
            middle + spread_m * np.column_stack([first, second])
        )
    across = np.column_stack([np.cos(spread_m * first), np.sin(spread_m * first)])
    matrices = np.eye(2) - 2 * across[:, :, None] * across[:, None, :]
    return matrices, 2 * (across @ middle + spread_m * second)[:, None] * across

"""Centres of the spline: on and beside the visible surface, in the core of the region, and along free lines of touches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.geometry import sphere_directions
from ..surfaces.rbf import RbfSurface
from .hole import SupportBand
from .hole_region import HoleRegion
from .touch import Touch

#: Maximum number of refinement rounds that add centres at violated constraints, and of centres per round.
_CORE_ROUNDS, _CORE_POINTS = 4, 6
#: Maximum number of rounds that add centres in free space which the surface still covers.
_FREE_ROUNDS = 3
#: Number of directions in which the surface is constrained to the hull.
_BEYOND = 200


@dataclass(slots=True)
class Centres:
    """Positions, target signed distances and their standard deviations [m]."""

    points: list[np.ndarray] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    sigmas: list[float] = field(default_factory=list)

    def put(self, point: np.ndarray, value: float, sigma_m: float) -> None:
        """Append a centre.

        Parameters
        ----------
        point
            Position (3) [m].
        value
            Signed distance at it [m], positive outside.
        sigma_m
            Standard deviation of the distance [m].
        """
        self.points.append(point)
        self.values.append(value)
        self.sigmas.append(sigma_m)


def with_off_surface(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], d_m: float
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m"]]:
    """Centres on, outside (+d) and inside (-d) the surface; d is shortened near other points (Sec. 5.3.1).

    Parameters
    ----------
    points
        Points (n, 3) of the surface [m].
    normals
        Unit outward normals (n, 3).
    d_m
        Distance of the off-surface centres [m].
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    centers, values = [points], [np.zeros(len(points))]
    for sign in (1.0, -1.0):
        reach = np.full(len(points), d_m)
        for _ in range(5):
            gaps, _ = tree.query(points + sign * reach[:, None] * normals)
            crowded = gaps < 0.98 * reach
            if not crowded.any():
                break
            reach[crowded] *= 0.6
        kept = ~crowded
        centers.append((points + sign * reach[:, None] * normals)[kept])
        values.append((sign * reach)[kept])
    return np.concatenate(centers), np.concatenate(values)


def constrain_core(
    fit: RbfSurface,
    region: HoleRegion,
    rho: Callable[[Float[np.ndarray, "n"], float], Float[np.ndarray, "n"]],
) -> RbfSurface:
    """Add centres that keep the core of the region inside; otherwise distant bands would each be closed separately.

    Parameters
    ----------
    fit
        Spline of the visible bands.
    region
        Where the surface is missing.
    rho
        Smoothing of centres from their standard deviation [m] and the extent of the fit [m].
    """
    core, depth_m = region.core()
    for _ in range(_CORE_ROUNDS):
        # Only clear violations: the region is an approximation, not the position of the surface.
        excess = fit(core) + 0.02 * depth_m
        worst = np.argsort(-excess)[:_CORE_POINTS]
        worst = worst[excess[worst] > 0]
        if not len(worst):
            break
        fit = fit.added(core[worst], -0.5 * depth_m[worst], rho(0.25 * depth_m[worst], fit.extent_m))
        core, depth_m = np.delete(core, worst, axis=0), np.delete(depth_m, worst)
    return fit


def constrain_to_hull(
    fit: RbfSurface,
    outer: HoleRegion,
    band: SupportBand,
    push_m: float,
    rho: Callable[[Float[np.ndarray, "n"], float], Float[np.ndarray, "n"]],
) -> RbfSurface:
    """Add centres that keep the surface inside a hull of the known and missing parts; splines bulge where unconstrained.

    Points behind the visible surface are inside the object and not constrained, also beyond the hull.

    Parameters
    ----------
    fit
        Spline of the visible bands.
    outer
        Convex hull that contains the object near the region.
    band
        Known points around the region.
    push_m
        Distance of the centres from the hull [m].
    rho
        Smoothing of centres from their standard deviation [m] and the extent of the fit [m].
    """
    ways = sphere_directions(_BEYOND)
    middle = outer.hull_m.mean(axis=0)
    reach_m = -(middle @ outer.planes[:, :3].T + outer.planes[:, 3])
    slope = ways @ outer.planes[:, :3].T
    with np.errstate(divide="ignore"):
        along_m = np.where(slope > 1e-9, reach_m / slope, np.inf)
    nearest = along_m.argmin(axis=1)
    points = middle + along_m.min(axis=1)[:, None] * ways + push_m * outer.planes[nearest, :3]
    points = points[~band.behind(points)]
    for _ in range(_CORE_ROUNDS):
        value = fit(points)
        worst = np.argsort(value)[:_CORE_POINTS]
        worst = worst[value[worst] < 0]
        if not len(worst):
            break
        some = points[worst]
        fit = fit.added(some, np.full(len(some), push_m), rho(np.full(len(some), 0.5 * push_m), fit.extent_m))
        points = np.delete(points, worst, axis=0)
    return fit


def constrain_free(
    fit: RbfSurface,
    free_m: Float[np.ndarray, "n 3"],
    push_m: float,
    rho: Callable[[Float[np.ndarray, "n"], float], Float[np.ndarray, "n"]],
) -> RbfSurface:
    """Add centres in free space that the surface still covers.

    Parameters
    ----------
    fit
        Spline.
    free_m
        Points (n, 3) that probes passed without contact [m].
    push_m
        Signed distance of an added centre and its standard deviation [m].
    rho
        Smoothing of centres from their standard deviation [m] and the extent of the fit [m].
    """
    for _ in range(_FREE_ROUNDS):
        values = fit(free_m)
        worst = np.argsort(values)[:3]
        worst = worst[values[worst] < 0]
        if not len(worst):
            break
        push = np.full(len(worst), push_m)
        fit = fit.added(free_m[worst], push, rho(push, fit.extent_m))
    return fit


def free_points(touch: Touch, d_m: float) -> list[np.ndarray]:
    """Points on the free line of a probe, ``d_m / 2`` apart, up to ``d_m`` before a contact.

    Parameters
    ----------
    touch
        Movement of the probe.
    d_m
        Distance kept from the contact, twice the spacing of the points [m].
    """
    if touch.start_m is None:
        return []
    end = touch.end_m if touch.contact_m is None else touch.contact_m
    assert end is not None
    way = end - touch.start_m
    length = float(np.linalg.norm(way))
    back = d_m if touch.contact_m is not None else 0.0
    if length <= back:
        return []
    count = max(2, int((length - back) / (0.5 * d_m)))
    return list(touch.start_m + np.outer(np.linspace(0.0, 1 - back / length, count), way))

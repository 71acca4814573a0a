"""Centres of the spline: beside the visible surface, around the core of the region, along what was free."""

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

__all__ = ["Centres", "around_core", "beyond_hull", "free_points", "with_off_surface"]

#: Rounds in which inner points of the region that the surface leaves outside are added, and how many each.
_CORE_ROUNDS, _CORE_POINTS = 4, 6
#: Directions in which a surface is kept in the hull of all that is known.
_BEYOND = 200


@dataclass(slots=True)
class Centres:
    """Places, wanted signed distances and their deviations [m]."""

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
    """Centres on, outside (+d) and inside (-d); d is shortened near other points (Sec. 5.3.1).

    Parameters
    ----------
    points
        Points (n, 3) of the surface [m].
    normals
        Unit normals (n, 3), outwards.
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


def around_core(
    fit: RbfSurface,
    region: HoleRegion,
    rho: Callable[[Float[np.ndarray, "n"], float], Float[np.ndarray, "n"]],
) -> RbfSurface:
    """The fit with centres that keep the core of the region inside: bands far apart would close each on its own.

    Parameters
    ----------
    fit
        Spline of the visible bands.
    region
        Where the surface is missing.
    rho
        Smoothing of centres by their deviation [m] and the extent of the fit [m].
    """
    core, depth_m = region.core()
    for _ in range(_CORE_ROUNDS):
        # Only what is plainly outside: a region is rough, and says little of where the surface is.
        excess = fit(core) + 0.02 * depth_m
        worst = np.argsort(-excess)[:_CORE_POINTS]
        worst = worst[excess[worst] > 0]
        if not len(worst):
            break
        fit = fit.added(core[worst], -0.5 * depth_m[worst], rho(0.25 * depth_m[worst], fit.extent_m))
        core, depth_m = np.delete(core, worst, axis=0), np.delete(depth_m, worst)
    return fit


def beyond_hull(
    fit: RbfSurface,
    outer: HoleRegion,
    band: SupportBand,
    push_m: float,
    rho: Callable[[Float[np.ndarray, "n"], float], Float[np.ndarray, "n"]],
) -> RbfSurface:
    """The fit with centres that keep it in a hull of all that is seen or missing: splines bulge where nothing holds them.

    What lies behind the seen surface is in the object, where that goes on beyond the hull.

    Parameters
    ----------
    fit
        Spline of the visible bands.
    outer
        Convex hull that holds the object near the region.
    band
        Known points around the region.
    push_m
        Distance of the centres from the hull [m].
    rho
        Smoothing of centres by their deviation [m] and the extent of the fit [m].
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


def free_points(touch: Touch, d_m: float) -> list[np.ndarray]:
    """Points that a probe passed without contact, half of ``d_m`` apart, up to ``d_m`` before a contact.

    Parameters
    ----------
    touch
        Movement of the probe.
    d_m
        Distance kept from the contact, twice that between the points [m].
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

"""Centres of the spline: on and beside the visible surface, in the core of the region, and along free lines of touches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from ...core.geometry import sphere_directions
from ..surfaces.rbf import RbfSurface
from .hole import SupportBand
from .hole_region import HoleRegion
from .radial_model import RadialMixture
from .touch import Touch

#: Maximum number of refinement rounds that add centres at violated constraints, and of centres per round.
_ROUNDS, _ADDED = 4, 6
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
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    """Centres on, outside (+d) and inside (-d) the surface with their points; d is shortened near other points (Sec. 5.3.1).

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
    centers, values, own = [points], [np.zeros(len(points))], [np.arange(len(points))]
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
        own.append(np.flatnonzero(kept))
    return np.concatenate(centers), np.concatenate(values), np.concatenate(own)


def band_sigma_m(
    band: SupportBand, radial: RadialMixture | None, visual_sigma_m: float
) -> Float[np.ndarray, "n"]:
    """Standard deviation of the points of a band [m]: their mean precision in the models of rims.

    Parameters
    ----------
    band
        Known points around the region.
    radial
        Models of the wall; without them the rims are exact.
    visual_sigma_m
        Standard deviation of the visible surface [m].
    """
    rims, fractions = (radial.rims, radial.fractions) if radial else ((0.0,), (1.0,))
    square_m2 = visual_sigma_m**2 + np.outer(rims, band.rim_sigma_m) ** 2
    return np.asarray((fractions @ (1 / square_m2)) ** -0.5)


_Smoothing = Callable[[Float[np.ndarray, "n"], float], Float[np.ndarray, "n"]]


def constrain_core(fit: RbfSurface, region: HoleRegion, rho: _Smoothing) -> RbfSurface:
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
    return _constrained(fit, core, *_inside(depth_m), rho)


def constrain_axis(
    fit: RbfSurface,
    axis_m: Float[np.ndarray, "2"],
    contacts_m: Float[np.ndarray, "n 3"],
    step_m: float,
    rho: _Smoothing,
) -> RbfSurface:
    """Add centres that keep the axis inside between the lowest and the highest contact with a wall around it.

    The wall is extrapolated from its rims; beyond the core of the region the spline closes below or above them otherwise,
    with a bottom in the middle of touched walls (at 33 mm, contacts from 29 to 93 mm).

    Parameters
    ----------
    fit
        Spline of the visible bands and contacts.
    axis_m
        x and y of the upright axis [m].
    contacts_m
        At least one contact (n, 3) [m].
    step_m
        Distance of places on the axis [m].
    rho
        Smoothing of centres from their standard deviation [m] and the extent of the fit [m].
    """
    z_m = np.arange(contacts_m[:, 2].min(), contacts_m[:, 2].max() + step_m, step_m)
    z_m[-1] = contacts_m[:, 2].max()
    nearest = np.abs(z_m[:, None] - contacts_m[:, 2]).argmin(axis=1)
    depth_m = np.hypot(*(contacts_m[nearest, :2] - axis_m).T)
    axis = np.column_stack([np.tile(axis_m, (len(z_m), 1)), z_m])
    return _constrained(fit, axis, *_inside(depth_m), rho)


def _inside(depth_m: Float[np.ndarray, "n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values and standard deviations of centres at an approximate depth [m], and the depth that is no violation [m]."""
    # Only clear violations: the depth is an approximation, not the position of the surface.
    return -0.5 * depth_m, 0.25 * depth_m, 0.02 * depth_m


def constrain_to_hull(
    fit: RbfSurface, outer: HoleRegion, band: SupportBand, push_m: float, rho: _Smoothing
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
    push = np.full(len(points), push_m)
    return _constrained(fit, points, push, 0.5 * push, 0 * push, rho)


def constrain_free(
    fit: RbfSurface, free_m: Float[np.ndarray, "n 3"], push_m: float, rho: _Smoothing
) -> RbfSurface:
    """Add centres in free space that the surface still covers.

    Parameters
    ----------
    fit
        Spline.
    free_m
        Points (n, 3) that probes passed without contact [m].
    push_m
        Signed distance of an added centre, twice its standard deviation [m].
    rho
        Smoothing of centres from their standard deviation [m] and the extent of the fit [m].
    """
    push = np.full(len(free_m), push_m)
    return _constrained(fit, free_m, push, 0.5 * push, 0 * push, rho)


def _constrained(
    fit: RbfSurface,
    points_m: Float[np.ndarray, "n 3"],
    values_m: Float[np.ndarray, "n"],
    sigma_m: Float[np.ndarray, "n"],
    min_m: Float[np.ndarray, "n"],
    rho: _Smoothing,
) -> RbfSurface:
    """Add the centres that are not on the side of their values by at least a distance, the worst first."""
    for _ in range(_ROUNDS):
        short_m = min_m - np.sign(values_m) * fit(points_m)
        worst = np.argsort(-short_m)[:_ADDED]
        worst = worst[short_m[worst] > 0]
        if not len(worst):
            break
        fit = fit.added(points_m[worst], values_m[worst], rho(sigma_m[worst], fit.extent_m))
        points_m = np.delete(points_m, worst, axis=0)
        values_m, sigma_m, min_m = (np.delete(each, worst) for each in (values_m, sigma_m, min_m))
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

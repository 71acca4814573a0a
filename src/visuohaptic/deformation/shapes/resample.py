"""Sample the wall of a container by its distance from the height axis: removes holes, patches and seams.

Rays from the axis detect a wall independently of the quality of its triangles. If a mesh has an inner and an outer
surface, the wall is the mid-surface; parts farther out (a handle) are not part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.errors import InputError
from . import _slice_kernels as kernels
from .wall_properties import harmonics, measured_thickness, row_median

#: Heights and angles of the first sampling.
LEVELS, ANGLES = 160, 96
#: Number of stored intersections per ray.
MAX = 8
#: A second surface within this fraction of the radius is the other side of one wall.
THICKEST_FRACTION = 0.25
#: A ray longer than those above and below it by this factor has missed the wall.
SPIKE = 1.15
#: Fraction of a ring that may be missing.
WIDEST_HOLE = 1 / 6


@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """A star-shaped wall around a vertical axis."""

    axis_point_m: tuple[float, float]
    low_m: float  #: height of the lowest ring
    high_m: float  #: height of the highest ring
    double: bool  #: the mesh has an inner and an outer surface
    wall_m: float  #: median horizontal distance of the two, NaN for one surface
    #: height and distance along the normal there; (0, 2) for one surface
    thickness_m: Float[np.ndarray, "k 2"]
    #: Fourier coefficients around the wall of the thickness relative to that: 1, cos, sin, cos 2 ...
    uneven: Float[np.ndarray, "k h"]
    thickness_spread: float  #: relative standard deviation of the remainder, NaN for one surface
    points_m: Float[np.ndarray, "v 3"]  #: of the mesh, about the axis
    faces: Int[np.ndarray, "f 3"]
    where: str
    notes: tuple[str, ...]

    def measured_m(self, heights_m: Float[np.ndarray, "h"]) -> Float[np.ndarray, "h"]:
        """Thickness, the distance of the two surfaces along the normal of the wall [m].

        Parameters
        ----------
        heights_m
            Heights in the mesh's frame [m].
        """
        return np.interp(heights_m, *self.thickness_m.T)

    def unevenness(self, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Thickness at points relative to the typical one at their height.

        Parameters
        ----------
        points_m
            In the mesh's frame [m].
        """
        angle = np.arctan2(points_m[:, 1] - self.axis_point_m[1], points_m[:, 0] - self.axis_point_m[0])
        terms = [
            np.interp(points_m[:, 2], self.thickness_m[:, 0], coefficients) for coefficients in self.uneven.T
        ]
        out: np.ndarray = np.einsum("hn,nh->n", terms, harmonics(angle))
        return out

    def radius_m(self, heights_m: Float[np.ndarray, "h"], around: int) -> Float[np.ndarray, "h a"]:
        """Radius of the mid-surface about the axis [m]; small holes are bridged.

        Parameters
        ----------
        heights_m
            Heights h in the mesh's frame [m].
        around
            Angles a, equally spaced from x+ towards y+.

        Raises
        ------
        InputError
            A hole wider than a sixth of the circumference, with its location.
        """
        first, pair, _ = _nearest(self.points_m, self.faces, heights_m, around)
        if self.double:
            # One surface only: the foot below the inner floor, or a solid stem.
            outer = first - np.minimum(self.wall_m / 2, first / 2)
            near = _thin(first, pair)
            # Where a handle joins, the second surface is not the outer one: use the value of the rest of the ring.
            gap = np.where(near, pair - first, np.nan)
            usual = row_median(gap)
            pair = np.where(near & (gap > 1.8 * usual), first + usual, pair)
            first = np.where(near, (first + np.where(near, pair, first)) / 2, outer)
        return _bridged(_without_spikes(first, heights_m)[0], heights_m, self.where)


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Intersections of rays from the height axis with a mesh: h heights, a angles."""

    points_m: Float[np.ndarray, "v 3"]  #: vertices about the axis
    first: Float[np.ndarray, "h a"]  #: radius of the nearest surface, inf if there is none
    pair: Float[np.ndarray, "h a"]  #: radius of the next one
    count: Int[np.ndarray, "h a"]  #: number of surfaces hit


def find_wall(
    points_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    where: str,
) -> Wall:
    """Determine axis, usable heights and type of wall.

    Parameters
    ----------
    points_m
        Vertices [m], z up.
    faces
        Triangles, of any quality and orientation.
    where
        Name of the mesh in messages.

    Raises
    ------
    InputError
        There is no wall around the axis, or a hole that is too large to bridge; with its location.
    """
    low, high = points_m[faces].min(axis=(0, 1)), points_m[faces].max(axis=(0, 1))
    if not (high - low > 0).all():
        raise InputError(where, "is flat, expected a container", field="mesh")
    margin = 2e-3 * (high[2] - low[2])
    heights = np.linspace(low[2] + margin, high[2] - margin, LEVELS)
    centre, rays = _centred_rays(points_m, faces, heights, 0.5 * (low + high)[:2])
    bottom, top, notes = _closed_rows(rays, heights, centre, where)
    near = _thin(rays.first, rays.pair)
    double = bool(near[bottom : top + 1].mean() > 0.5)
    low_m = heights[bottom]
    if double:
        bottom, low_m = _floor(rays, near, faces, heights, bottom)
        if low_m > heights[0]:
            notes.append(f"the solid foot, {1e3 * (low_m - low[2]):.3g} mm high, is ignored")
    first, (bottom, top) = bottom, _without_folds(rays, bottom, top)
    low_m = low_m if bottom == first else heights[bottom]
    used = slice(bottom, top + 1)
    missed = _without_spikes(rays.first[used], heights[used])[1]
    if missed:
        notes.append(
            f"the wall is bridged behind what joins it (handle, spout): {100 * missed:.1f} % of the directions"
        )
    wall, thickness, uneven, spread = float("nan"), np.zeros((0, 2)), np.zeros((0, 1)), float("nan")
    if double:
        wall = float(np.median(rays.pair[near] - rays.first[near]))
        thickness, uneven, spread = measured_thickness(
            rays.first[used], np.where(near, rays.pair, np.nan)[used], heights[used]
        )
        usual = 1e3 * float(np.median(thickness[:, 1]))
        notes.append(f"inner and outer surface, {usual:.2g} mm apart: the middle is taken as the wall")
    notes += _outside(rays, faces, heights, used, double=double)
    found = Wall(
        (float(centre[0]), float(centre[1])),
        float(low_m),
        float(heights[top]),
        double,
        wall,
        thickness,
        uneven,
        spread,
        rays.points_m,
        faces,
        where,
        tuple(notes),
    )
    found.radius_m(heights[used], ANGLES)  # rejects large holes here
    return found


def _centred_rays(
    points_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    heights: Float[np.ndarray, "h"],
    centre: Float[np.ndarray, "2"],
) -> tuple[Float[np.ndarray, "2"], _Rays]:
    """The axis at the centre of the closed sections, and the intersections from there."""
    angle = 2 * np.pi * np.arange(ANGLES) / ANGLES
    for _ in range(4):
        about = points_m - np.array([centre[0], centre[1], 0.0])
        rays = _Rays(about, *_nearest(about, faces, heights, ANGLES))
        full = (rays.count > 0).all(axis=1)
        if not full.any():
            break
        offset = 2 * rays.first[full] @ np.stack([np.cos(angle), np.sin(angle)], axis=1) / ANGLES
        move = np.median(offset, axis=0)
        if np.abs(move).max() < 1e-5 * np.ptp(about[:, 0]):
            break
        centre = centre + move
    return centre, rays


def _closed_rows(
    rays: _Rays, heights: Float[np.ndarray, "h"], centre: Float[np.ndarray, "2"], where: str
) -> tuple[int, int, list[str]]:
    """Lowest and highest row with a closed wall; rejects a mesh with almost none."""
    seen = rays.count > 0
    fraction = seen.mean(axis=1)
    rows = np.flatnonzero(fraction >= 0.97)
    if not len(rows) or np.median(fraction) < 0.6:
        place = heights[int(np.argmin(fraction))]
        raise InputError(
            where,
            f"no wall around the axis at ({centre[0]:.4g}, {centre[1]:.4g}) m: at height {place:.4g} m only "
            f"{100 * fraction.min():.0f} % of the directions intersect one",
            field="mesh",
            remedy="turn it with --up so that z is the height axis, close the holes, or keep one body only",
        )
    notes: list[str] = []
    bottom, top = int(rows[0]), int(rows[-1])
    for what, cut in (("bottom", bottom), ("top", LEVELS - 1 - top)):
        if cut > 0.3 * LEVELS:
            raise InputError(
                where,
                f"{100 * cut / LEVELS:.0f} % of the height at the {what} is not closed around the axis",
                field="mesh",
                remedy="turn it with --up so that z is the height axis",
            )
        if cut:
            notes.append(f"{100 * cut / LEVELS:.0f} % of the height at the {what} is ragged and ignored")
    gaps = int((~seen[bottom : top + 1]).sum())
    if gaps:
        notes.append(f"holes of {100 * gaps / ((top + 1 - bottom) * ANGLES):.1f} % of the wall bridged")
    return bottom, top, notes


def _floor(
    rays: _Rays,
    near: Bool[np.ndarray, "h a"],
    faces: Int[np.ndarray, "f 3"],
    heights: Float[np.ndarray, "h"],
    bottom: int,
) -> tuple[int, float]:
    """First row above a solid foot, and the height where the two-sided wall starts."""
    # A foot may be hollow below the floor: the highest row without two sides decides.
    share = near.mean(axis=1)
    above = bottom + int(0.3 * LEVELS)
    solid = np.flatnonzero(share[bottom:above] < 0.5)
    first = bottom + int(solid[-1]) + 1 if len(solid) else bottom
    # Where the floor is uneven, some of the directions still meet it, inside of the wall: less far inside higher up, by more
    # than the height if its slope is less than 45 degrees.
    depth = _depth(rays.first)
    while first < above and depth[first] - depth[first + 1] > heights[first + 1] - heights[first]:
        first += 1
    if first in (bottom, above):
        return bottom, float(heights[0])
    # The stiffness near the foot depends on its height: refine the search between the two rows.
    between = np.linspace(heights[first - 1], heights[first], 33)
    inner, outer, _ = _nearest(rays.points_m, faces, between, ANGLES)
    hollow = (_thin(inner, outer).mean(axis=1) >= 0.5) & ~(
        _depth(inner) - depth[first] > heights[first] - between
    )
    return first, float(between[int(np.flatnonzero(~hollow)[-1]) + 1]) if not hollow.all() else float(
        between[0]
    )


def _depth(radius: Float[np.ndarray, "h a"]) -> Float[np.ndarray, "h"]:
    """How much smaller the smallest radius of each row is than the usual one; infinite where half of the rays meet nothing."""
    out: np.ndarray = np.median(radius, axis=1) - np.minimum(radius.min(axis=1), 1e9)
    return out


def _without_folds(rays: _Rays, bottom: int, top: int) -> tuple[int, int]:
    """Rows without a ragged end or a folded lid, which are not wall: a ring there would pass through the axis."""
    clear = rays.first > 0.3 * np.median(rays.first, axis=1, keepdims=True)
    folded = np.flatnonzero((~clear & (rays.count > 0)).any(axis=1))
    short = int(0.04 * LEVELS)
    for end in folded[(folded >= bottom) & (folded <= bottom + short)]:
        bottom = int(end) + 1
    for end in folded[(folded <= top) & (folded >= top - short)][::-1]:
        top = int(end) - 1
    return bottom, top


def _outside(
    rays: _Rays, faces: Int[np.ndarray, "f 3"], heights: Float[np.ndarray, "h"], used: slice, *, double: bool
) -> list[str]:
    """Note parts that are farther out than the wall, like a handle."""
    radius, _count = _crossings(rays.points_m, faces, heights, ANGLES)
    radius[~np.isfinite(radius)] = 0.0
    last = np.where(np.isfinite(rays.pair), rays.pair, rays.first) if double else rays.first
    beyond = (radius.max(axis=2) > (1 + THICKEST_FRACTION) * last)[used]
    if beyond.mean() < 1e-3:
        return []
    places = np.argwhere(beyond)
    row, column = places[len(places) // 2]
    return [
        f"parts outside the wall (a handle?) are ignored: {100 * beyond.mean():.1f} % of the directions, as at "
        f"height {heights[used][row]:.4g} m, {360 * column / ANGLES:.0f} degrees from x towards y"
    ]


def _without_spikes(
    radius: Float[np.ndarray, "h a"], heights: Float[np.ndarray, "h"]
) -> tuple[Float[np.ndarray, "h a"], float]:
    """Mark rays as holes that miss the wall at the junction of a handle or spout and hit that part instead.

    They are longer than the rays above and below at the same angle, in a small part of the ring
    only; a whole ring of longer rays is part of the shape. The radius of a part behind the wall starts with a jump: where it
    changes by less than the height from row to row, the wall itself bulges. Also returns the fraction of such rays.
    """
    from scipy.ndimage import binary_propagation, median_filter

    rows = len(radius)
    if rows < 8:
        return radius, 0.0
    # Column by column, which SciPy filters in a tenth of the time of an image.
    size = 2 * (rows // 4) + 1
    usual = np.stack([median_filter(column, size=size, mode="nearest") for column in radius.T], axis=1)
    with np.errstate(invalid="ignore"):
        spike = np.isfinite(radius) & (radius > SPIKE * usual)
        jump = np.abs(np.diff(radius, axis=0)) > np.diff(heights)[:, None]
    spike &= spike.mean(axis=1, keepdims=True) < WIDEST_HOLE
    beside = np.pad(jump, ((1, 0), (0, 0))) | np.pad(jump, ((0, 1), (0, 0)))
    spike = binary_propagation(spike & beside, mask=spike)
    # Rays next to a spike are on its flank.
    flank = spike | np.roll(spike, 1, axis=1) | np.roll(spike, -1, axis=1)
    return np.where(flank, np.inf, radius), float(spike.mean())


def _thin(first: np.ndarray, pair: np.ndarray) -> Bool[np.ndarray, "h a"]:
    """Where the second surface is the other side of the same wall: close, or visible all around.

    A horizontal ray cuts the side of a shallow bowl obliquely, there the two surfaces are far apart.
    """
    seen = np.isfinite(pair)
    return seen & ((pair < (1 + THICKEST_FRACTION) * first) | (seen.mean(axis=1, keepdims=True) > 0.9))


def _nearest(
    points: np.ndarray, faces: np.ndarray, heights: np.ndarray, around: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First and second distinct radius along each ray (inf if there is none), and number of distinct radii."""
    radius, count = _crossings(points, faces, heights, around)
    radius.sort(axis=2)
    first = radius[..., 0]
    # Seams and duplicate triangles are hit twice at one point.
    other = np.where(radius > first[..., None] * (1 + 1e-4), radius, np.inf)
    return first, other.min(axis=2), count


def _crossings(
    points: np.ndarray, faces: np.ndarray, heights: np.ndarray, around: int
) -> tuple[np.ndarray, np.ndarray]:
    """Unsorted radii at which each ray intersects the mesh (padded with inf), and their number."""
    radius = np.full((len(heights), around, MAX), np.inf)
    count = np.zeros((len(heights), around), dtype=np.int64)
    kernels.ring_crossings(
        np.ascontiguousarray(points),
        np.ascontiguousarray(faces, dtype=np.int64),
        np.ascontiguousarray(heights, dtype=float),
        np.searchsorted(heights, points[faces, 2].min(axis=1)),
        around,
        radius,
        count,
    )
    return radius, count


def _bridged(radius: np.ndarray, heights: np.ndarray, where: str) -> Float[np.ndarray, "h a"]:
    missing: Bool[np.ndarray, "h a"] = ~np.isfinite(radius)
    if not missing.any():
        return radius
    _rows, around = radius.shape
    full = ~missing.all(axis=1)
    out = radius.copy()
    angle = np.arange(around)
    for row in np.flatnonzero(missing.any(axis=1) & full):
        good = ~missing[row]
        place = angle[good]
        gap = int(np.diff(np.append(place, place[0] + around)).max()) - 1
        if gap > around * WIDEST_HOLE:
            start = int(place[np.argmax(np.diff(np.append(place, place[0] + around)))]) + 1
            raise InputError(
                where,
                f"a hole of {360 * gap / around:.0f} degrees in the wall at height {heights[row]:.4g} m, from "
                f"{360 * (start % around) / around:.0f} degrees on (from x towards y), expected at most 60",
                field="mesh",
                remedy="close it",
            )
        out[row] = np.interp(angle, place, radius[row, good], period=around)
    if not full.all():
        known = np.flatnonzero(full)
        if not known.size:
            raise InputError(where, "no wall around the axis", field="mesh")
        for column in range(around):
            out[~full, column] = np.interp(heights[~full], heights[known], out[known, column])
    return out

"""Model of an object for quasi-static pushing: outline, supports and their loads, contact friction."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ...core import NON_NEGATIVE, InputError, check_ranges, finite_array
from ...core.geometry import polygon_area, polygon_second_moments

#: Default contact friction (foam or plastic on furniture).
CONTACT_FRICTION = 0.25
#: Support points of a flat bottom: its limit surface is accurate to 1 %.
PATCH_POINTS = 24
#: A regular polygon of at least this number of corners represents a disc: its edges deviate from the circle by less than
#: 2 % of the radius on either side, the centimetre to which outlines are drawn.
DISC_CORNERS = 12


@dataclass(frozen=True, slots=True, eq=False)
class PushModel:
    """An object on the floor, in a frame whose origin is its reference point.

    Mass and floor friction cancel out of quasi-static motion; only the
    distribution of the load matters. An object on a few feet moves very differently
    from one with a flat bottom.
    """

    outline_m: Float[np.ndarray, "m 2"]  #: corners, counter-clockwise; one point and ``round_m`` for a disc
    support_m: Float[np.ndarray, "n 2"]  #: support points on the floor
    load: Float[np.ndarray, "n"]  #: fraction of the weight on each; sums to 1
    #: between platform and object
    contact_friction: float = field(default=CONTACT_FRICTION, metadata=NON_NEGATIVE)
    round_m: float = field(default=0.0, metadata=NON_NEGATIVE)  #: dilation of the outline
    #: floor friction times height of the push: forward shift of the load
    tip_m: float = field(default=0.0, metadata=NON_NEGATIVE)

    def __post_init__(self) -> None:
        check_ranges(self)
        outline = finite_array("PushModel", self.outline_m, None, 2, field="outline_m")
        support = finite_array("PushModel", self.support_m, None, 2, field="support_m")
        load = finite_array("PushModel", self.load, len(support), field="load")
        if not (load.min() >= 0 and load.sum() > 0):
            raise InputError("PushModel", f"found {load}, expected fractions >= 0", field="load")
        if polygon_area(outline) < 0:
            outline = np.ascontiguousarray(outline[::-1])
        object.__setattr__(self, "outline_m", outline)
        object.__setattr__(self, "support_m", support)
        object.__setattr__(self, "load", load / load.sum())

    @property
    def centre_m(self) -> Float[np.ndarray, "2"]:
        """Centre of the load: a push through it does not rotate the object."""
        return self.load @ self.support_m

    @property
    def gyration_m(self) -> float:
        """Root mean square distance of the load from the reference point; scales rotations to lengths."""
        return max(float(np.sqrt(self.load @ (self.support_m**2).sum(axis=1))), 1e-3)

    @property
    def lever_m(self) -> float:
        """Ratio of maximum friction moment to maximum friction force: the load's mean distance from its centre."""
        away = self.support_m - self.centre_m
        return float(self.load @ np.hypot(away[:, 0], away[:, 1]))

    @property
    def reach_m(self) -> float:
        """Radius of the circle about the reference point that contains the outline."""
        return float(np.hypot(self.outline_m[:, 0], self.outline_m[:, 1]).max()) + self.round_m

    def with_centre_moved(self, dx_m: float, dy_m: float) -> PushModel:
        """The same model with displaced supports, for a centre of friction that differs from the assumed one.

        Parameters
        ----------
        dx_m, dy_m
            Displacement [m], in the frame of the outline.
        """
        return replace(self, support_m=self.support_m + np.array([dx_m, dy_m]))

    @classmethod
    def patch(
        cls, outline_m: Float[np.ndarray, "m 2"], contact_friction: float = CONTACT_FRICTION, **rest: float
    ) -> PushModel:
        """An object with a flat bottom and uniform pressure.

        Parameters
        ----------
        outline_m
            Corners about the reference point [m].
        contact_friction
            Coefficient of friction between platform and object.
        **rest
            Further fields: ``round_m``, ``tip_m`` [m].
        """
        points, load = patch_points(outline_m)
        return cls(outline_m, points, load, contact_friction, **rest)

    @classmethod
    def of_footprint(cls, outline_m: Float[np.ndarray, "m 2"]) -> PushModel:
        """A flat bottom for an object of which only the outline is known; a polygon that approximates a disc becomes a disc.

        Pushed by a rim, a round object rotates several times as far as a polygonal one when its contact slips: a
        rotating edge takes the contact normal along.

        Parameters
        ----------
        outline_m
            Corners about the reference point [m].
        """
        if not (radius_m := _drawn_radius(outline_m)):
            return cls.patch(outline_m)
        disc, middle = cls.disc(radius_m), np.mean(outline_m, axis=0)
        return replace(disc, outline_m=middle[None], support_m=disc.support_m + middle)

    @classmethod
    def disc(cls, radius_m: float, contact_friction: float = CONTACT_FRICTION) -> PushModel:
        """A round object with a flat bottom: two rings that reproduce its limit surface to 1 %.

        Parameters
        ----------
        radius_m
            Radius of the object [m].
        contact_friction
            Coefficient of friction between platform and object.
        """
        angle = np.arange(12) * (math.pi / 6)
        ring = np.column_stack([np.cos(angle), np.sin(angle)])
        # Inner and outer part of equal area; the mean radius of each.
        inner, outer = 2 / 3 * math.sqrt(0.5), 2 / 3 * (1 - 0.5**1.5) / 0.5
        points = radius_m * np.concatenate([inner * ring, outer * ring])
        return cls(np.zeros((1, 2)), points, np.full(24, 1 / 24), contact_friction, radius_m)


def _drawn_radius(outline_m: Float[np.ndarray, "m 2"]) -> float:
    """Radius [m] of the disc of equal area that a polygon approximates; 0 if it does not approximate a disc."""
    corners = np.asarray(outline_m, dtype=np.float64)
    if len(corners) < DISC_CORNERS:
        return 0.0
    away = np.hypot(*(corners - corners.mean(axis=0)).T)
    edges = np.hypot(*(corners - np.roll(corners, 1, axis=0)).T)
    # Corners are as near to the circle as the edges.
    height = away.mean() * (1.0 - math.cos(math.pi / len(corners)))
    even = float(np.ptp(away)) <= height and float(edges.max()) <= 2.0 * float(edges.mean())
    return math.sqrt(abs(polygon_area(corners)) / math.pi) if even else 0.0


def load_of_feet(
    feet_m: Float[np.ndarray, "n 2"], centre_m: tuple[float, float] = (0.0, 0.0)
) -> Float[np.ndarray, "n"]:
    """Fractions of the weight on feet of equal compliance: balance of forces and moments.

    Three feet are statically determinate. With more, the load varies linearly with the
    position, as on springs of equal stiffness.

    Parameters
    ----------
    feet_m
        Positions of the feet [m].
    centre_m
        Centre of mass [m], in the same frame.

    Raises
    ------
    InputError
        Fewer than three feet, all on one line, or one that would be lifted.
    """
    feet = finite_array("load_of_feet", feet_m, None, 2, field="feet_m", least=3)
    centre = finite_array("load_of_feet", centre_m, 2, field="centre_m")
    balance = np.vstack([feet.T, np.ones(len(feet))])
    load, _, rank, _ = np.linalg.lstsq(balance, np.array([*centre, 1.0]), rcond=1e-9)
    if rank < 3:
        raise InputError("load_of_feet", "found all feet on one line, expected three that are not")
    if load.min() < -1e-9:
        raise InputError(
            "load_of_feet",
            f"found the centre of mass {tuple(centre_m)} where foot {int(load.argmin())} would be lifted",
            remedy="the object would stand on fewer feet: give only those",
        )
    return np.maximum(load, 0.0)


def patch_points(
    outline_m: Float[np.ndarray, "m 2"], count: int = PATCH_POINTS
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Points and weights that represent uniform pressure on a polygon.

    Cells of a square grid are clipped with the polygon: their centroids, with the
    areas as weights. Then all points are scaled slightly, so that not only area
    and centroid but also the polar second moment are those of the polygon.

    Parameters
    ----------
    outline_m
        Corners [m].
    count
        Approximate number of points.

    Returns
    -------
    Points [m], and their weights, which sum to 1.

    Raises
    ------
    InputError
        The outline intersects itself or has no area.
    """
    import shapely

    outline = np.asarray(outline_m, dtype=np.float64)
    polygon = shapely.Polygon(outline) if len(outline) >= 3 else None
    if polygon is None or not polygon.is_valid or not polygon.area > 0:
        raise InputError(
            "patch_points", f"found {len(outline)} corners, expected an outline without crossings"
        )
    edge = math.sqrt(polygon.area / count)
    x0, y0, x1, y1 = polygon.bounds
    nx, ny = max(2, round((x1 - x0) / edge)), max(2, round((y1 - y0) / edge))
    xs, ys = np.linspace(x0, x1, nx + 1), np.linspace(y0, y1, ny + 1)
    left, low = np.meshgrid(xs[:-1], ys[:-1])
    right, high = np.meshgrid(xs[1:], ys[1:])
    cells = shapely.box(left.ravel(), low.ravel(), right.ravel(), high.ravel())
    cut = shapely.intersection(cells, polygon)
    area = shapely.area(cut)
    cut, area = cut[area > 1e-3 * edge * edge], area[area > 1e-3 * edge * edge]
    centre = shapely.centroid(cut)
    points, fraction = np.column_stack([shapely.get_x(centre), shapely.get_y(centre)]), area / area.sum()
    middle = fraction @ points
    away = points - middle
    return middle + away * math.sqrt(
        float(np.trace(polygon_second_moments(outline))) / float(fraction @ (away**2).sum(axis=1))
    ), fraction

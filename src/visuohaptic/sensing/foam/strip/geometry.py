"""Geometry of the strip: its back contour in the sensor frame, straight or bent."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ....core.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class StripGeometry:
    """Back contour of a foam strip, sampled at K points, in frame F.

    Frame F lies in the visible top plane of the foam: x along the direction of
    exploration, away from the robot, y to the left along the strip, z up. The
    coordinate s is the arc length along the middle line of the strip, halfway
    between back and front: on a bent strip the columns of foam are wedges, and
    the area that carries their mean stress is the one in the middle.
    """

    s_m: Float[np.ndarray, "K"]  #: arc length along the middle line, 0 at the centre
    back_m: Float[np.ndarray, "K 2"]  #: points on the back contour
    outward: Float[np.ndarray, "K 2"]  #: unit normals, from back to front (opposite to d of Alt 2016)
    width_m: float  #: w, thickness of the strip along the compression
    cell_m: Float[np.ndarray, "K"] = field(init=False)  #: length of foam that each point represents

    def __post_init__(self) -> None:
        object.__setattr__(self, "cell_m", np.gradient(self.s_m))

    @classmethod
    def straight(cls, length_m: float, width_m: float, spacing_m: float = 0.003) -> StripGeometry:
        """A straight strip, centred on the origin of F.

        Parameters
        ----------
        length_m
            Length of the strip [m].
        width_m
            Width along the compression [m].
        spacing_m
            Approximate distance between points [m].
        """
        s = _centred(length_m, width_m, spacing_m)
        back = np.column_stack([np.zeros_like(s), s])
        return cls(s, back, np.tile([1.0, 0.0], (len(s), 1)), width_m)

    @classmethod
    def bent(
        cls, length_m: float, radius_m: float, width_m: float, spacing_m: float = 0.003
    ) -> StripGeometry:
        """A strip bent around a round platform.

        Parameters
        ----------
        length_m
            Length of the back contour.
        radius_m
            Radius of the back contour; its centre is at x = -radius_m.
        width_m
            Width along the compression [m].
        spacing_m
            Distance between points on the back contour, about [m].
        """
        if not (np.isfinite(radius_m) and radius_m > width_m):
            raise InputError(
                "StripGeometry", f"found {radius_m}, expected more than width_m = {width_m}", field="radius_m"
            )
        middle = radius_m + width_m / 2
        s = _centred(length_m * middle / radius_m, width_m, spacing_m)
        angle = s / middle
        if np.abs(angle).max() > 0.5 * np.pi:
            raise InputError(
                "StripGeometry",
                f"a strip of {length_m} m covers more than half of the circle of radius {radius_m} m",
                field="length_m",
            )
        outward = np.column_stack([np.cos(angle), np.sin(angle)])
        return cls(s, radius_m * outward - [radius_m, 0.0], outward, width_m)

    @classmethod
    def along(
        cls, points_m: Float[np.ndarray, "n 2"], width_m: float, spacing_m: float = 0.003
    ) -> StripGeometry:
        """A strip along any smooth curve through at least four points, in order of increasing y.

        Parameters
        ----------
        points_m
            Points of the back contour, frame F [m].
        width_m
            Width along the compression [m].
        spacing_m
            Distance between points on the back contour, about [m].
        """
        from scipy.interpolate import CubicSpline

        points = np.asarray(points_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 4 or not np.isfinite(points).all():
            raise InputError(
                "StripGeometry", f"found shape {points.shape}, expected at least 4 finite points (x, y)"
            )
        chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        if not (np.diff(chord) > 0).all():
            raise InputError("StripGeometry", "two neighbouring points are the same", field="points_m")
        spline = CubicSpline(chord, points)
        dense = np.linspace(0.0, chord[-1], max(400, int(4 * chord[-1] / spacing_m)))
        tangent = spline(dense, 1)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        outward = np.column_stack([tangent[:, 1], -tangent[:, 0]])
        middle = spline(dense) + 0.5 * width_m * outward
        s_dense = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
        s = _centred(float(s_dense[-1]), width_m, spacing_m)
        at = np.interp(s, s_dense - 0.5 * s_dense[-1], dense)
        tangent = spline(at, 1)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        return cls(s, spline(at), np.column_stack([tangent[:, 1], -tangent[:, 0]]), width_m)

    @property
    def front_m(self) -> Float[np.ndarray, "K 2"]:
        """Front contour at rest, frame F."""
        return self.back_m + self.width_m * self.outward

    @property
    def end_cells_m(self) -> tuple[float, float]:
        """Foam beyond the first and the last point [m]: both lie half a spacing inside the ends."""
        return 0.5 * float(self.cell_m[0]), 0.5 * float(self.cell_m[-1])


def _centred(length_m: float, width_m: float, spacing_m: float) -> Float[np.ndarray, "K"]:
    """Points about ``spacing_m`` apart that stay half a spacing away from both ends."""
    for name, value in (("length_m", length_m), ("width_m", width_m), ("spacing_m", spacing_m)):
        if not (np.isfinite(value) and value > 0):
            raise InputError("StripGeometry", f"found {value}, expected a positive length", field=name)
    count = round(length_m / spacing_m)
    if not 8 <= count <= 2000:
        raise InputError(
            "StripGeometry",
            f"{length_m} m at {spacing_m} m gives {count} points, expected 8 to 2000",
            field="spacing_m",
        )
    step = length_m / count
    return (np.arange(count) - 0.5 * (count - 1)) * step

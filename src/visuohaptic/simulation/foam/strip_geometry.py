"""Size and shape of a simulated foam strip, straight or bent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError


@dataclass(frozen=True, slots=True)
class FoamStripGeometry:
    """A strip glued with its back to a straight plate or to a round platform, in frame F."""

    length_m: float = 0.25  #: along the back
    width_m: float = 0.02  #: w, in the direction of compression
    height_m: float = 0.01  #: h
    radius_m: float = math.inf  #: of the platform under the back contour
    spacing_m: float = 0.0005  #: of the columns along the back

    def __post_init__(self) -> None:
        if min(self.length_m, self.width_m, self.height_m, self.radius_m, self.spacing_m) <= 0:
            raise InputError("FoamStripGeometry", f"found {self}, expected lengths > 0")
        if self.length_m > 1.9 * math.pi * self.radius_m:
            raise InputError(
                "FoamStripGeometry", f"{self.length_m} m do not fit around radius {self.radius_m} m"
            )

    def positions_m(self) -> Float[np.ndarray, "k"]:
        """s of the columns, from -length / 2 to length / 2; s grows with y."""
        count = max(2, round(self.length_m / self.spacing_m)) + 1
        return np.linspace(-0.5 * self.length_m, 0.5 * self.length_m, count)

    def back_m(self, s_m: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k 2"]:
        """Points of the back contour.

        Parameters
        ----------
        s_m
            Positions (k) along the strip [m].
        """
        s = np.asarray(s_m, dtype=np.float64)
        if math.isinf(self.radius_m):
            return np.column_stack([np.zeros_like(s), s])
        angle = s / self.radius_m
        return self.radius_m * np.column_stack([np.cos(angle) - 1.0, np.sin(angle)])

    def normals(self, s_m: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k 2"]:
        """Unit vectors from the back to the front.

        Parameters
        ----------
        s_m
            Positions (k) along the strip [m].
        """
        s = np.asarray(s_m, dtype=np.float64)
        angle = np.zeros_like(s) if math.isinf(self.radius_m) else s / self.radius_m
        return np.column_stack([np.cos(angle), np.sin(angle)])

    def stretch(self, height_m: float) -> float:
        """Length along s at a height above the back, relative to that at the back.

        Parameters
        ----------
        height_m
            Height above the back [m].
        """
        return 1.0 if math.isinf(self.radius_m) else 1.0 + height_m / self.radius_m

    def position_of(self, points_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
        """Position s of the columns on whose rays points lie [m].

        Parameters
        ----------
        points_m
            Points (n, 2) in frame F [m].
        """
        points = np.asarray(points_m, dtype=np.float64)
        if math.isinf(self.radius_m):
            return points[:, 1]
        return self.radius_m * np.arctan2(points[:, 1], points[:, 0] + self.radius_m)

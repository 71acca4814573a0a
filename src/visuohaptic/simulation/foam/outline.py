"""Cross sections of rigid bodies that press into foam."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import InputError, rotation_2d, wrap_angle


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """Cross section of a rigid body: a polygon grown by a disc; one vertex is a disc."""

    vertices_m: Float[np.ndarray, "n 2"]  #: counter-clockwise
    radius_m: float = 0.0  #: of the rounded edges

    @classmethod
    def disc(cls, centre_m: tuple[float, float], radius_m: float) -> Outline:
        """Cross section of a cylinder.

        Parameters
        ----------
        centre_m
            Centre (x, y) [m].
        radius_m
            Radius [m].
        """
        return cls(np.array([centre_m], dtype=np.float64), radius_m)

    @classmethod
    def box(
        cls,
        centre_m: tuple[float, float],
        size_m: tuple[float, float],
        yaw_rad: float = 0.0,
        edge_m: float = 0.0,
    ) -> Outline:
        """A box with rounded edges.

        Parameters
        ----------
        centre_m
            Centre (x, y) [m].
        size_m
            Lengths along its x and its y [m].
        yaw_rad
            Rotation about its centre [rad].
        edge_m
            Radius of the edges [m].
        """
        half = 0.5 * np.asarray(size_m, dtype=np.float64) - edge_m
        if half.min() <= 0:
            raise InputError("Outline.box", f"edge radius {edge_m} m does not fit into a box of {size_m} m")
        corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return cls(corners, edge_m).moved(centre_m[0], centre_m[1], yaw_rad)

    def moved(self, x_m: float, y_m: float, yaw_rad: float = 0.0) -> Outline:
        """The outline rotated about the origin, then translated.

        Parameters
        ----------
        x_m, y_m
            Translation [m].
        yaw_rad
            Rotation [rad].
        """
        turned = np.asarray(self.vertices_m, dtype=np.float64) @ rotation_2d(yaw_rad).T
        return Outline(turned + np.array([x_m, y_m]), self.radius_m)

    def polygon_m(self, spacing_rad: float = math.pi / 24) -> Float[np.ndarray, "k 2"]:
        """The outline as a polygon, its arcs cut into chords.

        Parameters
        ----------
        spacing_rad
            Angle of a chord [rad].
        """
        vertices = np.asarray(self.vertices_m, dtype=np.float64)
        if self.radius_m <= 0.0:
            return vertices
        if len(vertices) == 1:
            angle = np.arange(0.0, 2 * math.pi - 1e-9, spacing_rad)
            return vertices + self.radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
        edges = np.roll(vertices, -1, axis=0) - vertices
        outward = np.arctan2(edges[:, 1], edges[:, 0]) - math.pi / 2
        begin = np.roll(outward, 1)
        turn = wrap_angle(outward - begin)
        count = 2 + (np.abs(turn) / spacing_rad).astype(np.int64)
        last = np.cumsum(count) - 1
        fraction = np.arange(last[-1] + 1) - np.repeat(last - count + 1, count)
        fraction = fraction * np.repeat(1.0 / (count - 1), count)
        fraction[last] = 1.0
        angle = np.repeat(begin, count) + np.repeat(turn, count) * fraction
        return np.repeat(vertices, count, axis=0) + self.radius_m * np.column_stack(
            [np.cos(angle), np.sin(angle)]
        )

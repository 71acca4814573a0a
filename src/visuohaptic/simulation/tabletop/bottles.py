"""Parametric bottles with known geometry: round, elliptic and flattened; with a simulated probe.

The base area is a circle, an ellipse or a flattened ellipse; the wall is a
stack of straight, convex and concave sections with a neck on top (Alt 2016,
Sec. 6.1.2 and 5.5.2). The middle can be cut out, like a transparent part.
The radius along any direction is a formula, so that ground truth needs no mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

#: Kinds of base area.
SECTIONS = ("round", "elliptic", "flattened")


@dataclass(frozen=True, slots=True, eq=False)
class Bottle:
    """A closed upright body around the z axis, from 0 to its height."""

    kind: str
    height_m: float
    knots_z: Float[np.ndarray, "k"]  #: heights of the profile's knots [m]
    knots_r: Float[np.ndarray, "k"]  #: radius at them [m]
    bulge_m: Float[np.ndarray, "k-1"]  #: of each section, positive outwards
    aspect: float  #: ratio of width along y to width along x
    flat: float  #: sides are cut off at this fraction of the radius along y; 1: not cut

    def radius_m(
        self, theta: Float[np.ndarray, "*n"], z_m: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        """Distance of the wall from the axis [m].

        Parameters
        ----------
        theta
            Angle around the axis [rad].
        z_m
            Height [m].
        """
        z = np.asarray(z_m, dtype=np.float64)
        base = np.interp(z, self.knots_z, self.knots_r)
        section = np.clip(np.searchsorted(self.knots_z, z, side="right") - 1, 0, len(self.bulge_m) - 1)
        low, high = self.knots_z[section], self.knots_z[section + 1]
        t = np.clip((z - low) / (high - low), 0.0, 1.0)
        base = base + 4 * t * (1 - t) * self.bulge_m[section]
        c, s = np.cos(theta), np.sin(theta)
        # Necks are round: the cross-section changes to a circle over the shoulder.
        shoulder = self.knots_z[-3:-1]
        round_ = np.clip((z - shoulder[0]) / (shoulder[1] - shoulder[0]), 0.0, 1.0)
        round_ = round_**2 * (3 - 2 * round_)
        aspect = self.aspect + (1 - self.aspect) * round_
        shape = 1.0 / np.sqrt(c**2 + (s / aspect) ** 2)
        limit = (self.flat + (10.0 - self.flat) * round_) * aspect / np.maximum(np.abs(s), 1e-9)
        # A soft minimum: real containers have rounded edges.
        return base * (shape**-12.0 + limit**-12.0) ** (-1.0 / 12.0)

    def mesh(
        self, low_m: float = 0.0, high_m: float | None = None, *, step_m: float = 0.003, caps: bool = True
    ) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
        """Triangles of the wall between two heights, counter-clockwise from outside.

        Parameters
        ----------
        low_m, high_m
            Heights [m]; the whole bottle by default.
        step_m
            Length of an edge [m].
        caps
            Whether floor and top are closed where they are within.
        """
        high = self.height_m if high_m is None else high_m
        rows = max(2, int(np.ceil((high - low_m) / step_m)) + 1)
        columns = max(24, int(np.ceil(2 * np.pi * float(self.knots_r.max()) / step_m)))
        z = np.linspace(low_m, high, rows)
        theta = 2 * np.pi * np.arange(columns) / columns
        tt, zz = np.meshgrid(theta, z)
        rho = self.radius_m(tt, zz)
        vertices = np.stack([rho * np.cos(tt), rho * np.sin(tt), zz], axis=-1).reshape(-1, 3)
        i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
        a, b = i * columns + j, i * columns + (j + 1) % columns
        faces = [np.stack([a, b, b + columns], -1), np.stack([a, b + columns, a + columns], -1)]
        quads = np.concatenate([part.reshape(-1, 3) for part in faces])
        around = np.arange(columns)
        following = (around + 1) % columns
        if caps and low_m <= 0.0:
            vertices = np.concatenate([vertices, [[0.0, 0.0, low_m]]])
            quads = np.concatenate(
                [quads, np.column_stack([following, around, np.full(columns, len(vertices) - 1)])]
            )
        if caps and high >= self.height_m:
            top = (rows - 1) * columns
            vertices = np.concatenate([vertices, [[0.0, 0.0, high]]])
            quads = np.concatenate(
                [quads, np.column_stack([top + around, top + following, np.full(columns, len(vertices) - 1)])]
            )
        return vertices, quads

    def probe(
        self,
        start_m: Float[np.ndarray, "3"],
        direction: Float[np.ndarray, "3"],
        length_m: float,
        *,
        sigma_m: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> Float[np.ndarray, "3"] | None:
        """First contact of a point probe that moves along a line; ``None`` without contact.

        Parameters
        ----------
        start_m
            Start of the line (3) [m].
        direction
            Unit vector (3).
        length_m
            Length of the line [m].
        sigma_m
            Standard deviation of the reported position in each direction [m].
        rng
            Source of that noise; none by default.
        """
        way = np.linspace(0.0, length_m, max(200, int(length_m / 0.0005)))
        inside = self._inside(start_m + np.outer(way, direction))
        if not inside.any():
            return None
        first = int(np.argmax(inside))
        low, high = way[max(first - 1, 0)], way[first]
        for _ in range(40):
            middle = 0.5 * (low + high)
            if self._inside((start_m + middle * direction)[None])[0]:
                high = middle
            else:
                low = middle
        contact = start_m + high * direction
        return contact if rng is None else contact + rng.normal(0.0, sigma_m, 3)

    def _inside(self, points: Float[np.ndarray, "n 3"]) -> np.ndarray:
        theta = np.arctan2(points[:, 1], points[:, 0])
        rho = np.hypot(points[:, 0], points[:, 1])
        z = points[:, 2]
        return (z >= 0) & (z <= self.height_m) & (rho <= self.radius_m(theta, np.clip(z, 0, self.height_m)))


def random_bottle(rng: np.random.Generator, kind: str | None = None) -> Bottle:
    """A random bottle with realistic dimensions.

    Parameters
    ----------
    rng
        Source of randomness.
    kind
        Base area, one of ``SECTIONS``; random by default.
    """
    kind = kind or str(rng.choice(SECTIONS))
    height = float(rng.uniform(0.15, 0.30))
    radius = float(rng.uniform(0.025, 0.045))
    neck = float(rng.uniform(0.3, 0.7)) * radius
    sections = int(rng.integers(3, 6))
    fractions = rng.uniform(0.6, 1.4, sections)
    body = np.cumsum(fractions) / fractions.sum() * height * rng.uniform(0.72, 0.85)
    knots_z = np.array([0.0, *body, float(rng.uniform(0.9, 0.94)) * height, height])
    body_r = radius * rng.uniform(0.75, 1.1, sections + 1)
    knots_r = np.array([*body_r, neck, neck])
    bulge = np.append(
        radius * rng.choice([-1.0, 0.0, 1.0], sections) * rng.uniform(0.04, 0.18, sections), [0, 0]
    )
    aspect = 1.0 if kind == "round" else float(rng.uniform(0.6, 0.9))
    flat = float(rng.uniform(0.7, 0.9)) if kind == "flattened" else 10.0
    return Bottle(kind, height, knots_z, knots_r, bulge, aspect, flat)

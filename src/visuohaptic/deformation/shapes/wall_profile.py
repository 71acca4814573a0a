"""The shape of one parametric container as functions of the height, validated (Alt 2016, Fig. 6.3a)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import InputError, wrap_angle
from .container import ContainerDescription

#: Number of heights at which the shape is evaluated between its break points.
FINE = 24


@dataclass(frozen=True, slots=True, eq=False)
class WallProfile:
    """Half-axes, centre and wall along the height.

    Symbols: k knots from the foot (z = 0) to the mouth; values between are linear, knots are dense.
    """

    z_m: Float[np.ndarray, "k"]
    radius_x_m: Float[np.ndarray, "k"]
    radius_y_m: Float[np.ndarray, "k"]
    exponent: Float[np.ndarray, "k"]  #: n of ``|x|^n + |y|^2 = 1``; 2 is an ellipse
    shift_m: Float[np.ndarray, "k"]  #: of the centre along y
    breaks_m: Float[np.ndarray, "b"]  #: heights where a mesh should have a ring
    walls: tuple[tuple[float, float, float], ...]  #: from z, to z, thickness; later ones take precedence
    dents: tuple[tuple[float, float, float, float, float], ...]  #: z, angle, depth, width, height
    name: str

    @classmethod
    def of(cls, container: ContainerDescription) -> WallProfile:
        """The validated profile of a description.

        Parameters
        ----------
        container
            Without ranges.

        Raises
        ------
        InputError
            It has ranges; or the wall would intersect itself, or is thicker than its radius of curvature.
        """
        if container.free_parameters:
            raise InputError(
                f"container {container.name}",
                f"{len(container.free_parameters)} numbers are ranges, the first is "
                f"{container.free_parameters[0]}",
                remedy="use a variant, or the nominal container",
            )
        knots, walls = _section_knots(container)
        band_breaks, bands = _wall_bands(container, float(knots[-1, 0]))
        breaks = _distinct(np.array([*knots[:, 0], *band_breaks]), 1e-6 * float(knots[-1, 0]))
        z: np.ndarray = np.unique(
            np.concatenate([np.linspace(a, b, FINE + 1) for a, b in itertools.pairwise(breaks)])
        )
        blend = container.blend[0]
        bulge = np.array([section.bulge[0] for section in container.sections])
        radius_x = _along(z, knots[:, 0], knots[:, 1], bulge, blend)
        radius_y = _along(z, knots[:, 0], knots[:, 2], bulge, blend)
        for ring in container.rings:
            window = _window((np.asarray(z) - ring.z[0]) / ring.width[0])
            radius_x, radius_y = radius_x + ring.depth[0] * window, radius_y + ring.depth[0] * window
        found = cls(
            z,
            radius_x,
            radius_y,
            2.0 / (1.0 - np.interp(z, knots[:, 0], knots[:, 3])),
            _along(z, knots[:, 0], knots[:, 4], np.zeros_like(bulge), blend),
            breaks,
            (*walls, *bands),
            tuple(
                (dent.z[0], dent.angle[0], dent.depth[0], dent.width[0], dent.height[0])
                for dent in container.dents
            ),
            container.name,
        )
        found._check(container)
        return found

    @property
    def height_m(self) -> float:
        """Height of the mouth above the foot [m]."""
        return float(self.z_m[-1])

    def wall_m(self, z_m: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
        """Thickness of the wall [m].

        Parameters
        ----------
        z_m
            Heights above the foot [m].
        """
        out = np.full(len(z_m), self.walls[0][2])
        for low, high, wall in self.walls:
            out[(z_m >= low) & (z_m <= high)] = wall
        return out

    def ring(self, z_m: Float[np.ndarray, "m"], around: int) -> Float[np.ndarray, "m n 3"]:
        """Points on horizontal sections, equally spaced; exactly mirror-symmetric without shift and dents.

        Parameters
        ----------
        z_m
            Heights of the m sections above the foot [m].
        around
            Points n of each section, a multiple of 4; the first is on x+.

        Returns
        -------
        (m, n, 3) array
            In the container's frame [m], counter-clockwise from above.
        """
        x, y, exponent, shift = (
            np.interp(z_m, self.z_m, values)
            for values in (self.radius_x_m, self.radius_y_m, self.exponent, self.shift_m)
        )
        section = unit_section(x, y, exponent, around)
        out = np.empty((len(z_m), around, 3))
        out[..., 0] = section[..., 0]
        out[..., 1] = section[..., 1]
        for z, angle, depth, width, height in self.dents:
            out[..., :2] *= 1 - _dent(out, z_m, z, angle, depth, width, height)[..., None]
        out[..., 1] += shift[:, None]
        out[..., 2] = z_m[:, None]
        return out

    def _check(self, container: ContainerDescription) -> None:
        wall = self.wall_m(self.z_m)
        small = np.minimum(self.radius_x_m, self.radius_y_m)
        if (small <= wall).any():
            worst = int(np.argmin(small - wall))
            raise _bad(
                container,
                f"radius {small[worst]:.4g} m at height {self.z_m[worst]:.4g} m, "
                f"expected more than the wall of {wall[worst]:.4g} m: the wall would intersect itself",
                "sections",
            )
        # Smallest radius of curvature around the section: b^2 / a at the tips of an ellipse.
        tip = small**2 / np.maximum(self.radius_x_m, self.radius_y_m)
        if (tip < wall / 2).any():
            worst = int(np.argmin(tip - wall / 2))
            raise _bad(
                container,
                f"radius of curvature {tip[worst]:.4g} m at height {self.z_m[worst]:.4g} m, expected at "
                f"least half of the wall of {wall[worst]:.4g} m",
                "sections",
            )
        for ring in container.rings:
            # Curvature of depth * cos^2 at its crest.
            bend = 2 * np.pi**2 * abs(ring.depth[0]) / ring.width[0] ** 2
            thick = float(self.wall_m(np.array([ring.z[0]]))[0])
            if bend * thick > 2:
                raise _bad(
                    container,
                    f"the ring at {ring.z[0]:.4g} m has a radius of curvature of {1 / bend:.3g} m, "
                    f"expected at least half of the wall of {thick:.4g} m",
                    "rings",
                )
        for z, _angle, depth, width, height in self.dents:
            if not 0 <= z <= self.height_m:
                raise _bad(container, f"the dent at {z:.4g} m is not on the wall", "dents")
            there = float(np.interp(z, self.z_m, small))
            if depth >= 0.8 * there or width > 3 * there or height > 2 * self.height_m:
                raise _bad(
                    container,
                    f"the dent at {z:.4g} m is larger than the container "
                    f"({depth:.4g} m deep where the radius is {there:.4g} m)",
                    "dents",
                )


def unit_section(
    radius_x_m: Float[np.ndarray, "m"],
    radius_y_m: Float[np.ndarray, "m"],
    exponent: Float[np.ndarray, "m"],
    around: int,
) -> Float[np.ndarray, "m n 2"]:
    """Closed curves ``|x/a|^n + |y/b|^2 = 1`` at equal arc lengths, the first point on x+.

    One quarter is computed and mirrored, so that both mirror symmetries are exact in floating point.

    Parameters
    ----------
    radius_x_m, radius_y_m
        Half-axes a and b of the m curves [m].
    exponent
        n of each curve, at least 2.
    around
        Points of each curve, a multiple of 4.
    """
    quarter = around // 4
    fine = np.linspace(0.0, np.pi / 2, 257)
    cosine, sine = np.cos(fine), np.sin(fine)
    cosine[-1] = 0.0
    n = exponent[:, None]

    def curve(c: np.ndarray, s: np.ndarray) -> np.ndarray:
        # Newton's method from outside on a convex, increasing function of the polar radius.
        r = 1.0 / np.maximum(np.maximum(c, s), 1e-300) * np.ones_like(n)
        for _ in range(30):
            power = (r * c) ** n
            step = (power + (r * s) ** 2 - 1) / (n * power / r + 2 * r * s * s)
            r = r - step
            if np.abs(step).max() < 1e-15:
                break
        return np.stack([radius_x_m[:, None] * r * c, radius_y_m[:, None] * r * s], axis=-1)

    points = curve(cosine, sine)
    length = np.concatenate(
        [np.zeros((len(points), 1)), np.cumsum(np.linalg.norm(np.diff(points, axis=1), axis=2), axis=1)], 1
    )
    fractions = np.linspace(0.0, 1.0, quarter + 1)
    angle = np.stack([np.interp(fractions, row / row[-1], fine) for row in length])
    c, s = np.cos(angle), np.sin(angle)
    c[:, -1], s[:, 0] = 0.0, 0.0
    first = curve(c, s)
    first[:, -1, 0] = 0.0
    first[:, 0, 1] = 0.0
    back = first[:, -2::-1] * np.array([-1.0, 1.0])
    half = np.concatenate([first, back], axis=1)
    return np.concatenate([half, half[:, -2:0:-1] * np.array([1.0, -1.0])], axis=1)


def _section_knots(
    container: ContainerDescription,
) -> tuple[Float[np.ndarray, "s 5"], list[tuple[float, float, float]]]:
    """Height, both half-axes, flatness and shift at the ends of the sections; and the wall of each section."""
    base = container.base
    ends = [(0.0, base.radius[0], (base.radius_y or base.radius)[0], base.flatness[0], 0.0)]
    walls: list[tuple[float, float, float]] = []
    for section in container.sections:
        low, below_x, below_y, below_flatness, below_shift = ends[-1]
        high = low + section.height[0]
        end_x = section.radius[0] if section.radius else below_x
        end_y = section.radius_y[0] if section.radius_y else end_x * below_y / below_x
        flatness = section.flatness[0] if section.flatness else below_flatness
        shift = section.shift[0] if section.shift else below_shift
        ends.append((high, end_x, end_y, flatness, shift))
        walls.append((low, high, (section.wall or container.wall)[0]))
    return np.array(ends), walls


def _wall_bands(
    container: ContainerDescription, height_m: float
) -> tuple[list[float], list[tuple[float, float, float]]]:
    """Heights where rings and rim need a ring of the mesh; and the bands whose wall thickness they change."""
    breaks: list[float] = []
    walls: list[tuple[float, float, float]] = []
    for ring in container.rings:
        z, half = ring.z[0], ring.width[0] / 2
        if not 0 <= z - half <= z + half <= height_m:
            raise _bad(container, f"the ring at {z:g} m reaches beyond 0 to {height_m:g} m", "rings")
        breaks += [z - half, z - half / 2, z, z + half / 2, z + half]
        if ring.wall:
            walls.append((z - half, z + half, ring.wall[0]))
    if container.rim:
        band = container.rim.height[0]
        if band >= height_m:
            raise _bad(container, f"found {band:g} m, expected less than {height_m:g} m", "rim")
        walls.append((height_m - band, height_m, container.rim.wall[0]))
        breaks.append(height_m - band)
    return breaks, walls


def _along(
    z: np.ndarray, ends: np.ndarray, values: np.ndarray, bulge: np.ndarray, blend: float
) -> np.ndarray:
    """Sections from end to end, curved by their sagitta, blended over ``blend``."""

    def plain(at: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        low, high = ends[index], ends[index + 1]
        fraction = (at - low) / (high - low)
        rise = values[index + 1] - values[index]
        value = values[index] + fraction * rise + 4 * bulge[index] * fraction * (1 - fraction)
        slope = (rise + 4 * bulge[index] * (1 - 2 * fraction)) / (high - low)
        return value, slope

    index = np.clip(np.searchsorted(ends, z, side="right") - 1, 0, len(ends) - 2)
    out = plain(z, index)[0]
    for joint in range(1, len(ends) - 1):
        half = min(blend / 2, 0.45 * (ends[joint] - ends[joint - 1]), 0.45 * (ends[joint + 1] - ends[joint]))
        inside = np.abs(z - ends[joint]) < half
        if not half or not inside.any():
            continue
        a, slope_a = plain(np.array([ends[joint] - half]), np.array([joint - 1]))
        b, slope_b = plain(np.array([ends[joint] + half]), np.array([joint]))
        t = (z[inside] - ends[joint] + half) / (2 * half)
        out[inside] = (
            (2 * t**3 - 3 * t**2 + 1) * a
            + (t**3 - 2 * t**2 + t) * 2 * half * slope_a
            + (3 * t**2 - 2 * t**3) * b
            + (t**3 - t**2) * 2 * half * slope_b
        )
    return out


def _window(fraction: np.ndarray) -> np.ndarray:
    """cos^2: one at the centre, zero beyond half a width."""
    return np.where(np.abs(fraction) < 0.5, np.cos(np.pi * fraction) ** 2, 0.0)


def _dent(
    points: np.ndarray, z_m: np.ndarray, z: float, angle: float, depth: float, width: float, height: float
) -> np.ndarray:
    radius = np.hypot(points[..., 0], points[..., 1])
    turn = np.arctan2(points[..., 1], points[..., 0]) - angle
    along = radius * np.abs(wrap_angle(turn))
    return depth / radius * _window(along / width) * _window((z_m - z) / height)[:, None]


def _distinct(values: np.ndarray, tolerance: float) -> np.ndarray:
    values = np.sort(values)
    keep = np.concatenate([[True], np.diff(values) > tolerance])
    out: np.ndarray = values[keep]
    return out


def _bad(container: ContainerDescription, problem: str, field: str) -> InputError:
    return InputError(f"container {container.name}", problem, field=field)

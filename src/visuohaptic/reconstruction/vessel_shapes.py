"""Upright bodies, and profiles of upright vessels of several classes of shapes, with uniform parameters.

Four classes that people make: straight (tumblers, jars), with a shoulder and a neck (bottles), with a stem (wine glasses, goblets),
and bowls. The ranges of the parameters are wide; what is known of a vessel weights the draws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np
from jaxtyping import Bool, Float, Int

#: Number of heights at which a profile is given, and of parameters of a class.
STEPS, PARAMETERS = 65, 6


@dataclass(frozen=True, slots=True, eq=False)
class OutlineRings:
    """Circles around the axis of an upright body, on its outline (:mod:`.transparency.outline_rings`)."""

    z_m: Float[np.ndarray, "n"] = field(default_factory=partial(np.zeros, 0))  #: heights [m]
    radius_m: Float[np.ndarray, "n"] = field(default_factory=partial(np.zeros, 0))  #: radii [m]
    sigma_m: Float[np.ndarray, "n"] = field(default_factory=partial(np.zeros, 0))  #: of the radii [m]
    common_m: float = 0.0  #: standard deviation of an error that all radii have in common [m]


@dataclass(frozen=True, slots=True, eq=False)
class UprightBody:
    """A truncated cone that stands, or leans on something, with the standard deviations of its axis and radius.

    Its ends are at right angles to its axis.
    """

    axis_m: Float[np.ndarray, "2"]  #: x, y of its axis at half of its height [m]
    axis_sigma_m: Float[np.ndarray, "2"]  #: standard deviations of the axis [m]
    radius_m: tuple[float, float]  #: lower and upper radius [m]
    radius_sigma_m: float  #: standard deviation of a common change of both radii [m]
    height_m: tuple[float, float]  #: z of the lower and upper end of its axis [m]
    evidence: float  #: log-likelihood ratio against no body [nat]
    rings: OutlineRings = field(default_factory=OutlineRings)  #: its radius at single heights
    lean_m: tuple[float, float] = (0.0, 0.0)  #: x, y of the upper end of its axis less those of the lower [m]
    #: standard deviations of x, y of the lower and upper end of the axis, if it leans [m]
    ends_sigma_m: Float[np.ndarray, "2 2"] | None = None

    @property
    def shape_m(self) -> Float[np.ndarray, "8"]:
        """x, y of the axis, lower and upper radius, lower and upper height, lean [m]."""
        return np.array([*self.axis_m, *self.radius_m, *self.height_m, *self.lean_m])

    @property
    def lean_rad(self) -> float:
        """Angle between its axis and the vertical [rad]."""
        return float(np.arctan2(np.hypot(*self.lean_m), self.height_m[1] - self.height_m[0]))

    def axis_at_m(self, z_m: float) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
        """x, y of the axis at a height, also beyond its ends, and their standard deviations [m].

        Both are linear in position and lean, whose covariance follows from the deviations at the middle and at both ends.

        Parameters
        ----------
        z_m
            Height [m].
        """
        part = (z_m - np.mean(self.height_m)) / (self.height_m[1] - self.height_m[0])
        middle = self.axis_sigma_m**2
        low, high = (middle, middle) if self.ends_sigma_m is None else self.ends_sigma_m**2
        square = middle + part * (high - low) + part**2 * (2 * (low + high) - 4 * middle)
        return self.axis_m + part * np.array(self.lean_m), np.sqrt(np.maximum(square, 0.0))

    def meets(self, other: UprightBody) -> bool:
        """Whether two bodies intersect, with the means of their radii.

        Parameters
        ----------
        other
            The other body.
        """
        apart_m = float(np.hypot(*(self.axis_m - other.axis_m)))
        return apart_m < 0.5 * (sum(self.radius_m) + sum(other.radius_m))

    def points_m(self, voxel_m: float) -> Float[np.ndarray, "n 3"]:
        """Points inside the body on a grid of the voxel spacing (n, 3) [m].

        Parameters
        ----------
        voxel_m
            Spacing of the points along each axis [m].
        """
        low, high = (end(end_circles(self.shape_m, 16), axis=0) for end in (np.min, np.max))
        sides = [np.arange(a, b + voxel_m, voxel_m) for a, b in zip(low, high, strict=True)]
        found: Float[np.ndarray, "n 3"] = np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 3)
        return found[self.contains(found)]

    def contains(self, points_m: Float[np.ndarray, "n 3"], margin_m: float = 0.0) -> Bool[np.ndarray, "n"]:
        """Whether points are inside the body.

        Parameters
        ----------
        points_m
            Points (n, 3) [m].
        margin_m
            Growth of its radii and of its height at both ends [m].
        """
        middle_m = np.array([*self.axis_m, np.mean(self.height_m)])
        axis_m = np.array([*self.lean_m, self.height_m[1] - self.height_m[0]])
        half_m = 0.5 * float(np.linalg.norm(axis_m))
        along_m = (points_m - middle_m) @ axis_m / (2 * half_m)
        away_m = np.sqrt(np.maximum(((points_m - middle_m) ** 2).sum(axis=1) - along_m**2, 0.0))
        inside: Bool[np.ndarray, "n"] = (
            away_m <= np.interp(along_m, (-half_m, half_m), self.radius_m) + margin_m
        )
        return inside & (np.abs(along_m) <= half_m + margin_m)


def end_circles(
    shape_m: Float[np.ndarray, "n"], number: int, fraction: float = 1.0
) -> Float[np.ndarray, "points 3"]:
    """Points on the two circles that bound a truncated cone, the lower one first [m].

    Parameters
    ----------
    shape_m
        x, y of the axis, lower and upper radius, lower and upper height, and lean along x and y, if it leans [m].
    number
        Number of points on each.
    fraction
        Fraction of the radii.
    """
    lean_m = shape_m[6:] if len(shape_m) > 6 else np.zeros(2)
    axis_m = np.array([*lean_m, shape_m[5] - shape_m[4]])
    x, y, z = axis_m / np.sqrt(axis_m @ axis_m)
    # The level directions, turned with the axis.
    across = np.array(
        [[1 - x * x / (1 + z), -x * y / (1 + z), -x], [-x * y / (1 + z), 1 - y * y / (1 + z), -y]]
    )
    ring, middle_m = _circle(number) @ across, np.array([*shape_m[:2], 0.5 * (shape_m[4] + shape_m[5])])
    both = [middle_m + (k - 0.5) * axis_m + fraction * shape_m[2 + k] * ring for k in (0, 1)]
    return np.concatenate(both)


@cache
def _circle(number: int) -> Float[np.ndarray, "number 2"]:
    turn = 2 * np.pi * np.arange(number) / number
    return np.column_stack([np.cos(turn), np.sin(turn)])


def vessel_profiles(
    kind: Int[np.ndarray, "n"], parameters: Float[np.ndarray, "n 6"]
) -> Float[np.ndarray, "n steps"]:
    """Radii of vessels (n, steps) from foot to rim at equal steps of the height, in units of the largest one.

    Parameters
    ----------
    kind
        Class of each vessel (n): straight, shouldered, stemmed, bowl.
    parameters
        Parameters of each vessel (n, 6), between 0 and 1; a class may use fewer.
    """
    t, found = np.linspace(0.0, 1.0, STEPS), np.empty((len(kind), STEPS))
    for number, profile in enumerate(_CLASSES):
        own = kind == number
        found[own] = profile(t, *parameters[own].T[..., None])
    return found / found.max(axis=1, keepdims=True)


@cache
def drawn_vessels(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Classes (n), parameters (n, 6) and profiles (n, steps) of vessels with equally frequent classes and uniform parameters.

    Parameters
    ----------
    count
        Number of vessels n.
    """
    kind, parameters = np.arange(count) % 4, np.random.default_rng(0).random((count, PARAMETERS))
    return kind, parameters, vessel_profiles(kind, parameters)


def _ramp(x: np.ndarray) -> np.ndarray:
    """Smooth step from 0 to 1."""
    x = np.clip(x, 0.0, 1.0)
    return x**2 * (3 - 2 * x)


def _straight(t: np.ndarray, foot: np.ndarray, *_: np.ndarray) -> np.ndarray:
    foot = 0.5 + foot
    return foot + (1 - foot) * t


def _shouldered(
    t: np.ndarray, start: np.ndarray, width: np.ndarray, neck: np.ndarray, *_: np.ndarray
) -> np.ndarray:
    return 1 - (0.05 + 0.75 * neck) * _ramp((t - 0.35 - 0.55 * start) / (0.05 + 0.35 * width))


def _stemmed(
    t: np.ndarray,
    foot: np.ndarray,
    edge: np.ndarray,
    stem: np.ndarray,
    start: np.ndarray,
    width: np.ndarray,
    rim: np.ndarray,
) -> np.ndarray:
    stem, start, width = 0.05 + 0.25 * stem, 0.2 + 0.5 * start, 0.15 + 0.45 * width
    base = stem + (0.5 + 0.6 * foot - stem) * (1 - _ramp(t / (0.02 + 0.13 * edge)))
    x = np.clip((t - start) / width, 0.0, 1.0)
    bowl = stem + (1 - stem) * np.sqrt(x * (2 - x))
    taper = np.clip((t - start - width) / np.maximum(1 - start - width, 1e-3), 0.0, 1.0)
    return np.maximum(base, bowl * (1 - (0.35 * rim) * taper))


def _bowl(t: np.ndarray, foot: np.ndarray, power: np.ndarray, *_: np.ndarray) -> np.ndarray:
    foot = 0.3 + 0.6 * foot
    return foot + (1 - foot) * t ** (0.3 + 0.9 * power)


_CLASSES: tuple[Callable[..., np.ndarray], ...] = (_straight, _shouldered, _stemmed, _bowl)

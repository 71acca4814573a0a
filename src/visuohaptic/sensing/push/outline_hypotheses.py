"""Hypotheses of outlines for an impression in the foam, and start values of their fits.

Symbols: u along the strip, v towards the base, delta = v - rest(u) >= 0 the deflection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ._primitive_kernels import BENT, ROUND, STRAIGHT

#: Position of an absent tip in the parameters of the kernels [m].
FAR_M = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class Impression:
    """Contour of the foam under contact, in coordinates of the strip; K points."""

    u_m: Float[np.ndarray, "K"]  #: positions along the strip, increasing [m]
    delta_m: Float[np.ndarray, "K"]
    sigma_m: Float[np.ndarray, "K"]
    rest: Float[np.ndarray, "3"]  #: rest(u) = r0 + r1 u + r2 u² [m], v of the undeformed front
    spacing_m: float

    @property
    def scale_m(self) -> float:
        """Largest deflection [m]."""
        return float(self.delta_m.max())

    @property
    def cut(self) -> tuple[bool, bool]:
        """Whether the strip ends (left, right) before the foam is undeformed again."""
        limit = np.maximum(0.1 * self.scale_m, 10 * self.sigma_m)
        return bool(self.delta_m[0] > limit[0]), bool(self.delta_m[-1] > limit[-1])

    @property
    def v_m(self) -> Float[np.ndarray, "K"]:
        """Position of the points towards the base, v [m]."""
        return self.delta_m + self.rest[0] + (self.rest[1] + self.rest[2] * self.u_m) * self.u_m


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """An outline that may have touched the foam."""

    name: str
    family: int
    free: tuple[int, ...]  #: indices of the shape parameters that are fitted
    #: start values of all shape parameters, without those of the flanks
    starts: tuple[Float[np.ndarray, "p"], ...]


def hypotheses(impression: Impression) -> list[Hypothesis]:
    """All plausible outlines, with start values from simple fits to the deepest points.

    Parameters
    ----------
    impression
        The measured contour.
    """
    peak = _Peak.of(impression)
    half = 0.5 * impression.spacing_m
    faces, bends = _faces(impression, peak), _bends(impression, peak)
    left_slope, right_slope = max(faces[0][1], 0.05), max(-faces[1][1], 0.05)
    places = (peak.u, peak.core_centre)
    tip_left = (
        *peak.tips(half, left=True),
        np.array([*faces[1], peak.u - half, FAR_M]),
        np.array([*bends[1][:2], bends[1][2] - half, FAR_M]),
    )
    tip_right = (
        *peak.tips(half, right=True),
        np.array([*faces[0], -FAR_M, peak.u + half]),
        np.array([*bends[0][:2], -FAR_M, bends[0][2] + half]),
    )
    points = tuple(np.array([u, peak.v, 50.0, 50.0]) for u in places)
    corners = tuple(np.array([u, peak.v, left_slope, right_slope]) for u in places)
    return [
        Hypothesis("line", STRAIGHT, (0, 1), peak.tips(half)),
        Hypothesis("tip_left", STRAIGHT, (0, 1, 2), tip_left),
        Hypothesis("tip_right", STRAIGHT, (0, 1, 3), tip_right),
        Hypothesis("two_tips", STRAIGHT, (0, 1, 2, 3), peak.tips(half, left=True, right=True)),
        Hypothesis("point", BENT, (0, 1), points),
        Hypothesis("corner", BENT, (0, 1, 2, 3), corners),
        Hypothesis("circle", ROUND, (0, 1, 2), _circles(impression, peak)),
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Peak:
    """The deepest point of an impression, and lines through the deepest points."""

    u: float
    v: float
    lines: list[tuple[float, float]]  #: v at u = 0 [m] and slope, for the deepest 15 %, 40 % and 70 %
    spans: list[tuple[float, float]]  #: first and last u of the same points [m]

    @classmethod
    def of(cls, impression: Impression) -> _Peak:
        u, delta = impression.u_m, impression.delta_m
        deepest = int(np.argmax(delta))
        cores = [delta >= fraction * impression.scale_m for fraction in (0.85, 0.6, 0.3)]
        return cls(
            float(u[deepest]),
            float(impression.v_m[deepest]),
            [_line(impression, core) for core in cores],
            [(float(u[core].min()), float(u[core].max())) for core in cores],
        )

    @property
    def core_centre(self) -> float:
        return 0.5 * (self.spans[0][0] + self.spans[0][1])

    def tips(self, half: float, *, left: bool = False, right: bool = False) -> tuple[np.ndarray, ...]:
        """Start values of a straight outline with or without tips half a spacing beyond the core."""
        return tuple(
            np.array([a, m, low - half if left else -FAR_M, high + half if right else FAR_M])
            for (a, m), (low, high) in zip(self.lines, self.spans, strict=True)
        )


def _line(impression: Impression, keep: Bool[np.ndarray, "K"]) -> tuple[float, float]:
    """Weighted least-squares line v = level + slope u through the points in ``keep``."""
    u, v, w = impression.u_m[keep], impression.v_m[keep], 1.0 / impression.sigma_m[keep]
    if len(u) < 2:
        return float(impression.v_m.max()), 0.0
    slope, level = np.polyfit(u, v, 1, w=w)
    return float(level), float(slope)


def _faces(impression: Impression, peak: _Peak) -> list[tuple[float, float]]:
    """Lines of the two faces that meet at the deepest point, each from the points on its side."""
    faces = []
    for side in (-1, 1):
        own = side * (impression.u_m - peak.u) >= 0
        near = own & (impression.delta_m >= 0.5 * impression.scale_m)
        faces.append(_line(impression, near if near.sum() >= 2 else own))
    return faces


def _bends(impression: Impression, peak: _Peak) -> list[tuple[float, float, float]]:
    """Lines on both sides of the sharpest convex bend, and its u: a tip that need not be the deepest point."""
    u, v = impression.u_m, impression.v_m
    bend = v[2:] - 2 * v[1:-1] + v[:-2]
    kink = float(u[1 + int(np.argmin(bend))]) if len(u) >= 5 else peak.u
    return [(*_line(impression, side * (u - kink) >= 0), kink) for side in (-1, 1)]


def _circles(impression: Impression, peak: _Peak) -> tuple[Float[np.ndarray, "3"], ...]:
    """Circles through the deepest points, and two of typical size that touch the deepest one."""
    u, v = impression.u_m, impression.v_m
    rounds = []
    for fraction in (0.8, 0.5, 0.3):
        core = impression.delta_m >= fraction * impression.scale_m
        if core.sum() < 3:
            core = np.abs(u - peak.u) <= 2.1 * impression.spacing_m
        try:
            a, b, radius = fit_circle_algebraic(np.column_stack([u[core], v[core]]))
        except ValueError:
            continue
        below = b < v[core].mean()  # the object's body is at smaller v than its tip
        radius = float(np.clip(radius if below else 0.3, 0.006, 0.5))
        rounds.append(np.array([a if below else peak.u, b + radius if below else peak.v, np.log(radius)]))
    return (*rounds, *(np.array([peak.u, peak.v, np.log(radius)]) for radius in (0.012, 0.05)))


def fit_circle_algebraic(points_m: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "3"]:
    """Taubin's circle fit: minimises sum (z - 2ax - 2by + c)², z = x² + y², normalised by the mean squared gradient.

    Almost unbiased for short arcs, where the plain algebraic fit (Kåsa)
    underestimates the radius. Solved by a singular value decomposition of the
    centred data, which is accurate also for nearly straight arcs.

    Parameters
    ----------
    points_m
        At least three points (K, 2) [m], not all collinear.

    Returns
    -------
    Centre and radius (a, b, R) [m].

    Raises
    ------
    InputError
        Fewer than three points, or exactly collinear or coincident ones.

    Notes
    -----
    Alt 2016, Sec. 3.3.3 ("algebraic approach described in [81]").
    """
    points = np.asarray(points_m, dtype=float)
    if len(points) < 3:
        raise InputError("points_m", f"found {len(points)} points, expected at least 3 for a circle")
    centroid = points.mean(axis=0)
    xy = points - centroid
    z = np.einsum("ki,ki->k", xy, xy)
    mean = z.mean()
    if mean <= 0:
        raise InputError("points_m", "found coinciding points, expected points on an arc")
    z0 = (z - mean) / (2.0 * np.sqrt(mean))
    _, _, rows = np.linalg.svd(np.column_stack([z0, xy]), full_matrices=False)
    v = rows[-1]
    if abs(v[0]) < 1e-12 * np.linalg.norm(v):
        raise InputError("points_m", "found collinear points, expected points on an arc")
    first = v[0] / (2.0 * np.sqrt(mean))
    offset = -mean * first
    centre = -v[1:] / (2.0 * first)
    radius = np.sqrt(v[1] ** 2 + v[2] ** 2 - 4.0 * first * offset) / (2.0 * abs(first))
    return np.array([*(centre + centroid), radius])

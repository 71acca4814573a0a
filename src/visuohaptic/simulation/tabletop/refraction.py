"""Ray-tracing scenes of glass, liquid, mirrors and opaque objects: solids of revolution and boxes.

Profiles are exact quadrics with normals smoothed along the profile: facets of a
mesh would refract rays in steps. A squashed solid is elliptic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from ...core import InputError, finite_array

#: Refractive indices at the 850 nm of the usual projectors [1].
AIR, WATER, GLASS, PET = 1.0, 1.33, 1.51, 1.57

Kind = Literal["glass", "opaque", "mirror"]
_KINDS: dict[str, float] = {"glass": 0.0, "opaque": 1.0, "mirror": 2.0}
#: Edges of a profile with a larger angle stay sharp [rad].
_CREASE_RAD = math.radians(40)


@dataclass(frozen=True, slots=True)
class Band:
    """Opaque label or cap around a solid, 0.2 mm outside its wall."""

    low_m: float  #: height above the foot where it starts [m]
    high_m: float  #: and where it ends [m]
    first_rad: float = 0.0  #: first angle around the axis [rad]
    width_rad: float = 2 * math.pi  #: arc that it covers [rad]
    albedo: float = 0.7  #: diffuse reflectance at the projector's wavelength


@dataclass(frozen=True, slots=True, eq=False)
class Revolution:
    """Solid of revolution about an upright axis: bottle, drinking glass, can, ball."""

    foot_m: tuple[float, float, float]  #: point on the axis where the profile's z is 0, world [m]
    profile_m: Float[np.ndarray, "points 2"]  #: outside from the foot up, (radius, height) [m]
    kind: Kind = "glass"  #: material
    wall_m: float | None = None  #: thickness of the wall; None = solid [m]
    index: float = GLASS  #: refractive index of the wall
    fill: float = 0.0  #: fraction of the inner height with liquid, 0-1
    fill_index: float = WATER  #: refractive index of the liquid
    bands: tuple[Band, ...] = ()  #: labels, caps
    yaw_rad: float = 0.0  #: rotation about the axis [rad]
    squash: float = 1.0  #: factor of the width along its own x; 1 = round
    albedo: float = 0.6  #: of an opaque solid

    def __post_init__(self) -> None:
        profile = finite_array("Revolution", self.profile_m, None, 2, field="profile_m", least=2)
        if (profile[:, 0] < 0).any() or (np.diff(profile[:, 1]) < 0).any():
            raise InputError("Revolution", "expected radii >= 0 and rising heights", field="profile_m")
        object.__setattr__(self, "profile_m", profile)

    @property
    def height_m(self) -> float:
        """Height above the foot [m]."""
        return float(self.profile_m[-1, 1])

    def radius_m(self, height_m: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Outer radius (before the squash) at heights above the foot; 0 above and below [m].

        Parameters
        ----------
        height_m
            Heights above the foot [m].
        """
        return np.interp(height_m, self.profile_m[:, 1], self.profile_m[:, 0], left=0.0, right=0.0)

    def contains(self, points_m: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Whether points of the world lie inside the outer surface, contents included.

        Parameters
        ----------
        points_m
            Points (..., 3) of the world [m].
        """
        local = np.asarray(points_m) - np.asarray(self.foot_m)
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x = (c * local[..., 0] + s * local[..., 1]) / self.squash
        y = -s * local[..., 0] + c * local[..., 1]
        return (np.hypot(x, y) <= self.radius_m(local[..., 2])) & (local[..., 2] >= 0)

    def transparent_at(self, points_m: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Whether points are inside, at a height where no band hides more than half of the wall.

        Parameters
        ----------
        points_m
            Points (..., 3) of the world [m].
        """
        if self.kind != "glass":
            return np.zeros(np.shape(points_m)[:-1], dtype=bool)
        inside = self.contains(points_m)
        height = np.asarray(points_m)[..., 2] - self.foot_m[2]
        for band in self.bands:
            if band.width_rad > math.pi:
                inside &= ~((height >= band.low_m) & (height <= band.high_m))
        return inside


@dataclass(frozen=True, slots=True)
class Box:
    """Upright box: table, wall, carton, mirror, block of glass."""

    centre_m: tuple[float, float, float]  #: world [m]
    size_m: tuple[float, float, float]  #: full edges [m]
    kind: Kind = "opaque"
    yaw_rad: float = 0.0
    index: float = GLASS
    albedo: float = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class RefractingScene:
    """Solids and boxes, and the arrays that the ray kernels read."""

    solids: tuple[Revolution, ...] = ()
    boxes: tuple[Box, ...] = ()
    solid_rows: Float[np.ndarray, "n 10"] = field(init=False)  #: see ``_refraction_kernels``
    segment_rows: Float[np.ndarray, "m 14"] = field(init=False)
    box_rows: Float[np.ndarray, "k 12"] = field(init=False)

    def __post_init__(self) -> None:
        solid_rows: list[tuple[float, ...]] = []
        segment_rows: list[tuple[float, ...]] = []
        for solid in self.solids:
            segments = _segments(solid)
            first = len(segment_rows)
            segment_rows.extend(segments)
            bounds = max(max(row[0], row[2]) for row in segments) + 1e-6, solid.height_m + 1e-3
            turn = math.cos(solid.yaw_rad), math.sin(solid.yaw_rad)
            solid_rows.append((*solid.foot_m, *turn, solid.squash, *bounds, first, len(segment_rows)))
        box_rows = []
        for box in self.boxes:
            turn, half = (math.cos(box.yaw_rad), math.sin(box.yaw_rad)), (0.5 * edge for edge in box.size_m)
            box_rows.append((*box.centre_m, *turn, *half, _KINDS[box.kind], box.index, box.albedo, 0.0))
        object.__setattr__(self, "solid_rows", np.array(solid_rows, dtype=float).reshape(-1, 10))
        object.__setattr__(self, "segment_rows", np.array(segment_rows, dtype=float).reshape(-1, 14))
        object.__setattr__(self, "box_rows", np.array(box_rows, dtype=float).reshape(-1, 12))

    def opaque_twin(self) -> RefractingScene:
        """The same scene with all glass painted, as in the image pairs of ClearGrasp."""
        from dataclasses import replace

        return RefractingScene(
            tuple(replace(solid, kind="opaque") for solid in self.solids),
            tuple(replace(box, kind="opaque") if box.kind == "glass" else box for box in self.boxes),
        )


def _segments(solid: Revolution) -> list[tuple[float, ...]]:
    """Rows of a solid's rings: outside with the foot, the inner wall, liquid, bands."""
    outer = np.vstack([[0.0, solid.profile_m[0, 1]], solid.profile_m])
    if outer[1, 0] == 0.0:
        outer = outer[1:]
    kind = _KINDS[solid.kind]
    if solid.kind != "glass" or solid.wall_m is None:
        if outer[-1, 0] > 0:
            outer = np.vstack([outer, [0.0, outer[-1, 1]]])
        rows = _rings(outer, AIR, solid.index, kind, solid.albedo)
        return rows + [row for band in solid.bands for row in _band(solid, band)]
    floor_m = solid.profile_m[0, 1] + solid.wall_m
    heights = np.unique(np.append(solid.profile_m[solid.profile_m[:, 1] > floor_m, 1], floor_m))
    inside = np.column_stack([np.maximum(solid.radius_m(heights) - solid.wall_m, 0.0), heights])
    level_m = floor_m + solid.fill * (heights[-1] - floor_m)
    rows = _rings(outer, AIR, solid.index, kind, solid.albedo)
    if inside[-1, 0] > 0:  # the rim of an open mouth
        rows += _rings(
            np.array([[outer[-1, 0], outer[-1, 1]], inside[-1]]), AIR, solid.index, kind, solid.albedo
        )
    if solid.fill > 0:
        radius = float(np.interp(level_m, inside[:, 1], inside[:, 0]))
        surface = [radius, level_m]
        wet = np.vstack([inside[inside[:, 1] < level_m - 1e-9], surface])
        dry = np.vstack([surface, inside[inside[:, 1] > level_m + 1e-9]])
        rows += _rings(
            np.vstack([wet[::-1], [0.0, floor_m]]), solid.fill_index, solid.index, kind, solid.albedo
        )
        if len(dry) > 1:
            rows += _rings(dry[::-1], AIR, solid.index, kind, solid.albedo)
        rows += _rings(np.array([surface, [0.0, level_m]]), AIR, solid.fill_index, kind, solid.albedo)
    else:
        rows += _rings(np.vstack([inside[::-1], [0.0, floor_m]]), AIR, solid.index, kind, solid.albedo)
    return rows + [row for band in solid.bands for row in _band(solid, band)]


def _rings(
    profile: Float[np.ndarray, "n 2"], ahead: float, behind: float, kind: float, albedo: float
) -> list[tuple[float, ...]]:
    """Rings of a profile whose left side, in its direction, is behind the normal."""
    steps = np.diff(profile, axis=0)
    keep = np.hypot(*steps.T) > 1e-9
    profile, steps = np.vstack([profile[:1], profile[1:][keep]]), steps[keep]
    normals = np.column_stack([steps[:, 1], -steps[:, 0]]) / np.hypot(*steps.T)[:, None]
    starts, ends = normals.copy(), normals.copy()
    for i in range(len(normals) - 1):
        if normals[i] @ normals[i + 1] > math.cos(_CREASE_RAD):
            mean = normals[i] + normals[i + 1]
            ends[i] = starts[i + 1] = mean / np.linalg.norm(mean)
    return [
        (*profile[i], *profile[i + 1], *starts[i], *ends[i], ahead, behind, kind, 0.0, 7.0, albedo)
        for i in range(len(normals))
    ]


def _band(solid: Revolution, band: Band) -> list[tuple[float, ...]]:
    heights = solid.profile_m[:, 1]
    between = heights[(heights > band.low_m) & (heights < band.high_m)]
    levels = np.concatenate([[band.low_m], np.unique(between), [band.high_m]])
    radii = solid.radius_m(np.minimum(levels, solid.height_m)) + 2e-4
    profile = np.column_stack([radii, levels])
    if band.high_m >= solid.height_m - 1e-6:  # a cap closes the top
        profile = np.vstack([profile, [0.0, band.high_m]])
    rows = _rings(profile, AIR, AIR, _KINDS["opaque"], band.albedo)
    width = 7.0 if band.width_rad >= 2 * math.pi else band.width_rad
    return [(*row[:11], band.first_rad, width, band.albedo) for row in rows]

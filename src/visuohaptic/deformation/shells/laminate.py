"""Walls of plies by classical lamination theory: paper, coated board, moulded fibre (Jones 1999, Secs. 2.5 to 4.3).

Directions are those of the wall: 1 along the height, 2 around it to the left as seen from outside, 3 outwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ...core import FINITE, POSITIVE, InputError, check_ranges

#: A face with a smaller inclination has no direction along the height [rad]: single-precision coordinates of 0.3 m on
#: triangles of 1 mm cause inclinations up to 5e-5.
LEVEL_rad = 1e-4


@dataclass(frozen=True, slots=True)
class Ply:
    """One layer, orthotropic in its plane."""

    thickness_m: float = field(metadata=POSITIVE)
    youngs_modulus_Pa: float = field(metadata=POSITIVE)  #: E_1, along its grain
    poisson_ratio: float = 0.3  #: nu_12: contraction across the grain per extension along it
    across_Pa: float | None = field(default=None, metadata=POSITIVE)  #: E_2; equal to E_1 by default
    #: G_12; by default after Huber 1923, with means of both directions: sqrt(E_1 E_2) / (2 + 2 sqrt(nu_12 nu_21))
    shear_Pa: float | None = field(default=None, metadata=POSITIVE)
    #: angle of the grain from the height, to the left as seen from outside
    angle_rad: float = field(default=0.0, metadata=FINITE)
    density_kg_per_m3: float | None = field(default=None, metadata=POSITIVE)

    def __post_init__(self) -> None:
        check_ranges(self)
        largest = (self.youngs_modulus_Pa / (self.across_Pa or self.youngs_modulus_Pa)) ** 0.5
        if not abs(self.poisson_ratio) < largest:
            raise InputError(
                "ply",
                f"found {self.poisson_ratio:g}, expected less than sqrt(E_1 / E_2), {largest:.3g}",
                field="poisson_ratio",
            )

    @property
    def law_Pa(self) -> Float[np.ndarray, "3 3"]:
        """Stress for unit strain (11, 22, 2 12) in the directions of the wall."""
        young, nu = self.youngs_modulus_Pa, self.poisson_ratio
        across = self.across_Pa or young
        back = nu * across / young
        mean = np.sqrt(young * across) / (2 + 2 * np.sign(nu) * np.sqrt(nu * back))
        stiff = np.array([[young, nu * across, 0.0], [nu * across, across, 0.0], [0.0, 0.0, 0.0]])
        stiff /= 1 - nu * back
        stiff[2, 2] = self.shear_Pa or mean
        return turned_law(stiff, np.array(self.angle_rad))


@dataclass(frozen=True, slots=True)
class Laminate:
    """Bonded plies; if the wall has another thickness, all plies are scaled in proportion."""

    plies: tuple[Ply, ...]  #: from the inside of the container outwards
    name: str = "laminate"
    scale: float = field(default=1.0, metadata=POSITIVE)  #: relative standard deviation of all moduli

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.plies:
            raise InputError(self.name, "found no plies, expected at least one", field="plies")

    @property
    def thickness_m(self) -> float:
        """Total thickness of the plies."""
        return sum(ply.thickness_m for ply in self.plies)

    @property
    def density_kg_per_m3(self) -> float | None:
        """Mean density over the thickness; None if that of a ply is unknown."""
        found = [ply.density_kg_per_m3 for ply in self.plies]
        known = [density for density in found if density is not None]
        if len(known) < len(found):
            return None
        return sum(d * p.thickness_m for d, p in zip(known, self.plies, strict=True)) / self.thickness_m

    @property
    def sections(self) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
        """A / t, B / t^2, D / t^3: membrane, coupling and plate stiffness, normalised by the thickness t [Pa]."""
        edges, laws = self._layers()
        a, b, d = (np.tensordot(np.diff(edges**k) / k, laws, axes=1) for k in (1, 2, 3))
        return a, b, d

    @property
    def shares(self) -> Float[np.ndarray, "n"]:
        """Fraction of the plate's stiffness from each ply; the sum is 1."""
        edges, laws = self._layers()
        parts = np.diff(edges**3) * np.trace(laws, axis1=1, axis2=2)
        out: np.ndarray = parts / parts.sum()
        return out

    def _layers(self) -> tuple[Float[np.ndarray, "n+1"], Float[np.ndarray, "n 3 3"]]:
        """Boundaries of the plies, from -1/2 inside to 1/2 outside, and their laws [Pa]."""
        edges = np.cumsum([0.0, *(ply.thickness_m for ply in self.plies)]) / self.thickness_m - 0.5
        return edges, self.scale * np.stack([ply.law_Pa for ply in self.plies])

    @property
    def youngs_modulus_Pa(self) -> float:
        """Young's modulus of the wall under tension along the height, without bending."""
        return float(1 / np.linalg.inv(self.sections[0])[0, 0])

    @property
    def poisson_ratio(self) -> float:
        """Geometric mean of both in-plane Poisson's ratios of the wall without bending."""
        membrane = self.sections[0]
        return float(membrane[0, 1] / np.sqrt(membrane[0, 0] * membrane[1, 1]))

    @property
    def mirrored(self) -> bool:
        """Whether the wall is invariant under a mirror along the height: no unbalanced oblique ply."""
        sections = self.sections
        size = max(float(np.abs(part).max()) for part in sections)
        # 1e-9: rounding of sums of plies that cancel, in double precision.
        return all(float(np.abs(part[:2, 2]).max()) < 1e-9 * size for part in sections)

    def stiffer(self, factor: float) -> Laminate:
        """The same wall with all moduli multiplied.

        Parameters
        ----------
        factor
            Factor of each modulus.
        """
        return replace(self, scale=factor * self.scale)


def turned_law(
    law: Float[np.ndarray, "3 3"], angle_rad: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n 3 3"]:
    """Transform a plane law to axes that are rotated by an angle.

    Parameters
    ----------
    law
        For strain (xx, yy, 2 xy) in its own axes.
    angle_rad
        Angle from the new x axis to its own.
    """
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    rows = [[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]]
    turn = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    out: np.ndarray = np.swapaxes(turn, -1, -2) @ law @ turn
    return out


def wall_directions(
    vertices_m: Float[np.ndarray, "v 3"],
    faces: Float[np.ndarray, "f 3"],
    parts: Sequence[Float[np.ndarray, "3 3"]],
) -> list[Float[np.ndarray, "f 3 3"]]:
    """Laws of a wall in the frame of each triangle, x along its first side and z outwards.

    On a level face, of a foot or a cap, there is no direction along the height: it gets the mean over all directions.

    Parameters
    ----------
    vertices_m, faces
        Triangles with outward orientation, the third coordinate up.
    parts
        Laws in the axes of the wall.
    """
    side = vertices_m[faces[:, 1]] - vertices_m[faces[:, 0]]
    normal = np.cross(side, vertices_m[faces[:, 2]] - vertices_m[faces[:, 0]])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    angle = np.arctan2(np.cross(normal, side)[:, 2], side[:, 2])
    level = np.hypot(normal[:, 0], normal[:, 1]) < LEVEL_rad
    # Harmonics of a rotated law end at the fourth: eight directions are sufficient.
    round_ = np.pi * np.arange(8) / 8
    return [
        np.where(level[:, None, None], turned_law(part, round_).mean(axis=0), turned_law(part, angle))
        for part in parts
    ]

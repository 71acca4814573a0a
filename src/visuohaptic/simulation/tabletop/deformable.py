"""Containers that deform between two fingers, by the models of ``deformation``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...core import InputError, check_numbers, within
from ...core.measurement import AIR_PA

if TYPE_CHECKING:
    from ...deformation.shells.fourier_shell import RevolutionShell


@dataclass(frozen=True, slots=True)
class BulkFill:
    """Filling of a container."""

    kg_per_m3: float  #: of the heap, voids included
    solid: float  #: volume fraction of the grains


#: Minimum volume of air, as a fraction of the container's: liquids and their container are slightly compressible.
MIN_AIR = 0.01
#: Rice has a density of 1450 kg/m^3, two fifths of its bulk volume are air.
WATER_FILL, GRAIN_FILL = BulkFill(1000.0, 1.0), BulkFill(870.0, 0.6)


@dataclass(frozen=True, slots=True, eq=False)
class DeformableContainer:
    """Force-deformation curve of a pinch by two opposite tips, by height.

    Between heights and deformations it is linear.
    """

    name: str
    height_m: Float[np.ndarray, "k"]  #: of the pinches, ascending, above the table
    radius_m: Float[np.ndarray, "k"]  #: of the wall there
    deformation_m: Float[np.ndarray, "m"]  #: mean of both tips, from 0
    force_N: Float[np.ndarray, "k m"]  #: of one tip
    mass_kg: float = 0.05
    friction: float = 0.6  #: with the foam of the fingers
    #: radius of curvature under the tips; None: that of the wall
    bend_m: Float[np.ndarray, "k"] | None = None

    def __post_init__(self) -> None:
        k, m = len(self.height_m), len(self.deformation_m)
        if self.force_N.shape != (k, m) or self.radius_m.shape != (k,) or k < 2 or m < 2:
            raise InputError(
                "DeformableContainer",
                f"found forces {self.force_N.shape} for {k} heights and {m} deformations",
            )
        rising = (np.diff(self.height_m) > 0).all() and (np.diff(self.deformation_m) > 0).all()
        if not (rising and self.deformation_m[0] == 0 and (np.diff(self.force_N, axis=1) >= 0).all()):
            raise InputError(
                "DeformableContainer",
                "expected ascending heights and deformations from 0, and forces that rise",
            )

    @classmethod
    def of_revolution(
        cls,
        name: str,
        shell: RevolutionShell,
        material: str,
        *,
        closed: bool = False,
        fill: float = 0.0,
        max_m: float = 0.012,
        mass_kg: float = 0.05,
        filling: BulkFill = WATER_FILL,
    ) -> DeformableContainer:
        """Create it from the linear stiffness of a shell of revolution and its contents.

        A pinch of a round wall preserves the volume to first order; the deformed
        ring w = d cos(2 t) loses the area (3 pi / 2) d^2, over a
        length of about a diameter. The force of enclosed air grows with the third power
        of the deformation, and is larger the less air is left above a filling.

        Parameters
        ----------
        name
            Name of the object.
        shell
            Shape and wall.
        material
            Name of the material.
        closed
            The contents cannot escape.
        fill
            Fraction of the volume that is filled; the weight of the filling is always included.
        max_m
            Maximum deformation of the curves [m].
        mass_kg
            Mass of the empty container [kg].
        filling
            Filling.
        """
        from ...deformation.shells.fourier_shell import pinch_stiffness

        check_numbers("of_revolution", within(0.0, 1.0), fill=fill)
        stiffness = np.asarray(pinch_stiffness(shell, material))
        free = np.isfinite(stiffness)
        height, radius = np.asarray(shell.height_m)[free], np.asarray(shell.radius_m)[free]
        # Denser at the start, where the third power is negligible.
        depth = max_m * np.linspace(0.0, 1.0, 25) ** 2
        force = stiffness[free, None] * depth
        z, r = np.asarray(shell.height_m), np.asarray(shell.radius_m)
        volume = float(np.sum(0.5 * math.pi * (r[1:] ** 2 + r[:-1] ** 2) * np.diff(z)))
        if closed:
            air = max(1.0 - filling.solid * fill, MIN_AIR) * volume
            lost = 1.5 * math.pi * 2.0 * radius[:, None]
            force = force + AIR_PA * lost**2 * depth**3 / air
        return cls(name, height, radius, depth, force, mass_kg + filling.kg_per_m3 * fill * volume)

    def turned(self, angle_rad: float) -> DeformableContainer:
        """What fingers feel that close along a direction: the same in all of them.

        Parameters
        ----------
        angle_rad
            Direction [rad].
        """
        return self

    def bend_at(self, height_m: float) -> float:
        """Radius of curvature of the wall under the tips [m]; 0 below and above the object.

        Parameters
        ----------
        height_m
            Height above the foot [m].
        """
        bend = self.radius_m if self.bend_m is None else self.bend_m
        return float(np.interp(height_m, self.height_m, bend, left=0.0, right=0.0))

    def radius_at(self, height_m: float) -> float:
        """Radius of the wall [m]; 0 below and above the object.

        Parameters
        ----------
        height_m
            Height above the foot [m].
        """
        return float(np.interp(height_m, self.height_m, self.radius_m, left=0.0, right=0.0))

    def force_at(self, height_m: float, deformation_m: float) -> float:
        """Force of one tip [N]; beyond the last deformation the walls are in self-contact, ten times stiffer.

        Parameters
        ----------
        height_m
            Height above the foot [m].
        deformation_m
            Deformation under the tip [m].
        """
        if not self.height_m[0] <= height_m <= self.height_m[-1] or deformation_m <= 0:
            return 0.0
        index = min(int(np.searchsorted(self.height_m, height_m, side="right")), len(self.height_m) - 1)
        low, high = self.height_m[index - 1], self.height_m[index]
        fraction = float((height_m - low) / (high - low))
        curve = (1 - fraction) * self.force_N[index - 1] + fraction * self.force_N[index]
        last = self.deformation_m[-1]
        if deformation_m <= last:
            return float(np.interp(deformation_m, self.deformation_m, curve))
        slope = float((curve[-1] - curve[-2]) / (last - self.deformation_m[-2]))
        return float(curve[-1] + 10.0 * slope * (deformation_m - last))

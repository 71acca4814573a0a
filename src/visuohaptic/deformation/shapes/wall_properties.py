"""What is known of a container's wall: given by the user, measured in an imported mesh, or the usual values."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.ranges import POSITIVE, check_ranges, within
from ..shells.shell_material import IsotropicMaterial
from .resample import Wall

__all__ = ["WallProperties", "wall_thickness"]

#: Thickness of a wall of which neither mesh nor user say it [m], and its relative standard deviation.
USUAL_WALL_m, USUAL_SPREAD = 0.0005, 0.1


@dataclass(frozen=True, slots=True)
class WallProperties:
    """What a user says of a wall; what is None is as the description or the mesh has it."""

    material: str | None = None  #: of the library; PET by default where a mesh is read
    thickness_m: float | None = field(default=None, metadata=POSITIVE)  #: of the whole wall
    thickness_spread: float | None = field(
        default=None, metadata=within(0, 0.5)
    )  #: relative standard deviation
    youngs_modulus_Pa: float | None = field(default=None, metadata=POSITIVE)  #: instead of the material's
    poisson_ratio: float | None = None  #: instead of the material's

    def __post_init__(self) -> None:
        check_ranges(self)

    def elastic_constants(
        self, material: IsotropicMaterial, modulus_spread: float
    ) -> tuple[IsotropicMaterial, float]:
        """Constants of the wall, those that are given in place of the material's.

        Parameters
        ----------
        material
            Constants of the material.
        modulus_spread
            Relative standard deviation of its Young's modulus.

        Returns
        -------
        tuple
            Constants, and the relative standard deviation of the modulus: 0 for one that is given.
        """
        if self.youngs_modulus_Pa is None and self.poisson_ratio is None:
            return material, modulus_spread
        given = self.youngs_modulus_Pa is not None
        # A material that was named keeps its name, and with it its density.
        name = "given" if given and self.material is None else material.name
        constants = IsotropicMaterial(
            self.youngs_modulus_Pa or material.youngs_modulus_Pa,
            material.poisson_ratio if self.poisson_ratio is None else self.poisson_ratio,
            name,
        )
        return constants, 0.0 if given else modulus_spread


def wall_thickness(wall: Wall, given: WallProperties) -> tuple[Float[np.ndarray, "k 2"], float, list[str]]:
    """Thickness of an imported wall by height.

    Parameters
    ----------
    wall
        Wall found in a mesh, with one surface or two.
    given
        Thickness [m] and its relative standard deviation as the user has them, where they are not None.

    Returns
    -------
    tuple
        Heights and thickness there [m], relative standard deviation, notes for the user.
    """
    thickness_m, spread = given.thickness_m, given.thickness_spread
    if not wall.double:
        one = USUAL_WALL_m if thickness_m is None else thickness_m
        notes = [] if thickness_m else [f"the mesh has one surface: its wall is taken as {1e3 * one:.2g} mm"]
        return np.array([[0.0, one]]), USUAL_SPREAD if spread is None else spread, notes
    usual = float(np.median(wall.thickness_m[:, 1]))
    measured = f"{1e3 * usual:.3g} mm ± {100 * wall.thickness_spread:.2f} %"
    if thickness_m is None:
        low, high = 1e3 * wall.thickness_m[:, 1].min(), 1e3 * wall.thickness_m[:, 1].max()
        said = f"the wall is as thick as measured: {measured} by the median, {low:.2g} to {high:.2g} mm along the height"
        return wall.thickness_m, wall.thickness_spread if spread is None else spread, [said]
    spread = USUAL_SPREAD if spread is None else spread
    notes = []
    # Two-sided, at 5 %: the standard deviations of both add up.
    if abs(thickness_m - usual) > 1.96 * np.hypot(spread * thickness_m, wall.thickness_spread * usual):
        notes = [
            f"the thickness given, {1e3 * thickness_m:.2g} mm, contradicts the mesh, {measured}; it is used"
        ]
    return np.array([[0.0, thickness_m]]), spread, notes

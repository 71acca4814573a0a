"""Materials of a wall: elastic constants with their uncertainty (Alt 2016, Sec. 2.2.4, Table 2.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType

from ...core import POSITIVE, Estimate, InputError, Material, check_numbers


@dataclass(frozen=True, slots=True)
class IsotropicMaterial:
    """A homogeneous linear elastic material."""

    youngs_modulus_Pa: float  #: E, stress per strain along one axis
    poisson_ratio: float  #: nu, contraction across per extension along
    name: str = "unknown"

    def __post_init__(self) -> None:
        check_numbers("material", POSITIVE, youngs_modulus_Pa=self.youngs_modulus_Pa)
        if not -1 < self.poisson_ratio < 0.5:
            raise InputError(
                "material",
                f"found {self.poisson_ratio}, expected more than -1 and less than 0.5",
                field="poisson_ratio",
                remedy="for rubber use 0.49",
            )

    @property
    def lame_Pa(self) -> tuple[float, float]:
        """Lambda and mu of 3D elasticity [Pa] (Alt 2016, Eq. (2.2))."""
        young, nu = self.youngs_modulus_Pa, self.poisson_ratio
        return young * nu / ((1 + nu) * (1 - 2 * nu)), young / (2 * (1 + nu))

    @property
    def density_kg_per_m3(self) -> float | None:
        """Density from the library; None if the library does not contain the material."""
        entry = MATERIALS.get(self.name)
        return None if entry is None or entry.density_kg_per_m3 is None else entry.density_kg_per_m3.value

    def stiffer(self, factor: float) -> IsotropicMaterial:
        """The same wall with another modulus.

        Parameters
        ----------
        factor
            Factor of Young's modulus.
        """
        return replace(self, youngs_modulus_Pa=factor * self.youngs_modulus_Pa)

    @classmethod
    def of(cls, found: Material | IsotropicMaterial | str) -> IsotropicMaterial:
        """Best estimates of a material's constants.

        Parameters
        ----------
        found
            Material with estimates, constants (returned unchanged), or a name of the library.

        Raises
        ------
        InputError
            Unknown name, or a material without Young's modulus or Poisson's ratio.
        """
        if isinstance(found, IsotropicMaterial):
            return found
        if isinstance(found, str):
            found = material(found)
        if found.youngs_modulus_Pa is None or found.poisson_ratio is None:
            raise InputError(
                f"material {found.name}",
                "has no Young's modulus or no Poisson's ratio",
                remedy=f"give both, or use one of {', '.join(MATERIALS)}",
            )
        return cls(found.youngs_modulus_Pa.value, found.poisson_ratio.value, found.name)


def _entry(
    name: str, low_GPa: float, high_GPa: float, poisson: float, density: float, spread: float = 0.02
) -> Material:
    # The ranges of Table 2.1 are interpreted as +- two standard deviations.
    youngs = Estimate(0.5e9 * (low_GPa + high_GPa), 0.25e9 * (high_GPa - low_GPa))
    return Material(name, youngs, Estimate(poisson, spread), Estimate(density, 0.02 * density))


#: Young's modulus from Table 2.1 where it is listed there, otherwise from common data sheets;
#: Poisson's ratio and density from common data sheets. For a single number in Table 2.1: +- 5 %.
MATERIALS = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            _entry("rubber", 0.01, 0.1, 0.49, 1100, 0.004),
            _entry("LDPE", 0.11, 0.45, 0.45, 920),
            _entry("HDPE", 0.76, 0.84, 0.42, 950),
            _entry("PP", 1.5, 2.0, 0.40, 905),
            _entry("PET", 2.0, 2.7, 0.38, 1380),
            _entry("PS", 3.0, 3.5, 0.34, 1050),
            _entry("PVC", 2.4, 4.1, 0.38, 1380),
            _entry("paperboard", 2.0, 5.0, 0.30, 750, 0.05),
            _entry("aluminium", 66.0, 72.0, 0.33, 2700),
            _entry("copper", 111.0, 123.0, 0.34, 8930),
            _entry("glass", 60.0, 75.0, 0.22, 2500),
            _entry("tinplate", 195.0, 211.0, 0.30, 7850),
            _entry("spring steel", 201.0, 211.0, 0.29, 7850),
        )
    }
)

#: Yield strength of a thin wall [Pa], for brittle materials the fracture strength: common data sheets, known to about 20 %.
YIELD_Pa = MappingProxyType(
    {
        "LDPE": 10e6, "HDPE": 26e6, "PP": 33e6, "PET": 55e6, "PS": 40e6, "PVC": 50e6, "paperboard": 25e6,
        "aluminium": 270e6, "copper": 70e6, "glass": 40e6, "tinplate": 300e6, "spring steel": 1100e6,
    }
)  # fmt: skip


def material(name: str) -> Material:
    """A material of the library.

    Parameters
    ----------
    name
        Case-insensitive.

    Raises
    ------
    InputError
        Unknown material; lists the known names.

    Examples
    --------
    >>> material("pet").poisson_ratio.value
    0.38
    """
    for known, entry in MATERIALS.items():
        if known.lower() == name.strip().lower():
            return entry
    raise InputError("material", f"found {name!r}, expected one of {', '.join(MATERIALS)}")


def material_constants(name: str) -> tuple[IsotropicMaterial, float]:
    """Elastic constants of a material of the library, and the relative standard deviation of its modulus.

    Parameters
    ----------
    name
        Case-insensitive.
    """
    entry = material(name)
    modulus = entry.youngs_modulus_Pa
    return IsotropicMaterial.of(entry), modulus.sigma / modulus.value if modulus else 0.0

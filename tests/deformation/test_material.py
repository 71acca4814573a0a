"""The material library agrees with Table 2.1, with a standard deviation."""

from __future__ import annotations

import pytest

from visuohaptic.core import InputError, Material
from visuohaptic.deformation.shells import MATERIALS, IsotropicMaterial, YIELD_Pa, material


@pytest.mark.parametrize(
    ("name", "low_GPa", "high_GPa"),
    [
        ("rubber", 0.01, 0.1),
        ("LDPE", 0.11, 0.45),
        ("HDPE", 0.8, 0.8),
        ("PP", 1.5, 2.0),
        ("PET", 2.0, 2.7),
        ("aluminium", 69, 69),
        ("copper", 117, 117),
        ("spring steel", 206, 206),
    ],
)
def test_the_range_of_table_2_1_is_within_two_sigma(name, low_GPa, high_GPa):
    youngs = material(name).youngs_modulus_Pa
    assert youngs.value == pytest.approx(0.5e9 * (low_GPa + high_GPa))
    assert youngs.value - 2 * youngs.sigma <= low_GPa * 1e9 * (1 + 1e-9)
    assert youngs.value + 2 * youngs.sigma >= high_GPa * 1e9 * (1 - 1e-9)


def test_every_entry_is_an_elastic_material():
    for name, entry in MATERIALS.items():
        found = IsotropicMaterial.of(name)
        lame, shear = found.lame_Pa
        # Young's modulus and Poisson's ratio back from (2.2).
        assert shear * (3 * lame + 2 * shear) / (lame + shear) == pytest.approx(found.youngs_modulus_Pa)
        assert lame / (2 * (lame + shear)) == pytest.approx(found.poisson_ratio)
        assert entry.density_kg_per_m3.value > 0


def test_what_is_missing_or_impossible_is_told():
    with pytest.raises(InputError, match="expected one of rubber, LDPE"):
        material("jelly")
    with pytest.raises(InputError, match="has no Young's modulus"):
        IsotropicMaterial.of(Material("mystery"))
    with pytest.raises(InputError, match=r"less than 0\.5"):
        IsotropicMaterial(1e9, 0.5)
    with pytest.raises(InputError, match="expected more than 0"):
        IsotropicMaterial(-1.0, 0.3)


def test_every_yield_strength_is_of_a_material() -> None:
    assert set(YIELD_Pa) == set(MATERIALS) - {"rubber"}
    # A wall bears a strain of 0.05 to 10 %.
    for name, strength in YIELD_Pa.items():
        assert 5e-4 < strength / material(name).youngs_modulus_Pa.value < 0.1

"""The world of lifts keeps Coulomb's law and its own masses, and the campaign counts right."""

import numpy as np
import pytest
from tests.worlds.lifts import DENSITY, KINDS, LIQUID, LiftObject, lift, lift_object, wall_load
from tests.worlds.shells import Revolution

from benchmarks import grasp_evidence


@pytest.fixture(scope="module")
def cylinder() -> LiftObject:
    """A tin tube, half full."""
    points = np.column_stack([np.full(41, 0.03), np.linspace(0, 0.12, 41)])
    wall = Revolution(points, np.full(40, 2e-4), 70e9, 0.33)
    return LiftObject("tube", {}, 0.5, wall, *wall_load(wall, 2700, 0.5), friction=0.5)


def test_mass_and_moments_are_those_of_a_tube_with_liquid(cylinder: LiftObject) -> None:
    shell, liquid = 2 * np.pi * 0.03 * 0.12 * 2e-4 * 2700, np.pi * 0.03**2 * 0.06 * LIQUID
    foot = np.pi * 0.03**2 * 2e-4 * 2700
    assert cylinder.mass_kg == pytest.approx(shell + liquid + foot, rel=1e-9)
    assert cylinder.centre_m == pytest.approx((shell * 0.06 + liquid * 0.03) / cylinder.mass_kg, rel=1e-9)
    about = (shell + 0.5 * liquid + 0.5 * foot) * 0.03**2
    assert cylinder.inertia_kg_m2[1] == pytest.approx(about, rel=1e-9)


def test_what_friction_can_hold_comes_along_and_what_it_cannot_stays(cylinder: LiftObject) -> None:
    """Coulomb: two pads hold 2 mu F, the load is m (g + 1 m/s2) on the way up."""
    limit = cylinder.mass_kg * (9.81 + 1.0) / (2 * cylinder.friction)
    held, lost = (lift(cylinder, 0.05, factor * limit) for factor in (1.1, 0.85))
    assert held.held
    assert held.slip_m < 5e-4
    assert held.turn_rad < 0.02
    # Below m g / 2 mu = 0.907 of the limit it does not leave the table, from which the hand rises 62.5 mm.
    assert not lost.held
    assert lost.slip_m == pytest.approx(0.0625, abs=1e-3)


def test_pieces_differ_from_their_description_as_is_declared() -> None:
    found = [lift_object(seed) for seed in range(0, 12 * len(KINDS), 2)]
    assert [one.kind for one in found[: len(KINDS)]] == list(KINDS)
    assert sorted({one.fill for one in found}) == pytest.approx([0.0, 0.5, 0.9])
    spread = float(np.std([np.log(one.friction) for one in found]))
    # 72 pieces: the standard error of a deviation is 8 %.
    assert spread == pytest.approx(0.15, rel=0.25)
    assert all(one.described["material"] in DENSITY for one in found)


def test_a_planned_grasp_is_lifted_and_figures_count_what_held() -> None:
    (first,) = grasp_evidence.campaign([0], factors=grasp_evidence.SAFETY[:1])
    assert first["success"]
    assert first["give_m"] < 5e-3
    assert 0.9 < first["declared"] <= 1
    lost = first | {"success": False, "slip_m": 0.06, "declared": 0.9}
    held, error = grasp_evidence.figures([first | {"declared": 0.9}, lost])
    assert held["ours"] == pytest.approx(0.5)
    assert error["ours"] == pytest.approx(0.4)
    assert "pot 0 slips" in held["note"]

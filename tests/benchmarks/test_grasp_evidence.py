"""The simulation of lifts obeys Coulomb's law and has its own masses; counting in the campaign."""

import numpy as np
import pytest
from tests.worlds import lifts
from tests.worlds.lifts import DENSITY, KINDS, LIQUID, LiftObject, lift, lift_object, lift_rim, wall_load
from tests.worlds.shells import Revolution

from benchmarks import grasp_evidence
from visuohaptic.grasping import GraspTask, object_load, plan_grasps


@pytest.fixture
def few_springs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eleven springs instead of nineteen in a pad: a third of the time. At a shoulder they are too few."""
    monkeypatch.setattr(lifts, "RINGS", (1, 4, 6))


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


@pytest.mark.usefixtures("few_springs")
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


def test_pads_that_come_from_outside_a_shoulder_have_closed_before_the_hand_rises() -> None:
    """A neck 2 cm within its shoulder, pressed above the reach of both: Coulomb's law as on a tube."""
    points = np.array([[0.04, 0.0], [0.04, 0.08], [0.02, 0.081], [0.02, 0.12]])
    wall = Revolution(points, np.full(3, 2e-4), 70e9, 0.33)
    bottle = LiftObject("bottle", {}, 0.5, wall, *wall_load(wall, 2700, 0.5), friction=0.5)
    limit = bottle.mass_kg * (9.81 + 1.0) / (2 * bottle.friction)
    held, lost = (lift(bottle, 0.1, factor * limit) for factor in (1.1, 0.85))
    assert held.held
    assert not lost.held


@pytest.mark.usefixtures("few_springs")
def test_a_wall_between_two_pads_turns_until_their_pressure_holds_the_moment(cylinder: LiftObject) -> None:
    """Springs over a disc of radius r that are pressed d by F turn by M / (F r^2 / 2 d), both pads together.

    M is the weight on an arm of the tube's radius. The rings of balls lie within the disc: their second moment is a little
    smaller than r^2 / 4, and they move in contact, so that 40 % are allowed.
    """
    force_N = 40.0
    found = lift_rim(cylinder, (0.03, 0.11), (1.0, 0.0), force_N)
    moment = cylinder.mass_kg * 9.81 * 0.03
    assert found.held
    assert found.slip_m < 5e-4
    assert found.turn_rad == pytest.approx(moment / (force_N * 0.01**2 / (2 * 0.003)), rel=0.4)
    # Friction would hold 2 mu F, more than the weight; but the moment is more than all pressure at opposite edges holds.
    weak_N = 0.9 * moment / (2 * 0.01)
    assert 2 * cylinder.friction * weak_N > 1.1 * cylinder.mass_kg * 10.81
    assert not lift_rim(cylinder, (0.03, 0.11), (1.0, 0.0), weak_N).held


def test_pieces_differ_from_their_description_as_is_declared() -> None:
    found = [lift_object(seed) for seed in range(0, 12 * len(KINDS), 2)]
    assert [one.kind for one in found[: len(KINDS)]] == list(KINDS)
    assert sorted({one.fill for one in found}) == pytest.approx([0.0, 0.5, 0.9])
    spread = float(np.std([np.log(one.friction) for one in found]))
    # 72 pieces: the standard error of a deviation is 8 %.
    assert spread == pytest.approx(0.15, rel=0.25)
    assert all(one.described["material"] in DENSITY for one in found)


@pytest.mark.usefixtures("few_springs")
def test_a_planned_grasp_is_lifted_and_figures_count_what_held() -> None:
    (first,) = grasp_evidence.campaign([0], factors=grasp_evidence.SAFETY[:1])
    assert first["success"]
    assert first["give_m"] < 5e-3
    assert 0.9 < first["declared"] <= 1
    (bowl,) = grasp_evidence.campaign([0], factors=grasp_evidence.SAFETY[:1], rim=True)
    assert bowl["success"]
    assert bowl["rim"]
    lost = first | {"success": False, "slip_m": 0.06, "declared": 0.9}
    held, error = grasp_evidence.figures([first | {"declared": 0.9}, lost])
    assert held["ours"] == pytest.approx(0.5)
    assert error["ours"] == pytest.approx(0.4)
    assert "pot 0 slips" in held["note"]
    assert first["work_J"] > 0
    assert 0 < first["score"] <= 1


def test_metrics_are_compared_by_the_order_in_which_they_put_what_holds_and_what_fails() -> None:
    """Of four pairs of a grasp that holds and one that fails, work orders all, the score half, and the probability none."""
    columns = ("seed", "success", "work_J", "score", "declared")
    values = [
        (0, True, 1, 0.9, 0.5),
        (2, True, 2, 0.2, 0.6),
        (4, False, 3, 0.5, 0.7),
        (6, False, 4, 0.6, 0.8),
    ]
    rows = [{"offered": True} | dict(zip(columns, one, strict=True)) for one in values]
    found = grasp_evidence.metric_figures([*rows, {"offered": False, "success": False}], draws=20)
    assert [row["ours"] for row in found] == pytest.approx([1.0, 0.5, 0.0])
    assert "4 lifts, 2 failed" in found[0]["note"]
    assert not grasp_evidence.metric_figures(rows[:2])


def test_metrics_of_any_place_are_those_of_the_planner() -> None:
    thing, container, surface = grasp_evidence.described(0, KINDS)
    plan = plan_grasps(container, GraspTask(force_N=5.0), count=1, confirm=False, surface=surface)
    best = plan.grasps[0]
    found = grasp_evidence.metrics(plan, object_load(container, thing.fill), best.vertex)
    assert (found["score"], found["work_J"]) == pytest.approx((best.score, best.work_J))
    assert found["declared"] == pytest.approx(best.success)

"""Limits and priors of tasks: probabilities by integration, limits from both sides."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtri

from visuohaptic.core import Estimate, HapticTag, Reason
from visuohaptic.core.objects import PrimitiveKind
from visuohaptic.tasks.manipulation import contents_task
from visuohaptic.tasks.memory import _agree
from visuohaptic.tasks.mobile.explore import StopReason
from visuohaptic.tasks.mobile.floor_outline import FloorOutline, log_depth_prior
from visuohaptic.tasks.mobile.known_objects import _alike, _log_side, _population_fit
from visuohaptic.tasks.mobile.outline_curvature import contact_curvature
from visuohaptic.tasks.mobile.touch_map._map_contacts import _held
from visuohaptic.tasks.mobile.touch_map._odometry_scale import OdometryScale
from visuohaptic.tasks.mobile.touch_map._straight_walls import WallDriftCorrection, _face_rad
from visuohaptic.tasks.mobile.travel.travel_memory import TravelMemory


def _friction(value: float, sigma: float = 0.1) -> HapticTag:
    return HapticTag(static_friction_N=Estimate(value, sigma))


def test_two_frictions_of_one_object_disagree_once_in_a_hundred() -> None:
    for probability, same in ((0.011, True), (0.009, False)):
        apart = -float(ndtri(0.5 * probability))
        assert _agree(_friction(5.0), _friction(5.0 + apart * math.hypot(0.1, 0.1))) == same
        assert _agree(_friction(5.0), HapticTag(min_static_friction_N=5.0 + 0.1 * apart)) == same


def test_frictions_are_alike_for_a_plan_within_a_seventh() -> None:
    assert _alike(_friction(5.0), _friction(5.0 * 1.14))
    assert not _alike(_friction(5.0), _friction(5.0 * 1.16))


def test_a_side_is_short_because_a_part_is_hidden_in_one_of_twenty_cases() -> None:
    """Integrals of the density: one, and a twentieth below three standard deviations of a side of 0.3 m."""

    def density(seen_m: float) -> float:
        return math.exp(_log_side(seen_m, 0.3, 0.005))

    short = quad(density, 0.0, 0.285)[0]
    assert short + quad(density, 0.285, 0.33, points=[0.3])[0] == pytest.approx(1.0, abs=1e-3)
    assert short / (0.285 / 0.3) == pytest.approx(0.05, rel=0.04)


def test_the_depth_of_a_box_is_within_a_factor_of_its_width_in_two_of_three() -> None:
    """One standard deviation of a lognormal distribution holds 68.3 %: the factor is 1.4."""

    def density(depth_m: float) -> float:
        return math.exp(log_depth_prior(0.3, depth_m))

    assert quad(density, 0.3 / 1.4, 0.3 * 1.4)[0] == pytest.approx(0.683, abs=0.005)


def test_half_of_the_objects_that_were_never_seen_are_round_and_5_to_40_cm_wide() -> None:
    def density(width_m: float) -> float:
        return math.exp(
            _population_fit([FloorOutline(True, (0.0, 0.0, 0.0), (width_m, width_m), (0.01, 0.01), 0.0)])
        )

    assert quad(density, 0.05, 0.4)[0] == pytest.approx(0.5, rel=1e-6)


def test_pushes_that_agree_are_trusted_to_half_a_per_cent_from_the_fifth_on() -> None:
    """The posterior by updates of a Kalman filter, one push after the other: two per cent each while there are few."""
    for count, sigma in ((4, 0.02), (5, 0.005)):
        scale, mean, variance = OdometryScale(0.05), 1.0, 0.05**2
        scale._ratios += [1.05] * count
        for _ in range(count):
            gain = variance / (variance + sigma**2)
            mean, variance = mean + gain * (1.05 - mean), (1.0 - gain) * variance
        assert 1.05 - scale.value == pytest.approx(1.05 - mean, rel=0.1)


def _pressed(*reach_m: float) -> list[Any]:
    return [
        SimpleNamespace(contacts=(1,), reason=Reason.OK, delta_m=np.array([0.0, one, np.nan]))
        for one in reach_m
    ]


@pytest.mark.parametrize(("slip_m", "held"), [(0.0046, True), (0.0054, False)])
def test_what_moves_less_than_five_millimetres_is_held(slip_m: float, held: bool) -> None:
    """The platform moves by 10 mm and this farther than the foam is pressed."""
    found: Any = SimpleNamespace(
        stopped_by=StopReason.TOO_HEAVY, profiles=_pressed(0.001, 0.011), travel_m=[0.2, 0.21 + slip_m]
    )
    assert _held(found) == held


@pytest.mark.parametrize(("wide_m", "straight"), [(0.14, False), (0.16, True)])
def test_a_contact_measures_a_direction_from_15_cm_on(wide_m: float, straight: bool) -> None:
    """Two ends that are known to 3 mm give the direction to 1.6 degrees."""
    line = SimpleNamespace(kind=PrimitiveKind.LINE, parameters=np.array([0.1, 0.0, 1.2]))
    contact: Any = SimpleNamespace(primitive=line, movable=False, diameter_m=wide_m)
    assert (_face_rad(contact) is not None) == straight


@pytest.mark.parametrize(
    ("step", "moved"),
    [
        ((0.018, 0.0, 0.0), False),
        ((0.0, 0.022, 0.0), True),
        ((0.0, 0.0, 0.045), False),
        ((0.0, 0.0, -0.055), True),
    ],
)
def test_an_object_has_moved_beyond_the_noise_of_a_sighting(
    step: tuple[float, float, float], moved: bool
) -> None:
    known: Any = SimpleNamespace(place_m=np.zeros(3))
    memory: Any = SimpleNamespace(_known={"box": known})
    assert TravelMemory.seen(memory, "box", np.array(step)) == moved
    assert (known.place_m == np.array(step)).all() == (moved or not any(step))


def test_a_contact_within_six_centimetres_belongs_to_an_object() -> None:
    square = np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2]])
    memory: Any = SimpleNamespace(_known={"box": SimpleNamespace(outline_m=lambda: square)})
    assert TravelMemory.near(memory, np.array([0.1, 0.255]))
    assert not TravelMemory.near(memory, np.array([0.1, 0.265]))


def test_a_contact_beside_the_outline_is_that_of_a_rim() -> None:
    """A plan rounds coordinates to micrometres; a tenth of a millimetre off, it bridges a concavity."""
    square = np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2]])
    assert contact_curvature(square, (0.1, -0.9e-4), 0.2) >= 0.0
    assert contact_curvature(square, (0.1, -1.1e-4), 0.2) == pytest.approx(-5.0)


def test_a_grasp_for_weighing_holds_twice_the_heaviest_contents(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coulomb friction of foam, 0.6, on both fingers; the lift is slow and low."""
    plans: list[Any] = []

    def lift(hand: Any, plan: Any) -> Any:
        plans.append(plan)
        return SimpleNamespace(mass_kg=None)

    monkeypatch.setattr(contents_task, "grasp_and_lift", lift)
    place = SimpleNamespace(height_m=0.1, angle_rad=0.0)
    curve: Any = SimpleNamespace(place=place, force_N=np.array([1.0, 50.0]))
    hand: Any = SimpleNamespace()
    contents_task.weigh(hand, 0.5, curve, (0.5, 0.0, 0.0))
    (plan,) = plans
    assert 2.0 * 0.6 * plan.force_N == pytest.approx(2.0 * 0.5 * 9.81)
    # 20 mm/s over 10 mm: half a second, in which a load cell has settled.
    assert plan.lift_m / plan.arm_m_s == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("distance_m", "along_m", "same"),
    [(0.375, 0.0, True), (0.385, 0.0, False), (0.35, 1.45, True), (0.35, 1.55, False)],
)
def test_a_wall_is_met_again_within_8_cm_and_a_metre_and_a_half_along_it(
    distance_m: float, along_m: float, same: bool
) -> None:
    """A wall at 0.3 m ahead; the pose is moved to where it was measured first."""
    walls = WallDriftCorrection(0.1)
    for x_m, y_m, expected_m in ((0.3, 0.0, 0.0), (distance_m, along_m, 0.3 - distance_m if same else 0.0)):
        line = SimpleNamespace(parameters=np.array([x_m, y_m, 0.5 * math.pi]))
        contact: Any = SimpleNamespace(primitive=line, points_foam_m=np.array([[x_m, y_m]]))
        pose = walls._against_walls((0.0, 0.0, 0.0), contact, 0.5 * math.pi)
        assert pose[0] == pytest.approx(expected_m, abs=1e-12)

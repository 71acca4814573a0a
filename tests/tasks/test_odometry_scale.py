"""The scale of odometry from the foam, for wheels with a known error."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from visuohaptic.simulation.mobile import (
    DriftingBase,
    OdometryErrors,
    QuickFoam,
    QuickFrames,
    QuickWorld,
    box,
    cylinder,
    wall,
)
from visuohaptic.tasks.mobile import ExploreSettings, ObstacleExploration, explore_obstacle
from visuohaptic.tasks.mobile.touch_map._odometry_scale import OdometryScale, odometry_scale_of

SETTINGS = ExploreSettings(
    approach_m_s=0.08, push_m_s=0.04, search_m=0.4, push_m=0.04, halt_s=0.3, back_off_m=0.05
)


class Wheels(DriftingBase):
    """Tell every way too long by the same share."""

    def __init__(self, world: QuickWorld, scale: float, slip_m: float = 1e-9) -> None:
        errors = OdometryErrors(
            scale=1e-9, scale_turn=1e-9, gyro_bias_rad_s=0.0, walk_rad=1e-9, slip_m=slip_m
        )
        super().__init__(world, np.random.default_rng(1), errors)
        self._scale = scale


def touched(world: QuickWorld, scale: float, slip_m: float = 1e-9) -> list[ObstacleExploration]:
    """Four pushes against whatever is ahead."""
    base = Wheels(world, scale, slip_m)
    foam: Any = QuickFoam(world, np.random.default_rng(0))
    return [explore_obstacle(base, QuickFrames(world), foam, SETTINGS) for _ in range(4)]


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.04])
@pytest.mark.parametrize("degrees", [0.0, 5.0])
def test_one_push_tells_the_scale(scale: float, degrees: float) -> None:
    world = QuickWorld([wall("ahead", 0.4, 0.0, 2.0, 0.1, yaw_rad=math.radians(90.0 + degrees))])
    for found in touched(world, scale):
        # 30 um of noise at 40 points over some 8 mm: far below; the foam's edge against an oblique wall is not, and
        # the delay, which is fitted with it, makes a hundredth of that.
        assert odometry_scale_of(found) == pytest.approx(scale, abs=0.004 if degrees == 0.0 else 0.01)


def test_a_delay_of_the_pictures_is_no_scale() -> None:
    """Half a frame is 0.7 mm at the speed of the push, of 6 mm, and nothing where the platform has slowed down: 10 %."""
    world = QuickWorld([wall("ahead", 0.4, 0.0, 2.0, 0.1, yaw_rad=math.radians(90.0))])
    for found in touched(world, 1.0):
        t_s = np.array([profile.t_s for profile in found.profiles])
        later = replace(found, travel_m=np.interp(t_s + 1 / 60, t_s, found.travel_m))
        assert odometry_scale_of(later) == pytest.approx(1.0, abs=0.02)


def test_what_gives_way_says_nothing() -> None:
    for thing in (
        cylinder("bin", 0.4, 0.0, 0.1, 0.3, mass_kg=0.6, friction=0.35),
        box("case", 0.4, 0.0, (0.2, 0.3, 0.3), mass_kg=0.8, friction=0.3),
    ):
        scale = OdometryScale(0.02)
        for found in touched(QuickWorld([thing]), 1.03):
            assert math.isnan(odometry_scale_of(found))
            scale.add(found)
        assert scale.value == 1.0


def test_contacts_join_and_slipping_wheels_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    from visuohaptic.tasks.mobile.touch_map import _odometry_scale

    rng = np.random.default_rng(0)
    told = iter([*rng.normal(1.02, 0.011, 19), 1.11, math.nan])
    monkeypatch.setattr(_odometry_scale, "odometry_scale_of", lambda found: next(told))
    scale, nothing = OdometryScale(0.02), Any
    values = []
    for _ in range(21):
        scale.add(nothing)
        values.append(scale.value)
    assert values[0] == pytest.approx(
        1.0 + 0.5 * 0.0214, abs=0.004
    )  # a push and the wheels' word weigh alike
    # 1.1 % by the root of 19 is 0.25 %; the outlier alone would shift a mean by 0.45 %.
    assert values[-1] == pytest.approx(1.02, abs=0.006)
    told = iter([1.1] * 6)
    spinning = OdometryScale(0.02)
    for _ in range(6):
        spinning.add(nothing)
    assert spinning.value == 1.0  # wheels that are wrong by five sigma spin

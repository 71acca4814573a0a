"""What the constants of maps, plans and pushes are said to do, computed by other means."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.navigation.grid import _distance_kernels
from visuohaptic.navigation.grid.cost_grid import SpeedLimits
from visuohaptic.navigation.mapping.mapper import MapperSettings
from visuohaptic.navigation.mapping.scan_matching import FREE_LOG_ODDS
from visuohaptic.navigation.planning import sideward_push
from visuohaptic.navigation.planning.search import _travel_kernels, push_lengths
from visuohaptic.navigation.problem.objects_file import objects_from_data
from visuohaptic.navigation.pushing import contact_candidates


def test_a_sum_of_squares_of_the_sweep_has_16_bits() -> None:
    """And no larger reach would do."""
    largest = [(2 * reach + 3) ** 2 + (2 * reach - 1) ** 2 for reach in range(200)]
    assert max(reach for reach in range(200) if largest[reach] < 2**16) == _distance_kernels.SWEPT_REACH


def test_three_beams_contradict_a_point_and_two_do_not() -> None:
    miss = MapperSettings().miss
    assert 3 * miss < FREE_LOG_ODDS < 2 * miss


def test_costs_of_a_cell_are_rounded_to_a_fifth_of_a_per_cent() -> None:
    assert pytest.approx(0.002, rel=0.1) == 0.5 / _travel_kernels.UNITS


def test_simulated_drives_know_a_failure_of_a_tenth_to_six_per_cent() -> None:
    drives = np.random.default_rng(1).random((20_000, sideward_push.SAMPLES)) < 0.1
    assert drives.mean(axis=1).std() == pytest.approx(0.061, rel=0.04)


def test_final_poses_beside_a_drive_know_a_fraction_of_a_half_to_a_sixth() -> None:
    poses = np.random.default_rng(1).random((20_000, push_lengths.LOOKED_AT)) < 0.5
    assert poses.mean(axis=1).std() == pytest.approx(0.177, rel=0.05)


def test_oblique_pushes_need_the_friction_of_foam_on_furniture() -> None:
    """A force within the cone of friction: its tangent is the coefficient."""
    normal = np.array([1.0, 0.0])
    for angle, friction in zip(contact_candidates.OBLIQUE_RAD, (0.21, 0.45), strict=True):
        push = np.array([math.cos(angle), math.sin(angle)])
        across = float(np.linalg.norm(push - (push @ normal) * normal))
        assert across / float(push @ normal) == pytest.approx(friction, rel=0.03)


def test_glass_that_was_never_pushed_is_avoided_by_5_cm() -> None:
    """Depth cameras measure it with an error of centimetres."""
    square = [[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2]]
    (found,) = objects_from_data({"objects": [{"id": "a", "type": "glass", "footprint_m": square}]})
    assert np.ptp(found.footprint_m, axis=0) == pytest.approx([0.3, 0.3], abs=0.004)


@pytest.mark.parametrize(("ratio", "possible"), [(950.0, True), (1050.0, False)])
def test_a_robot_is_at_most_a_thousand_times_faster_on_free_floor(ratio: float, possible: bool) -> None:
    """Costs have 16 bits: a step at full speed then has 65 units, and is rounded by less than a per cent."""
    assert 0.5 / (65_535.0 / 1000.0) < 0.01
    if possible:
        SpeedLimits(0.2, v_min_m_s=1.0 / ratio, v_max_m_s=1.0)
        return
    with pytest.raises(InputError, match="v_min_m_s"):
        SpeedLimits(0.2, v_min_m_s=1.0 / ratio, v_max_m_s=1.0)

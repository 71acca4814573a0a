"""What the constants of maps, plans and pushes are said to do, computed by other means."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.navigation.grid import _distance_kernels
from visuohaptic.navigation.mapping.mapper import MapperSettings
from visuohaptic.navigation.mapping.scan_matching import FREE_LOG_ODDS
from visuohaptic.navigation.planning import sideward_push
from visuohaptic.navigation.planning.search import _travel_kernels, push_lengths
from visuohaptic.navigation.pushing import contact_candidates, push_failure


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


def test_a_load_at_the_rim_of_a_disc_is_a_root_of_two_farther_out_than_one_spread_over_it() -> None:
    """Root mean square distance from the centre, by samples of the disc."""
    x, y = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 100_000))
    inside = np.hypot(x, y) < 1.0
    spread = math.sqrt(float(np.mean((x**2 + y**2)[inside])))
    assert pytest.approx(1.0 / spread, rel=0.01) == push_failure.RIM


def test_oblique_pushes_need_the_friction_of_foam_on_furniture() -> None:
    """A force within the cone of friction: its tangent is the coefficient."""
    normal = np.array([1.0, 0.0])
    for angle, friction in zip(contact_candidates.OBLIQUE_RAD, (0.21, 0.45), strict=True):
        push = np.array([math.cos(angle), math.sin(angle)])
        across = float(np.linalg.norm(push - (push @ normal) * normal))
        assert across / float(push @ normal) == pytest.approx(friction, rel=0.03)

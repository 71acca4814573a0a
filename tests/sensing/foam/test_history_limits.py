"""Release and unloading of foam, narrow dents and gaps in a contour: each limit from both sides."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from visuohaptic.core import Reason
from visuohaptic.sensing.foam import FoamContour, read_profile
from visuohaptic.sensing.foam.material.hysteresis import HysteresisState

ONE = np.ones(1)


def _unloads(peak: float, strain: float, sigma: float = 0.0) -> bool:
    state = HysteresisState.at_rest(1)
    state.update(peak * ONE, sigma * ONE, ONE > 0.0)
    return bool(state.update(strain * ONE, sigma * ONE, ONE > 0.0)[0])


@pytest.mark.parametrize(("drop", "unloads"), [(0.018, False), (0.022, True)])
def test_foam_unloads_two_per_cent_below_its_peak(drop: float, unloads: bool) -> None:
    assert _unloads(0.2, 0.2 * (1.0 - drop)) == unloads


@pytest.mark.parametrize(("sigmas", "unloads"), [(3.7, False), (4.3, True)])
def test_noise_of_four_deviations_is_no_unloading(sigmas: float, unloads: bool) -> None:
    """Of the difference of two strains of the same noise."""
    assert _unloads(0.2, 0.2 - sigmas * np.sqrt(2.0) * 0.002, 0.002) == unloads


@pytest.mark.parametrize(("strain", "unloads"), [(0.0055, True), (0.0045, False)])
def test_foam_is_released_below_half_a_per_cent(strain: float, unloads: bool) -> None:
    assert _unloads(0.2, strain) == unloads


def _contour(delta_m: np.ndarray, valid: np.ndarray | None = None) -> FoamContour:
    seen = np.ones(len(delta_m), bool) if valid is None else valid
    return FoamContour(0.5e-3 * np.arange(len(delta_m)), delta_m, np.full(len(delta_m), 3e-6), seen)


def test_a_shallow_dent_is_a_contact_when_it_is_half_as_long_as_the_strip_is_wide(material: Any) -> None:
    """A dent of a strain of 0.004 on a strip of 20 mm, point by point longer: the first one that counts."""
    for points in range(10, 60):
        delta = np.zeros(120)
        delta[30 : 30 + points] = 0.004 * 0.02
        contacts = read_profile(_contour(delta), material).contacts
        if contacts:
            break
    assert contacts[0].s_end_m - contacts[0].s_start_m == pytest.approx(0.01, abs=0.0011)


@pytest.mark.parametrize(("missing", "reason"), [(3, Reason.OK), (4, Reason.OCCLUDED)])
def test_a_gap_of_three_points_is_bridged(missing: int, reason: Reason, material: Any) -> None:
    delta, seen = np.zeros(120), np.ones(120, bool)
    delta[30:80] = 0.003
    seen[50 : 50 + missing] = False
    contacts = read_profile(_contour(delta, seen), material).contacts
    assert contacts[0].reason == reason

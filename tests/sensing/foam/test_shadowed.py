"""Fronts that the edge of a shadow hides from the tracker."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from tests.worlds import foam_disturbances as disturbances
from tests.worlds.foam import Sequence, draw_world, pincers
from tests.worlds.foam_lamps import lamps
from tests.worlds.foam_optics import EDGE
from tests.worlds.foam_scene import FRAME_S, Moment, shadow_row

from benchmarks import foam_evidence
from visuohaptic.sensing.foam.posterior import _compressed
from visuohaptic.sensing.foam.shadowed import _SHIFT, _SHIFTS, _extended, merged_fronts
from visuohaptic.tracking.contours.contour import ContourSettings

FRONT = 40.3


def _merged(
    ahead_px: float, rng: np.random.Generator, *, told_px: float = 0.0, grey: float = 180.0, count: int = 60
) -> np.ndarray:
    """Fits of fronts beyond the edge of a shadow that crosses them, over a floor; rendered at a tenth of a pixel."""
    fine = np.arange(0.0, 90.0, 0.1) - 0.45
    lanes = np.arange(5.0) - 2.0
    slope = 0.5
    shadow = FRONT - ahead_px + slope * lanes[:, None]
    light = np.where(fine < shadow, 1.0, 0.55)
    scene = np.where(fine < FRONT, grey * light, 80.0 * (1.0 if ahead_px < 0.0 else 0.55))
    pixels = gaussian_filter1d(scene, 9.0, axis=1).reshape(5, 90, 10).mean(axis=2)
    image = (pixels + 1.4 * rng.standard_normal((count, 5, 90))).astype(np.float32)
    ones, found = np.ones(count), np.full((count, 4), np.nan)
    lines = np.tile([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], (count, 1))
    edge = FRONT - ahead_px + told_px
    merged_fronts(
        image, lines, edge * ones, slope * ones, (FRONT + 1.0) * ones, 0.0 * ones, np.hypot(0.9, 0.29) * ones, 9.0 * ones,
        42.0 * ones, ones > 0, found,
    )  # fmt: skip
    return found


@pytest.mark.parametrize("ahead_px", [1.5, 3.0, 5.0, 7.0])
@pytest.mark.parametrize("told_px", [-0.3, 0.0, 0.3])
def test_a_front_that_merges_with_the_edge_of_a_shadow_is_found_within_its_error(ahead_px, told_px) -> None:
    found = _merged(ahead_px, np.random.default_rng(3), told_px=told_px)
    error = found[:, 0] - FRONT
    assert np.abs(error).max() < 0.5
    assert np.sqrt(np.mean((error / found[:, 1]) ** 2)) < 1.5
    assert np.median(found[:, 2]) == pytest.approx(0.55 * 180.0, rel=0.03)
    assert np.median(found[:, 3]) == pytest.approx(0.55 * 80.0, rel=0.03)


def test_foam_as_grey_as_the_surface_beyond_has_no_front() -> None:
    """Shaded foam and floor look alike: the step is below the smallest contrast of a contour."""
    found = _merged(5.0, np.random.default_rng(4), grey=80.0)
    step = found[:, 3] - found[:, 2]
    assert np.abs(step[found[:, 1] < 1.0]).max() < ContourSettings().min_contrast


@pytest.mark.parametrize("level", [0.0, 255.0])
def test_a_black_or_saturated_strip_has_no_front(level: float) -> None:
    ones, found = np.ones(2), np.full((2, 4), np.nan)
    lines, image = np.tile([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], (2, 1)), np.full((2, 5, 90), level, np.float32)
    merged_fronts(
        image, lines, 37.3 * ones, 0.5 * ones, 41.3 * ones, 0.0 * ones, ones, 9.0 * ones, 42.0 * ones, ones > 0, found,
    )  # fmt: skip
    assert not (found[:, 1] < 1.0).any()


def test_the_edges_that_are_tried_are_those_that_an_extrapolation_may_mean() -> None:
    """Places and slopes of five lines that are 6 px apart, extrapolated over five more lines, in a pseudo-random experiment."""
    rng, s_px = np.random.default_rng(1), 6.0 * np.arange(10.0)
    shadow, away = np.arange(10) < 5, []
    for _ in range(400):
        place, slope = 5.0 + 0.5 * s_px + 0.1 * rng.standard_normal(10), 0.5 + 0.025 * rng.standard_normal(10)
        edge, _ = _extended(cast(Any, SimpleNamespace(position_px=place, slope=slope)), shadow, s_px)
        away.append(edge[-1] - 5.0 - 0.5 * s_px[-1])
    assert 2.15 < 0.5 * _SHIFT * (_SHIFTS - 1) / np.std(away) < 2.7


def test_foam_that_is_pressed_moves_its_texture_with_it() -> None:
    place = np.arange(100.0)
    image = np.rint(100.0 + 50.0 * np.sin(place / 7.0)).astype(np.uint8)
    both = np.tile(image, (2, 1, 1)).reshape(2, 1, 100)
    moved = _compressed(both, np.array([0.8, 0.8]), np.array([True, False]))
    at = np.arange(70)
    left = moved[0, 0, at] - (100.0 + 50.0 * np.sin(at / 0.8 / 7.0))
    # Two samples and their mean are rounded: a third of a grey level; cut off, they would be half of one too dark.
    assert np.abs(left).max() < 2.0
    assert abs(left.mean()) < 4.0 * 0.35 / np.sqrt(len(at))
    assert (moved[1] == both[1]).all()


def test_a_press_is_read_while_the_edge_of_a_shadow_creeps_over_it() -> None:
    """The contour follows the edge, which is stronger than the front in the shadow; 2 of 29 frames were read."""
    sequence = disturbances.disturbed("hard shadow", 163)
    frames = foam_evidence.frames_of([foam_evidence.run_sequence(sequence)])
    read = frames["valid"] & frames["counted"]
    assert read.sum() >= 20
    error = np.abs(frames["force_N"] - frames["truth_N"])[read]
    assert (error < 4.0 * frames["sigma_N"][read]).all()
    assert np.median(error / frames["truth_N"][read]) < 0.02


def test_the_penumbra_of_a_shadow_is_no_edge_beyond_which_a_front_is_sought() -> None:
    """Two soft shadows beside the front at rest; a second edge within the blur of the first one read 2.1 N."""
    frames = foam_evidence.frames_of([foam_evidence.run_sequence(pincers(587))])
    assert not (frames["valid"] & (frames["force_N"] > 3.0 * frames["sigma_N"] + 0.05)).any()


@pytest.mark.parametrize("seed", [8, 12, 84, 452, 486])
def test_edges_of_several_lamps_near_the_front_press_nothing(seed: int) -> None:
    """A shadow on the floor that looked like a gap before a body (.37, .35 N), third edges beside the front (1.4, 3.8 N), and a shadow
    across an end of the strip (.46 N, 5.7 sigma), where foam could be deflected that far but for a body before it."""
    frames = foam_evidence.frames_of([foam_evidence.run_sequence(lamps(seed))])
    assert not (frames["valid"] & (frames["force_N"] > 3.0 * frames["sigma_N"] + 0.05)).any()


def test_the_edge_of_a_second_shadow_beyond_that_of_the_first_one_is_no_front() -> None:
    """Two lamps: two edges, nearly parallel to the front, 3 mm apart; the second one read .31 +- .03 N."""
    world = draw_world(9304)
    sequence, inwards = Sequence(world, {"kind": "two lamps"}), np.array([np.cos(0.03), np.sin(0.03)])
    for i in range(5):
        rows = []
        for ahead_m, grey, floor_m in ((0.001, 0.3, (0.0, 0.0)), (0.004, 0.35, (0.002, 0.001))):
            x, y = np.array([world.foam.width_m + ahead_m, 0.0]) - 0.01 * i * FRAME_S * inwards
            dark = world.darkness(grey)
            rows.append(
                shadow_row(EDGE, (x, y), 0.03, penumbra_m=0.0, dark=dark, half_m=0.01, floor_shift_m=floor_m)
            )
        sequence.add(i, Moment(shadows=rows))
    frames = foam_evidence.frames_of([foam_evidence.run_sequence(sequence)])
    assert not (frames["valid"] & (frames["force_N"] > 3.0 * frames["sigma_N"] + 0.05)).any()

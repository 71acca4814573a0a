"""What a record of a press must show, and what a strip and its camera may differ by: each limit from both sides."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.core.errors import CalibrationError
from visuohaptic.sensing.foam.material.press_checks import refuse_bad_points, refuse_unsuitable
from visuohaptic.sensing.foam.material.records import read_strain_stress
from visuohaptic.sensing.foam.strip.finger_tag import TagFix
from visuohaptic.sensing.foam.strip.zero import check_width


def _record(count: int = 40, low: float = 0.0, high: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    strain = np.linspace(low, high, count)
    return strain, 2e4 * strain


def _refused(said: str, strain: np.ndarray, stress: np.ndarray) -> bool:
    try:
        refuse_bad_points("press", strain, stress)
    except CalibrationError as error:
        return said in str(error)
    return False


@pytest.mark.parametrize(("count", "few"), [(11, True), (12, False)])
def test_three_strains_for_each_parameter_of_the_smallest_spline_are_a_curve(count: int, few: bool) -> None:
    assert _refused("different strains", *_record(count, high=0.45)) == few


@pytest.mark.parametrize(
    ("low", "high", "short"), [(0.11, 0.5, True), (0.09, 0.31, False), (0.0, 0.29, True)]
)
def test_a_press_reaches_from_a_tenth_to_three_tenths(low: float, high: float, short: bool) -> None:
    """The plateau of foams, which the calibration needs, begins at strains of 0.05 to 0.1."""
    assert _refused("expected a range", *_record(low=low, high=high)) == short


@pytest.mark.parametrize(("gap", "refused"), [(0.14, False), (0.16, True)])
def test_no_part_of_the_plateau_is_left_out(gap: float, refused: bool) -> None:
    strain = np.concatenate([np.linspace(0.0, 0.2, 20), np.linspace(0.2 + gap, 0.6, 20)])
    assert _refused("no points between", strain, 2e4 * strain) == refused


@pytest.mark.parametrize(("part", "refused"), [(0.045, False), (0.055, True)])
def test_tension_is_noise_up_to_a_twentieth_of_the_highest_stress(part: float, refused: bool) -> None:
    strain, stress = _record()
    stress[3] = -part * stress.max()
    assert _refused("expected 0 or more", strain, stress) == refused


@pytest.mark.parametrize(("part", "flat"), [(0.018, True), (0.022, False)])
def test_a_plateau_rises_by_a_fiftieth_of_the_mean_slope(part: float, flat: bool) -> None:
    strain, stress = _record()
    spline: Any = SimpleNamespace(
        minimum_slope=lambda: (0.2, part * 2e4), stress=lambda x: 2e4 * np.asarray(x), max_strain=0.5
    )
    if not flat:
        refuse_unsuitable("press", strain, stress, spline)
        return
    with pytest.raises(CalibrationError, match="is flat"):
        refuse_unsuitable("press", strain, stress, spline)


@pytest.mark.parametrize(("top_Pa", "refused"), [(140.0, True), (160.0, False)])
def test_no_foam_stays_below_150_pascal(top_Pa: float, refused: bool, tmp_path: Path) -> None:
    """A column in kPa named as Pa: 150 kPa would be 1.5 kN on 10 x 10 cm, more than foams of sensors bear."""
    strain, stress = _record()
    rows = "\n".join(f"{x},{top_Pa * y / stress.max()}" for x, y in zip(strain, stress, strict=True))
    (tmp_path / "press.csv").write_text(f"strain,stress_Pa\n{rows}\n")
    if not refused:
        assert len(read_strain_stress(tmp_path / "press.csv").strain) == 40
        return
    with pytest.raises(CalibrationError, match="no foam is so soft"):
        read_strain_stress(tmp_path / "press.csv")


@pytest.mark.parametrize("factor", [0.89, 0.91, 1.09, 1.11])
def test_a_strip_is_as_wide_as_given_to_a_tenth(factor: float) -> None:
    if abs(factor - 1.0) < 0.1:
        check_width(0.02 * factor, 0.02, "zero", stripe_m=0.0)
        return
    with pytest.raises(CalibrationError, match="wide"):
        check_width(0.02 * factor, 0.02, "zero", stripe_m=0.0)


@pytest.mark.parametrize(("residual_px", "bumped"), [(0.9, False), (1.1, True)])
def test_corners_of_a_tag_a_pixel_off_tell_a_bumped_camera(residual_px: float, bumped: bool) -> None:
    assert (TagFix(0.0, 1e-4, residual_px).bump_px > 0.0) == bumped

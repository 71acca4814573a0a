"""What constants of the command line are said to be, by other means."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy import constants
from scipy.stats import norm

from visuohaptic.cli._console import NO_RESULT
from visuohaptic.cli.verbs.geometry.recording_capture import _DEPTH_SCALE_M
from visuohaptic.cli.verbs.system import _known_loads

DOCS = Path(__file__).parents[2] / "docs"


def test_the_exit_code_without_a_result_is_that_of_the_page() -> None:
    codes = re.findall(r"^\| (\d+) \| no result", (DOCS / "cli.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert [int(code) for code in codes] == [NO_RESULT]


def test_depth_of_16_metres_is_stored_to_a_quarter_of_a_millimetre() -> None:
    """In 16 bits, of which the largest value means that nothing was measured."""
    assert (2**16 - 2) * _DEPTH_SCALE_M > 16.0
    assert pytest.approx(2.5e-4, rel=0.02) == _DEPTH_SCALE_M


def test_two_foams_of_three_have_an_exponent_of_4_to_16() -> None:
    middle, sigma = _known_loads._LOG_ALPHA, _known_loads._LOG_ALPHA_SIGMA
    below, above = norm.cdf((np.log(4.0) - middle) / sigma), norm.sf((np.log(16.0) - middle) / sigma)
    assert (below, above) == pytest.approx((1 / 6, 1 / 6), abs=0.01)


def test_a_kitchen_scale_shows_a_gram() -> None:
    assert pytest.approx(1e-3 * constants.g, rel=0.05) == _known_loads._SCALE_SIGMA_N

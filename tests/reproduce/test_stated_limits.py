"""What constants of the reproduced figures are said to be, by other means."""

from __future__ import annotations

import pytest
from scipy import constants

from visuohaptic.reproduce.chapter_4 import figure_4_4


def test_what_slides_at_the_speed_of_a_push_stops_within_half_a_millimetre() -> None:
    """Braking by friction with the floor: v^2 / (2 mu g)."""
    braking = figure_4_4.SPEED_m_s**2 / (2.0 * figure_4_4.FLOOR * constants.g)
    assert braking == pytest.approx(0.4e-3, rel=0.12)

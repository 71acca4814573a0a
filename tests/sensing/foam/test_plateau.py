"""Plateau and densification of a stress curve whose slope is a parabola."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.sensing.foam.material.calibration import plateau


def test_a_plateau_ends_at_twice_the_lowest_slope_and_densification_begins_at_three_times_it() -> None:
    """1 + (x / 0.1)^2 is 2 a tenth beside its minimum, and 3 a tenth times the root of 2."""
    curve: Any = SimpleNamespace(max_strain=0.6, slope=lambda x: 1.0 + ((x - 0.3) / 0.1) ** 2)
    (low, high), densification = plateau(curve)
    assert (low, high) == pytest.approx((0.2, 0.4), abs=0.002)
    assert densification == pytest.approx(0.3 + 0.1 * np.sqrt(2.0), abs=0.002)

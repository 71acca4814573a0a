"""Noise of touches and prints, by simulation of the readings that they stand for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from visuohaptic.recognition.data import TouchProtocol
from visuohaptic.recognition.data.compressions import WEIGHT, Compression


def test_a_mass_is_known_to_the_rounding_of_a_scale_of_a_tenth_of_a_gram() -> None:
    """Deviation of masses between 2 and 3 g from their rounded values."""
    mass_g = np.linspace(2.0, 3.0, 10_001)
    rounding_g = float(np.std(mass_g - np.round(mass_g, 1)))
    one = Compression("1", "PLA", (1.0,), 0.02, 4e-4, 2.5e-3, 0.01)
    (weight,) = (reading for reading in one.readings() if reading.height == WEIGHT)
    side: Any = weight.sides[0]
    assert 2.5 * side.i_relative_sigma == pytest.approx(rounding_g, rel=0.02)


def test_a_compliance_that_is_not_resolved_has_the_error_of_six_samples() -> None:
    """Least squares through the origin over six forces up to the largest one, half-way between its sixths; one and a half deviations."""
    protocol, rng = TouchProtocol(), np.random.default_rng(4)
    force_N = protocol.max_force_N * (np.arange(6) + 0.5) / 6
    noise_m = protocol.noise.deformation_m * rng.standard_normal((20_000, 6))
    compliance = noise_m @ force_N / (force_N @ force_N)
    assert protocol.resolution_m_per_N == pytest.approx(1.5 * float(compliance.std()), rel=0.03)

"""Refractive indices of the simulated tables, by Sellmeier's equation with published coefficients."""

from __future__ import annotations

import math

import pytest

from visuohaptic.simulation.tabletop import refraction

#: B and C [um^2] of each term: crown glass N-BK7 (Schott, data sheet); water of 20 degrees (Daimon and Masumura 2007).
GLASS = ((1.03961212, 0.00600069867), (0.231792344, 0.0200179144), (1.01046945, 103.560653))
WATER = (
    (5.684027565e-1, 5.101829712e-3), (1.726177391e-1, 1.821153936e-2), (2.086189578e-2, 2.620722293e-2),
    (1.130748688e-1, 1.069792721e1),
)  # fmt: skip


@pytest.mark.parametrize(("name", "terms"), [("GLASS", GLASS), ("WATER", WATER)])
def test_indices_are_those_of_the_infrared_projector(
    name: str, terms: tuple[tuple[float, float], ...]
) -> None:
    """At 850 nm, to the two digits that are stated; container glass has more soda than crown glass, 0.005 more."""
    square = 0.85**2
    index = math.sqrt(1.0 + sum(b * square / (square - c) for b, c in terms))
    assert getattr(refraction, name) == pytest.approx(index, abs=0.006)

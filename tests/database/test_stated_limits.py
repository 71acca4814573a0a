"""What constants of the search are said to do, by other means."""

from __future__ import annotations

from visuohaptic.database import search


def test_sixteen_squared_differences_of_levels_fit_into_16_bits() -> None:
    """And those of one level more do not."""
    levels = search._LEVELS
    assert 16 * (levels - 1) ** 2 < 2**16 <= 16 * levels**2

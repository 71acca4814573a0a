"""What constants of grasping are said to do, by other means."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.grasping import match


def test_points_of_a_match_know_their_residual_to_a_seventh() -> None:
    """Root mean square of the residuals of a fit of seven unknowns, as in a linear one."""
    rng = np.random.default_rng(1)
    free = rng.standard_normal((20_000, match.MIN_POINTS - 7))
    assert np.sqrt(np.mean(free**2, axis=1)).std() == pytest.approx(0.147, rel=0.07)

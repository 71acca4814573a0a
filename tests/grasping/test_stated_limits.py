"""What constants of grasping are said to do, by other means."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.grasping import feasibility, match
from visuohaptic.recognition.touch import refinement


def test_points_of_a_match_know_their_residual_to_a_seventh() -> None:
    """Root mean square of the residuals of a fit of seven unknowns, as in a linear one."""
    rng = np.random.default_rng(1)
    free = rng.standard_normal((20_000, match.MIN_POINTS - 7))
    assert np.sqrt(np.mean(free**2, axis=1)).std() == pytest.approx(0.147, rel=0.07)


def test_a_map_without_a_deviation_has_that_of_a_class() -> None:
    """Common and local part of the ratio of an object's stiffness to that of its class, which recognition states."""
    common, local, _ = refinement.CLASS
    assert pytest.approx(np.hypot(common, local), rel=0.01) == feasibility.UNSTATED_SIGMA

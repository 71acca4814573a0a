"""Motion while a beam is zeroed: scatter and creep from both sides of their limits."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core.errors import CalibrationError
from visuohaptic.sensing.beam.zero import _refuse_motion

COUNT = 100


def _refused(scatter: np.ndarray, sigma: np.ndarray) -> bool:
    try:
        _refuse_motion(["tip"], scatter, np.diag(sigma**2))
    except CalibrationError:
        return True
    return False


@pytest.mark.parametrize(("sigmas", "moved"), [(3.7, False), (4.3, True)])
def test_scatter_of_four_declared_deviations_is_motion(sigmas: float, moved: bool) -> None:
    """It alternates, so that it does not creep; its standard deviation is its amplitude."""
    sigma = np.full(6, 1e-2)
    scatter = np.zeros((COUNT, 6))
    scatter[:, 0] = sigmas * 1e-2 * np.sqrt((COUNT - 1) / COUNT) * (-1.0) ** np.arange(COUNT)
    assert _refused(scatter, sigma) == moved


@pytest.mark.parametrize(("sigmas", "crept"), [(2.3, False), (2.7, True)])
def test_a_drift_of_two_and_a_half_deviations_is_no_zero(sigmas: float, crept: bool) -> None:
    sigma = np.full(6, 1e-2)
    scatter = np.zeros((COUNT, 6))
    scatter[COUNT // 2 :, 4] = sigmas * 1e-2
    assert _refused(scatter, sigma) == crept


@pytest.mark.parametrize(("column", "finest"), [(0, 2e-5), (5, 5e-4)])
def test_twenty_micrometres_and_half_a_milliradian_are_stillness(column: int, finest: float) -> None:
    for factor in (0.9, 1.1):
        scatter = np.zeros((COUNT, 6))
        scatter[:, column] = factor * finest * np.sqrt((COUNT - 1) / COUNT) * (-1.0) ** np.arange(COUNT)
        assert _refused(scatter, np.full(6, 1e-9)) == (factor > 1.0)

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.recognition.data import TouchProtocol, as_measured, fit_curve

from .worlds import synthetic


def test_explorations_are_as_noisy_as_a_touch() -> None:
    true = np.log(np.tile(synthetic(40).features[..., 0], (5, 1, 1)))
    away = as_measured(true, np.random.default_rng(0), pose_m=0.0, discrepancy=0.06) - true
    sigma = TouchProtocol().relative_sigma(float(np.exp(np.median(true[:, 8, 0]))))
    assert away[:, 8, 0].std() == pytest.approx(np.hypot(sigma, 0.06), rel=0.2)


@pytest.mark.parametrize("stiffness", [300.0, 4000.0, 15e3])
def test_the_expected_doubt_is_that_of_a_fitted_curve(stiffness: float) -> None:
    protocol = TouchProtocol()
    rng = np.random.default_rng(0)
    reach = min(protocol.max_deformation_m, protocol.max_force_N / stiffness)
    d = np.arange(1, round(protocol.rate_Hz * reach / protocol.close_m_per_s) + 1)
    d = d * protocol.close_m_per_s / protocol.rate_Hz
    found = [
        fit_curve(
            d + rng.normal(0, 1e-4, len(d)), stiffness * d + rng.normal(0, 0.1, len(d))
        ).i_relative_sigma
        for _ in range(50)
    ]
    # The sum of squares of few samples is a little more than its integral.
    assert np.median(found) == pytest.approx(protocol.relative_sigma(stiffness), rel=0.25)


def test_a_rigid_place_is_resolved_by_six_samples() -> None:
    """Slope of six points spread evenly up to the largest force, of which each deviates by 0.1 mm; limits at 1.5 deviations."""
    protocol = TouchProtocol()
    force = protocol.max_force_N * np.sqrt(1 / 3)  # root mean square
    sigma = protocol.noise.deformation_m / (force * np.sqrt(6))
    assert protocol.resolution_m_per_N == pytest.approx(1.5 * sigma)
    assert protocol.relative_sigma(1e9) == pytest.approx(1e9 * sigma, rel=1e-3)

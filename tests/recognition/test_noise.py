from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.recognition.data import TouchProtocol, fit_curve, noisy_copies

from .worlds import synthetic


def test_copies_are_as_noisy_as_a_touch_and_carry_their_class() -> None:
    data = synthetic(40)
    copies = noisy_copies(data, 5, np.random.default_rng(0), pose_m=0.0, discrepancy=0.06, keep=False)
    assert copies.label == data.label * 5
    away = np.log(copies.features[..., 0]).reshape(5, *data.features.shape[:3]) - np.log(
        data.features[..., 0]
    )
    sigma = TouchProtocol().relative_sigma(float(np.median(data.features[:, 8, 0, 0])))
    assert away[:, :, 8, 0].std() == pytest.approx(np.hypot(sigma, 0.06), rel=0.2)
    np.testing.assert_array_equal(
        noisy_copies(data, 1, np.random.default_rng(0)).features[:120], data.features
    )
    with pytest.raises(InputError, match="expected at least 1"):
        noisy_copies(data, 0, np.random.default_rng(0))


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

"""Unloading is flagged, and corrected against hysteresis laws that the library does not use."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.errors import InputError
from visuohaptic.objects.measurement import Reason
from visuohaptic.sensing.foam.calibration import calibrate_foam
from visuohaptic.sensing.foam.hysteresis import HysteresisState, unloading_factor
from visuohaptic.sensing.foam.profile import read_profile
from visuohaptic.sensing.foam.records import StrainStress


def maxwell(strain, time, law):
    """Nonlinear spring with three relaxing branches (generalised Maxwell), exact for ramps."""
    elastic = law(strain)
    total = 0.6 * elastic
    for share, tau in ((0.2, 0.5), (0.2, 4.0), (0.15, 20.0)):
        q = np.zeros(len(strain))
        for i in range(1, len(strain)):
            dt = time[i] - time[i - 1]
            decay = np.exp(-dt / tau)
            q[i] = decay * q[i - 1] + tau / dt * (1 - decay) * (elastic[i] - elastic[i - 1])
        total = total + share * q
    return np.maximum(total, 0.0)


def slip(strain, law):
    """Elastic foam beside dry-friction elements that stick and slip (Prandtl)."""
    limits = np.array([150.0, 300.0, 450.0, 600.0])  # Pa
    stiffness = limits / np.array([0.01, 0.03, 0.08, 0.15])
    q = np.zeros(4)
    out = np.zeros(len(strain))
    for i in range(1, len(strain)):
        q = np.clip(q + stiffness * (strain[i] - strain[i - 1]), -limits, limits)
        out[i] = q.sum()
    return np.maximum(0.8 * law(strain) + out, 0.0)


def calibrated(strain, stress):
    turn = int(np.argmax(strain))
    direction = np.where(np.arange(len(strain)) <= turn, 1, -1)
    return calibrate_foam(StrainStress(strain, stress, direction), width_m=0.02, height_m=0.01).material


RAMP = np.concatenate([np.linspace(0, 0.55, 300), np.linspace(0.55, 0, 300)[1:]])


@pytest.mark.parametrize("model", ["maxwell", "slip"])
@pytest.mark.parametrize("peak", [0.55, 0.45, 0.35, 0.25])
def test_unloading_error_is_halved_for_foreign_laws(reference_law, model, peak):
    """Calibrated on one loop to 0.55, read on smaller loops."""
    time = np.arange(len(RAMP)) / 60.0

    def truth(strain):
        if model == "maxwell":
            return maxwell(strain, time[: len(strain)], reference_law.stress)
        return slip(strain, reference_law.stress)

    material = calibrated(RAMP, truth(RAMP))
    up = np.arange(0, peak, RAMP[1])
    loop = np.concatenate([up, up[::-1][1:]])
    stress = truth(loop)
    back = slice(len(up) + 3, len(loop) - int(0.02 / RAMP[1]))
    plain = material.stress(loop[back])
    corrected = plain * unloading_factor(material, loop[back], np.full(len(plain), loop.max()))
    error = [np.sqrt(np.mean((found - stress[back]) ** 2)) for found in (plain, corrected)]
    assert error[1] < 0.5 * error[0], error


def strip(depth, points=60, noise=0.0, rng=None):
    s = np.arange(points) * 0.003
    delta = np.where((s > 0.06) & (s < 0.12), depth, 0.0)
    if noise:
        delta = delta + rng.normal(0, noise, points)
    return s, delta, np.full(points, max(noise, 1e-6)), np.ones(points, dtype=bool)


def test_unloading_is_flagged_without_a_curve_and_corrected_with_one(reference_law, material):
    memory = HysteresisState.at_rest(60)
    for depth in (0.002, 0.004, 0.006):
        reading = read_profile(*strip(depth), material, memory=memory)
        assert reading.valid
        assert not reading.unloading
    back = read_profile(*strip(0.004), material, memory=memory)
    assert back.unloading
    assert not back.valid
    assert back.reason is Reason.UNLOADING
    assert not back.point_valid[30]

    down = reference_law.stress(RAMP) * np.where(
        np.arange(len(RAMP)) < 300, 1.0, 0.5 + 0.5 * (RAMP / 0.55) ** 2
    )
    hysteretic = calibrated(RAMP, down)
    memory = HysteresisState.at_rest(60)
    first = read_profile(*strip(0.004), hysteretic, memory=memory)
    read_profile(*strip(0.008), hysteretic, memory=memory)
    second = read_profile(*strip(0.004), hysteretic, memory=memory)
    assert second.valid
    assert second.unloading
    assert second.force_N < 0.9 * first.force_N
    assert second.budget.model_N > 3 * first.budget.model_N


def test_release_forgets_and_rest_does_not_flag(material):
    rng = np.random.default_rng(0)
    memory = HysteresisState.at_rest(60)
    # A contact at rest: the peak creeps up with the noise, no frame may be called unloading.
    flags = [
        read_profile(*strip(0.005, noise=1e-5, rng=rng), material, memory=memory).unloading
        for _ in range(300)
    ]
    assert not any(flags)
    read_profile(*strip(0.0), material, memory=memory)
    assert memory.peak_strain.max() == 0.0
    assert read_profile(*strip(0.002), material, memory=memory).valid


def test_small_unloading_does_not_jump(reference_law):
    stress = reference_law.stress(RAMP) * np.where(np.arange(len(RAMP)) < 300, 1.0, 0.6 + 0.4 * RAMP / 0.55)
    material = calibrated(RAMP, stress)
    factor = unloading_factor(material, np.array([0.3, 0.2999]), np.array([0.3, 0.3]))
    np.testing.assert_allclose(factor, 1.0, atol=0.01)
    assert np.all(np.diff(unloading_factor(material, np.linspace(0.05, 0.3, 50), np.full(50, 0.3))) > -0.01)


def test_wrong_use_says_so(material):
    with pytest.raises(InputError, match="has 5 points, the contour has 60"):
        read_profile(*strip(0.002), material, memory=HysteresisState.at_rest(5))
    with pytest.raises(InputError, match="has no unloading curve"):
        unloading_factor(material, np.array([0.1]), np.array([0.2]))

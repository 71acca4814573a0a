"""Unloading is flagged, and corrected against hysteresis laws that the library does not use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visuohaptic.core import InputError, Reason
from visuohaptic.sensing.foam import FoamContour, read_profile
from visuohaptic.sensing.foam.material import (
    HysteresisLaw,
    HysteresisState,
    StrainStress,
    calibrate_foam,
    identify_hysteresis,
    stop_path,
)


def maxwell(strain, time, law):
    """Nonlinear spring with three relaxing branches (generalised Maxwell), exact for ramps."""
    elastic = law(strain)
    total = 0.6 * elastic
    for fraction, tau in ((0.2, 0.5), (0.2, 4.0), (0.15, 20.0)):
        q = np.zeros(len(strain))
        for i in range(1, len(strain)):
            dt = time[i] - time[i - 1]
            decay = np.exp(-dt / tau)
            q[i] = decay * q[i - 1] + tau / dt * (1 - decay) * (elastic[i] - elastic[i - 1])
        total = total + fraction * q
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


def damaged(strain, law):
    """Pseudo-elastic foam (Ogden-Roxburgh): the largest energy so far damages, reloading is the way back."""
    grid = np.linspace(0, 0.6, 601)
    stress = law(grid)
    energy = np.concatenate([[0], np.cumsum(0.5 * (stress[1:] + stress[:-1]) * np.diff(grid))])
    now = np.interp(strain, grid, energy)
    largest = np.maximum.accumulate(now)
    softer = 1 - np.exp(-(largest - now) / (0.1 * energy[-1] + 0.2 * largest))
    return law(strain) * (1 - 0.35 * softer)


def recorded(strain, stress):
    falling = np.diff(strain, prepend=0.0) < 0
    return StrainStress(strain, stress, np.where(falling, -1, 1))


def calibrated(strain, stress):
    return calibrate_foam(recorded(strain, stress), width_m=0.02, height_m=0.01).material


RAMP = np.concatenate([np.linspace(0, 0.55, 300), np.linspace(0.55, 0, 300)[1:]])


def path(*turns):
    """Strains from rest through turning points, in the steps of the ramp."""
    legs = [np.zeros(1)]
    for begin, end in zip((0.0, *turns), turns, strict=False):
        legs.append(np.linspace(begin, end, max(2, round(abs(end - begin) / RAMP[1]) + 1))[1:])
    return np.concatenate(legs)


def read_path(material, strain):
    loading, law = material.stress(strain), material.hysteresis
    return loading - law.reduction(loading, stop_path(strain, law.yield_strain))[0]


LAWS = {
    "maxwell": lambda strain, law: maxwell(strain, np.arange(len(strain)) / 60.0, law),
    "slip": slip,
    "damaged": damaged,
}
PATHS = {
    "whole loop": lambda p: path(p, 0.02),
    "partial loops": lambda p: path(p, 0.6 * p, 0.9 * p, 0.5 * p, 1.1 * p, 0.7 * p),
    "ringing": lambda p: path(p, p - 0.04, p - 0.01, p - 0.03, p - 0.02),
}


@pytest.mark.parametrize("steps", [1, 5])
@pytest.mark.parametrize("peak", [0.45, 0.35, 0.25, 0.15])
@pytest.mark.parametrize("way", PATHS)
@pytest.mark.parametrize("model", LAWS)
def test_unloading_error_is_halved_for_foreign_laws(reference_law, model, way, peak, steps):
    """Calibrated on one loop to 0.55, in fine or coarse steps; read on other paths."""
    material = calibrated(RAMP[::steps], LAWS[model](RAMP, reference_law.stress)[::steps])
    strain = PATHS[way](peak)
    truth = LAWS[model](strain, reference_law.stress)
    back = (strain < np.maximum.accumulate(strain) - 1e-9) & (strain > 0.02)
    error = [
        np.sqrt(np.mean((found - truth)[back] ** 2))
        for found in (material.stress(strain), read_path(material, strain))
    ]
    assert error[1] < 0.5 * error[0], error


@pytest.mark.parametrize("model", LAWS)
def test_declared_sigma_holds_for_foreign_laws(reference_law, model):
    """Pulls over all paths and sizes: systematic, so only their rms is asked."""
    material = calibrated(RAMP, LAWS[model](RAMP, reference_law.stress))
    law, pulls = material.hysteresis, []
    for way in PATHS.values():
        for peak in (0.45, 0.3, 0.15):
            strain = way(peak)
            loading = material.stress(strain)
            part, sigma = law.reduction(loading, stop_path(strain, law.yield_strain))
            back = (strain < np.maximum.accumulate(strain) - 1e-9) & (strain > 0.02)
            # The loading curve has its own error: 2 % after a reloading that does not quite return to it.
            total = np.hypot(sigma, 0.02 * loading)
            pulls.append((loading - part - LAWS[model](strain, reference_law.stress))[back] / total[back])
    assert 0.2 < np.sqrt(np.mean(np.concatenate(pulls) ** 2)) < 2.1


def test_partial_loops_in_the_record_are_used(reference_law):
    """A record with small loops tells how the loss grows with the strain."""
    record = np.concatenate([RAMP, *(path(p, 0.6 * p, p, 0.0) for p in (0.4, 0.25, 0.12))])
    strain = path(0.2, 0.12, 0.2, 0.1)
    truth = slip(strain, reference_law.stress)
    back = strain < np.maximum.accumulate(strain) - 1e-9
    error = []
    for run in (RAMP, record):
        material = calibrated(RAMP, slip(RAMP, reference_law.stress))
        data = recorded(run, slip(run, reference_law.stress))
        law = identify_hysteresis(data.strain, data.stress_Pa, data.direction, material.loading)
        loading = material.stress(strain)
        found = loading - law.reduction(loading, stop_path(strain, law.yield_strain))[0]
        error.append(np.sqrt(np.mean((found - truth)[back] ** 2)))
    assert error[1] < 0.9 * error[0]


def test_a_sorted_table_is_no_path(reference_law):
    """Loading and unloading points side by side give the same law as the run itself."""
    stress = slip(RAMP, reference_law.stress)
    data = recorded(RAMP, stress)
    loading = calibrated(RAMP, stress).loading
    order = np.argsort(data.strain, kind="stable")
    found = [
        identify_hysteresis(data.strain[o], data.stress_Pa[o], data.direction[o], loading)
        for o in (np.arange(len(RAMP)), order)
    ]
    m = loading.stress(np.array([0.2]))
    parts = [law.reduction(m, stop_path(path(0.5, 0.2), law.yield_strain)[-1:])[0] for law in found]
    assert parts[1] == pytest.approx(parts[0], rel=0.05)


def test_state_follows_the_path_law(reference_law):
    """The strip's memory against the plain path, without noise; a reloading meets the loading curve."""
    law = calibrated(RAMP, slip(RAMP, reference_law.stress)).hysteresis
    strain = path(0.4, 0.3, 0.35, 0.2, 0.45, 0.44)
    memory, seen = HysteresisState.at_rest(3), np.array([True, True, False])
    expected = stop_path(strain, law.yield_strain)
    for now, xi in zip(strain, expected, strict=True):
        memory.update(np.full(3, now), np.zeros(3), seen, law)
        np.testing.assert_allclose(memory.xi[:2], [xi, xi], atol=1e-12)
        assert (memory.xi[2] == 1).all()
    again = expected[np.flatnonzero(strain >= 0.45 - 1e-9)]
    np.testing.assert_allclose(again, 1.0)


def strip(depth, points=60, noise=0.0, rng=None):
    s = np.arange(points) * 0.003
    delta = np.where((s > 0.06) & (s < 0.12), depth, 0.0)
    if noise:
        delta = delta + rng.normal(0, noise, points)
    return FoamContour(s, delta, np.full(points, max(noise, 1e-6)), np.ones(points, dtype=bool))


def test_unloading_is_flagged_without_a_curve_and_corrected_with_one(reference_law, material):
    memory = HysteresisState.at_rest(60)
    for depth in (0.002, 0.004, 0.006):
        reading = read_profile(strip(depth), material, memory=memory)
        assert reading.valid
        assert not reading.unloading
    back = read_profile(strip(0.004), material, memory=memory)
    assert back.unloading
    assert not back.valid
    assert back.reason is Reason.UNLOADING
    assert not back.point_valid[30]

    down = reference_law.stress(RAMP) * np.where(
        np.arange(len(RAMP)) < 300, 1.0, 0.5 + 0.5 * (RAMP / 0.55) ** 2
    )
    hysteretic = calibrated(RAMP, down)
    memory = HysteresisState.at_rest(60)
    first = read_profile(strip(0.004), hysteretic, memory=memory)
    read_profile(strip(0.008), hysteretic, memory=memory)
    second = read_profile(strip(0.004), hysteretic, memory=memory)
    assert second.valid
    assert second.unloading
    assert second.force_N < 0.9 * first.force_N
    assert second.budget.model_N > 2 * first.budget.model_N


def test_one_wrong_edge_is_no_turn_of_the_foam(material):
    """An edge that is 0.8 mm too deep with an error of 0.4 mm, or one of little force with none: nothing has turned."""
    contour = strip(0.004)
    wrong = replace(contour, delta_m=contour.delta_m.copy(), uncertainty_m=np.zeros(60))
    wrong.delta_m[30], wrong.uncertainty_m[30] = 0.0048, 4e-4
    memory = HysteresisState.at_rest(60)
    read_profile(wrong, material, memory=memory)
    assert not read_profile(strip(0.0041), material, memory=memory).unloading
    # Nor is the turn of the others hidden by it.
    read_profile(strip(0.006), material, memory=memory)
    assert read_profile(strip(0.004), material, memory=memory).reason is Reason.UNLOADING
    flank = [replace(contour, delta_m=contour.delta_m.copy()) for _ in range(2)]
    for frame, delta_m in zip(flank, (6e-4, 2e-4), strict=True):
        frame.delta_m[20] = delta_m
    memory = HysteresisState.at_rest(60)
    read_profile(flank[0], material, memory=memory)
    back = read_profile(flank[1], material, memory=memory)
    assert back.unloading
    assert back.valid
    assert not back.point_valid[20]


def test_release_forgets_and_rest_does_not_flag(material):
    rng = np.random.default_rng(0)
    memory = HysteresisState.at_rest(60)
    # A contact at rest: the peak creeps up with the noise, no frame may be called unloading.
    flags = [
        read_profile(strip(0.005, noise=1e-5, rng=rng), material, memory=memory).unloading for _ in range(300)
    ]
    assert not any(flags)
    read_profile(strip(0.0), material, memory=memory)
    assert memory.peak_strain.max() == 0.0
    assert read_profile(strip(0.002), material, memory=memory).valid


def test_nothing_jumps_at_the_flag(reference_law):
    """Force over a slow unloading, in steps of a thousandth of the strain: steps stay alike."""
    stress = reference_law.stress(RAMP) * np.where(np.arange(len(RAMP)) < 300, 1.0, 0.6 + 0.4 * RAMP / 0.55)
    material = calibrated(RAMP, stress)
    memory, force, flags = HysteresisState.at_rest(60), [], []
    for depth in np.concatenate([np.linspace(0.001, 0.006, 30), np.linspace(0.006, 0.005, 100)]):
        reading = read_profile(strip(depth), material, memory=memory)
        force.append(reading.force_N)
        flags.append(reading.unloading)
    steps = -np.diff(force[30:])
    flagged = int(np.argmax(flags[31:]))
    assert 0 < flagged < 50
    np.testing.assert_allclose(steps[flagged - 3 : flagged + 4], steps[flagged], rtol=0.2)
    # The steepest part is just behind the turn; no step is more than 1 % of the force.
    assert steps.max() < 0.01 * max(force)


def test_noise_does_not_turn_the_elements(reference_law):
    """A contact at rest reads the loading stress, as long as it rests: 300 frames, less than 1 %."""
    material = calibrated(RAMP, slip(RAMP, reference_law.stress))
    rng = np.random.default_rng(1)
    memory = HysteresisState.at_rest(60)
    for depth in np.linspace(0.0005, 0.005, 10):
        read_profile(strip(depth, noise=1e-5, rng=rng), material, memory=memory)
    with_memory, without = (
        np.mean([
            read_profile(strip(0.005, noise=1e-5, rng=rng), material, memory=m).force_N for _ in range(300)
        ])
        for m in (memory, None)
    )  # fmt: skip
    assert with_memory == pytest.approx(without, rel=0.01)


def test_wrong_use_says_so(material):
    with pytest.raises(InputError, match="has 5 points, the contour has 60"):
        read_profile(strip(0.002), material, memory=HysteresisState.at_rest(5))
    e = np.array([0.01, 0.1])
    with pytest.raises(InputError, match="yield_strain must be positive and rise"):
        HysteresisLaw(e[::-1], e, e)
    with pytest.raises(InputError, match="fraction and stress_Pa must be >= 0"):
        HysteresisLaw(e, -e, e)
    with pytest.raises(InputError, match="expected three equal ones"):
        HysteresisLaw(e, e[:1], e)


def test_a_held_contact_does_not_creep_down_its_branch(reference_law):
    """Half a minute of noise takes nothing away; it took 0.5 % while each point wandered by itself."""
    law = calibrated(RAMP, slip(RAMP, reference_law.stress)).hysteresis
    rng, sigma, points = np.random.default_rng(9), 2.5e-4, 60  # 5 um of 20 mm
    memory, seen = HysteresisState.at_rest(points), np.ones(points, dtype=bool)
    for now in np.concatenate([np.linspace(0, 0.3, 31), np.full(900, 0.3)]):
        memory.update(now + sigma * rng.standard_normal(points), np.full(points, sigma), seen, law)
    stress = np.full(points, float(reference_law.stress(np.array(0.3))))
    missing, _ = law.reduction(stress, memory.xi)
    # 4.5 standard deviations of what the filter leaves: a few points in 900 frames, by a few per mille.
    assert missing.mean() < 2e-4 * stress[0]


def test_a_kink_does_not_creep_after_its_contact_has_gone_deeper(reference_law):
    """A point in great doubt that scatters little goes its own way at once, and stays there."""
    law = calibrated(RAMP, slip(RAMP, reference_law.stress)).hysteresis
    points, kink = 60, 30
    noise, doubt = np.full(points, 2.5e-4), np.full(points, 2.5e-4)
    noise[kink], doubt[kink] = 1.5e-3, 3e-2
    stress = np.full(points, float(reference_law.stress(np.array(0.18))))

    def lost(noise_sigma) -> float:
        memory, rng = HysteresisState.at_rest(points), np.random.default_rng(4)
        for now in np.concatenate([np.linspace(0, 0.3, 7), np.full(60, 0.3)]):
            strain = np.full(points, now)
            strain[kink] *= 0.6  # neighbours go deeper
            scattered = strain + noise * rng.standard_normal(points)
            memory.update(scattered, doubt, np.ones(points, dtype=bool), law, noise_sigma=noise_sigma)
        return float(law.reduction(stress, memory.xi)[0][kink])

    # The last step is followed with its noise, and comes back by that: two standard deviations are allowed.
    back = np.maximum(1.0 - 2.0 * noise[kink] / law.yield_strain, -1.0)
    allowed = float(law.reduction(stress, np.tile(back, (points, 1)))[0][kink])
    # Held by its doubt it followed its neighbours too far, and crept back.
    assert lost(noise) < allowed < lost(None)

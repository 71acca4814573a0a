"""The monitor's residuals, fit and corrections, against simulations with the parameters changed by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visuohaptic.navigation.pushing import PushModel, PushMonitor, line_path, simulate_push
from visuohaptic.navigation.pushing.push_monitor import CONTACT_SIGMA_M, SAMPLES, SIGMAS
from visuohaptic.navigation.pushing.quasi_static import STEP_M

RADIUS_M = 0.17
BOX = 0.16 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
MODEL = PushModel.patch(BOX, 0.2)
START = (0.36, 0.06, 0.1)
#: Along a line that is turned by 0.3 rad.
TURN = np.array([[math.cos(0.3), math.sin(0.3)], [-math.sin(0.3), math.cos(0.3)]])
PATH = line_path(np.zeros(2), np.array([0.6, 0.0]) @ TURN)
OBJECT = (*(np.array(START[:2]) @ TURN), START[2] + 0.3)


def changed(value, model=MODEL):
    """Model and pose with friction, centre of friction and lateral place changed."""
    left = np.array([0.0, 1.0]) @ TURN
    moved = replace(
        model,
        contact_friction=max(0.0, model.contact_friction + value[0]),
        support_m=model.support_m + value[1:3],
    )
    return moved, (*(np.array(OBJECT[:2]) + value[3] * left), OBJECT[2])


def monitored(truth=(0.0, 0.0, 0.0, 0.0), rows=26):
    seen = simulate_push(*changed(np.array(truth)), PATH, RADIUS_M)
    monitor = PushMonitor(MODEL, OBJECT, RADIUS_M)
    for pose, contact in zip(PATH[:rows], seen.contact_m[:rows], strict=True):
        monitor.update(pose, None if np.isnan(contact[0]) else contact)
    return monitor, seen


def residuals(seen, value, rows):
    """Angles on the rim between what is seen and what is simulated, as lengths, and the prior."""
    simulated = simulate_push(*changed(value), PATH[:rows], RADIUS_M)
    found = []
    for k in range(rows):
        if not np.isnan(seen.contact_m[k, 0]):
            angles = [math.atan2(*(one.contact_m[k] - PATH[k, :2])[::-1]) for one in (simulated, seen)]
            found.append(0.3 if math.isnan(angles[0]) else math.remainder(angles[0] - angles[1], 2 * math.pi))
    return np.concatenate([np.clip(found, -0.5, 0.5) * RADIUS_M / CONTACT_SIGMA_M, value / np.array(SIGMAS)])


def test_residuals_are_contacts_on_the_rim_and_the_prior():
    monitor, seen = monitored((0.1, 0.02, -0.03, 0.008))
    for value in (
        (0.0, 0.0, 0.0, 0.0),
        (0.12, 0.01, -0.02, 0.0),
        (-0.15, -0.03, 0.02, -0.006),
        (0.0, 0.0, 0.0, 0.01),
    ):
        np.testing.assert_allclose(
            monitor._residual(np.array(value)), residuals(seen, np.array(value), 26), atol=1e-9
        )


def test_the_fit_is_the_least_of_all_and_its_covariance_that_of_the_slopes():
    truth = np.array([0.1, 0.02, -0.03, 0.008])
    monitor, seen = monitored(truth)
    estimate = monitor.estimate()

    def size(value):
        return float((residuals(seen, value, 26) ** 2).sum())

    best = size(estimate.value)
    assert best < 0.5 * size(np.zeros(4))
    rng = np.random.default_rng(1)
    others = [size(estimate.value + 0.3 * np.array(SIGMAS) * rng.standard_normal(4)) for _ in range(40)]
    # Three damped iterations after each step: near the least value, not exactly there.
    assert best < 1.15 * min(others) + 0.1
    slope = np.stack(
        [(residuals(seen, estimate.value + d, 26) - residuals(seen, estimate.value - d, 26)) / 2 / d.sum()
         for d in np.diag(0.02 * np.array(SIGMAS))], axis=1)  # fmt: skip
    declared, expected = (
        np.sqrt(np.diag(estimate.covariance)),
        np.sqrt(np.diag(np.linalg.inv(slope.T @ slope))),
    )
    np.testing.assert_allclose(declared, expected, rtol=0.35)
    assert (declared < 1.02 * np.array(SIGMAS)).all()
    contacts = residuals(seen, estimate.value, 26)[:-4] * CONTACT_SIGMA_M
    assert estimate.residual_m == pytest.approx(math.sqrt(float(np.mean(contacts**2))), rel=1e-6)
    # The object is where the fitted model has it at the last contact.
    ours = simulate_push(*changed(estimate.value), PATH[:26], RADIUS_M)
    last = int(np.flatnonzero(~np.isnan(seen.contact_m[:26, 0]))[-1])
    np.testing.assert_allclose(estimate.object_m, ours.object_m[last], atol=1e-9)
    np.testing.assert_allclose(estimate.model.support_m, MODEL.support_m + estimate.value[1:3])
    assert estimate.model.contact_friction == pytest.approx(0.2 + estimate.value[0])


def test_nothing_is_fitted_before_four_steps_and_two_contacts():
    monitor = PushMonitor(MODEL, OBJECT, RADIUS_M)
    wrong = np.array([0.17, 0.05])
    for k in range(3):
        assert monitor.update(PATH[k], PATH[k, :2] + wrong)
        assert not monitor.estimate().value.any()
    assert monitor.update(PATH[3], PATH[3, :2] + wrong)
    assert monitor.estimate().value.any()
    blind = PushMonitor(MODEL, OBJECT, RADIUS_M)
    for pose in PATH[:8]:
        blind.update(pose, None)
    found = blind.estimate()
    assert not found.value.any()
    np.testing.assert_allclose(found.covariance, np.diag(np.square(SIGMAS)))
    assert found.residual_m == 0.0
    np.testing.assert_allclose(found.object_m, OBJECT)


def test_a_step_counts_from_eight_tenths_of_its_length_and_the_last_half_of_it_is_averaged():
    monitor = PushMonitor(MODEL, OBJECT, RADIUS_M)
    ahead = np.array([1.0, 0.0]) @ TURN
    assert monitor.update((0.0, 0.0, 0.3), None)
    for share, new in ((0.3, False), (0.55, False), (0.75, False), (0.85, True)):
        place = share * STEP_M * ahead
        angle = 0.3 + {0.3: 1.0, 0.55: 0.02, 0.75: 0.04, 0.85: 0.06}[share]
        contact = place + RADIUS_M * np.array([math.cos(angle), math.sin(angle)])
        assert monitor.update((*place, 0.3), contact) == new
    assert monitor._angle[-1] == pytest.approx(0.34)


REST = line_path(PATH[25, :2], np.array([1.5, 0.0]) @ TURN)


def aside_of(path):
    """Lateral place of a path's end, to the left."""
    return float((path[-1, :2] - REST[-1, :2]) @ (np.array([0.0, 1.0]) @ TURN))


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [(0.0, 0.0), (0.03, 0.04), (-0.03, -0.04), (0.1, 0.12), (-0.2, -0.22), (0.15, 0.17)],
)
def test_a_correction_is_the_smallest_shift_that_is_allowed(wanted, expected):
    monitor, _ = monitored()

    def allowed(path, trace):
        off = aside_of(path)
        return off >= wanted - 1e-6 if wanted >= 0 else off <= wanted + 1e-6

    found = monitor.corrected(REST, np.random.default_rng(0), allowed=allowed)
    assert aside_of(found) == pytest.approx(expected, abs=1e-6)
    np.testing.assert_allclose(found[0, :2], REST[0, :2])
    assert (found is REST) == (expected == 0.0)
    assert (
        monitor.corrected(REST, np.random.default_rng(0), allowed=lambda path, trace: aside_of(path) > 0.31)
        is None
    )


@pytest.mark.parametrize(("failing", "first"), [((), 0.0), ((3,), 0.0), ((3, 5), 0.04), ((0,), 0.04)])
def test_eight_of_nine_models_have_to_agree_and_the_estimate_is_one_of_them(failing, first):
    """The calls are those of the estimate and of eight samples, shift by shift."""
    monitor, _ = monitored()
    calls = []

    def allowed(path, trace):
        calls.append(aside_of(path))
        return len(calls) > 1 + SAMPLES or len(calls) - 1 not in failing

    found = monitor.corrected(REST, np.random.default_rng(0), allowed=allowed)
    assert aside_of(found) == pytest.approx(first, abs=1e-6)
    assert SAMPLES == 8


def test_a_push_has_to_end_a_tenth_of_a_metre_before_the_path():
    """A drive that still pushes at its end is no release; a path that is nearly over is not changed; a miss is fine."""
    monitor, _ = monitored(rows=12)
    still = line_path(PATH[11, :2], PATH[20, :2])
    assert monitor.corrected(still, np.random.default_rng(0)) is None
    short = line_path(PATH[11, :2], PATH[11, :2] + np.array([1.9 * STEP_M, 0.0]) @ TURN)
    assert monitor.corrected(short, np.random.default_rng(0)) is short
    away = PushMonitor(MODEL, (0.3, 0.6, 0.0), RADIUS_M)
    for pose in PATH[:6]:
        away.update(pose, None)
    beside = line_path(PATH[5, :2], PATH[5, :2] + np.array([0.5, -0.1]))
    assert away.corrected(beside, np.random.default_rng(0)) is beside

"""Foam beside a push is drawn along; an occluder's edge is not foam."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.sensing.foam.material import read_plate
from visuohaptic.sensing.foam.validity import DECAY_PER_WIDTH, OnsetWatch, stepped_points
from visuohaptic.sensing.foam.validity._flank_kernels import REACH, SPAN, below_chord
from visuohaptic.simulation.foam import FoamStrip, FoamStripGeometry, Outline

WIDTH, SPACING = 0.02, 0.003
S = SPACING * (np.arange(80) + 0.5)
SIGMA = np.full(80, 2e-5)
ENDS = (SPACING / 2, SPACING / 2)


def stepped(delta, sigma=SIGMA, seen=None, s=S) -> np.ndarray:
    seen = np.ones(len(s), dtype=bool) if seen is None else seen
    return stepped_points(s, delta, sigma, seen, WIDTH, ENDS)


def plain_excess(s, delta, sigma, decay, tolerance, bulge, bulge_reach, sigmas):
    """The same by building the mirrored strip and solving for each catenary."""
    n = len(s)
    start, end = s[0] - ENDS[0], s[-1] + ENDS[1]
    x = np.concatenate([2 * start - s[::-1], s, 2 * end - s[::-1]])
    y, e = np.tile(delta, 3), np.tile(sigma, 3)
    y[:n], y[2 * n :], e[:n], e[2 * n :] = delta[::-1], delta[::-1], sigma[::-1], sigma[::-1]
    result = np.full(n, -1.0)
    for b in range(n):
        deepest = max(delta[np.abs(s - s[b]) <= bulge_reach].max(), 0.0)
        for left in range(1, REACH + 1):
            for right in range(1, min(REACH, SPAN - left) + 1):
                a, m, c = b + n - left, b + n, b + n + right
                if max(y[a], y[c]) <= y[m]:
                    continue
                basis = np.exp(
                    np.array([[x[a], -x[a]], [x[c], -x[c]]] - x[m] * np.array([[1, -1]] * 2)) / decay
                )
                fraction = np.ones(2) @ np.linalg.inv(basis)  # value at b per unit at a and at c
                value = fraction @ [y[a], y[c]] - y[m] - tolerance * max(y[a], y[c]) * fraction.sum()
                value -= bulge * deepest + sigmas * np.sqrt(
                    (fraction * [e[a], e[c]]) ** 2 @ [1, 1] + e[m] ** 2
                )
                result[b] = max(result[b], value)
    return result


@given(seed=st.integers(0, 10**6), count=st.integers(6, 30))
@settings(max_examples=30, deadline=None)
def test_kernel_equals_its_plain_twin(seed, count) -> None:
    rng = np.random.default_rng(seed)
    s = np.cumsum(rng.uniform(0.002, 0.006, count))
    delta = rng.uniform(-1e-3, 8e-3, count)
    sigma = rng.uniform(0, 1e-4, count)
    settings_ = (0.003, 0.03, 0.01, 0.03, 4.0)
    excess, side = below_chord(s, delta, sigma, s[0] - ENDS[0], s[-1] + ENDS[1], *settings_)
    np.testing.assert_allclose(excess, plain_excess(s, delta, sigma, *settings_), atol=1e-12)
    assert set(side[excess > -1.0]) <= {-1, 1}


@pytest.mark.parametrize("depth_mm", [1.0, 3.0, 8.0])
def test_a_hand_makes_a_step(depth_mm) -> None:
    rng = np.random.default_rng(1)
    hand = SIGMA * rng.standard_normal(80)
    hand[20:40] += 1e-3 * depth_mm
    assert np.flatnonzero(stepped(hand)).tolist() == list(range(20, 40))


def test_a_hand_over_the_end_of_the_strip() -> None:
    hand = np.zeros(80)
    hand[60:] = 0.002
    assert np.flatnonzero(stepped(hand)).tolist() == list(range(60, 80))


def test_a_hand_with_a_slanting_edge_beside_a_contact() -> None:
    y = S - 0.06
    push = 0.004 * np.exp(-np.maximum(np.abs(y) - 0.01, 0.0) / 0.006)
    hand = np.clip(0.5 * (S - 0.15), 0.0, 0.004) * (S < 0.2)  # flanks of 27 and of 90 degrees
    found = stepped(push + hand)
    assert found[(S > 0.16) & (S < 0.2)].all()
    assert not found[S < 0.1].any()


def test_points_that_are_not_seen_hide_no_step() -> None:
    hand, seen = np.zeros(80), np.ones(80, dtype=bool)
    hand[20:40] = 0.003
    seen[[19, 40]] = False
    hand[[19, 40]] = np.nan
    assert np.flatnonzero(stepped(hand, seen=seen)).tolist() == list(range(20, 40))


def test_texture_that_scatters_more_than_declared_is_no_step() -> None:
    rng = np.random.default_rng(5)
    plate = np.clip(0.02 * (S - 0.12), 0.0, None)
    for scatter in (2e-5, 4e-5, 6e-5, 1e-4):  # up to five declared sigmas
        alarms = [stepped(plate + scatter * rng.standard_normal(80)).any() for _ in range(200)]
        # Less than one frame in a hundred is allowed; 200 draws of 1 % have 5 or fewer in 98 %.
        assert np.sum(alarms) <= 5
    hand = 1e-4 * rng.standard_normal(80)
    hand[30:50] += 0.004
    assert stepped(hand)[30:50].all(), "four millimetres are a step all the same"


def test_what_is_uncertain_proves_nothing() -> None:
    hand = np.zeros(80)
    hand[20:40] = 0.001
    assert not stepped(hand, sigma=np.full(80, 2e-4)).any()


@pytest.mark.parametrize(
    "body",
    [
        Outline.disc((0.02, 0.0), 0.02),
        Outline.disc((0.005, 0.0), 0.005),
        Outline.box((0.01, 0.0), (0.02, 0.04), edge_m=0.0005),
        Outline.box((0.01, 0.0), (0.02, 0.04), edge_m=0.0005).moved(0.0, 0.0, 0.3),
        Outline.disc((0.02, 0.12), 0.02),  # half beyond the end of the strip
    ],
    ids=["cylinder", "pin", "plate", "tilted plate", "at the end"],
)
@pytest.mark.parametrize("radius_m", [np.inf, 0.25])
def test_no_push_of_the_simulated_strip_has_a_step(body, radius_m) -> None:
    strip = FoamStrip(FoamStripGeometry(length_m=0.24, radius_m=radius_m, spacing_m=0.001))
    path = np.concatenate([np.arange(0.0, 0.0101, 2.5e-4), np.arange(0.01, 0.0, -5e-4)])
    for i, depth in enumerate(path):
        state = strip.press([body.moved(WIDTH - depth, 0.0)], 1 / 30)
        if i % 4 == 0:
            for shift in (0.0, 0.0015):
                s = S - 0.12 + shift
                delta = np.interp(s, strip.s_m, state.delta_m)
                # No noise at all: the strictest case.
                assert not stepped_points(s, delta, 0 * SIGMA, S > 0, WIDTH, ENDS).any(), depth


def test_no_push_of_continuum_foam_has_a_step(continuum) -> None:
    foam = continuum.Foam((25000, 500), (10, -1))
    for body in (continuum.wedge(np.pi / 4), continuum.cylinder(0.006)):
        for depth, _, s, delta in continuum.press(foam, body, (0.001, 0.004), length=0.05, fine=6e-4, rows=8):
            for shift in (0.0, 0.001, 0.002):
                at = S[:33] - S[16] + shift
                found = stepped_points(
                    at, np.interp(np.abs(at), s, delta), SIGMA[:33] * 0, at < 1, WIDTH, ENDS
                )
                assert not found.any(), depth


@pytest.mark.data
def test_no_delivered_record_has_a_step(data) -> None:
    for name in ("plate_4cm", "cylinder_12cm", "large_plate"):
        for record in read_plate(data / "foam_continuum" / f"{name}.csv"):
            for shift in np.arange(6) * 0.0005:
                delta = np.interp(S + shift, record.s_m, record.delta_m)
                assert not stepped(delta, sigma=0 * SIGMA).any(), (name, record.depth_m)


def test_points_under_a_hand_stay_suspect_until_they_fall() -> None:
    watch = OnsetWatch(80, 0.1)
    seen, free = np.ones(80, dtype=bool), np.zeros(80)
    hand = free.copy()
    hand[20:40] = 0.002
    over = hand > 0
    watch.check(0.0, free, SIGMA, seen, over & False)
    assert watch.check(0.03, hand, SIGMA, seen, over)[over].all()
    assert watch.check(0.06, hand, SIGMA, seen, over & False)[over].all(), "another edge hides the step"
    assert not watch.check(0.09, free, SIGMA, seen, over & False).any()


def test_decay_is_that_of_the_widths_own_scale() -> None:
    # The Pasternak law of boundary.py for small strains: l^2 = kappa w^2 / 6, kappa 0.27 - 0.1.
    assert np.sqrt((0.27 - 0.1) / 6) > DECAY_PER_WIDTH

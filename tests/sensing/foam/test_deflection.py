"""Bounds for hidden foam, and errors common to reading and zero."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from visuohaptic.sensing.foam.deflection import (
    Deflection,
    fill_gaps,
)
from visuohaptic.sensing.foam.edges import edge_uncertainty_m, with_cancelled_texture
from visuohaptic.sensing.foam.material.hysteresis import HysteresisState
from visuohaptic.sensing.foam.posterior import EdgeStates
from visuohaptic.sensing.foam.profile import FoamReading, read_profile
from visuohaptic.sensing.foam.strip import StripGeometry
from visuohaptic.sensing.foam.validity import Validity, with_states

GEOMETRY = StripGeometry.straight(0.25, 0.02)
K = len(GEOMETRY.s_m)
SIGMA = np.full(K, 1e-5)


def filled(delta, hidden):
    """The contour with an occluder on some of its points."""
    probability = np.zeros((K, 4))
    probability[:, 0], probability[hidden] = 1.0, [0.0, 0.0, 1.0, 0.0]
    states = EdgeStates(probability, np.zeros(K), "")
    seen = states.foam
    filled = fill_gaps(GEOMETRY, delta, SIGMA, SIGMA, 0.0 * SIGMA, seen)
    return Deflection(*filled[:4], seen, filled[4], delta, states, *np.zeros((3, K)), filled[5])


def test_what_is_hidden_is_bounded_by_what_it_draws_along(continuum, reference_law) -> None:
    # As sharp as a pencil: whatever is blunter draws more foam along beside it.
    presses = continuum.press(
        reference_law, continuum.cylinder(0.006), (0.001, 0.003), length=0.05, fine=6e-4, rows=8
    )
    for depth, _, s, delta in presses:
        for half_m in (0.005, 0.008, 0.012):
            contour = np.interp(np.abs(GEOMETRY.s_m), s, delta)
            found = filled(contour, np.abs(GEOMETRY.s_m) < half_m)
            assert found.covered.any()
            assert (found.hidden_m[~found.seen] >= contour[~found.seen]).all(), (depth, half_m)


def test_a_finger_beside_nothing_hides_little_and_a_hand_hides_anything(material) -> None:
    force = [
        material.pressed_force_N(filled(np.zeros(K), np.abs(GEOMETRY.s_m) < half_m).hidden_m, GEOMETRY.cell_m)
        for half_m in (0.007, 0.04)
    ]
    # 5 points of 3 mm, at most 9 mm from the last one seen: 10 um exp(9 / 3) each at 0.1 N per mm and point.
    assert force[0] < 5 * 0.1 * 0.01 * np.exp(9 / 3)
    assert force[1] > 0.5


def test_a_gap_at_the_end_of_the_strip_is_bounded_from_one_side() -> None:
    found = filled(np.zeros(K), np.arange(K) < 4)
    assert np.all(np.diff(found.hidden_m[:4]) < 0.0)
    assert np.isfinite(found.delta_m).all()


def test_an_inaccurate_edge_beside_a_gap_is_bounded_by_the_foam_beside_it() -> None:
    """The edge of a shadow that crosses the front of foam at rest is 3 +- 1 mm behind it, and foam cannot form that step."""
    delta, sigma, hidden = np.zeros(K), SIGMA.copy(), np.isin(np.arange(K), (41, 42, 43))
    delta[40], sigma[40] = 3e-3, 1e-3
    found = fill_gaps(GEOMETRY, delta, sigma, SIGMA, 0.0 * SIGMA, ~hidden)
    apart = np.minimum(np.arange(40, 44) - 39, 44 - np.arange(40, 44)) * (GEOMETRY.s_m[1] - GEOMETRY.s_m[0])
    # 10 um e^(x / 3 mm) from the nearest point of either side that is known to 10 um.
    np.testing.assert_allclose(found[4][40:44], 1e-5 * np.exp(apart / 3e-3), rtol=1e-6)
    assert np.abs(found[0]).max() <= found[4].max()
    # A step that is measured accurately is a question of what the edge is, not of where the foam is.
    delta[40], sigma[40] = 1e-4, 1e-5
    assert fill_gaps(GEOMETRY, delta, sigma, SIGMA, 0.0 * SIGMA, ~hidden)[0][40] == delta[40]


def test_two_points_are_bridged_and_not_hidden() -> None:
    delta = 0.004 * np.exp(-np.maximum(np.abs(GEOMETRY.s_m) - 0.01, 0.0) / 0.006)
    found = filled(delta, np.isin(np.arange(K), (45, 46)))
    assert not found.covered.any()
    assert (np.abs(found.delta_m - delta) < 3.0 * found.sigma_m)[45:47].all()


def test_a_hidden_tip_is_within_its_error() -> None:
    # A wedge with a blunt edge of 3 mm radius: the straight line between its flanks is up to .7 mm above the tip.
    turn, radius = np.deg2rad(30.0), 0.003
    away = np.abs(GEOMETRY.s_m - GEOMETRY.s_m[45])
    round_m, flank_m = (
        np.sqrt(np.maximum(radius**2 - away**2, 0.0)),
        away * np.tan(turn) + radius * (np.cos(turn) - 1.0 / np.cos(turn)),
    )
    dent = np.where(away < radius * np.sin(turn), radius - round_m, flank_m)
    delta = np.maximum(0.006 - dent, 0.0)
    for hidden in ((45,), (44, 45)):
        found = filled(delta, np.isin(np.arange(K), hidden))
        assert (np.abs(found.delta_m - delta) < 2.0 * found.sigma_m)[list(hidden)].all()


def test_a_line_that_meets_the_end_face_is_replaced_by_the_decay_of_its_neighbours() -> None:
    # A plate up to 8 mm from the end; the front corner recedes, so that the last line meets the end face, 3 mm too deep.
    delta = 0.006 * np.exp(-np.maximum(GEOMETRY.s_m - GEOMETRY.s_m[-4], 0.0) / 0.004)
    edge, unclean = delta.copy(), np.zeros(K)
    edge[-1], unclean[-1] = edge[-1] + 0.003, 0.0008
    found, sigma, _, _, hidden, _ = fill_gaps(GEOMETRY, edge, SIGMA, SIGMA, unclean, np.ones(K, dtype=bool))
    assert abs(found[-1] - delta[-1]) < sigma[-1] < 0.0008
    assert not hidden.any()
    # Where the front is level, the body may end before the last line: its edge is kept.
    edge[-4:-1] = 0.006
    assert fill_gaps(GEOMETRY, edge, SIGMA, SIGMA, unclean, np.ones(K, dtype=bool))[0][-1] == edge[-1]


def test_a_flank_that_shows_the_far_edge_of_a_gap_is_inferred_from_its_neighbours() -> None:
    """Beside a dark body the gap of floor is merged with the front, and the foam beside that line is known to a third of its error."""
    delta, at = 0.001 * np.exp(-np.maximum(np.abs(GEOMETRY.s_m) - 0.006, 0.0) / 0.006), 46
    edge, unclean = delta.copy(), np.zeros(K)
    edge[at], unclean[at] = edge[at] - 0.0008, 0.00027
    unclean[[at - 1, at + 1]] = 0.00004, 0.00017
    found, sigma, _, _, hidden, _ = fill_gaps(GEOMETRY, edge, SIGMA, SIGMA, unclean, np.ones(K, dtype=bool))
    assert abs(found[at] - delta[at]) < sigma[at] < unclean[at]
    # Neighbours may share their errors: those of the decay between a and b are the geometric mean times the relative errors' mean.
    a, b, line = delta[at - 1], delta[at + 1], 0.5 * (delta[at - 1] + delta[at + 1])
    mean = np.sqrt(a * b)
    relative = 0.5 * (np.hypot(4e-5, 1e-5) / a + np.hypot(1.7e-4, 1e-5) / b)
    assert sigma[at] == pytest.approx(np.hypot(mean * relative, 0.5 * (line - mean)), rel=1e-3)
    # Where the next lines are as inaccurate, the worst one is inferred and they are measured: nothing is hidden.
    unclean[at - 2 : at + 3] = 0.00015, 0.00022, 0.0003, 0.00022, 0.00015
    found, _, _, _, hidden, seen = fill_gaps(GEOMETRY, edge, SIGMA, SIGMA, unclean, np.ones(K, dtype=bool))
    assert not hidden.any()
    assert seen[[at - 1, at, at + 1]].tolist() == [True, False, True]


def test_the_bottom_of_the_trough_between_two_bodies_is_no_decay() -> None:
    """Two plates 12 mm apart: foam rises from the bottom to either side, where an edge that is a little inaccurate is kept."""
    apart = np.abs(GEOMETRY.s_m - GEOMETRY.s_m[45] - 0.0008)
    delta = 0.005 * np.cosh(np.minimum(apart, 0.006) / 0.003) / np.cosh(2.0)
    delta *= np.exp(-np.maximum(apart - 0.015, 0.0) / 0.006)
    unclean = np.zeros(K)
    unclean[[44, 45, 46]] = 0.0001, 0.0004, 0.0001
    found, sigma, *_, seen = fill_gaps(GEOMETRY, delta, SIGMA, SIGMA, unclean, np.ones(K, dtype=bool))
    assert (np.abs(found - delta) < sigma).all()
    assert seen[45]


def test_texture_that_the_zero_has_too_cancels() -> None:
    rng = np.random.default_rng(4)
    noise, texture = np.full(K, 5e-6), 3e-5
    pixel, clean = np.full(K, 2e-4), np.ones(K, dtype=bool)
    declared = np.full(K, np.hypot(5e-6, texture))
    rest = 5e-6 * rng.standard_normal(K)
    sigma = with_cancelled_texture(rest, declared, noise, clean, pixel)
    # Its scatter over 81 second differences is known to a fifth.
    assert np.median(sigma) < 1.5 * 5e-6
    moved = np.where(np.abs(GEOMETRY.s_m) < 0.02, 0.003, rest)
    sigma = with_cancelled_texture(moved, declared, noise, clean, pixel)
    np.testing.assert_allclose(sigma[np.abs(GEOMETRY.s_m) < 0.02], declared[0], rtol=1e-6)
    # Another light at every point: nothing cancels.
    changed = np.hypot(5e-6, texture) * rng.standard_normal(K)
    sigma = with_cancelled_texture(changed, declared, noise, clean, pixel)
    assert 0.7 < np.median(sigma) / declared[0] < 1.4


def test_an_edge_that_may_be_that_of_an_occluder_is_no_history_of_the_foam() -> None:
    found = filled(np.full(K, 0.002), np.zeros(K, dtype=bool))
    doubt = np.where(np.isin(np.arange(K), np.arange(40, 46)), 0.4, 0.0)
    contour = replace(found, states=replace(found.states, doubt=doubt)).contour(GEOMETRY, 0.0)
    np.testing.assert_array_equal(np.flatnonzero(~contour.measured), np.arange(40, 46))


PLATE_M = 0.003 * np.exp(-np.maximum(np.abs(GEOMETRY.s_m) - 0.02, 0.0) / 0.006)


def read_with(material, delta, doubt) -> tuple[FoamReading, FoamReading, float]:
    """The reading before and after the states of its points are known, and the probability that it is wrong."""
    found = filled(delta, np.zeros(K, dtype=bool))
    found = replace(found, states=replace(found.states, doubt=doubt))
    before = read_profile(found.contour(GEOMETRY, 0.0), material)
    return before, *with_states(before, found, material, GEOMETRY.cell_m)


def test_texture_in_the_residual_is_not_counted_twice() -> None:
    """An edge between uneven levels: its error by texture is declared by the tracker, what it leaves in the residual is not
    another one. A kink whose residual is that of 30 noise variances errs by 30 times the noise, all of it coherent."""
    textured = SimpleNamespace(chi2=np.array([1.5, 3.0, 30.0]))
    strip = SimpleNamespace(
        front=textured,
        usable=np.array([True, True, False]),
        low_confidence=np.array([False, False, True]),
        width_sigma_m=np.array([3e-5, 3e-5, 3e-5]),
        width_noise_m=np.full(3, 4e-6),
    )
    clean, uneven, kink = edge_uncertainty_m(strip)
    assert clean == 0.0
    assert uneven < 0.5 * 3e-5
    assert kink == pytest.approx(30 * 4e-6)


def test_a_run_that_may_be_no_foam_is_in_sigma_and_refuses_the_frame(material) -> None:
    doubt = np.zeros(K)
    before, after, wrong = read_with(material, PLATE_M, doubt)
    assert wrong == 0.0
    assert after.budget.total_N < 1.1 * before.budget.total_N
    # Five points of the plate, each 3 mm of 10 mm high foam under its stress at 3 mm, with one in a hundred.
    part = slice(K // 2 - 2, K // 2 + 3)
    doubt[part] = 0.01
    _, after, wrong = read_with(material, PLATE_M, doubt)
    force_N = 5 * np.diff(GEOMETRY.s_m).mean() * 0.01 * float(material.stress(np.array([0.003 / 0.02]))[0])
    added_N = np.sqrt(after.budget.total_N**2 - before.budget.total_N**2)
    np.testing.assert_allclose(added_N, 0.1 * force_N, rtol=0.05)
    assert wrong == pytest.approx(0.01)
    # The same points hardly pressed: whatever they are, the force is right.
    _, _, wrong = read_with(material, 0.002 * PLATE_M, doubt)
    assert wrong == 0.0


def test_points_apart_are_in_doubt_for_one_cause(material) -> None:
    """Another lamp moves two parts of the front or none; the more certain part counts with its own probability."""
    doubt = np.zeros(K)
    doubt[K // 2 - 4 : K // 2 - 1], doubt[K // 2 + 2 : K // 2 + 5] = 0.04, 0.01
    before, after, wrong = read_with(material, 0.08 * PLATE_M, doubt)
    part_N = (
        3 * np.diff(GEOMETRY.s_m).mean() * 0.01 * float(material.stress(np.array([0.08 * 0.003 / 0.02]))[0])
    )
    added_N = np.sqrt(after.budget.total_N**2 - before.budget.total_N**2)
    np.testing.assert_allclose(added_N, part_N * np.sqrt(0.04 + 3 * 0.01), rtol=0.05)
    assert part_N < 3.0 * before.budget.total_N + 0.05 < 2.0 * part_N, "both parts together are too much"
    assert wrong == pytest.approx(0.01)


def test_light_shifts_all_points_of_a_contact_alike(material) -> None:
    found = filled(PLATE_M, np.zeros(K, dtype=bool))
    before = read_profile(found.contour(GEOMETRY, 0.0), material)
    light_m = 2e-5
    without, after = (
        with_states(before, replace(found, light_m=np.full(K, shift)), material, GEOMETRY.cell_m)[0]
        for shift in (0.0, light_m)
    )
    # The force of the same contact without tension, deflected by so much more.
    inside = (np.arange(K) >= before.contacts[0].first) & (np.arange(K) <= before.contacts[0].last)
    plain, deeper = (material.stress((PLATE_M + shift) / 0.02) * inside for shift in (0.0, light_m))
    more_N = 0.01 * np.trapezoid(deeper - plain, GEOMETRY.s_m)
    assert np.sqrt(after.budget.total_N**2 - without.budget.total_N**2) == pytest.approx(more_N, rel=0.05)


def test_what_a_shadow_may_hide_is_not_out_of_sight() -> None:
    found = filled(PLATE_M, np.zeros(K, dtype=bool))
    assert not replace(found, hidden_m=np.where(PLATE_M > 1e-3, PLATE_M, 0.0)).covered.any()
    assert filled(PLATE_M, np.abs(GEOMETRY.s_m) < 0.01).covered.any()


def test_what_is_filled_in_is_no_memory_of_the_foam(material) -> None:
    """Half of a plate's foam is out of sight, and what is there then was never as deep as its neighbours."""
    memory = HysteresisState.at_rest(K)
    beyond = np.arange(K) > K // 2
    first = filled(np.where(beyond, 0.0, 0.004), beyond)
    assert first.delta_m[K // 2 + 3] == pytest.approx(0.004)
    read_profile(first.contour(GEOMETRY, 0.0), material, memory=memory)
    now = filled(np.where(beyond, 0.003, 0.0041), np.zeros(K, dtype=bool))
    assert not read_profile(now.contour(GEOMETRY, 0.0), material, memory=memory).unloading


def test_foam_that_was_hidden_in_a_contact_has_an_unknown_branch_and_free_foam_has_none(material) -> None:
    """Six points are out of sight for a third of a second: three tenths of their force are uncertain, if anything was pressed then."""
    config = SimpleNamespace(tracking=SimpleNamespace(bump_px=2.0), max_contact_speed_m_s=0.1)
    setup = SimpleNamespace(material=material, geometry=GEOMETRY, config=config)
    away, nothing = np.isin(np.arange(K), np.arange(40, 46)), np.zeros(K, dtype=bool)
    front = SimpleNamespace(reason=np.zeros(K, dtype=int))
    frames = [(k / 30, away if 0 < k < 10 else nothing) for k in range(11)]

    def last(deltas) -> tuple[float, float]:
        """Model error of the last frame, with and without the history of the others."""
        validity = Validity(setup)
        for (t_s, hidden), delta in zip(frames, deltas, strict=True):
            found = filled(delta, hidden)
            before = read_profile(found.contour(GEOMETRY, 0.0), material)
            strip = SimpleNamespace(t_s=t_s, moved_px=0.0, front=front)
            after, _ = validity.evaluate(before, found, strip, frame_s=1 / 30, drifted=False)
        return after.budget.model_N, with_states(before, found, material, GEOMETRY.cell_m)[0].budget.model_N

    found_N, alone_N = last([PLATE_M] * 11)
    pressed_N = material.pressed_force_N(np.where(away, PLATE_M, 0.0), GEOMETRY.cell_m)
    assert pressed_N > 0.5
    assert found_N == pytest.approx(np.hypot(alone_N, 0.3 * pressed_N), rel=1e-6)
    found_N, alone_N = last([np.zeros(K)] * 10 + [PLATE_M])
    assert found_N == pytest.approx(
        np.hypot(alone_N, 0.3 * pressed_N), rel=1e-6
    )  # it may have begun out of sight
    # A frame without a contact ends the doubt.
    frames.append((11 / 30, nothing))
    found_N, alone_N = last([PLATE_M] * 10 + [np.zeros(K), PLATE_M])
    assert found_N == pytest.approx(alone_N, rel=1e-9)
    # Within two frames at 0.1 m/s the foam could go 3.3 mm deeper and return: beyond that, it is on the loading branch.
    frames[:] = [(k / 30, away if k == 1 else nothing) for k in range(4)]
    for deeper_m, doubtful in ((3.2e-3, True), (3.5e-3, False)):
        found_N, alone_N = last([PLATE_M] * 3 + [PLATE_M + deeper_m])
        assert (found_N > alone_N * (1.0 + 1e-9)) == doubtful

"""What is new in a contact, and what a dent in it leaves out, is in doubt; the rest is not."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from visuohaptic.sensing.foam.validity import NewContact, unverified_force, without_dents

K = 60
S_M = 0.003 * np.arange(K)
SIGMA_M = np.full(K, 2e-5)
PLATE_M = np.where(np.abs(S_M - 0.09) < 0.03, 0.005, 0.0)


def _watched(*deltas: np.ndarray, step_s: float = 1 / 30) -> np.ndarray:
    """What the last of these frames had before."""
    watch = NewContact(K)
    for i, delta in enumerate(deltas):
        before = watch.before(i * step_s, delta)
    return before


def test_a_contact_is_new_for_a_tenth_of_a_second() -> None:
    rest = np.zeros(K)
    for frames in (1, 2, 3):
        assert np.array_equal(_watched(rest, *[PLATE_M] * frames), rest), frames
    assert np.array_equal(_watched(rest, *[PLATE_M] * 4), PLATE_M)


def test_only_what_was_free_is_new() -> None:
    wider = np.where(np.abs(S_M - 0.09) < 0.06, 0.006, 0.0)
    before = _watched(*[PLATE_M] * 5, wider)
    assert np.array_equal(before[PLATE_M > 0], wider[PLATE_M > 0]), "it was pressed: pressed further"
    assert not before[PLATE_M == 0].any()


def test_the_first_frame_and_unseen_points_are_no_news() -> None:
    assert np.array_equal(_watched(PLATE_M), PLATE_M)
    unseen = np.full(K, np.nan)
    assert np.array_equal(_watched(unseen, PLATE_M), PLATE_M)


def test_release_is_never_new() -> None:
    assert np.array_equal(_watched(PLATE_M, np.zeros(K)), np.zeros(K))


@given(
    st.floats(0.002, 0.012),
    st.floats(0.01, 0.2),
    st.floats(-0.3, 0.3),
    st.integers(0, 2**31),
)
def test_bodies_without_dents_have_none(depth, radius, tilt, seed) -> None:
    """Cylinders and plates of any tilt, noise of one sigma."""
    s = S_M - S_M.mean()
    body = depth - radius + np.sqrt(np.maximum(radius**2 - s**2, 0.0)) if radius < 0.1 else depth + tilt * s
    delta = np.maximum(body, 0.0) + SIGMA_M * np.clip(np.random.default_rng(seed).standard_normal(K), -3, 3)
    # Three sigmas, beside the hull that goes through the highest of them: within 0.05 mm and 3 %.
    assert np.array_equal(without_dents(S_M, delta, SIGMA_M, 0.02), delta)


def test_a_dent_is_filled_and_a_gap_is_not() -> None:
    plate = np.full(K, 0.009)
    for bottom_m in (0.008, 0.004):
        dented = plate.copy()
        dented[20:40] = bottom_m
        assert np.allclose(without_dents(S_M, dented, SIGMA_M, 0.02), plate), bottom_m
    for first, last in ((20, 40), (20, 30), (20, 23)):
        for decay_m in (0.003, 0.006):  # of free foam: 0.15 to 0.3 of the width
            a, c = S_M[first - 1], S_M[last]
            catenary = 0.009 * np.cosh((S_M - 0.5 * (a + c)) / decay_m) / np.cosh(0.5 * (c - a) / decay_m)
            two = np.where((a < S_M) & (c > S_M), catenary, plate)
            assert np.array_equal(without_dents(S_M, two, SIGMA_M, 0.02), two), "two bodies, free foam"


def test_force_in_doubt_is_a_quarter_of_what_is_not_proved(material) -> None:
    pressure = float(material.stress(np.array(0.005 / material.width_m)))
    new = material.height_m * pressure * 0.003 * (PLATE_M > 0).sum()
    doubt = unverified_force(material, S_M, np.zeros(K), PLATE_M, SIGMA_M)
    assert np.isclose(doubt, 0.25 * new, rtol=1e-9)
    assert unverified_force(material, S_M, PLATE_M, PLATE_M, SIGMA_M) == 0.0
    holes = PLATE_M.copy()
    holes[PLATE_M == 0] = np.nan
    assert np.isfinite(unverified_force(material, S_M, np.zeros(K), holes, SIGMA_M))
    assert unverified_force(material, S_M[:1], np.zeros(1), np.full(1, np.nan), SIGMA_M[:1]) == 0.0

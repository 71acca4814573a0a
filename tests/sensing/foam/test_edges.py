"""Shifts of edges by adjacent structures, compared with explicit numbers."""

from __future__ import annotations

import warnings
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from scipy.special import ndtr

from visuohaptic.sensing.foam.edges import (
    SCATTER_POINTS,
    floor_probability,
    gap_shift_px,
    local_statistics,
    mean_between,
)

POINTS, GAP_PX = 60, 1.5


def _found(
    position_px: np.ndarray, body: np.ndarray, excess_px2: np.ndarray, *, texture_px: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Gaps of edges of foam of 180 before a floor of 80, which are at rest at 40; before some there is a body of 30."""
    count = len(position_px)
    front = SimpleNamespace(
        position_px=position_px,
        contrast=np.where(body, -150.0, -100.0),
        level=np.where(body, 30.0, 80.0),
        blur_px=np.full(count, 0.7),
        sigma_px=np.full(count, np.hypot(0.02, texture_px)),
        noise_px=np.full(count, 0.02),
    )
    image = np.where(np.arange(80) < 40, 180.0, 80.0)[None, None].repeat(count, axis=0)
    strip: Any = SimpleNamespace(
        lens_px=0.7,
        step_px=np.ones(count),
        front=front,
        edge_px=np.zeros(count),
        rest_px=np.full(count, 40.0),
    )
    return gap_shift_px(strip, cast(Any, SimpleNamespace(image=image)), excess_px2)


def _shift(still: int) -> tuple[np.ndarray, np.ndarray]:
    """Beyond the points at rest there is a body behind a gap."""
    touched = np.arange(POINTS) >= still
    # A third of the whole step is the body's: the variance of two steps a gap apart.
    excess = np.where(touched, (1 / 3) * (2 / 3) * GAP_PX**2, 0.0)
    excess += 0.01 * np.random.default_rng(0).standard_normal(POINTS)
    return _found(np.where(touched, 30.0, 40.0), touched, excess)


def test_the_edges_of_a_gap_and_of_what_is_behind_it_look_like_one() -> None:
    found, sigma = _shift(SCATTER_POINTS)
    # A noise of 0.01 px^2 in 0.5, of which two deviations are taken off: 0.49 to 0.51.
    np.testing.assert_allclose(found[SCATTER_POINTS:], GAP_PX / 3, atol=0.03)
    assert (found[:SCATTER_POINTS] < 0.1).all()
    assert (sigma[SCATTER_POINTS:] > 0.0).all()


def test_gaps_before_foam_at_rest_do_not_hide_each_other() -> None:
    """A tilted plate is close to foam that has hardly moved: such edges are not the scatter of those at rest."""
    near = np.arange(POINTS) >= POINTS - 12
    excess = np.where(near, (1 / 3) * (2 / 3) * np.linspace(0.4, 2.5, POINTS) ** 2, 0.0)
    excess += 0.01 * np.random.default_rng(3).standard_normal(POINTS)
    found, _ = _found(np.full(POINTS, 39.8), near, excess)
    np.testing.assert_allclose(found[near], np.linspace(0.4, 2.5, POINTS)[near] / 3, atol=0.03)


def test_other_texture_is_no_gap() -> None:
    """An edge whose texture shifts it by 0.1 px is blurred by 2 sqrt(2) 0.7 0.1 = 0.2 px^2 more or less than at rest."""
    count, rng = 20_000, np.random.default_rng(4)
    moved = np.arange(count) >= count // 2
    excess = np.where(moved, 2.0**1.5 * 0.7 * 0.1, 0.01) * rng.standard_normal(count)
    found, _ = _found(np.where(moved, 30.0, 40.0), np.ones(count, bool), excess, texture_px=0.1)
    assert 0.018 < np.mean(found[moved] != 0.0) < 0.03, "within 4 standard deviations of 2.3 %"
    assert 0.018 < np.mean(found[~moved] != 0.0) < 0.03


def test_one_edge_in_forty_has_a_gap_by_chance() -> None:
    """The stated rate of false alarms: 1.1 % with a limit a fifth higher, 5.5 % with one a fifth lower."""
    count, rng = 20_000, np.random.default_rng(1)
    # Before a body as dark as half of the step from foam to floor: the excess has its sign.
    found, _ = _found(np.full(count, 40.0), np.ones(count, bool), 0.01 * rng.standard_normal(count))
    assert 0.018 < np.mean(found != 0.0) < 0.03, "within 3 standard deviations of 2.3 %"


def test_few_edges_at_rest_do_not_tell_a_gap_from_chance() -> None:
    found, sigma = _shift(SCATTER_POINTS - 1)
    assert not found.any()
    assert not sigma.any()


def test_local_statistics_equal_those_of_each_window() -> None:
    rng = np.random.default_rng(8)
    values = np.where(rng.random(40) < 0.4, np.nan, rng.standard_normal(40))
    values[:12] = np.nan
    median, error = local_statistics(values)
    for k in range(40):
        known = values[max(k - 4, 0) : k + 5]
        known = known[np.isfinite(known)]
        if len(known) == 0:
            assert np.abs([median[k], error[k]]).max() < 1e-300
            continue
        deviation = 1.4826 * np.median(np.abs(known - np.median(known)))
        expected = np.median(known), deviation * np.sqrt(0.5 * np.pi / len(known))
        np.testing.assert_allclose((median[k], error[k]), expected, atol=1e-12)


def test_grey_levels_between_places_are_means_of_all_parallels() -> None:
    image = np.random.default_rng(9).integers(0, 255, (3, 5, 20)).astype(np.uint8)
    found = mean_between(image, np.array([[2.2, 7.7, 7.9], [-4.0, 3.0, 50.0], [18.0, np.nan, 30.0]]))
    expected = [
        [image[0, :, 2:8].mean(), np.nan],
        [image[1, :, :3].mean(), image[1, :, 3:].mean()],
        [np.nan, np.nan],
    ]
    np.testing.assert_allclose(found, expected)


PLACE = np.arange(90) - 40.2  #: of the samples, from the front at rest [px]


def _strips(floor: np.ndarray | float = 1.0, noise: float = 1.0) -> np.ndarray:
    """Textured foam of 180 before a textured floor of 80 in a light, (points, 5, samples), with an edge blurred as by a lens."""
    grain = np.random.default_rng(6).normal(1.0, 0.03, (POINTS, 5, len(PLACE)))
    over = ndtr(PLACE / 0.8)
    image = (180.0 * (1.0 - over) + 80.0 * floor * over) * grain
    return np.float32(image + np.random.default_rng(7).normal(0.0, noise, image.shape))


def _floor(
    shaded: np.ndarray, image: np.ndarray, excess: np.ndarray, rest: np.ndarray | None = None
) -> np.ndarray:
    """Probability that the floor as at rest lies beyond fronts near their place at rest."""
    each = np.ones(POINTS)
    strip: Any = SimpleNamespace(
        stripe=False, lens_px=0.75, rest_px=40.2 * each, step_px=each,
        image=np.where(shaded[:, None, None], image, _strips()),
        front=SimpleNamespace(position_px=40.2 - 0.7 * shaded, contrast=-100.0 * each),
    )  # fmt: skip
    zero: Any = SimpleNamespace(image=_strips(noise=0.3) if rest is None else rest)
    return floor_probability(strip, zero, excess)


def test_the_floor_in_a_shadow_is_no_body_behind_a_gap() -> None:
    shaded = np.arange(POINTS) >= POINTS // 2
    excess = np.where(shaded, 1.0, 0.0)
    for light in (0.6, 0.6 + 0.01 * np.clip(PLACE, 0.0, 9.0)):
        assert _floor(shaded, _strips(light), excess).min() > 0.8, (
            "twenty samples of a texture of twice the noise"
        )


def test_a_body_that_begins_at_the_front_is_not_the_floor_in_a_shadow() -> None:
    """Its grey level is that of the floor in a shadow; it has no texture, or another one."""
    covered, over = np.arange(POINTS) >= POINTS // 2, ndtr(PLACE / 0.8)
    grain = np.random.default_rng(8).normal(1.0, 0.05, (POINTS, 5, len(PLACE)))
    for texture in (1.0, grain):
        image = np.float32(_strips() * (1.0 - over) + 48.0 * texture * over)
        assert _floor(covered, image, np.where(covered, 1.0, 0.0))[covered][2:-2].mean() < 0.2


def test_a_saturated_floor_says_nothing_about_its_surface() -> None:
    """All of its samples are equal, as at rest: no variance of them has a logarithm."""
    image = _strips()
    image[..., PLACE > 2.0] = 255.0
    none = np.zeros(POINTS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert _floor(none < 1, image, none, image).max() < 1e-9

"""Shifts of edges by adjacent structures, compared with explicit numbers."""

from __future__ import annotations

import warnings
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from visuohaptic.sensing.foam._light_kernels import front_in_light
from visuohaptic.sensing.foam.edges import (
    _EDGE_BLURS,
    _PLATEAU_PX,
    _SAMPLE_PX,
    SCATTER_POINTS,
    gap_shift_px,
    local_statistics,
    mean_between,
    shift_by_light_px,
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


def _penumbra(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Light on the foam, which rises by 3 % a pixel to 5 px behind its front, and on the floor, which lies lower."""
    return 0.7 - 0.03 * np.clip(x, -6.0, 0.0), 0.6 + 0.01 * np.clip(x, 0.0, 9.0)


def _strips(
    moved_px: float,
    blur_px: float,
    foam: np.ndarray | float = 1.0,
    floor: np.ndarray | float = 1.0,
    noise: float = 1.0,
) -> np.ndarray:
    """Textured foam of 180 before a textured floor of 80 in their light, (points, 5, samples), with an edge blurred as by a lens."""
    grain = np.random.default_rng(6).normal(1.0, 0.03, (POINTS, 5, len(PLACE)))
    over = ndtr((PLACE + moved_px) / blur_px)
    image = (180.0 * foam * (1.0 - over) + 80.0 * floor * over) * grain
    return np.float32(image + np.random.default_rng(7).normal(0.0, noise, image.shape))


def _in_light(image: np.ndarray) -> np.ndarray:
    each, found = np.ones(POINTS), np.full((7, POINTS), np.nan)
    zero, rest = _strips(0.0, 0.8, noise=0.3), 40.2 * each
    front_in_light(
        image, zero, each, rest, rest - 0.3, 0.8 * each, _EDGE_BLURS * 0.8 * each, _PLATEAU_PX, found
    )
    return found


@pytest.mark.parametrize("moved_px", [0.0, 0.5, 1.2])
def test_a_penumbra_does_not_move_the_front_that_is_seen_in_its_light(moved_px: float) -> None:
    """A noise of 1 grey level in 5 pixels of 55: 0.01 px for the median of 60 points; foam moves its texture, and here it does not."""
    found = _in_light(_strips(moved_px, 0.8, *_penumbra(PLACE)))
    assert abs(np.median(found[0]) - moved_px) < 0.03


def test_pixels_and_interpolation_blur_the_samples_of_a_line() -> None:
    """With a blur that is a fifth too small or too large, displacements are 5 % too small or too large."""
    rng, moved = np.random.default_rng(11), 0.8
    u, v = np.meshgrid(np.arange(60.0), np.arange(60.0))
    found = np.full((7, POINTS), np.nan)
    lines = np.empty((2, POINTS, 5, 50), np.float32)
    for k in range(POINTS):
        turn, origin = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(29.0, 30.0, 2)
        along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        lane, place = np.meshgrid(np.arange(5) - 2.0, np.arange(50) - 25.0, indexing="ij")
        points = origin[:, None, None] + along[:, None, None] * place + across[:, None, None] * lane
        away = (u - origin[0]) * along[0] + (v - origin[1]) * along[1]
        for image, shift in zip(lines, (0.0, moved), strict=True):
            # A pixel integrates over its area: 1 / 12 px^2 in any direction.
            pixels = 180.0 - 100.0 * ndtr((away + shift) / np.hypot(0.5, np.sqrt(1.0 / 12.0)))
            image[k] = map_coordinates(pixels, points[::-1], order=1)
    each = np.ones(POINTS)
    blur = np.hypot(0.5, _SAMPLE_PX) * each
    front_in_light(
        lines[1], lines[0], each, 25.0 * each, 24.2 * each, blur, _EDGE_BLURS * blur, _PLATEAU_PX, found
    )
    assert abs(np.mean(found[0]) - moved) < 0.015


def test_another_blur_is_seen_beside_the_light() -> None:
    found = _in_light(_strips(0.0, 1.0, *_penumbra(PLACE)))
    # 0.36 px^2 more; of first order, with which the derivative falls by a fifth until half way.
    assert 0.25 < np.median(found[1]) < 0.4
    assert abs(np.median(_in_light(_strips(0.0, 0.8, *_penumbra(PLACE)))[1])) < 0.05


def test_light_that_is_no_straight_line_beside_the_front_is_in_its_error() -> None:
    """A step of the light in the plateau on the foam, at any place: its error is one draw, and the declared one its root mean square."""
    found = [_in_light(_strips(0.0, 0.8, np.where(-at > PLACE, 0.8, 1.0))) for at in np.arange(2.5, 6.0, 0.5)]
    wrong, _, declared = np.median(found, axis=2)[:, :3].T
    assert 0.7 < np.sqrt(np.mean(wrong**2)) / np.sqrt(np.mean(declared**2)) < 1.4, "of seven draws"


def test_a_front_that_is_not_near_its_place_at_rest_is_left() -> None:
    each, found = np.ones(POINTS), np.full((7, POINTS), np.nan)
    image, rest = _strips(2.0, 0.8), 40.2 * each
    front_in_light(
        image, image, each, rest, rest - 2.0, 0.8 * each, _EDGE_BLURS * 0.8 * each, _PLATEAU_PX, found
    )
    assert np.isnan(found).all()


def _put_back(
    shaded: np.ndarray,
    image: np.ndarray,
    pulled_px: np.ndarray,
    excess: np.ndarray,
    rest: np.ndarray | None = None,
) -> np.ndarray:
    """What the light explains of fronts at rest that are found ``pulled_px`` nearer to the base."""
    each = np.ones(POINTS)
    front = SimpleNamespace(position_px=40.2 - pulled_px, contrast=-100.0 * each)
    strip: Any = SimpleNamespace(
        stripe=False,
        lens_px=np.sqrt(0.8**2 - _SAMPLE_PX**2),
        edge_px=np.zeros(len(image)),
        image=np.where(shaded[:, None, None], image, _strips(0.0, 0.8)),
        step_px=each,
        rest_px=40.2 * each,
        usable=each > 0,
        low_confidence=each < 0,
        front=front,
    )
    zero: Any = SimpleNamespace(
        image=_strips(0.0, 0.8, noise=0.3) if rest is None else rest, blur_ratio=each, inferred=each < 0
    )
    return shift_by_light_px(strip, zero, excess)


def test_edges_that_light_has_shifted_are_put_back() -> None:
    shaded = np.arange(POINTS) >= POINTS // 2
    scatter = np.random.default_rng(3).normal(0.0, 0.03, POINTS)
    excess = np.where(shaded, 1.0, 0.0)
    pulled = np.where(shaded, 0.7, 0.0) - scatter
    shift, uneven, light = _put_back(shaded, _strips(0.0, 0.8, *_penumbra(PLACE)), pulled, excess)
    left = pulled - light * shift
    # A noise of 1 grey level is 0.015 px; the penumbra leaves 0.01 px.
    assert np.sqrt(np.mean(left[shaded] ** 2)) < 0.03
    assert np.abs(light * shift)[~shaded].mean() < 0.003, "by chance"
    assert np.abs(excess).max() < 0.3, "what the light explains is no excess"
    assert np.sqrt(uneven.max()) < 0.1
    assert light[shaded].min() > 0.8, "five points of twenty samples of a texture of twice the noise"


def test_pressed_foam_beside_a_contact_is_in_no_other_light() -> None:
    """Foam that has moved has other texture before its edge: 0.05 px for the fit and for the comparison with the zero image."""
    rng = np.random.default_rng(12)
    near, moved = np.arange(POINTS) >= POINTS - 12, 0.9
    image = _strips(moved, 0.8) + 180.0 * rng.normal(0.0, 0.03, (POINTS, 5, len(PLACE))) * (
        (PLACE > -6.0) & (PLACE < 0.0)
    )
    pulled = np.where(near, moved + rng.normal(0.0, 0.05, POINTS), rng.normal(0.0, 0.01, POINTS))
    shift, _, light = _put_back(near, np.float32(image), pulled, rng.normal(0.0, 0.05, POINTS))
    assert np.sqrt(np.mean(shift[near] ** 2)) > 0.03
    assert light[near].mean() < 0.05


def test_a_body_that_begins_at_the_front_is_not_the_floor_in_a_shadow() -> None:
    """Its grey level is that of the floor in the penumbra; it has no texture, or another one."""
    covered, over = np.arange(POINTS) >= POINTS // 2, ndtr(PLACE / 0.8)
    grain = np.random.default_rng(8).normal(1.0, 0.05, (POINTS, 5, len(PLACE)))
    for texture in (1.0, grain):
        image = np.float32(_strips(0.0, 0.8) * (1.0 - over) + 48.0 * texture * over)
        excess = np.where(covered, 1.0, 0.0)
        *_, floor = _put_back(covered, image, np.where(covered, 0.7, 0.0), excess)
        assert floor[covered][2:-2].mean() < 0.2
        assert excess[covered].mean() > 0.8, "what is no light is not explained by it"


def test_a_saturated_floor_says_nothing_about_its_surface() -> None:
    """All of its samples are equal, as at rest: no variance of them has a logarithm."""
    image = _strips(0.0, 0.8)
    image[..., PLACE > 3.0] = 255.0
    none = np.zeros(POINTS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shift, *_, floor = _put_back(none < 1, image, none, none.copy(), image)
    assert np.abs(shift).max() < 0.01
    assert floor.max() < 1e-9

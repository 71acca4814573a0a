"""What an edge is: kernels against plain twins, and made images of foam, shadows and bodies."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from visuohaptic.sensing.foam._posterior_kernels import (
    COV_PRESSED,
    COV_REST,
    VAR_PRESSED,
    foam_bands,
    join,
    shadow_odds,
)
from visuohaptic.sensing.foam.posterior import DECAY_PER_WIDTH

ENTER = np.log([0.05, 0.01, 0.01, 0.01])


def plain_join(unary, delta, sigma, rest_sigma, s, decay, chord, margin) -> np.ndarray:
    """Posterior of each state by the sum over all sequences."""
    n = len(s)
    total = np.zeros((n, 4))
    for path in itertools.product(range(4), repeat=n):
        value = 0.0 if path[0] == 0 else ENTER[path[0]]
        value += sum(unary[k, z] for k, z in enumerate(path))
        for k in range(1, n):
            a, b = path[k - 1], path[k]
            here = 0.0 if a == b else ENTER[b]
            if a <= 1 and b <= 1:
                pair = [
                    (delta[i], sigma[i]) if z == 0 else (0.0, rest_sigma[i]) for i, z in ((k - 1, a), (k, b))
                ]
                high, low = max(pair[0][0], pair[1][0]), max(min(pair[0][0], pair[1][0]), 0.0)
                fall = max(high, 0.0) * np.exp(-(s[k] - s[k - 1]) / decay) * (1 - chord) - low - margin
                here -= 0.5 * max(fall, 0.0) ** 2 / (np.hypot(pair[0][1], pair[1][1]) + 1e-9) ** 2
            value += max(here, -60.0)
        for k, z in enumerate(path):
            total[k, z] += np.exp(value)
    return total / total.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(5))
def test_chain_equals_the_sum_over_all_sequences(seed) -> None:
    rng = np.random.default_rng(seed)
    n = 6
    unary = rng.normal(0, 2, (n, 4))
    delta, sigma = rng.uniform(-1e-4, 4e-3, n), rng.uniform(1e-5, 1e-3, n)
    rest_sigma, s = np.full(n, 1e-4), np.cumsum(rng.uniform(2e-3, 4e-3, n))
    rules = DECAY_PER_WIDTH * 0.02, 0.03, 5e-5
    found = np.empty((n, 4))
    join(unary, delta, sigma, rest_sigma, s, ENTER, *rules, found)
    np.testing.assert_allclose(found, plain_join(unary, delta, sigma, rest_sigma, s, *rules), atol=1e-9)


def strip(rng, front, texture, *, shade=1.0, beyond="body", noise=2.0, blur=1.0):
    """Rest and now, (30, 5, 110): foam of grey 170 up to 85, then a floor of 70; an edge at ``front``.

    Beyond the edge the foam goes on in a shadow, or a body of the grey of shaded foam begins.
    """
    from scipy.ndimage import gaussian_filter1d

    shape, j = (30, 5, 110), np.arange(110.0)
    grains = 170.0 * (1.0 + texture * rng.standard_normal(shape))
    clean = np.where(j < 85.0, grains, 70.0)
    light = np.where(j < front, 1.0, shade)
    body = 170.0 * shade * (1.0 + texture * rng.standard_normal(shape))
    # The hard case: the floor is as grey as the shaded foam.
    floor = np.full(shape, 170.0 * shade)
    scene = (
        np.where(j < front, grains, body) if beyond == "body" else np.where(j < 85.0, grains * light, floor)
    )
    rest, now = (gaussian_filter1d(one, blur, axis=2) for one in (clean, scene))
    rest = np.mean([rest + noise * rng.standard_normal(shape) for _ in range(8)], axis=0)
    now = now + noise * rng.standard_normal(shape)
    return np.clip(np.rint(rest), 0, 255).astype(np.uint8), now.astype(np.float32)


def odds_of(rest, now, front, texture_part=1.0, variance=4.5) -> np.ndarray:
    result, ones = np.empty((30, 6)), np.ones(30)
    shadow_odds(now, rest, front * ones, 84.5 * ones, 0 * ones, 1.0, texture_part, variance, ones > 0, result)
    return result


def test_texture_decides_where_a_shaded_foam_is_as_grey_as_the_floor() -> None:
    rng = np.random.default_rng(1)
    rest, now = strip(rng, 70.0, 0.03, shade=0.5, beyond="foam")
    assert odds_of(rest, now, 69.5)[:, 0].sum() > 30.0
    rest, now = strip(rng, 70.0, 0.03, shade=0.5, beyond="body")
    assert odds_of(rest, now, 69.5)[:, 0].sum() < -30.0


def test_without_texture_the_pixels_say_nothing() -> None:
    rng = np.random.default_rng(2)
    for beyond in ("foam", "body"):
        rest, now = strip(rng, 70.0, 0.0, shade=0.5, beyond=beyond)
        # What is left of the zero's noise and rounding, over 30 points.
        assert abs(odds_of(rest, now, 69.5)[:, 0]).max() < 3.0


def test_texture_that_moves_with_the_foam_is_found() -> None:
    rng = np.random.default_rng(3)
    rest, _ = strip(rng, 85.0, 0.03)
    front, place = 70.0, np.arange(110.0)
    # Pressed: what was at 85 is at 70.
    moved = np.array([[np.interp(place * 85.0 / front, place, line) for line in point] for point in rest])
    now = np.where(place < front, moved, 60.0) + 2.0 * rng.standard_normal(rest.shape)
    bands, ones = np.empty((30, 9)), np.ones(30)
    foam_bands(now.astype(np.float32), rest, front * ones, 85.0 * ones, 1.0, ones > 0, bands)
    assert bands[:, COV_PRESSED].mean() > 0.9 * bands[:, VAR_PRESSED].mean()
    assert abs(bands[:, COV_REST].mean()) < 0.2 * bands[:, VAR_PRESSED].mean()

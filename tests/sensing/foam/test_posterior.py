"""Classification of edges: kernels compared with plain twins, and synthetic images of foam, shadows and bodies."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from visuohaptic.sensing.foam._chain_kernels import FOAM, edge_crossing, filter_runs, join, place_odds
from visuohaptic.sensing.foam._posterior_kernels import fit_light, shadow_odds
from visuohaptic.sensing.foam._texture_kernels import (
    COV_PRESSED,
    COV_REST,
    MAX_ODDS,
    OWN,
    VAR_PRESSED,
    foam_bands,
    level_odds,
)
from visuohaptic.sensing.foam._texture_kernels import texture_odds as foam_texture_odds
from visuohaptic.sensing.foam.posterior import DECAY_PER_WIDTH, EdgePosterior, body_odds
from visuohaptic.sensing.foam.strip._rectify_kernels import rectify

ENTER = np.log([0.05, 0.01, 0.01, 0.01])


def plain_join(
    unary, shared, crossing, delta, sigma, rest_sigma, s, decay, chord, margin
) -> tuple[np.ndarray, np.ndarray]:
    """Posterior of each state, and of runs that are none of the likeliest, by the sum over all sequences."""
    n = len(s)
    total, weights = np.zeros((n, 4)), {}
    for path in itertools.product(range(4), repeat=n):
        value = (0.0 if path[0] == 0 else ENTER[path[0]]) - shared[0, path[0]]
        value += sum(unary[k, z] for k, z in enumerate(path))
        for k in range(1, n):
            a, b = path[k - 1], path[k]
            here = -max(shared[k, b] - shared[k - 1, b], 0.0) if a == b else ENTER[b] - shared[k, b]
            if a <= 1 and b <= 1:
                pair = [
                    (delta[i], sigma[i]) if z == 0 else (0.0, rest_sigma[i]) for i, z in ((k - 1, a), (k, b))
                ]
                high, low = max(pair[0][0], pair[1][0]), max(min(pair[0][0], pair[1][0]), 0.0)
                fall = max(high, 0.0) * np.exp(-(s[k] - s[k - 1]) / decay) * (1 - chord) - low - margin
                here -= 0.5 * max(fall, 0.0) ** 2 / (np.hypot(pair[0][1], pair[1][1]) + 1e-9) ** 2
            here += {(0, 2): crossing[k, 0], (2, 0): crossing[k, 1]}.get((a, b), 0.0)
            value += max(here, -60.0)
        weights[path] = np.exp(value)
        for k, z in enumerate(path):
            total[k, z] += np.exp(value)
    posterior = total / total.sum(axis=1, keepdims=True)
    other = np.array(list(weights)) != posterior.argmax(axis=1)
    weight = np.array(list(weights.values())) / sum(weights.values())
    runs = np.zeros((n, n))
    for a in range(n):
        for b in range(a, n):
            runs[a, b] = runs[b, a] = float(weight @ other[:, a : b + 1].all(axis=1))
    return posterior, runs


@pytest.mark.parametrize("seed", range(5))
def test_chain_equals_the_sum_over_all_sequences(seed) -> None:
    rng = np.random.default_rng(seed)
    n = 6
    unary, crossing = rng.normal(0, 2, (n, 4)), -rng.exponential(1.0, (n, 2))
    shared = rng.exponential(2.0, (n, 4))
    delta, sigma = rng.uniform(-1e-4, 4e-3, n), rng.uniform(1e-5, 1e-3, n)
    rest_sigma, s = np.full(n, 1e-4), np.cumsum(rng.uniform(2e-3, 4e-3, n))
    rules = DECAY_PER_WIDTH * 0.02, 0.03, 5e-5
    found, runs = np.empty((n, 4)), np.empty((n, n))
    given = unary, shared, crossing, delta, sigma, rest_sigma, s
    join(*given, ENTER, *rules, found, runs, np.empty((n, 4))[:, 3])
    posterior, plain_runs = plain_join(*given, *rules)
    np.testing.assert_allclose(found, posterior, atol=1e-9)
    np.testing.assert_allclose(runs, plain_runs, atol=1e-9)


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


def texture_odds(rest, now, front, texture_part=1.0, variance=4.5) -> np.ndarray:
    result, ones = np.empty((30, 8)), np.ones(30)
    lines = np.tile([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], (30, 1))  # samples are pixels
    places = front * ones, 84.5 * ones, 0 * ones
    shadow_odds(now, rest, lines, *places, 1.0, 0.0 * ones, texture_part, variance, ones > 0, result)
    return result[:, 0] / np.median(result[:, 5])


def test_texture_decides_where_a_shaded_foam_is_as_grey_as_the_floor() -> None:
    rng = np.random.default_rng(1)
    rest, now = strip(rng, 70.0, 0.03, shade=0.5, beyond="foam")
    assert texture_odds(rest, now, 69.5).sum() > 30.0
    rest, now = strip(rng, 70.0, 0.03, shade=0.5, beyond="body")
    assert texture_odds(rest, now, 69.5).sum() < -30.0


def test_without_texture_the_pixels_say_nothing() -> None:
    rng = np.random.default_rng(2)
    for beyond in ("foam", "body"):
        rest, now = strip(rng, 70.0, 0.0, shade=0.5, beyond=beyond)
        # What is left of the zero's noise and rounding, over 30 points.
        assert abs(texture_odds(rest, now, 69.5)).max() < 3.0


@pytest.mark.parametrize("beyond", ["body", "foam"])
def test_smooth_textures_that_agree_by_chance_say_little(beyond) -> None:
    """Blotches as large as those of the foam: a few of them lie beyond each edge, not 250 pixels."""
    from scipy.ndimage import gaussian_filter, gaussian_filter1d

    rng, j = np.random.default_rng(5), np.arange(110.0)
    blotches = (gaussian_filter(rng.standard_normal((30, 5, 110)), (0, 2, 2), mode="wrap") for _ in range(2))
    foam, body = (170.0 + 6.0 * one / one.std() for one in blotches)
    rest = np.where(j < 85.0, foam, 70.0)
    shaded = np.where(j < 85.0, 0.6 * foam, 42.0) if beyond == "foam" else 0.6 * body
    rest, now = (gaussian_filter1d(one, 1.0, axis=2) for one in (rest, np.where(j < 60.0, foam, shaded)))
    now = (now + rng.standard_normal(now.shape)).astype(np.float32)
    texture = texture_odds(np.rint(rest).astype(np.uint8), now, 59.5, variance=1.0)
    if beyond == "foam":
        assert np.median(texture) > 10.0, "only white noise is left, and the blotches prove the foam"
    else:
        # Honest log-odds are wrong by more than 4 once in 55 points; three of 30 are rare, and pixels taken for
        # independent are wrong in ten.
        assert (texture > 4.0).sum() <= 3


@pytest.mark.parametrize("beyond", ["body", "foam"])
def test_the_surface_of_a_body_close_to_the_front_at_rest_is_no_second_edge(beyond) -> None:
    """A cardboard box that has pressed four pixels: two edges fit its surface better than one, and neither fits it."""
    from scipy.ndimage import gaussian_filter, gaussian_filter1d

    rng, j, ones = np.random.default_rng(8), np.arange(110.0), np.ones(30)
    grains = gaussian_filter(rng.standard_normal((30, 5, 110)), (0, 1, 1), mode="wrap")
    foam, floor = np.full((30, 5, 110), 175.0), 100.0
    body = 110.0 + 7.0 * grains / grains.std()
    other = body if beyond == "body" else np.where(j < 85.0, 0.62 * foam, 0.62 * floor)
    scenes = np.where(j < 85.0, foam, floor), np.where(j < 81.0, foam, other)
    rest, now = (gaussian_filter1d(one, 1.0, axis=2) for one in scenes)
    now = (now + 1.4 * rng.standard_normal(now.shape)).astype(np.float32)
    found, against = np.empty((30, 8)), np.zeros((30, 6))
    lines = np.tile([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], (30, 1))
    places = 80.5 * ones, 84.5 * ones, 0 * ones, 1.0
    shadow_odds(now, np.rint(rest).astype(np.uint8), lines, *places, 0 * ones, 1.0, 2.0, ones > 0, found)
    level_odds(found, ones, ones, 175.0 * ones, 2.0, against)
    if beyond == "body":
        assert against[:, 1].max() < 0.0
    else:
        assert np.median(against[:, 1]) > 8.0


@pytest.mark.parametrize(
    ("beyond", "moved", "at_rest"),
    [
        (35.0, 0, True),
        (70.0, 0, True),
        (12.0, 0, False),
        (35.0, 1, False),
        (35.0, 10, False),
        (70.0, 10, False),
    ],
)
def test_foam_in_a_shadow_is_at_rest_where_the_floor_lies_beyond_it(beyond, moved, at_rest) -> None:
    """A shadow on the foam, 25 px before its front: beyond that lies the floor in one light or the other, or a black body;
    or the front has moved in the shadow, before a body as grey as the floor."""
    from scipy.ndimage import gaussian_filter1d

    rng, j, ones = np.random.default_rng(9), np.arange(110.0), np.ones(30)
    scenes = (
        np.where(j < 85.0, 170.0, 70.0),
        np.where(j < 60.0, 170.0, np.where(j < 85.0 - moved, 85.0, beyond)),
    )
    rest, now = (gaussian_filter1d(np.tile(one, (30, 5, 1)), 1.0, axis=2) for one in scenes)
    now = (now + 1.4 * rng.standard_normal(now.shape)).astype(np.float32)
    found, against = np.empty((30, 8)), np.zeros((30, 6))
    lines = np.tile([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], (30, 1))
    places = 59.5 * ones, 84.5 * ones, 0 * ones, 1.0
    shadow_odds(now, np.rint(rest).astype(np.uint8), lines, *places, 0 * ones, 1.0, 2.0, ones > 0, found)
    bare = level_odds(found, ones, ones, 170.0 * ones, 2.0, against)
    assert bare.min() > 0.9 if at_rest else bare.max() < 0.1


@pytest.mark.parametrize("shaded", [True, False])
def test_the_fit_of_light_equals_plain_least_squares(shaded) -> None:
    rng, first, last = np.random.default_rng(3), 4, 30
    now, template = rng.uniform(20, 200, (5, 40)).astype(np.float32), rng.uniform(100, 180, (5, 40))
    over, out = rng.uniform(0, 1, (5, 40)), rng.uniform(0, 1, (5, 40))
    normal, solution, tau = np.empty((5, 5)), np.empty(5), (np.arange(40.0) - first) / 20.0
    surface = rng.uniform(50, 100, (5, 40))
    squares = fit_light(now, template, over, out, surface, first, last, 140.0, 0.8, shaded, normal, solution)
    foam = 140.0 + 0.8 * (template - 140.0)
    if shaded:
        a, b, d = foam * (1 - over) * (1 - out), foam * over * (1 - out), surface
        terms = [a, b, b * tau, d, d * tau]
    else:
        terms = [foam * (1 - over), surface, surface * tau, foam * (1 - over) * tau]
    part = slice(first, last + 1)
    design, y = np.stack([one[:, part].ravel() for one in terms], axis=1), now[:, part].ravel()
    found, left = np.linalg.lstsq(design, y, rcond=None)[:2]
    np.testing.assert_allclose(solution[: len(terms)], found, rtol=1e-3, atol=1e-4)  # a ridge of a millionth
    np.testing.assert_allclose(squares, left[0], rtol=1e-6)


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5])
def test_a_sharp_edge_between_the_pixels_is_not_two_edges(phase) -> None:
    """Samples half way between two pixels show an edge of half a pixel's blur with one of .74: a body's, of one step."""
    rng, y = np.random.default_rng(7), np.arange(130.0)[:, None] * np.ones(330)
    base = np.column_stack([np.linspace(10.0, 310.0, 30), np.full(30, 3.0 + phase)])
    blur, down, ones = 0.55, np.tile([0.0, 1.0], (30, 1)), np.ones(30)

    def sampled(edge: float, beyond: float) -> np.ndarray:
        image = np.clip(
            beyond + (170.0 - beyond) * ndtr((edge - y) / blur) + rng.normal(0.0, 1.0, y.shape), 0, 255
        )
        found = np.zeros((30, 5, 110), np.float32)
        rectify(np.rint(image).astype(np.uint8), base, down, ones, ones, np.zeros(30, np.int64), found)
        return found

    rest = np.rint(sampled(88.0, 80.0)).astype(np.uint8)
    now, result = sampled(87.0, 30.0), np.empty((30, 8))
    lines = np.column_stack([base, down, ones, ones])
    front = (84.0 - phase) * ones, (85.0 - phase) * ones, 0.0 * ones
    shadow_odds(now, rest, lines, *front, blur, 0.0 * ones, 1.0, 1.0, ones > 0, result)
    assert np.quantile(result[:, 1], 0.9) < 0.0, "log-odds of a second edge, where there is one"


def test_the_foam_behind_a_slanted_edge_is_compared_without_what_lies_beyond_it() -> None:
    rng, j = np.random.default_rng(6), np.arange(110.0)
    rest, _ = strip(rng, 85.0, 0.03)
    slope = 4.0
    edge = 60.0 + slope * (np.arange(5.0) - 2.0)
    now = np.where(j < edge[:, None], rest, 40.0) + 2.0 * rng.standard_normal(rest.shape)
    bands, ones = np.empty((30, 9)), np.ones(30)
    given = 60.0 * ones, 85.0 * ones, slope * ones, 1.0, ones > 0
    foam_bands(now.astype(np.float32), rest, *given, np.zeros(len(bands)), bands)
    # The variance is that of the texture, of 5 grey levels smoothed by a pixel, and of the noise, not that of a step of 130.
    assert bands[:, OWN].max() < 2.0 * (170.0 * 0.03) ** 2


def test_texture_that_moves_with_the_foam_is_found() -> None:
    rng = np.random.default_rng(3)
    rest, _ = strip(rng, 85.0, 0.03)
    front, place = 70.0, np.arange(110.0)
    # Pressed: what was at 85 is at 70.
    moved = np.array([[np.interp(place * 85.0 / front, place, line) for line in point] for point in rest])
    now = np.where(place < front, moved, 60.0) + 2.0 * rng.standard_normal(rest.shape)
    bands, ones = np.empty((30, 9)), np.ones(30)
    foam_bands(
        now.astype(np.float32),
        rest,
        front * ones,
        85.0 * ones,
        0 * ones,
        1.0,
        ones > 0,
        np.zeros(len(bands)),
        bands,
    )
    assert bands[:, COV_PRESSED].mean() > 0.9 * bands[:, VAR_PRESSED].mean()
    assert abs(bands[:, COV_REST].mean()) < 0.2 * bands[:, VAR_PRESSED].mean()


def test_an_occluder_that_goes_on_in_one_line_with_the_foam_is_a_coincidence() -> None:
    s = 0.003 * np.arange(9.0)
    sigma = np.full(9, 1e-5)
    straight = edge_crossing(0.002 + 0.1 * s, sigma, s, 0.02)
    # Within 30 um of a line that it crosses at any angle: 30 um of 3 mm; one edge alone within 20 mm: one part in six.
    assert (straight[2:-1] < -2.5).all()
    assert (straight > -6.0).all()
    step = edge_crossing(np.where(s > 0.0119, 0.005, 0.002), sigma, s, 0.02)
    assert (step[4] > -0.5).all(), "a step between two points may be where they meet"
    assert (step[[1, 2, 6, 7]] < -2.5).all()


def foam_odds(waited_s: float, apart_s: float, delta_m: float = 0.004) -> float:
    """Log-likelihood of a sharp edge as foam that was last seen at rest some time ago."""
    count = 5
    unary, against, shared = np.zeros((count, 4)), np.zeros((count, 6)), np.empty(count)
    every, since = np.ones(count), np.zeros(count)
    place_odds(
        waited_s, apart_s, delta_m * every, 2e-5 * every, 0.0 * every, since, every, 1.0, 2e-4 * every,
        0.02, 0.1, 0.0, against, unary, shared,
    )  # fmt: skip
    return float(unary[2, FOAM] + shared[2])


def test_a_wide_occluder_within_reach_is_one_coincidence_however_many_points_it_covers() -> None:
    """The shared evidence of a run counts once: the odds of an occluder do not fall with its length."""
    odds = []
    for count in (10, 40):
        s = 0.003 * np.arange(float(count))
        unary, shared = np.zeros((count, 4)), np.tile([0.0, 1.0, 1.0, 1.0], (count, 1))
        given = np.zeros((count, 2)), 0.002 * np.ones(count), 1e-5 * np.ones(count), 1e-4 * np.ones(count), s
        found, runs = np.empty((count, 4)), np.empty((count, count))
        rules = DECAY_PER_WIDTH * 0.02, 0.03, 5e-5
        join(unary, shared, *given, ENTER, *rules, found, runs, np.empty((count, 4))[:, 3])
        odds.append(runs[0, -1])
    assert odds[1] == pytest.approx(odds[0], rel=0.5)
    assert 1e-3 < odds[1] < 1e-2, (
        "one strip in a hundred has an occluder, and this one would be within reach by chance"
    )


def filtered(own: list[float], seen: float, *, spread_m: float = 0.0, onset: float = 1.0) -> list[float]:
    """Probability that ten points are wrong: 2 % in the first frame, and ``seen`` in each later frame by itself."""
    count, result = 10, []
    every, wrong, best = np.ones(count), np.zeros((count, count)), np.zeros((count, count))
    s = 0.003 * np.arange(float(count))
    for i, odds in enumerate(own):
        runs = np.full((count, count), seen if i else 0.02)
        prior = every if i else onset * every
        moved = np.linspace(0.0, spread_m, count)
        seen_so = every > 0, every < 0, odds * every
        filter_runs(runs, prior, moved, s, 1e-4 * every, *seen_so, 0.9, wrong, best)
        result.append(float(runs[0, -1]))
    return result


def test_an_edge_that_looks_the_same_in_every_frame_is_confirmed_at_the_rate_of_change_only() -> None:
    """A hand that comes to rest beside the foam looks no more like foam because it is seen again."""
    found = filtered([0.0] * 6, 1e-6)
    np.testing.assert_allclose(found, 0.02 * 0.9 ** np.arange(6), rtol=1e-3)


def test_a_better_view_confirms_a_contact_and_a_worse_one_after_it_takes_nothing_back() -> None:
    found = filtered([0.0, -0.2, 0.0, 0.5, 0.5, 0.3], 1e-9)
    assert found[2] == pytest.approx(0.02 * 0.9**2, rel=1e-3)
    assert found[3] == pytest.approx(0.02 * 0.9**3 * np.exp(-5.0), rel=0.02)
    assert found[5] == pytest.approx(found[3] * 0.9**2, rel=0.02)


def test_new_evidence_against_the_foam_counts_at_once() -> None:
    assert filtered([0.0, -1.0], 0.3)[1] == pytest.approx(0.3 + 0.9 * 0.02)


@pytest.mark.parametrize(("left", "right"), [(0, 0), (7, 0), (2, 3)])
def test_an_occluder_that_has_gone_left_its_end_behind_in_one_of_the_places_that_it_covered(
    left, right
) -> None:
    """Points 10 to 13 may be the end of an occluder over the points beside them, which are foam now."""
    count, wrong, best = 24, np.zeros((24, 24)), np.zeros((24, 24))
    wrong[10, 13], every, runs = 0.1, np.ones(count), np.zeros((count, count))
    places = np.arange(count)
    cleared = ((10 - left <= places) & (places < 10)) | ((places > 13) & (places <= 13 + right))
    s = 0.003 * np.arange(float(count))
    filter_runs(runs, every, 0.0 * s, s, 1e-4 * every, every > 0, cleared, 0.0 * s, 0.9, wrong, best)
    assert runs[10, 13] == pytest.approx(0.1 * 0.9 / ((left + 1) * (right + 1)))


def test_a_new_contact_that_moves_the_front_as_a_whole_is_no_coincidence() -> None:
    flat, uneven = (filtered([0.0], 0.0, spread_m=spread, onset=0.1)[0] for spread in (0.0, 0.002))
    assert flat == pytest.approx(0.2 * 2 / np.pi * np.arctan(0.1 / 27.0)), "a pixel over 27 mm, at any angle"
    assert uneven == pytest.approx(0.2 * 2 / np.pi * np.arctan(2.1 / 27.0))


def test_texture_that_foam_has_not_moved_is_that_beside_an_occluder() -> None:
    """Columns of nine bands at rest, of texture that has moved with the edge, and of texture that has not."""
    texture, noise = 9.0, 1.0
    bands, unary, against = np.zeros((11, 9)), np.zeros((11, 4)), np.zeros((11, 6))
    bands[:] = [60.0, 170.0, 1.0, 1.0, texture + noise, texture, texture, texture, texture]
    bands[9, COV_REST] = bands[10, COV_PRESSED] = 0.0
    transfer, variance = foam_texture_odds(bands, unary, against, np.empty(11))
    assert (transfer, variance) == (1.0, noise)
    # At rest both show the zero image: foam nine times in ten, else any texture; an occluder beside foam every other time.
    assert against[0, 0] == pytest.approx(math.log(0.5 / 0.9), abs=1e-3)
    assert against[9, 0] == pytest.approx(math.log(0.5) - (math.log(0.9) + MAX_ODDS), abs=1e-3)
    # Other texture has a cause that neighbours share: it counts a fifth.
    assert against[10, 0] == pytest.approx(0.2 * (math.log(0.5) + MAX_ODDS - math.log(0.1)), abs=1e-3)


def test_a_surface_coarser_than_any_part_of_the_strip_is_not_the_foam() -> None:
    rng = np.random.default_rng(8)
    rest, _ = strip(rng, 85.0, 0.03)
    body = np.where(np.arange(110.0) < 80.0, 170.0 + 30.0 * rng.standard_normal(rest.shape), 70.0)
    ones, other = np.ones(30), {}
    for name, now in (("worn", strip(rng, 85.0, 0.03)[0]), ("body", body)):
        # Half of the strip shows its own foam, from which the visible texture and the noise are known.
        now = np.where(np.arange(30)[:, None, None] < 15, rest + 2.0 * rng.standard_normal(rest.shape), now)
        bands, unary, against = np.empty((30, 9)), np.zeros((30, 4)), np.zeros((30, 6))
        foam_bands(
            now.astype(np.float32),
            rest,
            80.0 * ones,
            85.0 * ones,
            0 * ones,
            1.0,
            ones > 0,
            np.zeros(len(bands)),
            bands,
        )
        foam_texture_odds(bands, unary, against, np.empty(30))
        other[name] = float(np.median(against[18:, 0]))
    assert other["body"] > other["worn"] + 0.3


def test_a_slow_camera_costs_the_foam_nothing_but_frames_out_of_sight_do() -> None:
    # At five frames a second the largest speed reaches the whole strip in one frame: an edge anywhere says nothing.
    assert foam_odds(0.2, 0.2) == pytest.approx(foam_odds(0.4, 0.4), abs=1e-6)
    # At thirty, an edge that was something else for 0.4 s is the less likely the foam again.
    assert foam_odds(0.4, 1.0 / 30.0) < foam_odds(0.2, 1.0 / 30.0) < foam_odds(0.1, 1.0 / 30.0)
    assert foam_odds(0.4, 1.0 / 30.0) < foam_odds(0.4, 0.4) - 0.4


def end_of_strip(*, usable: bool, pressed: bool) -> float:
    """Probability that the last point is foam, where its pixels look like an occluder or its line meets no edge."""
    count = 12
    every = np.ones(count)
    seen = np.arange(count) < count - (not usable)
    delta = 0.003 * (np.arange(count) >= 6) if pressed else np.zeros(count)
    strip: Any = SimpleNamespace(
        t_s=0.1, usable=seen, low_confidence=~every.astype(bool), edge_px=0.0 * every, pixel_m=2e-4 * every, common_sigma_m=1e-5,
        stripe=every.astype(bool), lens_px=1.0, front=SimpleNamespace(blur_px=every, level=every, contrast=every),
    )  # fmt: skip
    edges: Any = SimpleNamespace(
        delta_m=delta,
        sigma_m=1e-5 * every,
        systematic_m=0.0 * every,
        encoding_m=0.0 * every,
        floor=0.0 * every,
    )
    posterior = EdgePosterior(0.003 * np.arange(count), 0.02, 1.0)
    posterior.start(0.0)
    with pytest.MonkeyPatch.context() as patch:

        def look(*given: Any) -> tuple[np.ndarray, ...]:
            unary = np.zeros((count, 4))
            unary[-1, FOAM] = -20.0
            return unary, np.zeros((count, 6)), np.zeros(count), every

        patch.setattr(posterior, "_look", look)
        return float(posterior.infer(strip, strip, edges).probability[-1, FOAM])


def test_only_beside_a_contact_may_the_last_line_meet_no_edge() -> None:
    """There the corner of a free end moves inwards; elsewhere a last line without an edge, or of an occluder, is no foam."""
    # Foam without an edge there is half as likely as no foam, but no frame before has shown anything else than foam.
    assert 0.01 < end_of_strip(usable=False, pressed=True) < 0.5
    # Pixels that are e^20 times less likely for foam leave it 2e-9 of the odds at most, no edge at all e^-60.
    assert end_of_strip(usable=False, pressed=False) < 1e-9
    assert end_of_strip(usable=True, pressed=True) < 1e-8


@pytest.mark.parametrize(
    ("floor", "least", "most"),
    [
        (
            [1, 1, 1, 1, 1, 1, 1],
            math.log(0.04),
            math.log(0.06),
        ),  # floor along the whole run: a body is missing
        ([1, 1, 1, 0, 1, 1, 1], 0.0, 0.0),  # flanks beside a body show the floor
        ([1, 0, 1, 1, 1, 1, 1], 0.0, 0.0),  # the body lies where no edge is seen, beside the run
        ([0, 1, 1, 1, 1, 1, 0], math.log(0.04), math.log(0.06)),  # a body elsewhere deflects nothing here
    ],
)
def test_foam_is_deflected_by_a_body_somewhere_along_a_run(floor, least, most) -> None:
    deflected = np.array([False, False, True, True, True, False, False])
    found = body_odds(np.array(floor, dtype=float), deflected)
    assert np.all(found[~deflected] == 0.0)
    assert np.all(found[deflected] >= least - 1e-9)
    assert np.all(found[deflected] <= most + 1e-9)

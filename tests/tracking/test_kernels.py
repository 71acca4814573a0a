"""The compiled loops against plain NumPy twins, and the chain against all combinations."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from visuohaptic.tracking.contours import _fit_kernels as fit
from visuohaptic.tracking.contours import _search_kernels as _kernels


def chain_energy(cost, first, step, direction, weight, index):
    """Energy of one combination, written as in Eq. (3.6)."""
    k = np.arange(len(index))
    points = (first + step * np.asarray(index))[:, None] * direction
    bend = points[:-2] - 2 * points[1:-1] + points[2:]
    return float(cost[k, index].sum() + weight * (bend**2).sum())


@pytest.mark.parametrize("bent", [0.0, 0.5])
@pytest.mark.parametrize(("lines", "positions"), [(1, 5), (2, 4), (3, 5), (5, 4), (6, 3)])
def test_chain_is_the_global_minimum(lines, positions, bent):
    rng = np.random.default_rng(lines * 10 + positions)
    for _ in range(5):
        cost = rng.uniform(-1, 1, (lines, positions)).astype(np.float32)
        first = rng.uniform(-5, 5, lines)
        angle = bent * rng.standard_normal(lines)
        direction = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        index = np.zeros(lines, np.int64)
        energy = _kernels.chain_minimum(cost, first, 1.5, direction, 0.05, 0, index)
        every = itertools.product(range(positions), repeat=lines)
        best = min(chain_energy(cost, first, 1.5, direction, 0.05, list(i)) for i in every)
        # float32 sums of a few terms of size ten
        assert energy == pytest.approx(best, abs=3e-5)
        assert chain_energy(cost, first, 1.5, direction, 0.05, index) == pytest.approx(best, abs=3e-5)


@pytest.mark.parametrize("free", [1, 2])
def test_chain_without_its_ends_is_the_minimum_over_all_shorter_chains(free):
    rng = np.random.default_rng(free)
    lines, positions = 6, 3
    direction = np.tile([0.0, 1.0], (lines, 1))
    for _ in range(10):
        cost = rng.uniform(-1, 1, (lines, positions)).astype(np.float32)
        first, index = rng.uniform(-5, 5, lines), np.zeros(lines, np.int64)
        energy = _kernels.chain_minimum(cost, first, 1.5, direction, 0.05, free, index)
        best = np.inf
        for low, high in itertools.product(range(free + 1), range(lines - free, lines + 1)):
            part = slice(low, high)
            for every in itertools.product(range(positions), repeat=high - low):
                best = min(
                    best, chain_energy(cost[part], first[part], 1.5, direction[part], 0.05, list(every))
                )
        assert energy == pytest.approx(best, abs=3e-5)


def test_chain_continues_the_line_of_the_others_where_an_end_is_missing():
    cost = np.full((8, 40), 0.5, np.float32)
    cost[np.arange(1, 8), 10 + 2 * np.arange(1, 8)] = -1.0
    cost[0, 30] = -0.2  # another edge, far from the line of the others
    index = np.zeros(8, np.int64)
    _kernels.chain_minimum(cost, np.zeros(8), 1.0, np.tile([0.0, 1.0], (8, 1)), 0.01, 1, index)
    np.testing.assert_array_equal(index, 10 + 2 * np.arange(8))


def test_chain_recovers_a_smooth_curve_among_many_positions():
    rng = np.random.default_rng(5)
    truth = np.rint(30 + 12 * np.sin(np.arange(40) / 6)).astype(int)
    cost = rng.uniform(-0.3, 0.0, (40, 61)).astype(np.float32)
    cost[np.arange(40), truth] -= 0.7
    index = np.zeros(40, np.int64)
    _kernels.chain_minimum(cost, np.zeros(40), 1.0, np.tile([0.0, 1.0], (40, 1)), 0.01, 0, index)
    np.testing.assert_array_equal(index, truth)


def strength_twin(grey, origin, direction, first, count, polarity):
    """|grad G * i| by NumPy: sampled lattice, then two separable filters."""
    side = np.stack([-direction[:, 1], direction[:, 0]], axis=1) * _kernels.ACROSS_PX
    t = first[:, None] + np.arange(-3, count + 3)
    offsets = np.arange(-2, 3)
    points = (
        origin[:, None, None]
        + t[:, :, None, None] * direction[:, None, None]
        + offsets[None, None, :, None] * side[:, None, None]
    )
    nearest = np.floor(points + 0.5).astype(int)
    x = np.clip(nearest[..., 0], 0, grey.shape[1] - 1)
    y = np.clip(nearest[..., 1], 0, grey.shape[0] - 1)
    samples = grey[y, x].astype(float)
    smooth = np.array([1, 4, 6, 4, 1]) / 16
    result = np.empty((len(origin), count))
    for k in range(len(origin)):
        mean, slope = samples[k].mean(axis=1), (samples[k] * offsets).sum(axis=1) / (10 * _kernels.ACROSS_PX)
        g = np.convolve(np.convolve(mean, smooth, "valid"), [0.5, 0, -0.5], "valid")
        h = np.convolve(slope, smooth, "valid")[1:-1]
        size = np.hypot(g, h)
        facing = abs(g) if polarity == 0 else polarity * g
        result[k] = np.where(facing > 0.35 * size, size, -size)
    return result


@pytest.mark.parametrize("polarity", [-1, 0, 1])
def test_edge_strength_equals_its_twin_also_beyond_the_border(polarity):
    rng = np.random.default_rng(2)
    grey = rng.integers(0, 256, (80, 90), dtype=np.uint8)
    angle = rng.uniform(0, 2 * np.pi, 12)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    origin = rng.uniform(10, 70, (12, 2))
    first = rng.uniform(-4, 4, 12)
    found = np.empty((12, 40), np.float32)
    _kernels.edge_strength(grey, origin, direction, first, 40, polarity, found)
    twin = strength_twin(grey, origin, direction, first, 40, polarity)
    # The magnitude; at a facing angle within rounding of the limit the sign may differ.
    np.testing.assert_allclose(abs(found), abs(twin), atol=2e-3)
    assert np.mean(np.sign(found) != np.sign(twin)) < 0.01


def test_share_is_a_line_fit_through_the_neighbours():
    rng = np.random.default_rng(3)
    value = 5 + 0.1 * np.arange(40) + rng.standard_normal(40)
    use = rng.random(40) > 0.2
    mean, spread = np.empty(40), np.empty(40)
    fit.fraction(value, np.ones(40), use, 6, mean, spread)
    for k in range(40):
        near = np.array([j for j in range(max(k - 6, 0), min(k + 7, 40)) if use[j] and j != k])
        if len(near) < 4:
            assert np.isinf(spread[k])
            continue
        assert mean[k] == pytest.approx(np.polyval(np.polyfit(near, value[near], 1), k), abs=1e-6)


def test_share_trusts_neighbours_as_far_as_they_agree():
    rng = np.random.default_rng(4)
    mean, spread = np.empty(200), np.empty(200)
    for scatter in (0.0, 3.0):
        value = rng.standard_normal(200) + scatter * rng.standard_normal(200)
        fit.fraction(value, np.ones(200), np.ones(200, np.bool_), 10, mean, spread)
        # Twenty neighbours: own noise / 20 when they agree, the scatter squared when not.
        low, high = (0.0, 0.25) if scatter == 0.0 else (5.0, 13.0)
        assert low < spread.mean() < high

"""The fit by blocks against NumPy: its sums, and its robust step by plain least squares on every block."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.special import betaln, expit
from tests.patience import PATIENCE_S

from visuohaptic.tracking.templates.alignment._block_kernels import block_step, block_sums, template_sums
from visuohaptic.tracking.templates.alignment._sample_kernels import row_positions, sample_rows
from visuohaptic.tracking.templates.alignment._scatter_kernels import block_covariance, seen_blurs

SIDE, DOWN, ACROSS, BORDER = 8, 3, 4, 2
#: The last blocks of a row and of a column take what is left.
ROWS, COLUMNS = DOWN * SIDE + 3, ACROSS * SIDE + 5
UPPER = np.triu_indices(7)


def block(j: int, i: int) -> tuple[slice, slice]:
    """Rows and columns of a block."""
    ends = (ROWS if j == DOWN - 1 else (j + 1) * SIDE), (COLUMNS if i == ACROSS - 1 else (i + 1) * SIDE)
    return slice(j * SIDE, ends[0]), slice(i * SIDE, ends[1])


def centred(part: slice) -> np.ndarray:
    """Places from the middle of a block, in its sides."""
    return (np.arange(part.start, part.stop) - 0.5 * (part.start + part.stop - 1)) / SIDE


@pytest.mark.parametrize("cubic", [False, True])
def test_sums_equal_their_numpy_twin(cubic: bool) -> None:
    rng = np.random.default_rng(1)
    image = rng.uniform(20, 220, (60, 70)).astype(np.float32)
    template, gx, gy = (rng.normal(0, 30, (ROWS, COLUMNS)).astype(np.float32) for _ in range(3))
    offset = rng.uniform(-0.4, 0.4, (2, ROWS, COLUMNS)).astype(np.float32)
    h = np.array([[1.1, 0.1, 12.0], [-0.1, 0.9, 36.0], [1e-3, -2e-3, 1.0]])
    sums, fixed = np.zeros((2, DOWN, ACROSS, 28))
    samples = np.full((2, ROWS, COLUMNS), np.nan, np.float32)
    sample_rows(image, h, offset, np.arange(ROWS), cubic, *samples)
    template_sums(template, gx, gy, SIDE, BORDER, fixed)
    block_sums(*samples, template, gx, gy, fixed, SIDE, BORDER, sums)

    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    q = h[2, 0] * u + h[2, 1] * v + 1
    px = (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / q + offset[0]
    py = (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / q + offset[1]
    inside = (px >= 1) & (px <= 70 - 2.001) & (py >= 1) & (py <= 60 - 2.001)
    assert 0.5 < inside.mean() < 1.0
    inner = np.zeros_like(inside)
    inner[BORDER:-BORDER, BORDER:-BORDER] = True
    value = map_coordinates(image.astype(float), [py, px], order=3 if cubic else 1, prefilter=False)
    for j in range(DOWN):
        for i in range(ACROSS):
            part = block(j, i)
            t = template[part].astype(float)
            columns = (
                np.ones_like(t),
                centred(part[1]) * t,
                centred(part[0])[:, None] * t,
                t,
                gx[part],
                gy[part],
                value[part],
            )
            a = np.stack([np.asarray(column, float).ravel() for column in columns])
            expected = (a * (inside & inner)[part].ravel()) @ a.T
            scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-9
            # Sums of at most 150 products in float32: 1e-5 of the scale of each.
            np.testing.assert_allclose(sums[j, i] / scale[UPPER], (expected / scale)[UPPER], atol=3e-5)


def scene(rng: np.random.Generator, theta: np.ndarray) -> tuple[np.ndarray, ...]:
    """Sums of blocks whose image is the template moved by ``theta`` and softened; the last block shows something else."""
    x, y = np.linspace(-0.8, 0.8, ACROSS), np.linspace(-0.6, 0.6, DOWN)
    softened = rng.normal(0, 0.01, (DOWN, ACROSS, 2, 4))
    known = np.random.default_rng(9).normal(0, 0.003, (DOWN, ACROSS, 2, 1))
    softened = np.concatenate([softened, known], axis=-1)
    sums = np.zeros((DOWN, ACROSS, 28))
    for j in range(DOWN):
        for i in range(ACROSS):
            t, gx, gy = rng.normal(0, [[30.0], [300.0], [300.0]], (3, SIDE * SIDE))
            v, u = (part.ravel() / SIDE for part in np.mgrid[:SIDE, :SIDE] - 0.5 * (SIDE - 1))
            # The last column is a known motion, which a block shows beside those of the unknowns.
            motion = design_of(x[i], y[j], softened[j, i]) @ theta - softened[j, i, :, 4]
            shown = 0.7 * (t - gx * motion[0] - gy * motion[1]) + 0.1 * u * t - 0.05 * v * t + 20.0
            if (j, i) == (DOWN - 1, ACROSS - 1):
                shown = rng.normal(90, 30, SIDE * SIDE)
            a = np.stack([np.ones_like(t), u * t, v * t, t, gx, gy, shown + rng.normal(0, 2.0, SIDE * SIDE)])
            sums[j, i] = (a @ a.T)[UPPER]
    return sums, x, y, softened


def fields(x: float, y: float) -> np.ndarray:
    """The eight velocity fields at a point, (2, 8)."""
    return np.array([[1, x, y, 0, 0, 0, -x * x, -x * y], [0, 0, 0, 1, x, y, -x * y, -y * y]])


def design_of(x: float, y: float, softened: np.ndarray) -> np.ndarray:
    """Motions of a block due to the twelve unknowns, (2, 12)."""
    return np.hstack([fields(x, y), softened[:, :4]])


def twin(sums, x, y, softened, independent, noise, blur, passes):
    """What :func:`block_step` does, by least squares on every block and dense algebra."""
    motions, squares, chance, variances = [], [], [], []
    for s, known in zip(sums.reshape(-1, 28), softened[..., 4].reshape(-1, 2), strict=True):
        a = np.zeros((7, 7))
        a[UPPER] = s
        a = a + np.triu(a, 1).T
        slopes = np.linalg.solve(a[:3, :3], a[:3, 3:])
        left = a[3:, 3:] - a[3:, :3] @ slopes  # of T, gradients and image beside bias and slopes
        gain = left[0, 3] / left[0, 0]
        rho2 = left[0, 3] ** 2 / (left[0, 0] * left[3, 3])
        beside = left[1:, 1:] - np.outer(left[1:, 0], left[0, 1:]) / left[0, 0]
        metric = beside[:2, :2] + np.eye(2) * (1e-5 * np.trace(beside[:2, :2]) + 1e-9)
        seen = np.linalg.solve(metric, beside[:2, 2])
        motions.append(-seen / gain + known)
        squares.append(gain**2 * metric)
        variances.append(max((beside[2, 2] - seen @ beside[:2, 2]) / (s[0] - 6), 1 / 12))
        m = independent - 2
        chance.append(betaln(0.5, 0.5 * (m - 2)) - 0.5 * (m - 4) * np.log(1 - rho2) if gain > 0 else -5.0)
        if gain <= 0:
            variances[-1] = 0.0
    used = np.array(variances) > 0
    motions, squares, chance, variances = (
        np.array(part)[used] for part in (motions, squares, chance, variances)
    )
    design = np.stack([design_of(u, v, softened[j, i]) for j, v in enumerate(y) for i, u in enumerate(x)])[
        used
    ]
    size = sums[..., 0].ravel()[used]
    wider = size / independent
    probability, scatter = expit(chance), 1.0
    for _ in range(passes):
        common = np.average(variances, weights=probability * size)
        metric = squares / (noise * scatter * np.maximum(variances, common))[:, None, None]
        prior = np.diag([0.0] * 8 + [blur**-2] * 3 + [1.0])
        matrix = prior + np.einsum("n,nai,nab,nbj->ij", probability, design, metric, design)
        step = np.linalg.solve(matrix, np.einsum("n,nai,nab,nb->i", probability, design, metric, motions))
        off = motions - design @ step
        chi2 = np.einsum("na,nab,nb->n", off, metric, off)
        total, count = probability @ chi2, probability.sum()
        ratio = np.clip(chance + np.log(wider) + 0.5 * chi2 * (1 / wider - 1), -30, 30)
        probability = expit(ratio)
        scatter = max(scatter * total / max(2 * count - 12, 1.0), 1.0)
    variance = np.average(variances, weights=probability * size)
    return np.log(0.5 + 0.5 * np.exp(ratio)).sum(), variance, step, matrix, probability, used


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_the_step_equals_its_numpy_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    theta = np.concatenate([rng.normal(0, 0.003, 8), rng.normal(0, 0.5, 4)])
    sums, x, y, softened = scene(rng, theta)
    independent = np.full((DOWN, ACROSS), 30.0)
    step, matrix, probability = np.zeros(12), np.zeros((12, 12)), np.zeros((DOWN, ACROSS))
    fits = np.zeros((DOWN, ACROSS, 9))
    odds, variance = block_step(
        sums, x, y, softened, independent, 0.5 * SIDE**2, 1.5, 6.0, 4, step, matrix, probability, fits
    )
    expected = twin(sums, x, y, softened, 30.0, 1.5, 6.0, 4)
    # Sums in float64 with reordering allowed.
    assert odds == pytest.approx(expected[0], rel=1e-6)
    assert variance == pytest.approx(expected[1], rel=1e-6)
    sigma = np.sqrt(np.diag(np.linalg.inv(expected[3])))
    np.testing.assert_allclose(step / sigma, expected[2] / sigma, atol=1e-5)
    scale = np.sqrt(np.outer(np.diag(expected[3]), np.diag(expected[3])))
    np.testing.assert_allclose(matrix / scale, expected[3] / scale, atol=1e-6)
    np.testing.assert_allclose(probability.ravel()[expected[5]], expected[4], atol=1e-6)
    # And it is right: what was put in within four of its own standard deviations, and nothing is less
    # probable than the stranger.
    assert np.abs((step - theta) / sigma).max() < 4.0
    assert probability[-1, -1] == probability.min()
    assert probability.ravel()[:-1].min() > 0.9
    assert fits[:-1, :, 7] == pytest.approx(0.7, abs=0.05)


def fitted(rng: np.random.Generator, scatter: float) -> tuple[np.ndarray, ...]:
    """Motions of 12 x 12 blocks that scatter more than their pixels tell, the fit to them, and what produced them."""
    x = y = np.linspace(-0.9, 0.9, 12)
    softened = np.concatenate([rng.normal(0, 0.01, (12, 12, 2, 4)), np.zeros((12, 12, 2, 1))], axis=-1)
    design = np.array([[design_of(x[i], y[j], softened[j, i]) for i in range(12)] for j in range(12)])
    theta = np.concatenate([rng.normal(0, 0.003, 8), np.zeros(4)])
    fits = np.zeros((12, 12, 9))
    half = rng.normal(0, 300.0, (12, 12, 2, 2))
    metric = half @ half.swapaxes(2, 3) + 1e3 * np.eye(2)
    fits[..., 0], fits[..., 1], fits[..., 2] = metric[..., 0, 0], metric[..., 0, 1], metric[..., 1, 1]
    noise = np.linalg.solve(np.linalg.cholesky(metric).swapaxes(2, 3), rng.normal(0, scatter, (12, 12, 2, 1)))
    fits[..., 3:5] = design @ theta + noise[..., 0]
    fits[..., 6] = 1.0
    prior = np.diag([0.0] * 8 + [6.0**-2] * 3 + [1.0])
    matrix = prior + np.einsum("jiak,jiab,jibl->kl", design, metric, design)
    step = np.linalg.solve(matrix, np.einsum("jiak,jiab,jib->k", design, metric, fits[..., 3:5]))
    return x, y, softened, fits, step, theta, design, metric, matrix


def test_the_covariance_is_that_of_fits_without_each_block() -> None:
    """A jackknife, made here by leaving out every block and fitting the others."""
    x, y, softened, fits, step, _, design, metric, matrix = fitted(np.random.default_rng(3), 2.0)
    probability, found = np.ones((12, 12)), np.zeros((12, 12))
    ratio = block_covariance(x, y, softened, 1.0, 1.0, 6.0, 12, step, probability, fits, found)
    whole = np.einsum("jiak,jiab,jib->k", design, metric, fits[..., 3:5])
    inverse = np.linalg.inv(matrix)
    expected = inverse[:, 8:] @ np.diag([6.0**-2] * 3 + [1.0]) @ inverse[8:]
    for j, i in np.ndindex(12, 12):
        d, w = design[j, i], metric[j, i]
        without = np.linalg.solve(matrix - d.T @ w @ d, whole - d.T @ w @ fits[j, i, 3:5])
        expected += np.outer(without - step, without - step)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-6)
    assert ratio == pytest.approx(np.trace(matrix @ expected) / 12, rel=1e-6)


@pytest.mark.parametrize("scatter", [1.0, 4.0])
def test_the_covariance_follows_a_scatter_that_the_pixels_do_not_know(scatter: float) -> None:
    z2 = []
    for seed in range(60):
        x, y, softened, fits, step, theta, *_ = fitted(np.random.default_rng(seed), scatter)
        found = np.zeros((12, 12))
        block_covariance(x, y, softened, 1.0, 1.0, 6.0, 12, step, np.ones((12, 12)), fits, found)
        off = (step - theta)[:8]
        z2.append(off @ np.linalg.solve(found[:8, :8], off) / 8)
    # 480 squares: 6.5 % at one sigma; a covariance of a hundred blocks' scatter adds a tenth to the mean of its inverse.
    assert np.mean(z2) == pytest.approx(1.0, abs=0.3)


def test_a_blur_of_the_image_is_that_of_the_template_where_each_block_is() -> None:
    """Second moments are mapped by the derivative of the warp, made here by finite differences."""
    rng = np.random.default_rng(4)
    h = np.array([[90.0, 20.0, 300.0], [-15.0, 60.0, 200.0], [0.1, -0.2, 1.0]])
    x, y, unit, variance = np.linspace(-0.9, 0.9, 5), np.linspace(-0.5, 0.5, 3), 60.0, 0.7
    softened = rng.normal(0, 0.01, (3, 5, 2, 4))
    seen, mean, moments = np.zeros((3, 5, 2, 5)), np.zeros(3), np.array([0.8, 0.3, 1.4])
    seen_blurs(softened, x, y, h, unit, variance, seen, mean)

    def warp(at: np.ndarray) -> np.ndarray:
        mapped = h @ np.append(at, 1.0)
        return mapped[:2] / mapped[2]

    blurs = []
    for j, i in np.ndindex(3, 5):
        at, step = np.array([x[i], y[j]]), 1e-5
        jacobian = np.stack([warp(at + step * axis) - warp(at - step * axis) for axis in np.eye(2)], axis=-1)
        back = np.linalg.inv(jacobian / (2 * step * unit))
        there = back @ moments[[[0, 1], [1, 2]]] @ back.T
        blurs.append(0.5 * np.trace(there))
        expected = softened[j, i, :, :3] @ [there[0, 0], there[0, 1], there[1, 1]]
        np.testing.assert_allclose(seen[j, i, :, :3] @ moments, expected, rtol=1e-6)
        known = -variance * softened[j, i, :, [0, 2]].sum(axis=0)
        np.testing.assert_allclose(
            seen[j, i, :, 3:], np.column_stack([softened[j, i, :, 3], known]), rtol=1e-12
        )
    assert mean @ moments == pytest.approx(np.mean(blurs), rel=1e-6)


@pytest.mark.parametrize("size", [(4, 4), (40, 30), (32769, 40000)])
@pytest.mark.parametrize(
    "rows",
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[1e3, 0, 1e6], [0, 1e3, 1e6], [0, 0, 1]],
        [[1, 0, 0], [0, 1, 0], [1, 0, -5]],  # a column of the template is at the horizon
        [[1, 0, -5], [0, 1, -3], [1, 0, -5]],  # there, a position that is 0 / 0
        [[1, 0, np.nan], [0, np.nan, 0], [0, 0, 1]],
        [[np.inf, 0, 0], [0, 1, 0], [0, 0, 1]],
    ],
)
def test_neighbours_of_every_position_are_in_the_image(size: tuple[int, int], rows: list) -> None:
    """The 16 of a cubic spline are read without a check: other memory would be read, or the process would end.

    ``float32`` has no number between 32767 and 32767.004: a bound of positions alone lets the neighbours leave a wide image.
    """
    width, height = size
    nothing, index = np.zeros(20, np.float32), np.zeros(20, np.int32)
    fx, fy, inside = np.zeros((3, 20), np.float32)
    row_positions(np.array(rows, float), 3, 20, width, height, nothing, nothing, index, fx, fy, inside)
    v, u = np.divmod(index, width)
    assert u.min() >= 1
    assert v.min() >= 1
    assert u.max() + 2 < width
    assert v.max() + 2 < height


def test_the_last_pixels_of_an_image_are_sampled() -> None:
    """Positions whose 16 neighbours end at the last row and column, against another spline."""
    rng = np.random.default_rng(8)
    image = rng.uniform(0, 255, (11, 13)).astype(np.float32)
    value, inside = np.full((2, 8, 8), np.nan, np.float32)
    h = np.array([[0.1, 0.0, 10.29], [0.0, 0.1, 8.29], [0.0, 0.0, 1.0]])
    sample_rows(image, h, np.zeros((2, 1, 1), np.float32), np.arange(8), True, value, inside)
    places = 0.1 * np.arange(8) + 0.29
    v, u = np.meshgrid(8 + places, 10 + places, indexing="ij")
    expected = map_coordinates(image.astype(float), [v, u], order=3, mode="mirror", prefilter=False)
    assert inside.all()
    np.testing.assert_allclose(value, expected, atol=2e-3)


def small_spline() -> np.ndarray:
    """Cubic samples of a small image, and whether they are inside of it, (2, 5, 6)."""
    image = (np.arange(11 * 13, dtype=np.float32) % 7).reshape(11, 13)
    h, found = (
        np.array([[1.2, 0.1, 1.3], [-0.1, 0.9, 2.4], [0.01, 0.0, 1.0]]),
        np.zeros((2, 5, 6), np.float32),
    )
    sample_rows(image, h, np.zeros((2, 1, 1), np.float32), np.arange(5), True, *found)
    return found


def test_a_cubic_spline_is_sampled_without_the_compiler() -> None:
    """``NUMBA_DISABLE_JIT``, for a debugger: one instruction reads four neighbours in machine code only."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    script = f"import {__name__} as here; print(*here.small_spline().ravel())"
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stderr
    compiled = small_spline()
    assert compiled[1].sum() > 20
    np.testing.assert_allclose(np.array(done.stdout.split(), float), compiled.ravel(), atol=1e-5)

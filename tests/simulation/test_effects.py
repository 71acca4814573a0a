"""Noise by its moments, light by its formula, kernels by their NumPy twins."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.simulation.rendering import CameraEffects
from visuohaptic.simulation.rendering._render_kernels import develop
from visuohaptic.simulation.rendering.effects import _normal_quantiles, in_bands

CORES = "visuohaptic.simulation.rendering.effects.available_cores"


def developed(
    effects: CameraEffects, level: float = 120.0, shape: tuple[int, int, int] = (200, 300, 1), **more
):
    image = np.full(shape, level, np.float32)
    times = more.get("times", np.zeros(shape[0]))
    return effects.developed(image, times, np.random.default_rng(more.get("seed", 0)))


def test_noise_has_the_stated_moments_and_independent_pixels() -> None:
    image = developed(CameraEffects(noise_sigma=5.0), 120.3, (400, 500, 1))[..., 0].astype(float)
    n = image.size
    # Rounding adds 1/12 to the variance. Limits: 4 standard errors of mean, variance, correlation.
    variance = 25 + 1 / 12
    assert abs(image.mean() - 120.3) < 4 * np.sqrt(variance / n)
    assert abs(image.var() / variance - 1) < 4 * np.sqrt(2 / n)
    centred = image - image.mean()
    for a, b in (
        (centred[:, 1:], centred[:, :-1]),
        (centred[1:], centred[:-1]),
        (centred[:, 4:], centred[:, :-4]),  # four normals come from one random number
    ):
        assert abs((a * b).mean() / centred.var()) < 4 / np.sqrt(a.size)
    kurtosis = (centred**4).mean() / centred.var() ** 2
    assert abs(kurtosis - 3) < 4 * np.sqrt(24 / n) + 0.01  # rounding makes it 3 - 0.00003


def test_shot_noise_grows_with_the_level() -> None:
    effects = CameraEffects(noise_sigma=1.0, shot_noise=0.05)
    for level in (40.0, 160.0):
        spread = developed(effects, level).astype(float).var()
        expected = 1 + 0.05 * level + 1 / 12
        assert abs(spread / expected - 1) < 4 * np.sqrt(2 / 60000)


def test_same_seed_same_picture() -> None:
    effects = CameraEffects(noise_sigma=3.0)
    np.testing.assert_array_equal(developed(effects, seed=5), developed(effects, seed=5))
    assert (developed(effects, seed=5) != developed(effects, seed=6)).mean() > 0.8


def test_develop_equals_numpy() -> None:
    rng = np.random.default_rng(1)
    rows, columns, channels = 6, 7, 3
    image = rng.uniform(-20, 300, (rows, columns, channels)).astype(np.float32)
    field = rng.uniform(0.5, 1, (rows, columns)).astype(np.float32)
    gain = rng.uniform(0.8, 1.2, rows)
    sigma = np.sqrt(4 + 0.1 * np.arange(256)).astype(np.float32)
    seeds = rng.integers(0, 2**64, rows, dtype=np.uint64)
    table = _normal_quantiles()
    result = np.zeros(image.shape, np.uint8)
    words = np.zeros(6, np.uint64)
    develop(image, field, gain, sigma, seeds, table, words, words.view(np.uint16), result)

    numbers = columns * channels
    mask = (1 << 64) - 1
    normals = np.zeros((rows, numbers))
    for row in range(rows):
        state = int(seeds[row])
        for k in range(numbers):
            if k % 4 == 0:  # splitmix64, in whole numbers of Python
                state = (state + 0x9E3779B97F4A7C15) & mask
                z = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & mask
                z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
                z ^= z >> 31
            normals[row, k] = table[(z >> (16 * (k % 4))) & 0xFFFF]
    value = image * field[..., None] * gain[:, None, None]
    value += sigma[np.clip(value, 0, 255).astype(int)] * normals.reshape(image.shape)
    expected = np.clip(np.floor(value + 0.5), 0, 255).astype(int)
    # float32 against float64 may round a number at exactly one half differently.
    assert np.abs(expected - result.astype(int)).max() <= 1
    assert (expected == result).mean() > 0.97


def test_vignetting_and_gradient() -> None:
    image = developed(CameraEffects(vignetting=0.4, gradient_x=0.2), 200.0, (201, 301, 1))[..., 0].astype(
        float
    )
    assert abs(image[100, 150] - 200) <= 1
    # Corner: 1 - 0.4, times 1 + 0.1 on the right.
    assert abs(image[0, -1] - 200 * 0.6 * 1.1) <= 1
    assert abs(image[0, 0] - 200 * 0.6 * 0.9) <= 1


def test_light_follows_the_time_of_each_row() -> None:
    effects = CameraEffects(light=lambda t: 1.0 if t < 0.01 else 0.0, gain=1.5)
    image = developed(effects, 100.0, times=np.arange(200) * 1e-4)[..., 0]
    np.testing.assert_array_equal(image[:99], 150)
    np.testing.assert_array_equal(image[101:], 0)


def test_levels_are_clipped_and_rounded() -> None:
    assert developed(CameraEffects(gain=10.0)).max() == 255
    assert developed(CameraEffects(), 99.4).max() == 99
    assert developed(CameraEffects(), 99.6).min() == 100


@pytest.mark.parametrize("channels", [1, 3])
def test_jpeg_keeps_the_picture_roughly(channels: int) -> None:
    image = developed(CameraEffects(noise_sigma=2.0, jpeg_quality=90), shape=(64, 64, channels))
    assert image.shape == (64, 64, channels)
    assert abs(image.mean() - 120) < 1


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("blur_px", -1.0),
        ("noise_sigma", np.nan),
        ("vignetting", 1.5),
        ("jpeg_quality", 0),
        ("exposure_samples", 0),
    ],
)
def test_bad_effects_are_refused(field: str, value: float) -> None:
    with pytest.raises(InputError, match=f"CameraEffects: {field}: found"):
        CameraEffects(**{field: value})


def test_bands_of_rows_cover_each_row_once(monkeypatch) -> None:
    """However many cores draw an image together, each of its rows is worked on once."""
    for cores, rows in ((1, 900), (2, 901), (3, 899), (64, 300), (7, 5)):
        monkeypatch.setattr(CORES, lambda cores=cores: cores)
        worked = np.zeros(rows, int)

        def work(low: int, high: int, worked=worked) -> None:
            worked[low:high] += 1

        in_bands(work, rows)
        assert (worked == 1).all()


def test_an_error_in_a_band_is_raised(monkeypatch) -> None:
    monkeypatch.setattr(CORES, lambda: 4)

    def work(low: int, _high: int) -> None:
        if low:
            raise ValueError(f"row {low}")

    with pytest.raises(ValueError, match="row 225"):
        in_bands(work, 900)


def test_more_cores_give_the_same_levels(monkeypatch) -> None:
    effects = CameraEffects(noise_sigma=3.0, vignetting=0.3, gradient_x=0.2)
    exact = np.random.default_rng(2).uniform(0, 255, (400, 21, 3)).astype(np.float32)
    images = []
    for cores in (1, 3):
        monkeypatch.setattr(CORES, lambda cores=cores: cores)
        images.append(effects.developed(exact, np.linspace(0, 0.01, 400), np.random.default_rng(3)))
    np.testing.assert_array_equal(*images)

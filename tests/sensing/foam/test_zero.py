"""The zero reference: averaging, refusal, adaptation and drift."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import CalibrationError, InputError
from visuohaptic.sensing.foam.strip import DriftSettings, ZeroReference, ZeroWatch

K = 20
IMAGE = np.random.default_rng(3).integers(0, 256, (K, 5, 60)).astype(np.float64)


def _zero(rng: np.random.Generator, frames: int = 40, noise_m: float = 2e-5) -> ZeroReference:
    width = 0.02 + noise_m * rng.standard_normal((frames, K))
    return ZeroReference.from_samples(1.0, np.zeros((frames, K)), width, IMAGE)


def test_mean_and_its_sigma() -> None:
    errors = []
    for seed in range(60):
        zero = _zero(np.random.default_rng(seed))
        errors.append((zero.width_m - 0.02) / zero.width_sigma_m)
    # 60 x 20 draws; each sigma comes from 40 frames and is itself known to 11 %.
    assert np.std(errors) == pytest.approx(1.0, abs=0.1)


def test_file_round_trip(tmp_path) -> None:
    zero = _zero(np.random.default_rng(0))
    zero.save(tmp_path / "zero.yaml")
    back = ZeroReference.load(tmp_path / "zero.yaml", K)
    assert back.width_m == pytest.approx(zero.width_m, rel=1e-8)
    assert back.frames == 40
    with pytest.raises(InputError, match="reference_px: has 20 points, the sensor has 21; zero again"):
        ZeroReference.load(tmp_path / "zero.yaml", 21)


def test_file_keeps_the_image(tmp_path) -> None:
    zero = _zero(np.random.default_rng(0))
    zero.save(tmp_path / "zero.yaml")
    back = ZeroReference.load(tmp_path / "zero.yaml", K)
    np.testing.assert_array_equal(back.image, IMAGE)


@pytest.mark.parametrize("damage", ["older", "no base64", "no picture", "other size"])
def test_a_file_without_its_image_is_refused(tmp_path, damage) -> None:
    path = tmp_path / "zero.yaml"
    _zero(np.random.default_rng(0)).save(path)
    text = path.read_text()
    start = text.index("image_png:")
    other = {
        "older": "",
        "no base64": "image_png: '?'\n",
        "no picture": "image_png: aGVsbG8=\n",
    }
    if damage == "other size":
        small = ZeroReference.from_samples(0.0, np.zeros((4, K)), np.full((4, K), 0.02), IMAGE[:, :3])
        small.save(path)
    else:
        path.write_text(text[:start] + other[damage])
    with pytest.raises(
        InputError, match=r"image_png: found no image of the strip .*; zero again: visuohaptic"
    ):
        ZeroReference.load(path, K)


def test_a_moving_front_is_refused() -> None:
    width = 0.02 - 1e-4 * np.arange(30)[:, None] * np.ones(K)
    with pytest.raises(CalibrationError, match=r"moved by .* mm while zeroing"):
        ZeroReference.from_samples(0.0, np.zeros((30, K)), width, IMAGE)


def test_unseen_points_are_refused() -> None:
    width = np.full((10, K), 0.02)
    width[:, 3:5] = np.nan
    with pytest.raises(CalibrationError, match="2 of 20 contour points"):
        ZeroReference.from_samples(0.0, np.zeros((10, K)), width, IMAGE)


def test_one_unseen_point_takes_its_neighbours_width_and_a_wide_sigma() -> None:
    width = np.full((10, 40), 0.02)
    width[:, 7] = np.nan
    zero = ZeroReference.from_samples(0.0, np.zeros((10, 40)), width, np.zeros((40, 5, 60)))
    assert zero.width_m[7] == pytest.approx(0.02)
    assert zero.width_sigma_m[7] == pytest.approx(2e-4, rel=0.01)
    assert np.delete(zero.width_sigma_m, 7).max() < 1e-6


def test_adapts_at_rest_only_and_tells_when_it_drifted() -> None:
    watch = ZeroWatch(
        _zero(np.random.default_rng(1)), DriftSettings(time_constant_s=1.0, rest_s=0.5, limit=0.03)
    )
    usable = np.ones(K, dtype=bool)
    for t in np.arange(0, 5, 0.1):
        watch.update(float(t), np.full(K, 0.0197), touched=True, usable=usable)
    assert abs(watch.drift_m) < 1e-12
    for t in np.arange(5, 15, 0.1):
        watch.update(float(t), np.full(K, 0.0197), touched=False, usable=usable)
    assert watch.drift_m == pytest.approx(-3e-4, abs=2e-5)
    assert not watch.drifted
    for t in np.arange(15, 30, 0.1):
        watch.update(float(t), np.full(K, 0.0192), touched=False, usable=usable)
    assert watch.drifted

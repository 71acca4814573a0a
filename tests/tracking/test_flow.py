from __future__ import annotations

import cv2
import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.tracking.points import FlowSettings, PointTracker, location_sigma_px

ROWS, COLUMNS = 200, 260


def spectrum(rng, rows=256, columns=512):
    """Band-limited periodic texture as a Fourier sum: it can be shifted by any part of a pixel, exactly."""
    fy, fx = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)[None, :]
    f = np.hypot(fx, fy)
    noise = np.fft.rfft2(rng.standard_normal((rows, columns)))
    return noise * np.exp(-((f / 0.12) ** 2)) * (f > 0.01), fx, fy


def picture(texture, dx, dy, rng=None, sigma=0.0):
    coefficients, fx, fy = texture
    image = np.fft.irfft2(coefficients * np.exp(-2j * np.pi * (fx * dx + fy * dy)))
    image = 128 + 40 * image / image.std()
    image = image[:ROWS, :COLUMNS]
    if rng is not None:
        image = image + rng.normal(0, sigma, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_points_follow_a_sub_pixel_motion_and_keep_their_ids():
    rng = np.random.default_rng(3)
    texture = spectrum(rng)
    tracker, regions = PointTracker(), np.ones((ROWS, COLUMNS), np.uint8)
    first, sums = None, {}
    for i in range(8):
        step = tracker.update(picture(texture, 4.3 * i, -2.6 * i, rng, 2.0), regions)
        if i == 0:
            assert len(step.ids) == 0
            continue
        if first is None:
            first = {int(k): p for k, p in zip(step.ids, step.before_px, strict=True)}
        for k, p in zip(step.ids, step.after_px, strict=True):
            if int(k) in first:
                sums[int(k)] = p - first[int(k)]
        error = step.after_px - step.before_px - [4.3, -2.6]
        # The bound is 0.02 px for this texture; interpolation and rounding add about as much.
        assert np.median(np.abs(error)) < 0.05
    long = [v for k, v in sums.items() if k in set(step.ids.tolist())]
    assert len(long) > 20
    np.testing.assert_allclose(np.median(long, axis=0), [7 * 4.3, -7 * 2.6], atol=0.1)


def test_the_declared_sigma_is_that_of_the_noise():
    rng = np.random.default_rng(5)
    texture = spectrum(rng)
    errors = []
    for _ in range(12):
        # Much noise, so that the bound exceeds what interpolation adds.
        tracker = PointTracker(FlowSettings(noise_grey=8.0, quality=0.2))
        regions = np.ones((ROWS, COLUMNS), np.uint8)
        tracker.update(picture(texture, 0, 0, rng, 8.0), regions)
        step = tracker.update(picture(texture, 2, 1, rng, 8.0), regions)
        errors.append((step.after_px - step.before_px - [2, 1]) / step.sigma_px[:, None])
    spread = 1.4826 * np.median(np.abs(np.concatenate(errors)))
    # The worse of two directions is declared for both, and the window's content was measured with noise.
    assert 0.5 < spread < 1.3


def test_location_sigma_follows_the_structure_tensor():
    x = np.arange(81.0)
    waves = 128 + 40 * np.sin(2 * np.pi * x / 16)[:, None] * np.ones(81)
    both = 128 + 40 * np.sin(2 * np.pi * x / 16)[:, None] * np.sin(2 * np.pi * x / 16)
    point = np.array([[40.0, 40.0]])
    edge = location_sigma_px(waves.astype(np.uint8), point, 21, 2.0)[0]
    corner = location_sigma_px(np.rint(both).astype(np.uint8), point, 21, 2.0)[0]
    assert edge > 1, "an edge cannot be located along itself"
    # Mean square gradient of the product: (2 pi / 16 * 40)^2 / 4 for each axis, less for central differences.
    gradient_2 = (40 * np.sin(2 * np.pi / 16)) ** 2 / 4
    assert corner == pytest.approx(2.0 * np.sqrt(2 / (gradient_2 * 21**2)), rel=0.1)


def test_regions_keep_their_points_apart_and_covered_points_are_dropped():
    rng = np.random.default_rng(6)
    still, moves = spectrum(rng), spectrum(rng)
    regions = np.zeros((ROWS, COLUMNS), np.uint8)
    regions[20:180, 10:110] = 1
    regions[20:180, 150:250] = 2
    # Without coarse levels: there a window would reach from the cover over all points.
    tracker = PointTracker(FlowSettings(levels=1), rows=(10, 190))
    for i in range(4):
        image = picture(still, 0, 0)
        image[:, 130:] = picture(moves, 0, 5.0 * i)[:, 130:]
        if i == 3:
            image[60:140, 10:110] = 30
        step = tracker.update(image, regions)
    left, right = step.of(1), step.of(2)
    assert 0 < len(left.ids) < left.tried[1], "those under the cover are gone"
    assert not np.any((left.after_px[:, 1] > 70) & (left.after_px[:, 1] < 130))
    np.testing.assert_allclose(np.median(left.after_px - left.before_px, axis=0), 0, atol=0.02)
    np.testing.assert_allclose(np.median(right.after_px - right.before_px, axis=0), [0, 5], atol=0.05)
    tracker.forget(2)
    assert len(tracker.update(image, np.zeros_like(regions)).of(2).ids) == 0


def test_nothing_to_follow_on_a_blank_wall():
    tracker, regions = PointTracker(), np.ones((ROWS, COLUMNS), np.uint8)
    rng = np.random.default_rng(7)
    for _ in range(2):
        step = tracker.update(np.clip(rng.normal(128, 2, (ROWS, COLUMNS)), 0, 255).astype(np.uint8), regions)
    assert len(step.ids) == 0
    assert step.after_px.shape == (0, 2)


def test_a_motion_that_is_told_beforehand_may_be_large():
    texture = spectrum(np.random.default_rng(8))
    regions = np.ones((ROWS, COLUMNS), np.uint8)
    tracker = PointTracker(FlowSettings(levels=1))
    tracker.update(picture(texture, 0, 0), regions)
    step = tracker.update(picture(texture, 60, 0), regions, shift_px={1: np.array([59.0, 1.0])})
    assert len(step.ids) > 20
    np.testing.assert_allclose(np.median(step.after_px - step.before_px, axis=0), [60, 0], atol=0.05)


def test_bins_keep_the_coordinates_of_the_image():
    rng = np.random.default_rng(10)
    texture = spectrum(rng)
    regions = np.ones((ROWS, COLUMNS), np.uint8)
    trackers = [PointTracker(FlowSettings(binning=n, spacing_px=12 / n), rows=(20, 180)) for n in (1, 2)]
    for image in (picture(texture, 0, 0), picture(texture, 5.0, -3.0)):
        fine, coarse = (tracker.update(image, regions) for tracker in trackers)
    np.testing.assert_allclose(np.median(coarse.after_px - coarse.before_px, axis=0), [5, -3], atol=0.05)
    # Where the texture is the same point of the scene: the fine picture around a bin's centre is the bin.
    assert coarse.before_px[:, 1].min() >= 20
    assert coarse.before_px[:, 1].max() <= 180
    assert len(fine.ids) > 20
    assert len(coarse.ids) > 20


def test_what_cannot_be_used_is_refused():
    with pytest.raises(InputError, match="window_px: found 4, expected at least 5"):
        FlowSettings(window_px=4)
    with pytest.raises(InputError, match="points: found 1, expected at least 4"):
        FlowSettings(points=1)
    tracker = PointTracker()
    with pytest.raises(InputError, match="images of the same size"):
        tracker.update(np.zeros((9, 9), np.uint8), np.zeros((9, 8), np.uint8))
    tracker.update(np.zeros((40, 40), np.uint8), np.zeros((40, 40), np.uint8))
    with pytest.raises(InputError, match=r"expected \(40, 40\) as before"):
        tracker.update(np.zeros((41, 40), np.uint8), np.zeros((41, 40), np.uint8))


def test_opencv_flow_agrees_with_a_window_search():
    """Two independent methods: the best shift of a window by squared differences, on a grid of 0.05 px."""
    texture = spectrum(np.random.default_rng(9))
    tracker, regions = PointTracker(), np.ones((ROWS, COLUMNS), np.uint8)
    image, moved = picture(texture, 0, 0), picture(texture, 0.35, -0.2)
    tracker.update(image, regions)
    step = tracker.update(moved, regions)
    shifts = np.arange(-0.6, 0.61, 0.05)
    for before, after in zip(step.before_px[:5], step.after_px[:5], strict=True):
        patch = cv2.getRectSubPix(image, (21, 21), tuple(before.tolist())).astype(float)
        costs = [
            [
                np.sum((cv2.getRectSubPix(moved, (21, 21), (before[0] + u, before[1] + v)) - patch) ** 2)
                for u in shifts
            ]
            for v in shifts
        ]
        v, u = np.unravel_index(np.argmin(costs), (len(shifts), len(shifts)))
        np.testing.assert_allclose(after - before, [shifts[u], shifts[v]], atol=0.08)


def test_regions_are_asked_for_only_when_points_are_missing():
    rng, asked = np.random.default_rng(9), []
    image = picture(spectrum(rng), 0, 0)
    regions = np.ones(image.shape, np.uint8)

    def made() -> np.ndarray:
        asked.append(True)
        return regions

    tracker = PointTracker(FlowSettings(points=60))
    for _ in range(4):
        tracker.update(image, made, labels=(1,))
    assert len(asked) == 1, "enough points after the first frame"
    regions[:, 40:] = 0
    tracker.forget(1)
    many = [len(tracker.update(image, made, labels=(1,)).ids) for _ in range(10)]
    assert max(many) < 0.7 * 60, "a strip holds fewer points than are wanted"
    # What offered some is asked again at once, what had none only every fourth frame.
    assert len(asked) < 1 + 6
    np.testing.assert_array_equal(tracker.update(image, made, labels=(1,)).label, 1)
    with pytest.raises(InputError, match="same size"):
        PointTracker().update(image, lambda: regions[1:])

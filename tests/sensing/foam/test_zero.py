"""The zero reference: averaging, rejection, adaptation and drift."""

from __future__ import annotations

import re

import numpy as np
import pytest

from visuohaptic.core import CalibrationError, InputError
from visuohaptic.sensing.foam.strip import ZeroReference, ZeroWatch
from visuohaptic.sensing.foam.strip.rest_widths import without_wrong_edges
from visuohaptic.sensing.foam.strip.zero import DRIFT_LIMIT
from visuohaptic.sensing.foam.validity import check_untouched

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


@pytest.mark.parametrize("off_m", [-4e-4, 5e-4])
def test_an_edge_that_is_not_the_front_s_is_told_by_its_neighbours(off_m) -> None:
    # Texture shifts each front by 30 um; that of a pore, or dirt, is found 0.4 mm away in all frames, to 5 um.
    rng, points, at = np.random.default_rng(4), 83, 40
    rest_m = 0.02 + 3e-5 * rng.standard_normal(points)
    seen_m = rest_m + off_m * (np.arange(points) == at) + 5e-6 * rng.standard_normal((8, points))
    image = np.zeros((points, 5, 60))
    zero = ZeroReference.from_samples(0.3, np.zeros((8, points)), seen_m, image)
    assert np.flatnonzero(zero.inferred).tolist() == [at]
    # Its own texture and the mean of two others: 30 um sqrt(1.5), known from 80 differences that share neighbours to a tenth.
    assert zero.width_sigma_m[at] == pytest.approx(3.7e-5, rel=0.3)
    assert abs(zero.width_m[at] - rest_m[at]) < 3 * zero.width_sigma_m[at]


@pytest.mark.parametrize("points", [40, 83, 200])
def test_right_widths_are_taken_for_wrong_ones_as_rarely_as_stated(points) -> None:
    rng, strips = np.random.default_rng(0), 1500
    widths = rng.standard_normal((strips, points))
    lost = sum(bool(np.isnan(without_wrong_edges(width)).any()) for width in widths)
    # One of a hundred is 15 of 1,500, with a Poisson scatter of 3.9; the median's tails are a little shorter than Student's.
    assert 4 <= lost <= 27


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


@pytest.mark.parametrize("points", [1, 3])
def test_an_edge_that_is_found_late_is_not_a_moving_front(points) -> None:
    """Edges of which the first frame saw another one, 7 mm away; a body moves several neighbours."""
    width = np.full((8, K), 0.02) + np.random.default_rng(4).normal(0.0, 2e-5, (8, K))
    width[0, 5 : 5 + points] -= 0.007
    if points == 1:
        assert ZeroReference.from_samples(0.0, np.zeros((8, K)), width, IMAGE).width_m[5] == pytest.approx(
            0.02, abs=1e-4
        )
        return
    with pytest.raises(CalibrationError, match=r"moved by 7.* mm while zeroing"):
        ZeroReference.from_samples(0.0, np.zeros((8, K)), width, IMAGE)


@pytest.mark.parametrize(
    ("dent", "points", "refused"), [(0.115, 5, True), (0.085, 5, False), (0.5, 2, False), (0.5, 3, True)]
)
def test_a_body_that_rests_on_the_strip_is_refused(dent: float, points: int, refused: bool) -> None:
    """It stands still, so the front does not move; two edges that are found wrong are no body."""
    width = np.full((8, K), 0.02) + np.random.default_rng(5).normal(0.0, 1e-5, (8, K))
    width[:, 7 : 7 + points] *= 1.0 - dent
    zero = ZeroReference.from_samples(0.0, np.zeros((8, K)), width, IMAGE)
    s_m = 0.005 * np.arange(K)
    if not refused:
        check_untouched(zero, s_m)
        return
    with pytest.raises(
        CalibrationError, match=r"mm wide at s = (35|40|45|50|55) mm, .* while nothing touches"
    ):
        check_untouched(zero, s_m)


def test_a_strip_that_is_not_seen_is_refused() -> None:
    with pytest.raises(CalibrationError, match="none of 20 contour points was seen in half of the 10 frames"):
        ZeroReference.from_samples(0.0, np.zeros((10, K)), np.full((10, K), np.nan), IMAGE)


def test_the_error_of_an_inferred_width_is_that_of_its_prediction() -> None:
    """Strips cut along a random walk; gaps inside and at an end, neighbours share their errors."""
    z = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        true = 0.02 + np.cumsum(2e-5 * rng.standard_normal(80))
        width = true + 1e-6 * rng.standard_normal((10, 80))
        width[:, 30:34], width[:, 77:], width[6:, 3] = np.nan, np.nan, np.nan
        zero = ZeroReference.from_samples(0.0, np.zeros((10, 80)), width, np.zeros((80, 5, 60)))
        np.testing.assert_array_equal(np.flatnonzero(zero.inferred), [30, 31, 32, 33, 77, 78, 79])
        assert zero.known.all()
        assert zero.width_sigma_m[~zero.inferred].max() < 1e-6
        z.append(((zero.width_m - true) / zero.width_sigma_m)[zero.inferred])
    # 200 gaps tell a standard deviation to a twentieth.
    assert np.std(z, axis=0) == pytest.approx(1.0, abs=0.2)


def test_widths_that_nothing_tells_are_unknown(tmp_path) -> None:
    width = np.full((10, K), 0.02)
    width[:, 2:] = np.nan
    zero = ZeroReference.from_samples(0.0, np.zeros((10, K)), width, IMAGE)
    assert zero.known.sum() == 2
    zero.save(tmp_path / "zero.yaml")
    back = ZeroReference.load(tmp_path / "zero.yaml", K)
    np.testing.assert_array_equal(back.known, zero.known)
    np.testing.assert_array_equal(back.inferred, zero.inferred)


@pytest.mark.parametrize("sigma", [".nan", "-1.0e-5"])
def test_a_file_with_a_sigma_that_is_none_is_refused(tmp_path, sigma) -> None:
    path = tmp_path / "zero.yaml"
    _zero(np.random.default_rng(0)).save(path)
    path.write_text(re.sub(r"width_sigma_m: \[[^,]*,", f"width_sigma_m: [{sigma},", path.read_text()))
    with pytest.raises(InputError, match=r"width_sigma_m"):
        ZeroReference.load(path, K)


def test_adapts_at_rest_only_and_tells_when_it_drifted() -> None:
    watch = ZeroWatch(_zero(np.random.default_rng(1)))
    usable = np.ones(K, dtype=bool)
    for t in np.arange(0, 5, 0.1):
        watch.update(float(t), np.full(K, 0.0197), touched=True, usable=usable)
    assert abs(watch.drift_m) < 1e-12
    # Six time constants: 0.2 % of the way are left.
    for t in np.arange(5, 190, 0.5):
        watch.update(float(t), np.full(K, 0.0197), touched=False, usable=usable)
    assert watch.drift_m == pytest.approx(-3e-4, abs=2e-5)
    assert not watch.drifted
    for t in np.arange(190, 375, 0.5):
        watch.update(float(t), np.full(K, 0.0192), touched=False, usable=usable)
    assert watch.drifted


@pytest.mark.parametrize(("part", "drifts"), [(0.8, True), (1.2, False)])
def test_what_deflects_all_points_alike_may_be_the_zero_s_drift(part, drifts) -> None:
    """Before the first frame nothing is known of how the deflection came about."""
    delta = np.full(K, part * DRIFT_LIMIT * 0.02)
    assert _common_m([(0.0, delta)]) == pytest.approx(delta[0] / np.sqrt(3.0) if drifts else 0.0)
    delta[5:9] = np.nan  # hidden
    assert (_common_m([(0.0, delta)]) > 0.0) == drifts
    delta[-6:] = 0.0  # free foam beside a contact has not drifted
    assert _common_m([(0.0, delta)]) == pytest.approx(0.0, abs=1e-12)
    assert _common_m([(0.0, np.full(K, np.nan))]) == 0.0


def test_a_deflection_that_comes_at_once_is_no_drift() -> None:
    """A plate as long as the strip: what a drift can contribute from one frame to the next remains.

    The measured width, of which the limit is a part, has an error of 1e-4.
    """
    half, frame_s = 0.5 * 0.03 * 0.02, 1.0 / 30.0
    rest, pressed = np.zeros(K), np.full(K, half)
    frames = [(0.0, rest), (frame_s, pressed)] + [(k * frame_s, pressed) for k in range(2, 100)]
    # The drift reaches its limit, twice this deflection, within a second.
    one = 2.0 * half * frame_s / np.sqrt(3.0)
    assert _common_m(frames[:2]) == pytest.approx(one, rel=1e-3)
    assert _common_m(frames) == pytest.approx(one, rel=1e-3), "what stays does not become a drift"
    assert _common_m([*frames, (3.4, rest)]) == 0.0, "what is gone is none"
    # Frames that are not read leave time for a drift.
    unseen = [(frame_s, np.full(K, np.nan)), (0.2, pressed)]
    assert _common_m([frames[0], *unseen]) == pytest.approx(0.4 * half / np.sqrt(3.0), rel=1e-3)


@pytest.mark.parametrize(("rate", "all_drift"), [(0.8, True), (1.2, False)])
def test_the_fastest_drift_reaches_its_limit_in_the_time_of_rest(rate, all_drift) -> None:
    times_s = np.arange(0.0, 0.6, 1.0 / 30.0)
    frames = [(float(t), np.full(K, rate * 0.03 * 0.02 * t)) for t in times_s]
    found = _common_m(frames) * np.sqrt(3.0) / (0.03 * 0.02 * times_s[-1])
    assert found == pytest.approx(rate if all_drift else 1.0, rel=1e-3)


def _common_m(frames: list[tuple[float, np.ndarray]]) -> float:
    """Common standard deviation in the last one of some frames [m]."""
    watch = ZeroWatch(_zero(np.random.default_rng(1)))
    return [watch.sigma_m(t_s, delta_m) for t_s, delta_m in frames][-1]


@pytest.mark.parametrize("points", [[11], [40, 41, 42, 43], [79]])
def test_a_width_that_was_hardly_measured_is_told_by_its_neighbours(points) -> None:
    """Edges that lie anywhere within 3 mm, as their own uncertainty says, in strips cut along a random walk."""
    z = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        true = 0.02 + np.cumsum(2e-5 * rng.standard_normal(80))
        width, uncertainty = true + 1e-6 * rng.standard_normal((10, 80)), np.zeros(80)
        width[:, points] += 3e-3 * rng.standard_normal(len(points))
        uncertainty[points] = 3e-3
        zero = ZeroReference.from_samples(
            0.0, np.zeros((10, 80)), width, np.zeros((80, 5, 60)), uncertainty_m=uncertainty
        )
        np.testing.assert_array_equal(np.flatnonzero(zero.inferred), points)
        z.append(((zero.width_m - true) / zero.width_sigma_m)[points])
    assert np.std(z, axis=0) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(("part", "own"), [(0.8, True), (1.25, False)])
def test_the_more_accurate_of_two_widths_is_taken(part, own) -> None:
    """A point beside a straight line between its neighbours, at which every other point misses them by 20 um."""
    width = 0.02 + 1e-5 * (-1.0) ** np.arange(80)
    # Interpolation misses each point by 20 um; Student's variance over the 77 other points is 77/75 of that.
    uncertainty = np.zeros(80)
    uncertainty[31] = part * 2e-5 * np.sqrt(77 / 75)
    zero = ZeroReference.from_samples(
        0.0, np.zeros((4, 80)), np.tile(width, (4, 1)), np.zeros((80, 5, 60)), uncertainty_m=uncertainty
    )
    assert bool(zero.inferred[31]) is not own

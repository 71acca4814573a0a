"""Contours compared with exact scenes: noise at its bound, calibrated sigma, recovery, rejection."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.tracking.synthetic import Scene, bound_px, camera

from visuohaptic.core import InputError
from visuohaptic.tracking.contours import ConstraintLines, ContourSettings, ContourTracker, PointReason

BRIGHT_BEHIND = ContourSettings(polarity=1)


def errors(scene, *, points, trials, noise, rng, **lines_kw):
    """Errors, declared sigma and validity (trials, points) of fresh trackers."""
    exact = scene.exact(4)
    lines, truth = scene.lines(points, **lines_kw)
    found = [ContourTracker(BRIGHT_BEHIND).track(camera(exact, noise, rng), lines) for _ in range(trials)]
    error = np.array([c.position_px - truth for c in found])
    return error, np.array([c.sigma_px for c in found]), np.array([c.valid for c in found])


@pytest.mark.parametrize("blur", [0.7, 1.0, 1.4, 2.0])
def test_noise_is_at_the_bound_and_declared(blur):
    rng = np.random.default_rng(int(10 * blur))
    pooled, stated = [], []
    for phase in (0.0, 0.37, 0.71):
        scene = Scene(lambda s, p=phase: p + 0.01 * s, columns=1100, centre=(550.0, 60.0), blur=blur)
        error, sigma, valid = errors(scene, points=60, trials=12, noise=5.0, rng=rng)
        assert valid.all()
        # 720 errors of 0.03-0.05 px: the mean is known to 0.002 px.
        assert abs(error.mean()) < 0.01
        pooled.append(error)
        stated.append(sigma)
    # 2160 errors: the standard deviation is known to 1.5 %, three of which are allowed.
    assert np.std(pooled) / bound_px(blur, 80, 5) < 1.15
    assert 0.85 < np.sqrt(np.mean(np.square(stated))) / np.std(pooled) < 1.2
    assert np.mean(np.abs(np.divide(pooled, stated)) < 3) > 0.99


@pytest.mark.parametrize("angle", [0.2, np.pi / 4, 1.3, 2.5, -2.0])
def test_any_orientation(angle):
    scene = Scene(lambda s: 0.3 + 0.02 * s, rows=300, columns=300, centre=(150.0, 150.0), angle=angle)
    error, sigma, valid = errors(
        scene, points=11, trials=8, noise=5.0, rng=np.random.default_rng(1), reach=40.0
    )
    assert valid.all()
    assert abs(error.mean()) < 0.02
    # 88 errors: 7.5 % each, three of them; few points share less than a long contour does.
    assert error.std() / bound_px(1.0, 80, 5) < 1.4
    assert np.abs(error / sigma).max() < 5


def test_without_noise_the_position_is_exact():
    for blur in (0.7, 1.0, 2.0):
        for phase in np.linspace(0, 1, 5, endpoint=False):
            scene = Scene(lambda s, p=phase: p + 0.003 * s, blur=blur)
            error, _, valid = errors(scene, points=17, trials=1, noise=0.0, rng=np.random.default_rng(0))
            assert valid.all()
            # Rounding alone is 0.29 grey levels: bound 0.002-0.003 px; three of them.
            assert np.abs(error).max() < 0.01


@pytest.mark.parametrize("radius", [40, 60, 100, 300])
def test_curved_edges_are_not_biased(radius):
    scene = Scene(
        lambda s: radius - np.sqrt(np.maximum(radius**2 - s**2, 1.0)), rows=170, centre=(200.0, 60.0)
    )
    points = 3 if radius < 60 else 5
    error, sigma, valid = errors(scene, points=points, trials=20, noise=5.0, rng=np.random.default_rng(2))
    assert valid.all()
    # An uncorrected edge of radius 40 would be off by 0.30 px; 20 trials leave 0.008 px.
    assert np.abs(error.mean(axis=0)).max() < 0.04
    assert np.abs(error / sigma).max() < 5


@pytest.mark.parametrize("slope", [0.3, 0.6, 1.0, 1.5])
def test_steep_edges(slope):
    scene = Scene(lambda s: slope * s, rows=420, centre=(200.0, 210.0))
    error, sigma, valid = errors(
        scene, points=9, trials=8, noise=5.0, rng=np.random.default_rng(3), reach=130.0
    )
    assert valid.mean() > 0.95
    assert np.abs((error / sigma)[valid]).max() < 5
    assert np.abs(error[valid]).mean() < 0.06


def test_shading_is_not_a_shift():
    scene = Scene(lambda s: 0.3 + 0 * s, columns=800, centre=(400.0, 60.0))
    y, x = np.mgrid[:120, :800].astype(float)
    exact = scene.exact(4) + 0.5 * np.maximum(y - 60.3, 0) - 0.3 * np.maximum(60.3 - y, 0) + 0.02 * x
    lines, truth = scene.lines(41)
    rng = np.random.default_rng(4)
    error = [
        ContourTracker(BRIGHT_BEHIND).track(camera(exact, 5, rng), lines).position_px - truth
        for _ in range(12)
    ]
    assert abs(np.mean(error)) < 0.02
    assert np.std(error) / bound_px(1.0, 80, 5) < 1.15


def test_texture_behind_the_edge_widens_sigma():
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(5)
    ratios = []
    for _ in range(6):
        scene = Scene(lambda s: 0.3 + 0 * s, columns=800, centre=(400.0, 60.0))
        texture = gaussian_filter(rng.standard_normal((120, 800)), 2.0)
        exact = scene.exact(4)
        exact = exact + 10 * texture / texture.std() * (exact - 60) / 80
        lines, truth = scene.lines(41)
        c = ContourTracker(BRIGHT_BEHIND).track(camera(exact, 5, rng), lines)
        ratios.append(((c.position_px - truth) / c.sigma_px)[c.valid])
    ratio = np.concatenate(ratios)
    assert ratio.size > 200
    # Texture is a model error, not noise: its effect is only known roughly.
    assert ratio.std() < 1.5


@pytest.mark.parametrize("cell_px", [1.5, 3.0])
def test_the_edge_of_a_wide_textured_strip_is_found_in_any_frame(cell_px):
    """Every step over texture adds to the jump term, over 140 px more than an edge, though no edge was crossed."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(13)
    scene = Scene(lambda s: 0.3 + 0 * s, rows=240, centre=(200.0, 50.0), low=130.0, high=190.0)
    exact = scene.exact(3)
    texture = gaussian_filter(rng.standard_normal(exact.shape), cell_px)
    exact = exact + 8 * texture / texture.std() * (exact - 130) / 60
    lines, truth = scene.lines(21, reach=0.0)
    # From the back, 145 px behind the edge.
    away = lines.origin_px + 145.0 * lines.direction_px, -lines.direction_px
    start, stop = np.full(21, 17.0), np.full(21, 162.0)
    lines = ConstraintLines(*away, start, stop, np.full(21, 8.5))
    tracker = ContourTracker(ContourSettings(full_search_every=2))
    for _ in range(5):
        c = tracker.track(camera(exact, 2, rng), lines)
        assert c.valid.mean() > 0.9
        assert np.abs(c.position_px - (145.0 - truth))[c.valid].max() < 1.5


def test_polarity_either_and_wrong():
    scene = Scene(lambda s: 0.2 + 0 * s, low=150.0, high=70.0)
    image = camera(scene.exact(3), 3, np.random.default_rng(6))
    lines, truth = scene.lines(15)
    for polarity in (0, -1):
        c = ContourTracker(ContourSettings(polarity=polarity)).track(image, lines)
        assert c.valid.all()
        np.testing.assert_allclose(c.contrast, -80, atol=4)
        np.testing.assert_allclose(c.position_px, truth, atol=0.1)
    assert not ContourTracker(BRIGHT_BEHIND).track(image, lines).valid.any()


def test_plain_image_has_no_contour():
    image = camera(np.full((120, 400), 90.0), 5, np.random.default_rng(7))
    lines, _ = Scene(lambda s: 0 * s).lines(21)
    c = ContourTracker().track(image, lines)
    assert not c.valid.any()
    assert np.isfinite(c.sigma_px[c.valid]).all()


def test_an_object_over_the_whole_foam_gives_no_valid_points():
    scene = Scene(lambda s: 0.3 + 0 * s, rows=200, centre=(200.0, 140.0))
    exact = scene.exact(3)
    exact[80:170, 150:235] = 200.0  # its edge is stronger than the front's: all energies prefer it
    lines, truth = scene.lines(21, reach=100.0)
    c = ContourTracker(BRIGHT_BEHIND).track(camera(exact, 3, np.random.default_rng(8)), lines)
    x = lines.origin_px[:, 0]
    assert (np.abs(c.position_px - truth) < 5 * c.sigma_px)[c.valid & ((x < 140) | (x > 245))].all()
    # The smoothness pulls up to three points beside the object off their edge: not valid, and said so.
    assert c.valid[(x < 150 - 4 * 17) | (x > 235 + 4 * 17)].all()


def test_strong_texture_behind_does_not_attract():
    scene = Scene(lambda s: 0.3 + 0 * s, rows=200, centre=(200.0, 80.0), low=40, high=80)
    exact = scene.exact(3)
    y, x = np.mgrid[:200, :400]
    exact = np.where(y > 100, np.where((y // 9 + x // 14) % 2, 30.0, 240.0), exact)
    lines, truth = scene.lines(21, reach=70.0)
    c = ContourTracker(BRIGHT_BEHIND).track(camera(exact, 3, np.random.default_rng(9)), lines)
    assert c.valid.all()
    np.testing.assert_allclose(c.position_px, truth, atol=0.2)


def test_follows_motion_and_recovers_from_a_jump():
    rng = np.random.default_rng(10)
    tracker = ContourTracker(BRIGHT_BEHIND)
    searched = []
    for shift in (0, 3, 6, 9, 50, 51, 52):  # 41 px at once is outside the window of 15
        scene = Scene(lambda s, h=shift: h + 4 * np.exp(-((s / 60) ** 2)), rows=200, centre=(200.0, 80.0))
        lines, truth = scene.lines(21, reach=70.0)
        c = tracker.track(camera(scene.exact(3), 3, rng), lines)
        assert c.valid.all()
        np.testing.assert_allclose(c.position_px, truth, atol=0.15)
        searched.append(c.searched_all)
    assert searched == [True, False, False, False, True, False, False]


def test_prediction_and_reset():
    scene = Scene(lambda s: 20 + 0 * s, rows=200, centre=(200.0, 80.0))
    lines, truth = scene.lines(15, reach=70.0)
    image = camera(scene.exact(3), 3, np.random.default_rng(11))
    tracker = ContourTracker(BRIGHT_BEHIND)
    assert not tracker.track(image, lines, predicted_px=truth + 8).searched_all
    tracker.reset()
    assert tracker.track(image, lines).searched_all
    fewer, _ = scene.lines(9)
    with pytest.raises(InputError, match=r"found 9 lines after 15.*reset"):
        tracker.track(image, fewer)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"direction_px": np.tile([0.0, 2.0], (5, 1))}, "length 2 in line 0"),
        ({"start_px": np.full(5, 30.0)}, "stop < start"),
        ({"stop_px": np.full(4, 30.0)}, "expected \\(5,\\)"),
        ({"origin_px": np.full((5, 2), np.nan)}, "not finite"),
        ({"half_width_px": 0.5}, "less than 1.5"),
    ],
)
def test_bad_lines_are_refused(change, text):
    good = {
        "origin_px": np.ones((5, 2)), "direction_px": np.tile([0.0, 1.0], (5, 1)),
        "start_px": np.zeros(5), "stop_px": np.full(5, 20.0),
    }  # fmt: skip
    with pytest.raises(InputError, match=text):
        ConstraintLines(**(good | change))


def test_bad_frames_and_settings_are_refused():
    lines, _ = Scene(lambda s: 0 * s).lines(5)
    with pytest.raises(InputError, match="expected uint8"):
        ContourTracker().track(np.zeros((100, 100)), lines)
    with pytest.raises(InputError, match="polarity: found 2, expected -1 to 1"):
        ContourSettings(polarity=2)
    with pytest.raises(InputError, match="more than 0"):
        ContourSettings(window_px=0)


def test_lines_that_leave_the_image_are_out_of_range():
    scene = Scene(lambda s: 0.3 + 0 * s)
    lines, _ = scene.lines(31)  # 510 px of points on 400 px of image
    c = ContourTracker(BRIGHT_BEHIND).track(camera(scene.exact(2), 3, np.random.default_rng(0)), lines)
    outside = (lines.origin_px[:, 0] < 8) | (lines.origin_px[:, 0] > 391)
    assert (c.reason[outside] == PointReason.OUT_OF_RANGE).all()
    assert c.valid[3:-3][~outside[3:-3]].all()


@settings(max_examples=25, deadline=None)
@given(
    angle=st.floats(-np.pi, np.pi),
    phase=st.floats(-10, 10),
    slope=st.floats(-0.5, 0.5),
    bend=st.floats(-0.002, 0.002),
    dark=st.booleans(),
    contrast=st.floats(30, 150),
    blur=st.floats(0.7, 2.0),
    seed=st.integers(0, 2**31),
)
def test_a_valid_point_is_never_far_from_the_truth(angle, phase, slope, bend, dark, contrast, blur, seed):
    low, high = (50.0 + contrast, 50.0) if dark else (50.0, 50.0 + contrast)
    scene = Scene(
        lambda s: phase + slope * s + bend * s * s,
        rows=240, columns=240, centre=(120.0, 120.0), angle=angle, low=low, high=high, blur=blur,
    )  # fmt: skip
    lines, truth = scene.lines(7, reach=60.0)
    image = camera(scene.exact(3), 5, np.random.default_rng(seed))
    c = ContourTracker(ContourSettings(polarity=-1 if dark else 1)).track(image, lines)
    assert c.valid.sum() >= 6
    assert (np.abs(c.position_px - truth) < 5 * c.sigma_px + 0.02)[c.valid].all()


@pytest.mark.data
def test_real_high_speed_pixels(data):
    """Vibrating beam, 75 raw frames of 40 x 640: two edges of one black stripe move together."""
    film = np.fromfile(data / "sensing" / "pyidi" / "data_showcase.mraw", np.uint8).reshape(-1, 40, 640)
    x = np.arange(80.0, 561.0, 12.0)
    tracks = []
    for row, polarity in ((18.0, -1), (26.5, 1)):
        count = len(x)
        lines = ConstraintLines(
            np.stack([x, np.full(count, row)], 1), np.tile([0.0, 1.0], (count, 1)), np.full(count, -4.0),
            np.full(count, 4.0), 6.0,
        )  # fmt: skip
        tracker = ContourTracker(ContourSettings(polarity=polarity, plateau_px=2.0, window_px=4))
        found = [tracker.track(frame, lines) for frame in film]
        tracks.append((np.array([c.position_px for c in found]), np.array([c.sigma_px for c in found])))
        assert np.mean([c.valid for c in found]) > 0.9
    (upper, upper_sigma), (lower, lower_sigma) = tracks
    motion = np.median(upper - upper.mean(axis=0), axis=1)
    assert motion.std() > 0.02  # it does vibrate
    # The stripe keeps its width: what is left of the difference is noise.
    width = lower - upper
    left = width - width.mean(axis=0) - (width - width.mean(axis=0)).mean(axis=1, keepdims=True)
    declared = np.sqrt(np.mean(upper_sigma**2 + lower_sigma**2))
    assert left.std() < 0.02
    assert left.std() < 1.5 * declared


@pytest.mark.parametrize(("second", "expected"), [(None, 30.0), (24, 18.0)])
def test_a_point_that_the_chain_left_beside_a_kink_starts_at_the_one_edge(second, expected):
    """Twelve pixels beside its edge a point moves onto it; of two edges in reach neither is chosen."""
    from visuohaptic.tracking.contours._refine_kernels import start_on_edge

    image = np.full((80, 120), 170, np.uint8)
    image[40:] = 90
    if second is not None:
        image[10 + second : 10 + second + 3] = 90
    image = np.ascontiguousarray(image)
    origin = np.column_stack([np.array([30.0, 50.0, 70.0]), np.full(3, 10.0)])
    direction = np.tile([0.0, 1.0], (3, 1))
    found, strength = np.array([10.0, 18.0, 36.0]), np.array([30.0, 0.0, 30.0])
    start_on_edge(
        image, origin, direction, found, strength, np.zeros(3), np.full(3, 60.0), -1, 30.0, 1.0, 20.0
    )
    assert found[1] == pytest.approx(expected, abs=1.0)
    assert found[[0, 2]].tolist() == [10.0, 36.0]
    # Beyond its neighbours there is nothing to find.
    found[:] = (10.0, 12.0, 14.0)
    start_on_edge(
        image, origin, direction, found, strength, np.zeros(3), np.full(3, 60.0), -1, 30.0, 1.0, 20.0
    )
    assert found[1] == 12.0


@pytest.mark.parametrize(
    ("gap_px", "step"), [(3.5, 70.0), (4.0, 70.0), (5.0, -110.0), (8.0, -110.0), (8.0, 70.0), (8.0, -40.0)]
)
def test_an_edge_before_a_narrow_gap_is_where_it_was(gap_px, step):
    """Behind the gap is a body; a single blurred step fits neither edge, and was valid 0.4 to 3.6 px beyond the first one."""
    rng = np.random.default_rng(5)
    near, tracker = Scene(lambda s: 0.2 + 0.01 * s, blur=0.8), ContourTracker()
    body = Scene(lambda s: 0.2 + 0.01 * s + gap_px, blur=0.8, low=0.0, high=step)
    lines, truth = near.lines(19)
    clear = near.exact(4)
    tracker.track(camera(clear, 2.0, rng), lines)
    found = [tracker.track(camera(clear + body.exact(4), 2.0, rng), lines) for _ in range(5)]
    valid = np.array([c.valid for c in found])
    error = (np.array([c.position_px for c in found]) - truth)[valid]
    assert valid.mean() > 0.9
    # 85 errors of 0.01 px, and 0.03 px where the gap has few pixels of its own; ends have few neighbours.
    assert np.abs(np.median(error)) < 0.02
    assert np.sqrt(np.mean((error / np.array([c.sigma_px for c in found])[valid]) ** 2)) < 2.0


def test_motion_blur_is_not_taken_for_two_edges():
    rng = np.random.default_rng(6)
    sharp, soft = (Scene(lambda s: 0.3 + 0.01 * s, blur=blur) for blur in (0.8, 2.4))
    lines, truth = sharp.lines(19)
    tracker, image = ContourTracker(), soft.exact(4)
    tracker.track(camera(sharp.exact(4), 2.0, rng), lines)
    found = tracker.track(camera(image, 2.0, rng), lines)
    assert found.valid.all()
    assert np.median(found.blur_px) == pytest.approx(2.4, rel=0.1)
    assert np.sqrt(np.mean(((found.position_px - truth) / found.sigma_px) ** 2)) < 1.6

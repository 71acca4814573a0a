"""Walls of bricks: a template whose pattern repeats is not followed a period off."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from visuohaptic.tracking.points import apply_homography
from visuohaptic.tracking.templates import EsmTemplate, align
from visuohaptic.tracking.templates.alignment.esm_pyramid import EsmSettings, Work
from visuohaptic.tracking.templates.alignment.esm_template import resemblance
from visuohaptic.tracking.templates.alignment.repeats import _evened, peaks

from ..worlds import views

#: Side of the template, width and height of a brick [px].
SIDE, WIDTH, HEIGHT = 240, 32, 16
PLACE = np.array([[1.0, 0.05, 180.4], [-0.04, 1.02, 110.0], [1e-4, 5e-5, 1.0]])
COVERS = (np.s_[:, :60], np.s_[:, -60:], np.s_[:60], np.s_[-60:])


def wall(differ: float, grain: float, size: tuple[int, int] = (SIDE, SIDE)) -> np.ndarray:
    """Bricks whose grey levels differ, in courses that are displaced by half a brick, with a grain."""
    rng = np.random.default_rng(1)
    image = np.full(size, 150.0)
    for row in range(size[0] // HEIGHT + 1):
        for column in range(-1, size[1] // WIDTH + 1):
            y, x = row * HEIGHT, column * WIDTH + (row % 2) * WIDTH // 2
            image[y + 2 : y + HEIGHT, max(x + 2, 0) : max(x + WIDTH, 0)] = 80 + rng.normal(0, differ)
    image += cv2.GaussianBlur(rng.normal(0, grain, size), (0, 0), 1.2)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.6), 0, 255).astype(np.uint8)


def photo(pattern: np.ndarray, hidden: tuple[slice, slice] | None, rng: np.random.Generator) -> np.ndarray:
    """The print at ``PLACE`` before grey paper, with a grey sheet over a part of it."""
    image = np.full((480, 640), 120, np.uint8)
    if hidden is not None:
        pattern = pattern.copy()
        pattern[hidden] = 140
    cv2.warpPerspective(pattern, PLACE, (640, 480), image, cv2.INTER_CUBIC, cv2.BORDER_TRANSPARENT)
    return np.clip(np.rint(image + rng.normal(0, 2, image.shape)), 0, 255).astype(np.uint8)


def off_px(template: EsmTemplate, homography: np.ndarray) -> float:
    off = apply_homography(homography, template.corners) - apply_homography(PLACE, template.corners)
    return float(np.linalg.norm(off, axis=1).max())


@pytest.mark.parametrize("start", [(WIDTH, 0), (-WIDTH, 0), (WIDTH // 2, HEIGHT), (0, 2 * HEIGHT)])
def test_a_covered_wall_is_not_followed_a_period_off(start: tuple[int, int]) -> None:
    """All of these were valid, at the place of the start."""
    pattern = wall(3.0, 12.0)
    template, rng, right = EsmTemplate.from_image(pattern), np.random.default_rng(5), 0
    for cover in COVERS:
        shift = np.array([[1, 0, start[0]], [0, 1, start[1]], [0, 0, 1.0]])
        found = align(template, photo(pattern, cover, rng), PLACE @ shift)
        assert not found.valid or off_px(template, found.homography) < 2.0
        right += found.valid
    assert right >= 3


def test_natural_bricks_of_different_sizes_are_not_followed_at_a_place_that_is_deformed() -> None:
    """Of these, 5 of 6 were valid 27 to 42 px off, with a homography that bends the joints onto each other."""
    pattern = np.rint(
        cv2.resize(
            views.picture("brick", np.random.default_rng(4)), (SIDE, SIDE), interpolation=cv2.INTER_AREA
        )
    ).astype(np.uint8)
    template, rng, right = EsmTemplate.from_image(pattern), np.random.default_rng(6), 0
    for cover in COVERS[:3]:
        for x, y in ((16, 16), (0, 32)):
            start = PLACE @ np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])
            found = align(template, photo(pattern, cover, rng), start)
            assert not found.valid or off_px(template, found.homography) < 2.0
            right += found.valid
    assert right >= 4


def test_a_wall_that_goes_on_has_no_place() -> None:
    """Equal bricks on all sides: every place a period off is as probable."""
    large = wall(0.0, 0.0, (SIDE + 4 * WIDTH, SIDE + 4 * WIDTH))
    template = EsmTemplate.from_image(large[2 * WIDTH : -2 * WIDTH, 2 * WIDTH : -2 * WIDTH])
    image = np.clip(large + np.random.default_rng(2).normal(0, 2, large.shape), 0, 255).astype(np.uint8)
    start = np.array([[1, 0, 2.0 * WIDTH], [0, 1, 2.0 * WIDTH], [0, 0, 1.0]])
    found = align(template, image, start)
    assert not found.valid
    assert "probability" in found.reason


@pytest.mark.parametrize("differ", [3.0, 10.0])
def test_the_odds_grow_with_what_distinguishes_the_bricks(differ: float) -> None:
    """Bricks that differ by one and a half standard deviations of the noise are enough over a whole wall, without a grain."""
    pattern = wall(differ, 0.0)
    template = EsmTemplate.from_image(pattern)
    found = align(template, photo(pattern, COVERS[0], np.random.default_rng(8)), PLACE)
    assert found.valid
    assert off_px(template, found.homography) < 0.2


def test_only_patterns_that_repeat_are_compared() -> None:
    assert EsmTemplate.from_image(wall(3.0, 12.0)).repeats
    for name, repeats in (("brick", True), ("coins", True), ("astronaut", False), ("gravel", False)):
        part = cv2.resize(
            views.picture(name, np.random.default_rng(0)), (200, 200), interpolation=cv2.INTER_AREA
        )
        assert EsmTemplate.from_image(np.rint(part).astype(np.uint8)).repeats == repeats, name
    tag = cv2.GaussianBlur(
        np.kron(np.random.default_rng(3).integers(0, 2, (8, 8)) * 200, np.ones((20, 20))), (0, 0), 1
    )
    assert not EsmTemplate.from_image(tag.astype(np.uint8), sharp=True).repeats


@pytest.mark.parametrize(("explained", "repeats"), [(0.22, False), (0.28, True)])
def test_a_template_repeats_if_a_quarter_of_its_variance_does(explained: float, repeats: bool) -> None:
    """A grain that repeats every 48 px, and one that does not; the correlation of 20,000 pixels is known to 0.01."""
    rng = np.random.default_rng(1)
    again, once = (cv2.GaussianBlur(rng.normal(0, 1, (n, n)), (0, 0), 0.7) for n in (48, 192))
    again = np.tile(again, (4, 4))
    pattern = np.sqrt(explained) * again / again.std() + np.sqrt(1 - explained) * once / once.std()
    image = np.rint(128 + 20 * pattern).astype(np.uint8)
    assert resemblance([image.astype(np.float32)]) == pytest.approx(explained, abs=0.02)
    assert EsmTemplate.from_image(image).repeats == repeats


@pytest.mark.parametrize(("ranges", "found"), [(1.4, True), (1.7, False)])
def test_other_places_are_searched_half_as_far_again_as_a_fit_may_move(ranges: float, found: bool) -> None:
    pattern, settings = wall(10.0, 12.0), EsmSettings()
    template = EsmTemplate.from_image(pattern)
    image = photo(pattern, None, np.random.default_rng(0))
    for x, y in ((1, 0), (-1, 0), (0, 1)):
        start = np.eye(3)
        start[:2, 2] = ranges * settings.search_px * np.array([x, y])
        work = Work(template, image, start @ PLACE, settings, None)
        ((shift, _),) = peaks(work, 1, work.homography, 1, local=True)
        homography = work.to_image @ work.homography @ shift
        # A pixel of the second level is two of the image, and the shift is in the template's plane.
        assert (off_px(template, homography) < 4.0) == found


def test_contrast_as_low_as_the_noise_of_a_camera_counts_half() -> None:
    """Two grey levels (rms), as in all photos here."""
    noise = 2.0 * np.random.default_rng(2).standard_normal((200, 200))
    assert _evened((100.0 + noise).astype(np.float32), 12).var() == pytest.approx(0.5, abs=0.03)

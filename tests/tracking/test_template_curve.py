"""Prints seen by cameras whose grey levels are proportional to the light, or follow the curve of sRGB."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from visuohaptic.core import Camera, Frame
from visuohaptic.tracking.points import apply_homography
from visuohaptic.tracking.pose import estimate_plane_poses
from visuohaptic.tracking.templates import BLUR_VARIANCES, EsmTemplate, Template, TemplateTracker, align

#: Light that black ink and white paper reflect; samples of a pixel along each axis; side of a module [px].
BLACK, WHITE, SAMPLES = 0.04, 0.8, 6


def srgb(light: np.ndarray) -> np.ndarray:
    """Grey levels by the standard's formula (IEC 61966-2-1)."""
    return 255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def test_the_model_of_the_curve_is_that_of_the_standard() -> None:
    """The grey level of a mixture of black and white, between those of both."""
    half = np.zeros((64, 64), np.float32)
    half[:, 32:] = 255.0
    soft = EsmTemplate.from_image(half, sharp=True).finest(0, len(BLUR_VARIANCES) - 1, 2).image[30]
    share = 0.5 * (1 + erf((np.arange(1, 63) - 31.5) / np.sqrt(2 * BLUR_VARIANCES[-1])))
    expected, ends = (srgb(BLACK + (WHITE - BLACK) * part) for part in (share, np.array([0.0, 1.0])))
    expected = 255.0 * (expected - ends[0]) / (ends[1] - ends[0])
    assert np.abs(soft - expected).max() < 0.02 * 255


def photo(lens_px: float, curve: bool, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A slanted tag 5 on grey paper by means of light over pixels, and its four black corners [px]."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = cv2.aruco.generateImageMarker(family, 5, 8)
    # Modules of 5 mm from the tag's middle to pixels, 0.22 m from a camera of 600 px.
    turn, _ = cv2.Rodrigues(np.array([0.35, -0.25, 0.6]))
    lens = np.array([[600.0, 0, 119.5], [0, 600.0, 119.5], [0, 0, 1.0]])
    place = lens @ np.column_stack([0.005 * turn[:, 0], 0.005 * turn[:, 1], [0.0006, -0.0004, 0.22]])
    place /= place[2, 2]
    v, u = np.mgrid[: 240 * SAMPLES, : 240 * SAMPLES]
    points = (np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5) / SAMPLES - 0.5
    at = apply_homography(np.linalg.inv(place), points) + 4.0
    column, row = np.floor(at).astype(int).T
    inside = (column >= 0) & (column < 8) & (row >= 0) & (row < 8)
    paper = (np.abs(at - 4.0) < 5.2).all(axis=1)
    light = np.where(paper, WHITE, 0.2)
    light[inside] = np.where(cells[row[inside], column[inside]] > 0, WHITE, BLACK)
    light = light.reshape(240, SAMPLES, 240, SAMPLES).mean(axis=(1, 3))
    light = gaussian_filter(light, lens_px)
    grey = srgb(light) if curve else 255.0 * light
    image = np.clip(np.rint(grey + rng.normal(0, 1.5, grey.shape)), 0, 255).astype(np.uint8)
    return image, apply_homography(place, np.array([[-4, -4], [4, -4], [4, 4], [-4, 4.0]]))


@pytest.mark.parametrize("lens_px", [0.5, 0.8, 1.2])
@pytest.mark.parametrize("curve", [False, True])
def test_a_tag_is_where_it_is_whatever_the_curve(lens_px: float, curve: bool) -> None:
    """The lens blurs light, not grey levels: on an sRGB image, bright parts grow by half a pixel, and tags were lost."""
    image, corners = photo(lens_px, curve, np.random.default_rng(1))
    tag = Template.from_tag(5, size_m=0.04)
    start, _ = cv2.findHomography(
        tag.tag_corners, corners + np.array([[1.0, -0.5], [-0.8, 0.6], [0.4, 1.1], [-1.0, 0.2]])
    )
    found = align(tag.esm, image, start)
    assert found.valid, found.reason
    assert found.curve == pytest.approx(float(curve), abs=0.25)
    # Without the curve, corners were 0.3 px off or more, or the tag was lost. Blur is one Gaussian over the tag, whose pixels
    # differ in size: the declared deviation is 0.06 px at a blur of 1.2, and four of them are a quarter of a pixel.
    off = apply_homography(found.homography, tag.tag_corners) - corners
    assert np.abs(off).max() < 0.25


def test_the_tracker_keeps_the_curve_and_forgets_it_when_it_is_lost() -> None:
    rng = np.random.default_rng(3)
    image, corners = photo(0.8, True, rng)
    tag = Template.from_tag(5, size_m=0.04)
    blank = np.full_like(image, 120)
    linear, _ = photo(0.8, False, rng)
    with TemplateTracker([tag], Camera.simple(240, 240, 600.0), threaded=False) as tracker:
        seen = [
            tracker.update(Frame(one, 0.1 * k, k))[0] for k, one in enumerate((image, image, blank, linear))
        ]
    assert [one.valid for one in seen] == [True, True, False, True]
    for one, curve in ((seen[1], 1.0), (seen[3], 0.0)):
        assert one.alignment is not None
        assert one.alignment.curve == pytest.approx(curve, abs=0.25)
        off = apply_homography(one.alignment.homography, tag.tag_corners) - corners
        assert np.abs(off).max() < 0.25


def test_corners_that_fit_no_pose_are_not_valid() -> None:
    """The same picture by a camera that is said to be another: no place of the tag has corners there."""
    image, _ = photo(0.8, True, np.random.default_rng(4))
    tag = Template.from_tag(5, size_m=0.04)
    with TemplateTracker([tag], Camera.simple(240, 240, 600.0), threaded=False) as tracker:
        right = tracker.update(Frame(image, 0.0, 0))[0]
    squeezed = cv2.resize(image, (240, 150), interpolation=cv2.INTER_AREA)
    squeezed = cv2.copyMakeBorder(squeezed, 45, 45, 0, 0, cv2.BORDER_REPLICATE)
    with TemplateTracker([tag], Camera.simple(240, 240, 600.0), threaded=False) as tracker:
        wrong = tracker.update(Frame(squeezed, 0.0, 0))[0]
    assert right.valid
    # The height was reduced to 5 / 8, which no tilt of the tag in this direction explains.
    assert not wrong.valid
    assert "fit no pose" in wrong.detail


def test_corners_about_the_pose_are_two_more_observations_of_their_variance() -> None:
    """A factor of the variance, by its density: known as by two degrees of freedom, and the scatter has two more."""
    image, _ = photo(0.8, True, np.random.default_rng(4))
    tag = Template.from_tag(5, size_m=0.04)
    camera = Camera.simple(240, 240, 595.0)  # the photo has 600 px, so that the corners fit badly
    with TemplateTracker([tag], camera, threaded=False) as tracker:
        seen = tracker.update(Frame(image, 0.0, 0))[0]
    assert seen.alignment is not None
    corners, covariance = seen.alignment.corners, seen.alignment.corner_covariance
    alone = estimate_plane_poses(camera, tag.points_m(tag.esm.corners), corners, covariance)[0]
    assert alone.chi2 == pytest.approx(seen.chi2, rel=1e-3)
    assert abs(seen.chi2 - 2.0) > 1.0  # else, the number of degrees of freedom would have no effect
    inverse = np.linspace(0, 20, 200_001)
    density = np.exp(-inverse) * inverse * np.exp(-0.5 * seen.chi2 * inverse)
    factor = density.sum() / (density @ inverse)
    np.testing.assert_allclose(np.diag(seen.covariance), factor * np.diag(alone.covariance), rtol=0.01)

"""Blur and size of the image against those of the template."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from visuohaptic.tracking.points import apply_homography
from visuohaptic.tracking.templates import (
    BLUR_VARIANCES,
    EsmSettings,
    EsmTemplate,
    Template,
    Work,
    align,
    detect_templates,
    matching_blur,
)


@pytest.fixture(scope="module")
def view(views):
    return views.PlaneView.named("astronaut", 160)


def place(view, scale: float) -> np.ndarray:
    return np.array([[scale, 0.01, 40.3], [-0.01, scale, 41.7], [0, 0, 1.0]])


@pytest.mark.parametrize("variance", [0.0, 0.5, 1.2, 3.0])
def test_the_blur_is_found(view, variance):
    template = EsmTemplate.from_image(view.template)
    true = place(view, 1.0)
    clean = gaussian_filter(view.continuous(true, (240, 240)), np.sqrt(variance))
    rng = np.random.default_rng(1)
    image = np.clip(np.round(clean + rng.normal(0, 3, clean.shape)), 0, 255).astype(np.uint8)
    found = align(template, image, true)
    blur = matching_blur(template, image, found)
    # The next one on the ladder is as near as it gets.
    steps = np.array(BLUR_VARIANCES)
    nearest = int(np.argmin(np.abs(steps - variance)))
    assert abs(int(np.argmin(np.abs(steps - blur))) - nearest) <= 1


def test_a_softer_image_declares_what_it_scatters_by(view):
    """A sharper template promises gradients that the image does not have; what it leaves is measured, too."""
    template = EsmTemplate.from_image(view.template)
    true = place(view, 1.0)
    clean = gaussian_filter(view.continuous(true, (240, 240)), 1.7)
    rng = np.random.default_rng(2)
    sharp, matched = [], []
    blur, declared = 0.0, ([], [])
    for k in range(60):
        image = np.clip(np.round(clean + rng.normal(0, 5, clean.shape)), 0, 255).astype(np.uint8)
        if k == 0:
            blur = matching_blur(template, image, align(template, image, true))
        for which, errors in ((0, sharp), (1, matched)):
            found = align(template, image, true, blur=blur if which else 0.0)
            errors.append(found.corners - apply_homography(true, template.corners))
            declared[which].append(np.trace(found.corner_covariance))
    scatter = [np.sqrt(np.var(errors, axis=0, ddof=1).sum()) for errors in (sharp, matched)]
    ratio = [np.sqrt(np.mean(declared[which])) / scatter[which] for which in (0, 1)]
    # 60 draws of 8 coordinates, strongly correlated: 6 % at one sigma.
    assert ratio == pytest.approx([1.0, 1.0], abs=0.18)


@pytest.mark.parametrize("scale", [0.2, 0.35, 0.5, 0.62, 0.71, 0.9, 1.0, 1.1])
def test_no_chain_is_much_coarser_or_finer_than_the_image(view, scale):
    template = EsmTemplate.from_image(view.template)
    work = Work(template, np.zeros((240, 240), np.uint8), place(view, scale), EsmSettings(), None)
    # Below 1 / sqrt(2) by the rounding to whole pixels; there is nothing finer than the template.
    assert 1 / np.sqrt(2) - 0.03 < work.relative <= max(1.02, scale + 0.01)


def test_variances_of_chains_agree(view):
    template = EsmTemplate.from_image(view.template)
    for chain in (0, 1, 2):
        for blur in (0, 4, 9):
            assert template.blur_index(chain, template.variance(chain, blur)) == blur
    # The same softness seen through another chain stays nearly the same softness.
    one, two = (template.variance(chain, template.blur_index(chain, 2.5)) for chain in (0, 1))
    assert one == pytest.approx(2.5, rel=0.2)
    assert two == pytest.approx(2.5, rel=0.2)


def test_what_was_lost_is_found_by_correlation_first(view):
    rng = np.random.default_rng(3)
    template = Template.from_image("photo", view.template, width_m=0.04)
    frame = rng.integers(90, 150, (480, 640)).astype(np.uint8)
    frame[200:360, 300:460] = view.template
    before = np.array([[1, 0, 210.0], [0, 1, 230.0], [0, 0, 1]])
    found = detect_templates((template,), frame, region=(100, 100, 600, 470), last_seen={"photo": before})
    assert found["photo"].support == 0
    assert apply_homography(found["photo"].homography, np.zeros((1, 2)))[0] == pytest.approx(
        [300, 200], abs=0.2
    )
    # Without it, or where it has turned too far, the features find it.
    assert detect_templates((template,), frame, region=(100, 100, 600, 470))["photo"].support >= 8
    turned = frame.copy()
    turned[200:360, 300:460] = np.rot90(view.template)
    found = detect_templates((template,), turned, region=(100, 100, 600, 470), last_seen={"photo": before})
    assert found["photo"].support >= 8


def test_another_tag_is_not_taken_for_the_lost_one():
    lost, other = (Template.from_tag(number, size_m=0.04) for number in (5, 6))
    frame = np.full((480, 640), 150, np.uint8)
    frame[60:420, 150:510] = other.image
    before = {lost.name: np.array([[1, 0, 120.0], [0, 1, 60.0], [0, 0, 1]])}
    assert detect_templates((lost,), frame, region=(0, 0, 640, 480), last_seen=before) == {}

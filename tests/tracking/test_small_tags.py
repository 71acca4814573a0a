"""Small and blurred tags: found at least as often as by OpenCV's detector with its own settings."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from visuohaptic.core.camera import Camera, Frame
from visuohaptic.tracking.templates import Template, TemplateTracker, detect_templates, template_tracker
from visuohaptic.tracking.templates.template import tag_image

#: Samples of a pixel along each axis, and the image's width and height [px].
SAMPLES, SIZE = 4, (320, 240)


def photo(size_px: float, blur_px: float, rng: np.random.Generator) -> tuple[np.ndarray, int, np.ndarray]:
    """A tag with a border of ``size_px`` turned in its plane, moved during the exposure; its number and corners."""
    number, cell = int(rng.integers(0, 587)), 16
    light = 0.04 + 0.86 * np.pad(tag_image(number, cell, cell) / 255.0, 40, constant_values=0.5)
    turn, middle = rng.uniform(0, 2 * np.pi), np.array(SIZE) / 2 + rng.uniform(-40, 40, 2)
    scale = size_px / (8 * cell)
    rotation = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    centre = (len(light) - 1) / 2
    half = 4 * cell
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]]) @ rotation.T + middle
    motion = blur_px * np.array([np.cos(turn + 0.7), np.sin(turn + 0.7)])
    total = np.zeros((SIZE[1] * SAMPLES, SIZE[0] * SAMPLES))
    fractions = np.linspace(-0.5, 0.5, 9) if blur_px else np.zeros(1)
    soft = cv2.GaussianBlur(light, (0, 0), 0.35 / (scale * SAMPLES))
    for fraction in fractions:
        place = np.column_stack([rotation, middle + fraction * motion - rotation @ [centre, centre]])
        fine = SAMPLES * place + [[0, 0, SAMPLES / 2 - 0.5]] * 2
        total += cv2.warpAffine(soft, fine, total.shape[::-1], borderValue=0.5)
    seen = cv2.resize(total / len(fractions), SIZE, interpolation=cv2.INTER_AREA)
    grey = 200 * np.clip(cv2.GaussianBlur(seen, (0, 0), 0.6), 0, 1) ** (1 / 2.2)
    return np.clip(np.rint(grey + rng.normal(0, 2, grey.shape)), 0, 255).astype(np.uint8), number, corners


@pytest.mark.parametrize(("size_px", "blur_px", "least"), [(13, 0, 6), (17, 0, 8), (20, 3, 6), (26, 3, 9)])
def test_small_and_blurred_tags_are_found(size_px: float, blur_px: float, least: int) -> None:
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    peer, found, theirs = cv2.aruco.ArucoDetector(family, cv2.aruco.DetectorParameters()), 0, 0
    for seed in range(10):
        image, number, corners = photo(size_px, blur_px, np.random.default_rng([seed, size_px]))
        tag = Template.from_tag(number, size_m=0.04)
        detection = detect_templates((tag,), image).get(tag.name)
        ids = peer.detectMarkers(image)[1]
        theirs += ids is not None and number in ids
        if detection is not None:
            found += 1
            seen = np.column_stack([tag.tag_corners, np.ones(4)]) @ detection.homography.T
            off = np.linalg.norm(seen[:, :2] / seen[:, 2:] - corners, axis=1).max()
            # About a pixel, as documented: a corner of two cells of two pixels is itself as wide.
            assert off < 2.0 + 0.25 * blur_px
    assert found >= max(least, theirs)


@pytest.mark.parametrize("confirmed", [True, False])
def test_a_place_that_the_better_blur_does_not_confirm_is_not_valid(monkeypatch, confirmed: bool) -> None:
    """The sharp edges of a template fit one side of smeared ones, 2 to 3 px off; the softer one, which fits better, is not there."""
    image, number, corners = photo(110, 3, np.random.default_rng(0))
    align, asked = template_tracker.align, []

    def judged(*args, blur, **others):
        asked.append(blur)
        found = align(*args, blur=blur, **others)
        return found if blur is None or confirmed else replace(found, valid=False, reason="no convergence")

    monkeypatch.setattr(template_tracker, "align", judged)
    tag, camera = Template.from_tag(number, size_m=0.04), Camera.simple(*SIZE, focal_px=600.0)
    with TemplateTracker([tag], camera, threaded=False) as tracker:
        (pose,) = tracker.update(Frame(image, 0.0, 0))
    assert asked[0] is None
    assert max(asked[1:]) > 0.0
    assert pose.valid == confirmed
    if confirmed:
        seen = np.column_stack([tag.tag_corners, np.ones(4)]) @ pose.alignment.homography.T
        off = seen[:, :2] / seen[:, 2:] - corners
        assert np.abs(off).max() < 4.0 * pose.alignment.corner_sigma_px
    else:
        assert pose.detail == "no convergence"


def test_another_tag_is_not_taken_for_it() -> None:
    """The code has a distance of eleven bits; up to five are corrected."""
    image, number, _ = photo(40, 0, np.random.default_rng(3))
    others = tuple(Template.from_tag(k, size_m=0.04) for k in range(0, 587, 37) if k != number)
    assert detect_templates(others, image) == {}

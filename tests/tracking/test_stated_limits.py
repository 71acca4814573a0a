"""What the constants of the trackers are said to be, computed by other means."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from visuohaptic.simulation.rendering import _finger_tag
from visuohaptic.tracking.contours import stripe
from visuohaptic.tracking.contours.contour import PIXEL_PX
from visuohaptic.tracking.templates import _template_file, sheet, template
from visuohaptic.tracking.templates.alignment import esm_template


def test_tags_are_those_of_the_family_36h11() -> None:
    """OpenCV has the codes without the black border."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    assert len(family.bytesList) == _template_file._TAG_COUNT
    assert family.markerSize + 2 == template.TAG_CELLS == _finger_tag.CELLS


def test_papers_have_their_standard_sizes() -> None:
    """ISO 216: an area of a power of one half of a square metre, sides in the ratio of the square root of 2, in millimetres."""
    for name, halved in (("A4", 4), ("A3", 3)):
        area, ratio = 2.0**-halved, np.sqrt(2.0)
        assert sheet.PAPERS_M[name] == pytest.approx((np.sqrt(area / ratio), np.sqrt(area * ratio)), abs=6e-4)
    assert sheet.PAPERS_M["letter"] == pytest.approx((8.5 * sheet._INCH_M, 11.0 * sheet._INCH_M))
    assert pytest.approx(0.3048) == 12 * sheet._INCH_M


def test_a_pixel_is_a_box() -> None:
    place = (np.arange(1000) + 0.5) / 1000 - 0.5
    assert pytest.approx(place.std(), rel=1e-5) == PIXEL_PX


def test_colours_of_a_stripe_fill_their_table() -> None:
    assert stripe.CELLS * stripe.CELL == 256


def test_curve_one_is_that_of_srgb() -> None:
    """IEC 61966-2-1, within a hundredth of white in the light of each grey level."""
    grey = np.linspace(0.0, 1.0, 256)
    light = np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4)
    assert np.abs(grey ** (1.0 / esm_template._EXPONENT) - light).max() < 0.01

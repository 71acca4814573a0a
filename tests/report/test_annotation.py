"""Overlays on a frame are at the right positions."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError, Primitive, PrimitiveKind
from visuohaptic.report import FrameNotes, annotated_frame, gradient_image, primitive_outline
from visuohaptic.report.annotation import FRONT_BGR, REFERENCE_BGR


@pytest.fixture
def edge():
    """Grey 50 above row 60, grey 200 below."""
    image = np.full((120, 160), 50, np.uint8)
    image[60:] = 200
    return image


def test_the_gradient_is_on_the_edge(edge):
    strength = gradient_image(edge)
    assert set(np.argmax(strength[:, 10:-10], axis=0)) <= {59, 60}
    assert strength[:50].max() == 0


def test_the_split_leaves_the_upper_half_as_it_was(edge):
    picture = annotated_frame(edge, FrameNotes(), split_row=90)
    np.testing.assert_array_equal(picture[:90], np.repeat(edge[:90, :, None], 3, axis=2))
    assert picture[95:].max() == 0  # no gradient there


def test_the_frame_itself_is_not_changed(edge):
    colour = np.repeat(edge[:, :, None], 3, axis=2)
    before = colour.copy()
    annotated_frame(colour, FrameNotes(front_px=np.array([[0, 10], [150, 10.0]]), lines=["text"]))
    np.testing.assert_array_equal(colour, before)


def test_contours_are_drawn_at_their_pixels(edge):
    notes = FrameNotes(
        reference_px=np.array([[10, 100], [150, 100.0]]),
        front_px=np.array([[10, 20], [np.nan, 20], [80, 20], [150, 20]]),
    )
    picture = annotated_frame(edge, notes, split=False)
    # Anti-aliasing leaves up to a tenth of the background in the middle of a thin line.
    np.testing.assert_allclose(picture[100, 70], REFERENCE_BGR, atol=20)
    np.testing.assert_allclose(picture[20, 120], FRONT_BGR, atol=20)
    assert tuple(picture[20, 45]) == (50, 50, 50)  # interrupted where a point is missing


def test_far_and_missing_points_do_no_harm(edge):
    wild = np.array([[np.inf, 0], [1e300, 5], [-1e9, 3], [np.nan, np.nan]])
    annotated_frame(edge, FrameNotes(wild, wild, np.zeros(4, bool), [wild], [wild], ["± µm"]))


@pytest.mark.parametrize(
    ("kind", "parameters", "distance"),
    [
        (PrimitiveKind.CIRCLE, [1, 2, 0.5], lambda x, y: np.hypot(x - 1, y - 2) - 0.5),
        (PrimitiveKind.LINE, [1, 2, np.pi / 4], lambda x, y: (x - 1) - (y - 2)),
        (PrimitiveKind.SEGMENT, [0, 0, 2, 1], lambda x, y: x - 2 * y),
        (PrimitiveKind.CORNER, [1, 2, 0, np.pi / 2], lambda x, y: (x - 1) * (y - 2)),
    ],
)
def test_outlines_satisfy_their_equation(kind, parameters, distance):
    values = np.array(parameters, dtype=float)
    outline = primitive_outline(Primitive(kind, values, np.eye(len(values)), 1.0))
    np.testing.assert_allclose(distance(*outline.T), 0, atol=1e-12)


def test_validities_of_other_points_are_refused(edge):
    notes = FrameNotes(front_px=np.full((3, 2), 5.0), front_valid=np.ones(2, bool))
    with pytest.raises(InputError, match="FrameNotes: front_valid: found 2, expected 3"):
        annotated_frame(edge, notes)

"""Readable tags: rounded to their uncertainty, "not observed" distinguished from zero."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import Estimate, HapticTag, Primitive, PrimitiveKind
from visuohaptic.report import estimate_text, primitive_text, tag_text


@pytest.mark.parametrize(
    ("estimate", "text"),
    [
        (None, None),
        (Estimate(3.2123, 0.04), "3.21 ± 0.04"),
        (Estimate(3.2123, 0.12), "3.21 ± 0.12"),
        (Estimate(312.3, 40.0), "312 ± 40"),
        # From 3 on one digit, below it two; what is rounded up to 3 or 10 counts as that.
        (Estimate(3.2123, 0.3), "3.2 ± 0.3"),
        (Estimate(3.2123, 0.29), "3.21 ± 0.29"),
        (Estimate(3.2123, 0.298), "3.2 ± 0.3"),
        (Estimate(3.2123, 0.0998), "3.21 ± 0.10"),
        (Estimate(3.2123, 2.1), "3.2 ± 2.1"),
        (Estimate(0.0, 0.0), "0.000 ± 0.000"),
        (Estimate(3.2123, 0.04, spread=0.613), "3.21 ± 0.04 (spread 0.61)"),
    ],
)
def test_digits_follow_sigma(estimate, text):
    assert estimate_text(estimate) == text


@pytest.mark.parametrize(
    ("kind", "parameters", "text"),
    [
        (PrimitiveKind.CIRCLE, [0, 0, 0.0601], "circle, radius 60.1 ± 1.0 mm"),
        (PrimitiveKind.SEGMENT, [0, 0, 0.03, 0.04], "segment, 50.0 mm long"),
        (PrimitiveKind.CORNER, [0, 0, np.radians(170), np.radians(-100)], "corner of 90°"),
        (PrimitiveKind.LINE, [0, 0, np.pi / 2], "line, 90°"),
    ],
)
def test_primitives_have_a_size(kind, parameters, text):
    values = np.array(parameters, dtype=float)
    assert primitive_text(Primitive(kind, values, 1e-6 * np.eye(len(values)), 0.9)) == text


def test_the_short_text_of_a_tag():
    assert tag_text(HapticTag(fixed=True)) == "fixed"
    assert tag_text(HapticTag()) == "nothing observed"
    assert tag_text(HapticTag(fixed=False, falls=True)) == "movable, topples"

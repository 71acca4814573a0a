"""Footprints of touched objects after a push, for known shapes."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import BaseState, HapticTag, Primitive, PrimitiveKind
from visuohaptic.tasks.mobile import footprint_after_push

#: Of each place ten points.
SEEN = np.repeat([[2.0, 1.0], [2.02, 1.1], [2.01, 1.2]], 10, axis=0)


def found(shape: Primitive | None, heading_rad: float = 0.0) -> Any:
    state = BaseState(0.0, 1.0, 1.0, heading_rad, 0.0, 0.0)
    return SimpleNamespace(fit_state=state, tag=HapticTag(primitive=shape))


def test_a_circle_lies_ahead_of_the_foam() -> None:
    circle = Primitive(PrimitiveKind.CIRCLE, np.array([0.1, 0.0, 0.08]), np.eye(3), 1.0)
    outline = footprint_after_push(found(circle, 0.5 * math.pi), SEEN, front_m=0.17)
    centre = outline.mean(axis=0)
    # Heading north: 17 cm to the foam and 10 cm to the centre.
    assert centre == pytest.approx([1.0, 1.27], abs=1e-9)
    assert np.hypot(*(outline - centre).T) == pytest.approx(0.08)


def test_a_face_is_as_deep_as_it_is_wide_and_away_from_the_platform() -> None:
    segment = Primitive(PrimitiveKind.SEGMENT, np.array([0.02, -0.1, 0.02, 0.1]), np.eye(4), 1.0)
    outline = footprint_after_push(found(segment), SEEN, front_m=0.17)
    assert outline.min(axis=0) == pytest.approx([1.19, 0.9])
    assert outline.max(axis=0) == pytest.approx([1.39, 1.1])


def test_without_a_shape_what_was_seen_is_moved_on() -> None:
    outline = footprint_after_push(found(None), SEEN, front_m=1.1)
    # The foam stands at x = 2.1, 10 cm behind where the face was seen.
    assert outline.min(axis=0) == pytest.approx([2.1, 1.0])
    assert outline.max(axis=0) == pytest.approx([2.3, 1.2])


def test_a_stray_point_does_not_widen_what_was_seen() -> None:
    rng = np.random.default_rng(0)
    face = np.column_stack([np.full(300, 2.0), rng.uniform(1.0, 1.16, 300)]) + 0.01 * rng.standard_normal(
        (300, 2)
    )
    outline = footprint_after_push(found(None), np.vstack([face, [2.0, 1.25]]), front_m=1.1)
    # The outermost of these points are 3 cm outside of either end, and the stray one 9 cm.
    assert np.ptp(outline[:, 1]) == pytest.approx(0.16, abs=0.015)

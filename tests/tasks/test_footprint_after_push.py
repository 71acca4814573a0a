"""Outlines of touched objects after a push, for known shapes."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import BaseState, HapticTag, Primitive, PrimitiveKind
from visuohaptic.tasks.mobile import FloorOutline, footprint_after_push

#: A box of 20 cm by 12 cm by the laser, its near side at x = 2.
SEEN = FloorOutline(False, (2.0, 1.1, 0.0), (0.2, 0.12), (0.006, 0.008))


def found(shape: Primitive | None, heading_rad: float = 0.0) -> Any:
    state = BaseState(0.0, 1.0, 1.0, heading_rad, 0.0, 0.0)
    return SimpleNamespace(fit_state=state, tag=HapticTag(primitive=shape))


def test_a_circle_lies_ahead_of_the_foam() -> None:
    circle = Primitive(PrimitiveKind.CIRCLE, np.array([0.1, 0.0, 0.08]), np.diag([1.0, 1.0, 4e-6]), 1.0)
    outline = footprint_after_push(found(circle, 0.5 * math.pi), SEEN, front_m=0.17)
    # Heading north: 17 cm to the foam and 10 cm to the centre.
    assert outline.centre_m == pytest.approx([1.0, 1.27], abs=1e-9)
    assert np.hypot(*(outline.corners_m - outline.centre_m).T) == pytest.approx(0.08)
    assert outline.sigma_m == pytest.approx((4e-3, 4e-3))


def test_a_face_is_as_deep_as_by_the_laser_and_away_from_the_platform() -> None:
    segment = Primitive(
        PrimitiveKind.SEGMENT, np.array([0.02, -0.1, 0.02, 0.1]), np.diag([1.0, 4.0, 1.0, 9.0]) * 1e-6, 1.0
    )
    outline = footprint_after_push(found(segment), SEEN, front_m=0.17)
    assert outline.corners_m.min(axis=0) == pytest.approx([1.19, 0.9])
    assert outline.corners_m.max(axis=0) == pytest.approx([1.31, 1.1])
    assert outline.sigma_m == pytest.approx((np.sqrt(13e-6), 0.008))


@pytest.mark.parametrize("turned_deg", [-30.0, 20.0])
@pytest.mark.parametrize("swapped", [False, True])
def test_a_face_that_is_touched_obliquely_keeps_its_heading(turned_deg: float, swapped: bool) -> None:
    along = 0.1 * np.array([-math.sin(math.radians(turned_deg)), math.cos(math.radians(turned_deg))])
    ends = [-along, along][:: -1 if swapped else 1]
    segment = Primitive(PrimitiveKind.SEGMENT, np.concatenate(ends) + (0.02, 0.0) * 2, np.eye(4) * 1e-6, 1.0)
    outline = footprint_after_push(found(segment), SEEN, front_m=0.17)
    assert math.degrees(outline.pose[2]) == pytest.approx(turned_deg)
    assert outline.pose[:2] == pytest.approx((1.19, 1.0))


def test_without_a_shape_what_was_seen_is_moved_on() -> None:
    # Of a corner neither end is known.
    corner = Primitive(PrimitiveKind.CORNER, np.array([0.1, 0.0, -1.5, 0.5]), np.eye(4) * 1e-6, 1.0)
    for shape in (None, corner):
        outline = footprint_after_push(found(shape), SEEN, front_m=1.1)
        # The foam stands at x = 2.1, 10 cm behind where the face was seen.
        assert outline.corners_m.min(axis=0) == pytest.approx([2.1, 1.0])
        assert outline.corners_m.max(axis=0) == pytest.approx([2.22, 1.2])
        assert outline.sigma_m == SEEN.sigma_m

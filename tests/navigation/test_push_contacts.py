"""Contacts on outlines whose stable pushes are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import MultiPoint, Point, Polygon

from visuohaptic.core.geometry import polygon_centroid
from visuohaptic.navigation.pushing import push_contacts
from visuohaptic.navigation.pushing.contact_candidates import STABLE_RAD

from .plan_scenes import box


def angles(pushes):
    return np.rad2deg([np.arctan2(push.direction[1], push.direction[0]) for push in pushes])


def test_a_box_has_its_four_faces_and_none_of_its_corners():
    pushes = push_contacts(box(0, 0, 2.0, 1.0), np.zeros(2), 0.5)
    assert np.allclose(sorted(angles(pushes) % 360), [0, 90, 180, 270], atol=1e-6)
    for push in pushes:
        assert np.hypot(*(push.robot - push.contact)) == pytest.approx(0.5, abs=1e-6)


def test_a_disc_is_pushed_from_everywhere():
    angle = np.arange(48) * 2 * np.pi / 48
    pushes = push_contacts(np.column_stack([np.cos(angle), np.sin(angle)]), np.zeros(2), 0.5)
    assert len(pushes) >= 16


def test_a_flat_triangle_has_no_push_where_the_foot_of_the_centre_is_off_the_face():
    outline = np.array([[0.0, 0.0], [4.0, 0.0], [4.6, 0.5]])
    centre = outline.mean(axis=0)
    for push in push_contacts(outline, centre, 0.3):
        # What it pushes against is a face, and the line of the push meets it.
        assert Polygon(outline - centre).exterior.distance(Point(*push.contact)) < 1e-6


def test_slanting_pushes_come_on_top():
    straight = push_contacts(box(0, 0, 1.0), np.zeros(2), 0.3)
    more = push_contacts(box(0, 0, 1.0), np.zeros(2), 0.3, oblique=True)
    assert not any(push.oblique for push in straight)
    assert sum(not push.oblique for push in more) == len(straight)
    assert sum(push.oblique for push in more) == 16  # two angles to two sides of four faces


def test_slanting_pushes_meet_no_corner():
    """There the contact slides off the face: steered, objects turned away by 29 deg."""
    found = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        outline = np.array(MultiPoint(rng.uniform(-0.2, 0.2, (6, 2))).convex_hull.exterior.coords)[:-1]
        centre = np.asarray(polygon_centroid(outline))
        for push in push_contacts(outline, centre, 0.17, oblique=True):
            if push.oblique:
                place, faces = (
                    push.contact + centre,
                    np.stack([outline, np.roll(outline, -1, axis=0)], axis=1),
                )
                ends = np.hypot(*(faces - place).transpose(2, 0, 1))
                lengths = np.hypot(*(faces[:, 1] - faces[:, 0]).T)
                own = int((ends.sum(axis=1) - lengths).argmin())
                assert ends[own].min() > 1e-7
                found += 1
    assert found > 40


def test_perpendicular_pushes_keep_off_sharp_corners():
    """The line through the centroid of an L passes the corner of its leg: steered, the object turned away by 29 deg."""
    ell = np.array(
        [
            [0.177, -0.166],
            [0.149, 0.273],
            [-0.039, 0.261],
            [-0.023, 0.011],
            [-0.253, -0.004],
            [-0.241, -0.193],
        ]
    )
    ell = ell - polygon_centroid(ell)
    pushes = push_contacts(ell, np.zeros(2), 0.17)
    assert len(pushes) == 4
    assert min(np.hypot(*(ell - push.contact).T).min() for push in pushes) > 0.015
    angle = np.arange(16) * 2 * np.pi / 16  # corners of a drawn disc are not sharp
    assert len(push_contacts(0.2 * np.column_stack([np.cos(angle), np.sin(angle)]), np.zeros(2), 0.17)) == 16


@settings(max_examples=40, deadline=None)
@given(
    width=st.floats(0.3, 4.0),
    depth=st.floats(0.3, 4.0),
    turn=st.floats(0, 3.14),
    radius=st.floats(0.1, 2.0),
)
def test_the_disc_touches_and_the_push_goes_through_the_centre(width, depth, turn, radius):
    outline = box(0, 0, width, depth, turn)
    body = Polygon(outline)
    pushes = push_contacts(outline, np.zeros(2), radius)
    assert len(pushes) == 4
    for push in pushes:
        assert body.distance(Point(*push.robot)) == pytest.approx(radius, abs=1e-6)
        assert body.exterior.distance(Point(*push.contact)) < 1e-6
        cross = push.robot[0] * push.direction[1] - push.robot[1] * push.direction[0]
        assert abs(cross) < 1e-9
        assert push.robot @ push.direction < 0


def test_a_concavity_is_pushed_where_the_disc_touches_both_sides():
    ell = np.array([[0.0, 0.0], [0.42, 0.0], [0.42, 0.2], [0.2, 0.2], [0.2, 0.38], [0.0, 0.38]])
    centre = polygon_centroid(ell)
    pushes = push_contacts(ell, centre, 0.17, oblique=True)
    seat = np.array([0.37, 0.37]) - centre  # touches both inner faces
    (seated,) = (push for push in pushes if np.hypot(*(push.robot - seat)) < 1e-3)
    assert not seated.oblique
    # At a single corner of a concavity the object would turn until the other side touches.
    outside = [push for push in pushes if push is not seated and not push.oblique]
    normals = [(push.contact - push.robot) / 0.17 for push in outside]
    # Of a face, up to the tolerance of a perpendicular push.
    assert all(min(abs(normal)) < np.sin(STABLE_RAD) for normal in normals)

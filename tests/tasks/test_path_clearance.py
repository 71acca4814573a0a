"""Clearance of a moving tool, compared with analytic geometry; a supervised arm rejects paths without clearance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.tasks import example_robot as right

from visuohaptic.core import DeviceError, InputError
from visuohaptic.core.camera import Pose
from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.tasks.framework import Capsule, KnownObstacles, Supervisor

RESOLUTION_M = 0.002


def at(*place_m: float, turn_rad: float = 0.0) -> Pose:
    return Pose.from_rotation_vector([0.0, turn_rad, 0.0], np.array(place_m))


def square(side_m: float = 0.4, height_m: float = 0.0) -> SurfaceMesh:
    a = 0.5 * side_m
    corners = np.array([[-a, -a, height_m], [a, -a, height_m], [a, a, height_m], [-a, a, height_m]])
    return SurfaceMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def ball(radius_m: float) -> SurfaceMesh:
    """Rings of 2 mm: a chord of it is 0.02 mm inside of the sphere."""
    count = math.ceil(math.pi * radius_m / 0.002)
    theta, phi = np.meshgrid(
        np.linspace(0, math.pi, count), np.linspace(0, 2 * math.pi, 2 * count), indexing="ij"
    )
    points = radius_m * np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1
    )
    k = np.arange(points[..., 0].size).reshape(theta.shape)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    return SurfaceMesh(
        points.reshape(-1, 3), np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    )


BALL = ball(0.03)


@settings(max_examples=30, deadline=None)
@given(
    st.floats(-0.05, 0.05),
    st.floats(0.06, 0.12),
    st.floats(0.0, 0.06),
    st.floats(0.004, 0.02),
    st.floats(-1.2, 1.2),
)
def test_a_rod_past_a_ball(x: float, z: float, length: float, radius: float, lean: float) -> None:
    """A capsule that is moved along y: the distance of its swept stadium from the centre, less both radii."""
    tip = np.array([math.sin(lean), 0.0, math.cos(lean)]) * length
    known = KnownObstacles(
        (Capsule((0.0, 0.0, 0.0), (float(tip[0]), 0.0, float(tip[2])), radius),), [BALL], keep_m=0.001
    )
    found = known.along(at(x, -0.1, z), at(x, 0.1, z))
    # In the plane y = 0, which the axis crosses: from the origin to the segment.
    start, way = np.array([x, z]), np.array([tip[0], tip[2]])
    part = float(np.clip(-start @ way / max(float(way @ way), 1e-12), 0.0, 1.0))
    true = float(np.linalg.norm(start + part * way)) - radius - 0.03
    if true > 0.001 + 2 * RESOLUTION_M:
        assert found.free
        # Never more than the truth, but for the chord; less by the resolution.
        assert true - 1.01 * RESOLUTION_M <= found.clearance_m <= true + 1e-4
    if true < 0.0:
        assert not found.free
        assert found.fraction < 0.55


def test_a_turning_rod_meets_a_point_at_its_angle() -> None:
    """30 cm along x, turned about y: a point 20 cm away and 40 degrees below is met there, less its radius."""
    angle = math.radians(40.0)
    point = 0.2 * np.array([math.cos(angle), 0.0, -math.sin(angle)])
    rod = Capsule((0.0, 0.0, 0.0), (0.3, 0.0, 0.0), 0.005)
    known = KnownObstacles((rod,), [point[None]], keep_m=0.002)
    found = known.along(at(0, 0, 0), at(0, 0, 0, turn_rad=math.radians(80.0)))
    assert not found.free
    # The tool keeps 2 mm: it is called off when 7 mm, and the resolution, are left across 20 cm.
    reached = math.radians(80.0) * found.fraction
    assert angle - math.asin(0.013 / 0.2) < reached <= angle - math.asin(0.007 / 0.2)
    assert found.point_m == pytest.approx(tuple(point))
    assert known.along(at(0, 0, 0), at(0, 0, 0, turn_rad=math.radians(-170.0))).free


def test_what_it_stands_at_may_be_left() -> None:
    known = KnownObstacles((Capsule((0, 0, 0), (0, 0, 0.1), 0.01),), [square()])
    assert known.along(at(0, 0, 0.01), at(0, 0, 0.2)).free
    assert not known.along(at(0, 0, 0.2), at(0, 0, 0.01)).free
    assert not known.along(at(0, 0, 0.012), at(0.1, 0, 0.001)).free
    assert KnownObstacles((Capsule((0, 0, 0), (0, 0, 0), 0.01),), []).along(at(0, 0, 0), at(1, 0, 0)).free
    with pytest.raises(InputError):
        KnownObstacles((), [square()])


def test_an_arm_does_not_run_into_what_was_fused() -> None:
    """Across at 10 cm over a table with a box of 20 cm on it; above the box it may pass, slowly it may touch."""
    arm = right.Arm()
    box = square(0.1, 0.2)
    box = SurfaceMesh(np.add(box.vertices_m, (0.45, 0.2, 0.0)), box.faces)
    known = KnownObstacles((Capsule((0, 0, 0), (0, 0, 0.15), 0.01),), [box])
    with Supervisor(clock=lambda: arm.t_s) as guard:
        watched = guard.arm(arm, known)
        watched.pose()
        arm.at = np.array([0.4, 0.0, 0.1])
        with pytest.raises(
            DeviceError, match=r"the tool comes within -?\d+ mm from \(0\.\d+, 0\.\d+, 0\.200\) m after"
        ):
            watched.move_linear(at(0.45, 0.3, 0.1), 0.15)
        assert arm.goal is None
        watched.move_linear(at(0.45, 0.3, 0.1), 0.04)
        assert arm.goal is not None
        watched.stop()
        arm.at = np.array([0.4, 0.0, 0.25])
        watched.move_linear(at(0.45, 0.3, 0.25), 0.15)
        assert arm.goal is not None


def test_the_way_that_was_felt_may_be_gone_back_fast() -> None:
    """A wall was seen at 20 cm where the probe, slowly, met nothing: it comes back the way it went, and no other."""
    arm = right.Arm()
    wall = square(0.1)
    wall = SurfaceMesh(wall.vertices_m[:, [2, 1, 0]] + (0.45, 0.2, 0.1), wall.faces)
    known = KnownObstacles((Capsule((0, 0, 0), (0, 0, 0.15), 0.01),), [wall])
    with Supervisor(clock=lambda: arm.t_s) as guard:
        watched = guard.arm(arm, known)
        watched.pose()
        arm.at = np.array([0.4, 0.2, 0.1])
        watched.move_linear(at(0.5, 0.2, 0.1), 0.04)
        arm.at = np.array([0.5, 0.2, 0.1])
        with pytest.raises(DeviceError, match="approach from elsewhere"):
            watched.move_linear(at(0.4, 0.18, 0.1), 0.15)
        arm.at = np.array([0.4, 0.2, 0.1])
        watched.move_linear(at(0.5, 0.2, 0.1), 0.04)
        arm.at = np.array([0.5, 0.2, 0.1])
        watched.move_linear(at(0.4, 0.2, 0.1), 0.15)
        assert arm.goal is not None

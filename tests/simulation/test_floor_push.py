"""MuJoCo as the reference for pushes is converged and satisfies Coulomb's cone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.reproduce.pushes import FloorBody, FloorPush

pytest.importorskip("mujoco")

SQUARE = 0.145 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def path(length=0.4):
    x = np.linspace(0.0, length, int(length / 0.01) + 1)
    return np.column_stack([x, 0 * x, 0 * x])


def test_half_the_time_step_changes_nothing():
    thing = FloorBody(SQUARE, 0.9 * SQUARE, contact_friction=0.3)
    ends = [
        FloorPush(thing, (0.34, 0.04, 0.2), path()[0], time_step_s=step).drive(path()).object_m[-1]
        for step in (5e-4, 2.5e-4)
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-3)


def test_it_rests_without_creeping_and_is_passed_untouched():
    thing = FloorBody(SQUARE, 0.9 * SQUARE)
    trace = FloorPush(thing, (0.5, 0.6, 0.2), path()[0]).drive(path(0.3))
    assert not trace.touching.any()
    assert not trace.dropped
    np.testing.assert_allclose(trace.object_m[-1], trace.object_m[0], atol=1e-5)


def test_a_disc_without_contact_friction_slides_as_the_formula_says():
    # tan(theta / 2) grows as exp(way / D): see the test of the quasi-static push.
    theta, reach = 0.5, 0.17 + 0.12
    angle = np.arange(6) * math.pi / 3
    feet = 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    thing = FloorBody(np.zeros((1, 2)), feet, 0.12, contact_friction=0.0)
    trace = FloorPush(thing, (reach * math.cos(theta), reach * math.sin(theta), 0.0), path()[0]).drive(
        path(0.25)
    )
    told = 2 * math.atan(math.tan(theta / 2) * math.exp(0.25 / reach))
    place = trace.object_m[-1, :2] - trace.platform_m[-1, :2]
    np.testing.assert_allclose(place, reach * np.array([math.cos(told), math.sin(told)]), atol=2e-3)


def test_two_feet_do_not_stand():
    with pytest.raises(InputError, match="found 2 feet"):
        FloorBody(SQUARE, SQUARE[:2])

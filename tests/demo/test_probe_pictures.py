"""Probe readings come only from the images of its rod."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core.camera import Frame, Pose
from visuohaptic.demo.probe_chapters import _probe, default_beam
from visuohaptic.demo.served import place_bottle
from visuohaptic.demo.story import Mission
from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.reconstruction.completion import Completion, HoleRegion
from visuohaptic.rigs.virtual_beam import T_TIP_SENSOR, VirtualProbe
from visuohaptic.sensing.beam import estimate
from visuohaptic.simulation.tabletop import Bottle, SimulatedArm

#: Bending stiffness across a clamped rod of spring steel, 3 E I / L^3, of Sec. 3.6.1.
ACROSS_N_PER_M = 3 * 206e9 * math.pi * 0.00075**4 / 4 / 0.12**3
#: A cylinder: sections of one radius.
CYLINDER = Bottle(
    "round", 0.2, np.array([0.0, 0.05, 0.1, 0.15, 0.2]), np.full(5, 0.03), np.zeros(4), 1.0, 10.0
)  # fmt: skip


@pytest.fixture
def mission(tmp_path: Path) -> Mission:
    mission = Mission(2, tmp_path, quick=True)
    default_beam(mission)
    return mission


def probe_at(x_m: float, y_m: float) -> VirtualProbe:
    arm = SimulatedArm(Pose(np.eye(3), np.array([x_m, y_m, 0.1])))
    return VirtualProbe(arm, CYLINDER, np.random.default_rng(4))


def test_the_picture_of_the_rod_tells_the_force(mission: Mission) -> None:
    sensor = mission.known.probe
    assert sensor is not None
    # Bent as a cantilever, by what the tip would be inside of the wall: 4 mm, at 30 degrees about the axis.
    out = np.array([math.cos(math.pi / 6), math.sin(math.pi / 6), 0.0])
    cell = probe_at(*(0.026 * out[:2]))
    read = [sensor.read(Frame(cell.image(0.1 * k), 0.1 * k, k)).reading.wrench for k in range(8)]
    # Where the clamp's print is read a little off, a frame in thirty counts as moved.
    assert sum(one.valid for one in read) >= 6
    force_N = np.mean([T_TIP_SENSOR.rotation @ one.force_N for one in read if one.valid], axis=0)
    # The stiffness of the rod's parts is known to 3.5 % (diameter 0.7 % four times, modulus 2 %); the zero of eight frames
    # of this camera to some 5 mN across and 20 mN along its sight, of which 4 sigma.
    assert np.abs(force_N - 0.004 * ACROSS_N_PER_M * out).max() < 0.035 * 0.36 + 4 * 0.01
    # A view of the rod at rest has no force in it, wherever the tip truly is.
    rest = probe_at(0.2, 0.0)
    read = [sensor.read(Frame(rest.image(2 + 0.1 * k), 2 + 0.1 * k, k)).reading.wrench for k in range(8)]
    assert np.linalg.norm(np.mean([one.force_N for one in read], axis=0)) < 4 * 0.01


def test_noise_does_not_keep_the_exact_rod_from_ending(
    mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Residuals that noise leaves let Newton's last steps wander, by thousandths of a standard deviation."""
    looks = []
    exact = estimate.rod_from_base
    monkeypatch.setattr(estimate, "rod_from_base", lambda *given: looks.append(0) or exact(*given))
    sensor, rest, counts = mission.known.probe, probe_at(0.2, 0.0), []
    assert sensor is not None
    for k in range(50):
        looks.clear()
        sensor.read(Frame(rest.image(0.1 * k), 0.1 * k, k))
        counts.append(len(looks))
    # A start that is off by a few deviations needs some five steps; one frame of eight took all 30, ten halvings each.
    assert max(counts) < 60, counts


def completion(mission: Mission) -> Completion:
    """The table's bottle, with a ring in its middle that was not seen."""
    bottle = place_bottle(mission)
    shape, foot = bottle.probed(), np.array([*bottle.foot_m, 0.0])
    low, high = 0.3 * bottle.height_m, 0.7 * bottle.height_m
    seen = [
        SurfaceMesh(vertices + foot, faces)
        for vertices, faces in (shape.mesh(0.0, low), shape.mesh(high, bottle.height_m))
    ]
    hidden, _ = shape.mesh(low, high, caps=False)
    from visuohaptic.demo.bottle import PLACE

    return Completion(
        seen[0].joined(seen[1]), HoleRegion.of_points(hidden + foot), T_visual_haptic=PLACE.inverse()
    )


@pytest.mark.parametrize("picture", ["blank", "at rest"])
def test_without_a_bent_rod_in_the_picture_nothing_is_felt(
    mission: Mission, monkeypatch: pytest.MonkeyPatch, picture: str
) -> None:
    missing = completion(mission)
    if picture == "blank":
        monkeypatch.setattr(VirtualProbe, "image", lambda self, t_s: np.full((360, 640), 90, np.uint8))
    else:
        monkeypatch.setattr(VirtualProbe, "load_N", lambda self: np.zeros(3))
    touched = _probe(mission, missing, lambda touches: len(touches) >= 1)
    assert not any(touch.contact_m is not None for touch in touched.touches)
    if picture == "blank":
        assert touched.ending.outcome == "sensor_failed", touched.ending
    else:
        assert len(touched.touches) == 1

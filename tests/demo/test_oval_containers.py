"""A container that is not round: its axes are seen, it is squeezed along both, and weighed."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from visuohaptic.demo import Illustration, Mission, place_bottle, probe_chapters
from visuohaptic.demo.hand_chapters import recognise_the_bottle
from visuohaptic.reconstruction.mesh import SurfaceMesh
from visuohaptic.simulation.tabletop import OvalContainer


def oval_place(folder: Path) -> Mission:
    """An elliptic bottle on the second place of the table of a house, and nothing known of it."""
    mission = Mission(22, folder, world=22).at(1)
    assert isinstance(place_bottle(mission).container, OvalContainer)
    return mission


def surface(mission: Mission) -> SurfaceMesh:
    """The wall of the body in the mission's scene, as rings of triangles."""
    bottle, around = place_bottle(mission), np.arange(48) * math.pi / 24
    solid = bottle.scene.solids[0]
    z = np.linspace(0.0, bottle.height_m, 60)
    radius = np.interp(z, bottle.outline_m[:, 1], bottle.outline_m[:, 0])
    x, y = solid.squash * np.outer(radius, np.cos(around)), np.outer(radius, np.sin(around))
    c, s = math.cos(solid.yaw_rad), math.sin(solid.yaw_rad)
    points = np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z[:, None], x.shape)], axis=-1)
    points[..., :2] += bottle.foot_m
    low = (48 * np.arange(59)[:, None] + np.arange(48)).ravel()
    beside = (48 * np.arange(59)[:, None] + (np.arange(48) + 1) % 48).ravel()
    faces = np.vstack(
        [np.column_stack([low, beside, low + 48]), np.column_stack([beside, beside + 48, low + 48])]
    )
    return SurfaceMesh(points.reshape(-1, 3), faces)


def test_the_axes_of_an_oval_are_seen_and_felt(tmp_path: Path, plain_hand: Any) -> None:
    mission = oval_place(tmp_path)
    known, bottle = mission.known, place_bottle(mission)
    picture = Illustration(np.zeros((2, 2), np.uint8), "")
    found = probe_chapters._find_the_opaque(
        mission, cast(Any, SimpleNamespace(surface=surface(mission))), picture
    )
    assert found.done
    assert isinstance(bottle.container, OvalContainer)
    assert known.squash == pytest.approx(bottle.scene.solids[0].squash, rel=0.03)
    off = math.remainder(known.wide_rad - bottle.container.yaw_rad - 0.5 * math.pi, math.pi)
    assert abs(off) < 0.02
    assert bottle.outline_error_m(known.outline_m) < 1e-3
    squeezed = recognise_the_bottle(mission)
    mission.opened.close()
    assert squeezed.done
    assert squeezed.correct
    assert {claim.kind for claim in squeezed.claims} == {"class", "mass"}
    widths = {round(abs(curve.surface_m), 2) for curve in known.curves}
    assert known.class_name == bottle.name
    assert max(widths) < 0.05

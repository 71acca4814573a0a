"""Cross sections of obstacles against geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.simulation.mobile import box, cylinder, section, table


def turn(axis: str, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    if axis == "z":
        return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return np.array([[c, 0, s], [0, 1.0, 0], [-s, 0, c]])


def test_upright_section_is_the_outline() -> None:
    (cut,) = section(box("b", 0, 0, (0.2, 0.1, 0.3)), np.array([1.0, 2.0, 0.0]), turn("z", 0.3), 0.045)
    (outline,) = box("b", 0, 0, (0.2, 0.1, 0.3)).outlines
    assert cut.vertices_m == pytest.approx(outline.moved(1.0, 2.0, 0.3).vertices_m)


def test_leaning_box_is_longer_and_shifted() -> None:
    lean = 0.2
    sharp = box("b", 0, 0, (0.2, 0.1, 0.3), edge_m=0.0)
    (cut,) = section(sharp, np.zeros(3), turn("y", lean), 0.05)
    x = cut.vertices_m[:, 0]
    # Its front face leans over by 0.05 tan(lean) beyond where it meets the floor's height.
    assert np.ptp(cut.vertices_m[:, 1]) == pytest.approx(0.1)
    front = 0.1 / math.cos(lean) + 0.05 * math.tan(lean)
    assert x.max() == pytest.approx(front, rel=1e-9)


def test_nearly_upright_and_tilted_agree() -> None:
    """Both branches on both sides of the limit give the same front, to the sagitta of the polygon."""
    can = cylinder("c", 0, 0, 0.05, 0.3)
    (a,) = section(can, np.zeros(3), turn("y", 0.00199), 0.045)
    (b,) = section(can, np.zeros(3), turn("y", 0.00201), 0.045)
    sagitta = 0.05 * (1 - math.cos(math.pi / 32))
    assert a.polygon_m()[:, 0].min() == pytest.approx(b.vertices_m[:, 0].min(), abs=sagitta + 1e-5)


def test_lying_or_too_low_has_no_section() -> None:
    thin = box("b", 0, 0, (0.03, 0.1, 0.3))
    assert section(thin, np.array([0.0, 0.0, 0.02]), turn("y", math.pi / 2), 0.045) == ()
    assert section(box("b", 0, 0, (0.1, 0.1, 0.03)), np.zeros(3), np.eye(3), 0.045) == ()


def test_frictions_and_legs() -> None:
    thing = box("b", 0, 0, mass_kg=2.0, friction=0.5, static_ratio=1.2)
    assert thing.dynamic_friction_N == pytest.approx(9.81)
    assert thing.static_friction_N == pytest.approx(11.772)
    desk = table("t", 0, 0)
    assert math.isinf(desk.static_friction_N)
    assert len(desk.outlines) == 4

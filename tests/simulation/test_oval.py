"""Pinched tubes of elliptic cross-section, compared with shells of other elements, and with exact laws."""

import math
from functools import lru_cache

import numpy as np
import pytest
from tests.worlds.oval_shells import Oval

from visuohaptic.deformation import mesh_container, object_map
from visuohaptic.deformation.shapes.container import Base, ContainerDescription, Top, WallSection
from visuohaptic.deformation.shells.fourier_shell import RevolutionShell, pinch_stiffness
from visuohaptic.deformation.shells.shell_material import IsotropicMaterial
from visuohaptic.simulation.tabletop import DeformableContainer, OvalContainer, oval_container

HDPE = IsotropicMaterial.of("HDPE")
Z = np.linspace(0.0, 0.15, 61)


@lru_cache
def tube(a_m: float, squash: float, closed: bool, fill: float = 0.0) -> OvalContainer:
    wall = np.column_stack([np.full(61, a_m), Z, np.full(61, 7e-4)])
    return oval_container(wall, (squash, 0.0), HDPE, closed=closed, fill=fill)


def stiffness(felt: DeformableContainer, height_m: float) -> float:
    return felt.force_at(height_m, 1e-4) / 1e-4


@pytest.mark.parametrize("closed", [False, True])
def test_a_round_tube_is_as_stiff_as_a_shell_of_revolution(closed: bool) -> None:
    # A round wall keeps its volume to first order: enclosed air does not count.
    found = tube(0.03, 1.0, closed)
    shell = RevolutionShell(np.full(61, 0.03), Z, np.full(61, 7e-4), rim_held=closed)
    true = pinch_stiffness(shell, "HDPE")
    for felt in (found.across, found.along):
        for height in (0.04, 0.075, 0.12):
            assert stiffness(felt, height) == pytest.approx(np.interp(height, Z, true), rel=0.04)


def test_an_elliptic_tube_is_as_stiff_as_one_of_triangle_shells() -> None:
    found = tube(0.042, 0.62, True)
    described = ContainerDescription(
        name="oval",
        base=Base(shape="ellipse", radius=(0.042, 0.042), radius_y=(0.026, 0.026)),
        sections=[WallSection(height=(0.15, 0.15))], wall=(7e-4, 7e-4), material="HDPE", top=Top(kind="stiff"),
    )  # fmt: skip
    surface = object_map(mesh_container(described, around=24), None, band=False)
    points, true = np.asarray(surface.vertices_m), np.asarray(surface.stiffness_N_per_m)
    for felt, tip in ((found.across, (0.0, 0.026, 0.075)), (found.along, (0.042, 0.0, 0.075))):
        near = int(np.argmin(np.linalg.norm(points - tip, axis=1)))
        assert stiffness(felt, float(points[near, 2])) == pytest.approx(true[near], rel=0.12)


def test_a_wall_with_shoulder_and_groove_is_as_stiff_as_one_of_solids() -> None:
    r = np.interp(Z, [0.0, 0.06, 0.1, 0.135, 0.15], [0.04, 0.04, 0.038, 0.016, 0.015])
    r = r - 0.004 * np.exp(-(((Z - 0.055) / 0.005) ** 2))
    thick = np.where(Z > 0.135, 1.2e-3, 7e-4)
    found = oval_container(np.column_stack([r, Z, thick]), (0.6, 0.0), HDPE)
    levels = np.column_stack([r, 0.6 * r, Z])
    solid = Oval(levels, 0.5 * (thick[1:] + thick[:-1]), HDPE.youngs_modulus_Pa, HDPE.poisson_ratio, terms=15)
    heights = np.array([0.02, 0.055, 0.07, 0.1, 0.115, 0.13, 0.145])
    # As many harmonics of the point force in both.
    for axis, felt in enumerate((found.along, found.across)):
        same = [stiffness(felt, float(height)) for height in heights]
        np.testing.assert_allclose(same, 1.0 / solid._compliance(heights - 1e-5, axis), rtol=0.03)


def test_air_in_an_oval_container_resists_and_more_the_less_of_it_there_is() -> None:
    empty, full = tube(0.042, 0.62, True), tube(0.042, 0.62, True, 0.97)
    for axis in ("across", "along"):
        assert stiffness(getattr(full, axis), 0.075) > 1.02 * stiffness(getattr(empty, axis), 0.075)
    volume = math.pi * 0.62 * 0.042**2 * 0.15
    assert full.mass_kg - empty.mass_kg == pytest.approx(0.97 * 1000.0 * volume, rel=1e-6)


def test_fingers_between_the_axes_meet_the_support_of_the_ellipse() -> None:
    found = tube(0.04, 0.5, False)
    for angle in np.linspace(0.0, math.pi, 7):
        felt, direction = found.turned(float(angle)), np.array([math.cos(angle), math.sin(angle)])
        around = np.linspace(0.0, 2.0 * math.pi, 20001)
        points = np.column_stack([0.02 * np.cos(around), 0.04 * np.sin(around)])
        assert felt.radius_at(0.07) == pytest.approx((points @ direction).max(), rel=1e-6)
        # The circle of this curvature at the farthest point touches the ellipse to second order.
        k = int(np.argmax(points @ direction))
        centre = points[k] - felt.bend_at(0.07) * direction
        beside = np.linalg.norm(np.roll(points, 200, axis=0)[k] - centre)
        assert beside == pytest.approx(felt.bend_at(0.07), abs=2e-5)
    ends = stiffness(found.across, 0.07), stiffness(found.along, 0.07)
    assert ends[0] < stiffness(found.turned(0.7), 0.07) < ends[1]

"""Force compared with the limit surface and with statics computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.deformation.nonlinear import liquid_level_m
from visuohaptic.deformation.shapes import load_object
from visuohaptic.deformation.shells import IsotropicMaterial
from visuohaptic.grasping import GripperModel, Handling, Load, object_load, required_force_N

from .objects import container

CALM = Handling(acceleration_m_per_s2=0.0, tilt_rad=0.0, safety=1.0)
LEFT, RIGHT = np.array([[-0.03, 0.0, 0.1]]), np.array([[0.03, 0.0, 0.1]])


def needed(load: Load, slant: float = 0.0, gripper: GripperModel | None = None, handling: Handling = CALM):
    return float(
        required_force_N(load, LEFT, RIGHT, np.array([slant]), gripper or GripperModel(), handling)[0]
    )


def test_a_weight_below_the_fingers_needs_half_of_it_by_mu():
    assert needed(Load(0.5, (0, 0, 0.05))) == pytest.approx(0.5 * 9.81 / (2 * 0.6))


def test_a_weight_nearer_to_one_finger_loads_it_more():
    assert needed(Load(0.5, (0.015, 0, 0.05))) == pytest.approx(0.5 * 9.81 * 0.75 / 0.6)


def test_a_tilt_below_the_centre_of_mass_needs_torsion_and_points_have_none():
    tilted = Handling(acceleration_m_per_s2=0.0, tilt_rad=0.2, safety=1.0)
    high, low = Load(0.5, (0, 0, 0.14)), Load(0.5, (0, 0, 0.06))
    weight = 0.5 * 9.81
    moment = weight * 0.04 * np.sin(0.2) / 2
    by_hand = np.hypot(weight / 2, moment / (2 / 3 * 0.01)) / 0.6
    assert needed(high, handling=tilted) == pytest.approx(by_hand)
    assert needed(low, handling=tilted) == pytest.approx(weight / 2 / 0.6)
    assert needed(high, gripper=GripperModel(finger_radius_m=0.0), handling=tilted) == np.inf


@given(mu=st.floats(0.05, 1.5), slant=st.floats(0, 1.5), mass=st.floats(0.001, 5))
def test_what_is_applied_stays_inside_the_friction_cone(mu, slant, mass):
    force = needed(Load(mass, (0, 0, 0.05)), slant, GripperModel(friction=mu))
    if np.tan(slant) >= mu:
        assert force == np.inf
    else:
        # Worst case: the slant and the weight pull the same way along the wall.
        pull = force * np.sin(slant) + mass * 9.81 / 2
        assert pull <= mu * force * np.cos(slant) * (1 + 1e-9)


def test_mass_and_centre_of_a_tube_with_water():
    """Against the formulas of a cylinder; 32 sides enclose sin(x)/x of the circle's area, x = 2 pi / 32."""
    shell = container(around=32, even=True)
    polygon = np.sin(2 * np.pi / 32) / (2 * np.pi / 32)
    circle = np.pi * 0.035**2 * polygon
    wall = 1380 * 2 * 32 * 0.035 * np.sin(np.pi / 32) * 0.2 * 0.0005
    empty = object_load(shell)
    assert empty.mass_kg == pytest.approx(wall, rel=1e-6)
    np.testing.assert_allclose(empty.centre_m, [0, 0, 0.1], atol=1e-9)
    half = object_load(shell, 0.5)
    water = 1000 * circle * 0.1
    assert half.mass_kg == pytest.approx(wall + water, rel=1e-6)
    # Pressed flat at the level: exact where the wall is a prism, but for the band that the level cuts.
    assert half.centre_m[2] == pytest.approx((wall * 0.1 + water * 0.05) / (wall + water), rel=5e-3)


def test_bad_loads_are_refused():
    with pytest.raises(InputError, match=r"found 2\.0, expected 0 to 1"):
        object_load(container(), 2.0)
    with pytest.raises(InputError, match=r"mass_kg: found 0\.0, expected more than 0"):
        Load(0.0, (0, 0, 0))
    with pytest.raises(InputError, match="wall_kg_per_m3: found nan"):
        object_load(container(), wall_kg_per_m3=float("nan"))
    with pytest.raises(InputError, match="has no density"):
        object_load(replace(container(), material=IsotropicMaterial(2e9, 0.3, "given")))


@pytest.mark.data
@pytest.mark.parametrize("name", ["object_sim/mug.stl", "ycb/TomatoSoupCan.obj"])
def test_water_in_real_meshes_lies_between_foot_and_level(data, name):
    container = load_object(data / "deformation" / "meshes" / name)
    low = container.mesh.vertices_m[:, 2].min()
    for fill in (0.2, 0.8):
        load = object_load(container, fill, wall_kg_per_m3=1e-6)
        assert load.mass_kg == pytest.approx(1000 * fill * container.volume_m3, rel=1e-6)
        level = liquid_level_m(container, fill)
        # Of a vessel that is about a prism: half the level, wider above or below by a quarter.
        assert 0.25 * level < load.centre_m[2] - low < 0.75 * level

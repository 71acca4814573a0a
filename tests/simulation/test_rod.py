"""The simulated rod against closed forms, and against itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc
from tests.sensing.beam.pose_noise import POSE_NOISE, noisy_pose

from visuohaptic.core import InputError
from visuohaptic.simulation.beam import ElasticRod, RodRig

ROD = ElasticRod()
EI = ROD.youngs_Pa * np.pi / 4 * (0.5 * ROD.diameter_m) ** 4
GJ = EI / (1 + ROD.poisson)
L = ROD.length_m


def tip(state):
    pose = state.pose(1.0)
    rotation = pose.rotation
    turn = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    return np.concatenate([pose.translation_m - [L, 0, 0], turn])


def test_small_loads_bend_like_the_textbook():
    # Cantilever tables (right-handed): rows F_X ... M_Z, columns the motion of the tip.
    area = np.pi * (0.5 * ROD.diameter_m) ** 2
    expected = np.zeros((6, 6))
    expected[0, 0] = 1 / ROD.spring_N_per_m + L / (ROD.youngs_Pa * area)
    expected[1, [1, 5]] = L**3 / (3 * EI), L**2 / (2 * EI)
    expected[2, [2, 4]] = L**3 / (3 * EI), -(L**2) / (2 * EI)
    expected[3, 3] = 1 / ROD.spring_Nm_per_rad + L / GJ
    expected[4, [4, 2]] = L / EI, -(L**2) / (2 * EI)
    expected[5, [5, 1]] = L / EI, L**2 / (2 * EI)
    for axis in range(6):
        load = np.zeros(6)
        load[axis] = 1e-4 if axis < 3 else 1e-5
        moved = tip(ROD.bend(load[:3], load[3:])) / load[axis]
        # Shear bends the rod by 8e-5 more; the square of the load does the rest.
        scale = np.abs(expected[axis]).max()
        assert np.abs(moved - expected[axis]).max() < 2e-4 * scale, axis


@pytest.mark.parametrize("force_N", [0.5, 2.0, 5.0, 12.0])
def test_a_force_across_bends_it_like_the_elastica(force_N):
    # Bisshopp and Drucker (1945): cantilever of any deflection under a dead force at its end.
    alpha = np.sqrt(force_N * L**2 / EI)

    def length(slope):
        k2 = 0.5 * (1 + np.sin(slope))
        start = np.arcsin(1 / np.sqrt(2 * k2))
        return ellipk(k2) - ellipkinc(start, k2) - alpha

    slope = brentq(length, 1e-9, 0.5 * np.pi - 1e-9)
    k2 = 0.5 * (1 + np.sin(slope))
    start = np.arcsin(1 / np.sqrt(2 * k2))
    down = L * (1 - 2 / alpha * (ellipe(k2) - ellipeinc(start, k2)))
    along = L * np.sqrt(2 * np.sin(slope)) / alpha
    state = ROD.bend(np.array([0.0, 0.0, force_N]))
    found = state.points_m[-1]
    # 160 links: (alpha / 160)^2 of the deflection, and the shear of 8e-5.
    assert found[2] == pytest.approx(down, rel=3e-4)
    assert found[0] == pytest.approx(along, rel=3e-4)
    assert abs(found[1]) < 1e-12


def test_a_moment_rolls_it_into_an_arc():
    moment = 1.2 * EI / L
    state = ROD.bend(np.zeros(3), np.array([0.0, 0.0, moment]))
    radius = EI / moment
    assert state.points_m[-1, 0] == pytest.approx(radius * np.sin(1.2), rel=1e-5)
    assert state.points_m[-1, 1] == pytest.approx(radius * (1 - np.cos(1.2)), rel=1e-5)


def test_the_error_falls_with_the_square_of_the_links():
    load = np.array([0.5, 2.0, -1.0]), np.array([0.05, 0.02, -0.1])
    tips = [ElasticRod(links=n).bend(*load).points_m[-1] for n in (40, 80, 160, 640)]
    errors = [np.linalg.norm(found - tips[-1]) for found in tips[:3]]
    assert 3.5 < errors[0] / errors[1] < 4.6
    assert 3.5 < errors[1] / errors[2] < 4.6
    assert errors[2] < 1e-6


def test_sections_are_rotations_and_balance_the_load():
    state = ROD.bend(np.array([-1.0, 1.0, 2.0]), np.array([0.05, 0.0, 0.1]))
    product = state.frames @ state.frames.transpose(0, 2, 1)
    assert np.abs(product - np.eye(3)).max() < 1e-12
    # The clamp is turned about X by what its spring carries.
    moment_Nm = state.moment_Nm + np.cross(state.points_m[-1] - state.points_m[0], state.force_N)
    carried = moment_Nm[0] / ROD.spring_Nm_per_rad
    assert np.arctan2(state.frames[0, 2, 1], state.frames[0, 1, 1]) == pytest.approx(carried, abs=1e-9)
    assert state.points_m[0, 0] == pytest.approx(-1.0 / ROD.spring_N_per_m)


def test_a_buckling_load_is_refused():
    with pytest.raises(InputError, match="no shape found"):
        ROD.bend(np.array([-60.0, 0.1, 0.0]))


def test_the_rig_sees_what_the_rod_does():
    rig = RodRig()
    state = ROD.bend(np.array([0.0, 1.0, 0.0]))
    poses = rig.poses(state)
    xi, mount = rig.mounts["tip"]
    section = rig.T_camera_sensor.inverse() @ poses["tip"] @ mount.inverse()
    assert section.translation_m == pytest.approx(state.pose(xi).translation_m, abs=1e-15)
    middle = rig.T_camera_sensor.apply(np.array([0.5 * L, 0, 0]))
    assert middle == pytest.approx([0, 0, 0.3], abs=1e-12)


def test_noise_has_the_covariance_that_it_says():
    rng = np.random.default_rng(3)
    covariance = POSE_NOISE[0.3].covariance
    pose = RodRig().T_camera_sensor
    draws = [noisy_pose(pose, covariance, rng) for _ in range(2000)]
    spread = np.std([draw.translation_m - pose.translation_m for draw in draws], axis=0)
    # 2000 draws: 1.6 % one sigma.
    assert spread == pytest.approx(np.sqrt(np.diag(covariance))[:3], rel=0.07)

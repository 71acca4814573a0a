"""The linear beam against the formulas of the text and the large-deflection rod."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.beam import plane_inverse

from visuohaptic.core import InputError
from visuohaptic.sensing.beam import Beam, compliance, shortening, stress_ratio
from visuohaptic.simulation.beam import ElasticRod

BEAM = Beam()


def test_the_section_constant_is_that_of_the_text():
    assert BEAM.inertia_m4 == pytest.approx(2.48e-13, rel=3e-3)  # 3.6.1


@pytest.mark.parametrize("xi", [0.2, 0.5, 1.0])
def test_the_published_inverse_undoes_the_compliance_in_both_planes(xi):
    # Eq. (3.5) takes dw/dxi = L dw/dx; in the X-Z plane slope and moment change sign together.
    for axes, sign in (((1, 5), 1.0), ((2, 4), -1.0)):
        block = compliance(BEAM, xi)[np.ix_(axes, axes)]
        flip = np.diag([1.0, sign])
        w = np.diag([1.0, BEAM.length_m]) @ flip @ block @ flip
        assert plane_inverse(BEAM, xi) @ w == pytest.approx(np.eye(2), abs=1e-9)


def test_slopes_are_derivatives_of_the_deflection():
    step = 1e-5
    ahead, behind = compliance(BEAM, 0.6 + step), compliance(BEAM, 0.6 - step)
    rate = (ahead - behind) / (2 * step * BEAM.length_m)
    here = compliance(BEAM, 0.6)
    assert here[5, [1, 5]] == pytest.approx(rate[1, [1, 5]], rel=1e-7)  # phi_Z = dw_Y/dx
    assert here[4, [2, 4]] == pytest.approx(-rate[2, [2, 4]], rel=1e-7)  # phi_Y = -dw_Z/dx


def test_work_is_the_same_both_ways_round():
    tip = compliance(BEAM, 1.0)
    assert tip == pytest.approx(tip.T, rel=1e-12)
    assert np.linalg.eigvalsh(tip).min() > 0


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_axis_alone_has_the_sign_of_the_simulated_rod(axis, sign):
    wrench = np.zeros(6)
    wrench[axis] = sign * 1e-3 * BEAM.full_scale[axis]
    state = ElasticRod().bend(wrench[:3], wrench[3:])
    for xi in (0.3, 1.0):
        pose = state.pose(xi)
        r = pose.rotation
        turn = 0.5 * np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
        moved = np.concatenate([pose.translation_m - [xi * BEAM.length_m, 0, 0], turn])
        expected = compliance(BEAM, xi) @ wrench
        scale = np.array([np.abs(expected[:3]).max()] * 3 + [np.abs(expected[3:]).max()] * 3)
        # One thousandth of full scale: shear up to 1e-3 near the clamp, shortening below 1e-3.
        assert np.abs(moved - expected).max() < 2e-3 * scale.max()
        assert (np.abs(moved - expected) <= 2e-3 * np.where(scale > 0, scale, 1e-9)).all()


def test_the_bent_rod_is_shorter_by_what_is_said():
    wrench = np.array([0, 0.8, -0.5, 0, 0.02, 0.03])
    state = ElasticRod().bend(wrench[:3], wrench[3:])
    for xi in (0.4, 1.0):
        drawn = xi * BEAM.length_m - state.pose(xi).translation_m[0]
        # Second order in a slope of 0.15: the next term is 2 % of it.
        assert shortening(BEAM, xi, wrench) == pytest.approx(drawn, rel=0.06)
    u = np.linspace(0, 0.7, 20001)
    a = BEAM.length_m * (0.8 * BEAM.length_m + 0.03) / BEAM.bending_Nm2
    b = 0.5 * 0.8 * BEAM.length_m**2 / BEAM.bending_Nm2
    planar = 0.5 * BEAM.length_m * np.trapezoid((a * u - b * u**2) ** 2, u)
    assert shortening(BEAM, 0.7, np.array([0, 0.8, 0, 0, 0, 0.03])) == pytest.approx(planar, rel=1e-6)


def test_the_rod_yields_at_its_moment_limit():
    assert stress_ratio(BEAM, np.array([0, 0.6, 0.8]) * BEAM.moment_limit_Nm) == pytest.approx(1.0)
    # In pure torsion a round rod carries 2 / sqrt(3) times as much.
    assert stress_ratio(BEAM, np.array([2 / 3**0.5, 0, 0]) * BEAM.moment_limit_Nm) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"length_m": 0.0}, "beam: length_m: found 0, expected a positive number"),
        ({"youngs_Pa": float("nan")}, "beam: youngs_Pa: found nan"),
        ({"poisson": 0.6}, "expected below 0.5"),
        ({"diameter_m": 1.5}, "expected a slender rod; give both in metres"),
    ],
)
def test_a_beam_that_can_not_be_is_refused(change, text):
    with pytest.raises(InputError, match=text):
        Beam(**change)


def test_positions_off_the_rod_are_refused():
    with pytest.raises(InputError, match=r"xi: found 1\.2, expected 0 < xi <= 1"):
        compliance(BEAM, 1.2)

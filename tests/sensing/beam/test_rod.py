"""The exact rod: its kernel compared with a plain integration, and with a chain of links."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

from visuohaptic.core import InputError
from visuohaptic.sensing.beam import Beam, base_wrench, compliance, rod_from_base
from visuohaptic.simulation.beam import ElasticRod

BEAM = Beam()
XI = np.array([0.3, 0.5, 1.0])


def random_wrench(rng, fraction=0.5):
    return rng.uniform(-fraction, fraction, 6) * BEAM.full_scale * [0.5, 0.5, 0.5, 1, 0.3, 0.3]


def bent(wrench):
    """The rod under a wrench at its tip."""

    def missing(moment):
        return rod_from_base(BEAM, np.concatenate([wrench[:3], moment]), XI).wrench[3:] - wrench[3:]

    found = root(missing, base_wrench(BEAM, wrench)[3:], tol=1e-14)
    return rod_from_base(BEAM, np.concatenate([wrench[:3], found.x]), XI)


def twin(base, xi):
    """The same equations in plain NumPy, integrated by scipy to 1e-12."""
    force, moment = base[:3], base[3:]
    ei, gj, ea, k_x, k_phi = BEAM.stiffness
    clamp = np.array([force[0] / k_x, 0, 0])

    def rates(_, y):
        r, frame = y[:3], y[3:].reshape(3, 3)
        m = moment - np.cross(r - clamp, force)
        t = frame[:, 0]
        u = m / ei + (1 / gj - 1 / ei) * (t @ m) * t
        return np.concatenate([t * (1 + t @ force / ea), np.cross(u, frame, axisb=0, axisc=0).ravel()])

    c, s = np.cos(moment[0] / k_phi), np.sin(moment[0] / k_phi)
    start = np.concatenate([clamp, np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).ravel()])
    places = xi * BEAM.length_m
    found = solve_ivp(rates, (0, places[-1]), start, "DOP853", places, rtol=1e-12, atol=1e-14).y.T
    return found[:, :3], found[:, 3:].reshape(-1, 3, 3)


def test_the_kernel_equals_its_twin():
    rng = np.random.default_rng(1)
    for _ in range(5):
        shape = rod_from_base(BEAM, random_wrench(rng, 1.0), XI)
        position, rotation = twin(shape.base, XI)
        # Fourth order in 24 steps of at most 0.05 rad: 1e-8.
        assert np.abs(shape.position_m - position).max() < 1e-8 * BEAM.length_m
        assert np.abs(shape.rotation - rotation).max() < 1e-7


def test_jacobians_are_differences():
    rng = np.random.default_rng(2)
    base = random_wrench(rng, 0.8)
    shape = rod_from_base(BEAM, base, XI)
    for c in range(6):
        step = np.zeros(6)
        step[c] = 1e-4 if c < 3 else 1e-5
        ahead, behind = rod_from_base(BEAM, base + step, XI), rod_from_base(BEAM, base - step, XI)
        rate = (ahead.position_m - behind.position_m) / (2 * step[c])
        scale = np.abs(shape.jacobian[:, :3, c]).max()
        assert np.abs(rate - shape.jacobian[:, :3, c]).max() < 1e-4 * scale
        spin = (ahead.rotation - behind.rotation) / (2 * step[c]) @ shape.rotation.transpose(0, 2, 1)
        turn = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        assert np.abs(turn - shape.jacobian[:, 3:, c]).max() < 1e-4 * np.abs(turn).max()
        rate = (ahead.wrench - behind.wrench) / (2 * step[c])
        assert rate == pytest.approx(shape.wrench_jacobian[:, c], rel=1e-4, abs=1e-5)


def test_it_agrees_with_the_chain_of_links():
    rng = np.random.default_rng(4)
    for _ in range(12):
        wrench = random_wrench(rng)
        shape = bent(wrench)
        assert shape.wrench == pytest.approx(wrench, abs=1e-9)
        state = ElasticRod(links=240).bend(wrench[:3], wrench[3:])
        for k, xi in enumerate(XI):
            pose = state.pose(xi)
            # Shear, which the exact rod has not, is 8e-5 of the bending; links: 1e-5.
            assert np.abs(pose.translation_m - shape.position_m[k]).max() < 5e-6
            assert np.abs(pose.rotation - shape.rotation[k]).max() < 3e-5


def test_small_loads_give_the_linear_beam():
    wrench = 1e-5 * BEAM.full_scale
    shape = bent(wrench)
    for k, xi in enumerate(XI):
        expected = compliance(BEAM, xi) @ wrench
        moved = shape.position_m[k] - [xi * BEAM.length_m, 0, 0]
        # Couplings of second order: 1e-5 times the slope at full scale, of the largest motion.
        assert np.abs(moved - expected[:3]).max() < 3e-5 * np.abs(expected[:3]).max()


def test_cross_sections_that_do_not_rise_are_refused():
    with pytest.raises(InputError, match="expected rising values"):
        rod_from_base(BEAM, np.zeros(6), np.array([1.0, 0.5]))

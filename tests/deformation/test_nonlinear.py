"""Equilibrium paths: published curves on small meshes, the pinched tube, a balloon, and failure."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from benchmarks.shell_nonlinear import PINCH, quarter_tube

from benchmarks import _shell_problems as problems
from visuohaptic.core import InputError
from visuohaptic.deformation.nonlinear import (
    follow_displacement,
    pinch_curve,
    reach_loads,
)
from visuohaptic.deformation.shapes import tube_mesh
from visuohaptic.deformation.shells import (
    CorotationalShell,
    IsotropicMaterial,
    ShellMesh,
    ShellModel,
    opposing_points,
)


@pytest.mark.parametrize(
    ("problem", "mesh", "limit"),
    [
        (problems.end_shear, 16, 0.01),
        (problems.end_moment, 24, 0.01),
        (problems.pullout, 20, 0.02),
        (problems.hinged_roof, 10, 0.02),
    ],
)
def test_published_curves(problem, mesh, limit):
    """Distance from every tabulated point to our curve, axes scaled to one."""
    walked = problem(mesh)
    assert walked.complete
    assert walked.distance < limit


def test_snap_back_is_walked_through_by_arc_length():
    walked = problems.hinged_roof(12, thickness=6.35)
    assert walked.complete
    assert walked.load.min() < -0.1
    assert np.any(np.diff(walked.shown[:, 0]) < 0)
    assert walked.distance < 0.025


def test_the_pinched_tube_softens_and_stiffens_as_other_codes_say():
    model, load = quarter_tube(12, 44)
    shell = CorotationalShell(model)
    path = follow_displacement(shell, load, [0.0005, 0.001, 0.0015, 0.002, 0.003, 0.0045, 0.006])
    assert path.complete
    assert path.iterations <= 40
    force, depth = np.r_[0, path.load], np.r_[0, path.control_m]
    for newton, millimetres in PINCH.items():
        # The force at a depth is steadier between points than the depth at a force: 4 % with this
        # mesh and straight lines between seven points.
        assert np.interp(millimetres / 1e3, depth, force) == pytest.approx(newton, rel=0.04)
    # A path ends at the load that is asked for, and says so when its iterations are used up.
    ended = follow_displacement(shell, load, list(path.control_m), until_load=0.999 * float(path.load[1]))
    assert ended.complete
    np.testing.assert_allclose(ended.load, path.load[:2], rtol=1e-9)
    few = follow_displacement(shell, load, list(path.control_m), max_iterations=path.points[0].iterations + 2)
    assert not few.complete
    assert len(few.points) == 1
    assert "the iterations ended at displacement 0.0005" in few.reason
    # The curve starts as the linear model says.
    first = follow_displacement(shell, load, [1e-6]).load[0]
    assert first == pytest.approx(1e-6 / (-model.solve(load)[np.argmin(load[:, 0]), 0]), rel=1e-3)


def balloon(pressure_Pa, n=12):
    """An eighth of a sphere of radius 0.05 with symmetric edges."""
    mesh = problems.grid_mesh(
        lambda u, v: (
            0.05 * np.cos(u * np.pi / 2) * np.cos(0.98 * v * np.pi / 2),
            0.05 * np.sin(u * np.pi / 2) * np.cos(0.98 * v * np.pi / 2),
            0.05 * np.sin(0.98 * v * np.pi / 2),
        ),
        n, n, 0.0005, crossed=True,
    )  # fmt: skip
    x, y, z = mesh.vertices_m.T
    fixed = problems.held(
        mesh,
        (np.abs(z) < 1e-9, (2, 3, 4)),
        (np.abs(y) < 1e-9, (1, 3, 5)),
        (np.abs(x) < 1e-9, (0, 4, 5)),
    )
    return ShellModel(mesh, IsotropicMaterial(1e7, 0.4), fixed)


def test_pressure_blows_up_a_sphere_as_membrane_theory_says():
    model = balloon(0)
    for pressure in (500.0, 2000.0):
        shell = CorotationalShell(model, pressure=lambda volume, pressure=pressure: (pressure, 0.0))
        nothing = np.zeros((model.nodes, 6))
        nothing[0, 0] = 1e-9
        path = reach_loads(shell, nothing, [1.0], past_limits=False)
        assert path.complete
        grown = np.linalg.norm(path.points[-1].state.points_m[6], axis=-1) / 0.05 - 1
        # p r^2 (1 - nu) / (2 E t r), to first order in the growth of the radius; the mesh's chord
        # error and the small hole at the pole cost a few percent.
        linear = pressure * 0.05 * 0.6 / (2 * 1e7 * 0.0005)
        assert grown == pytest.approx(linear * (1 + 2 * linear), rel=0.05)


def test_boyle_in_a_pinched_ellipse():
    """Enclosed air: the pressure of the state is that of its volume, and it pushes back."""
    mesh = tube_mesh(1.0, 0.1, 0.0005, around=24, along=8)
    mesh = ShellMesh(mesh.vertices_m * [0.045, 0.025, 1], mesh.faces, 0.0005, mesh.fraction)
    fixed = np.zeros((len(mesh.vertices_m), 6), dtype=bool)
    fixed[:24] = True
    model = ShellModel(mesh, IsotropicMaterial(2.5e9, 0.38), fixed)
    rim = np.arange(8 * 24, 9 * 24)
    floor = np.stack([np.zeros(22, int), np.arange(2, 24), np.arange(1, 23)], axis=1)
    lid = np.vstack([floor, np.stack([np.full(22, rim[0]), rim[1:-1], rim[2:]], axis=1)])
    open_shell = CorotationalShell(model, lid=lid)
    rest = open_shell.volume(open_shell.rest)
    assert rest == pytest.approx(np.pi * 0.045 * 0.025 * 0.1, rel=0.02)

    def boyle(volume):
        return 1e5 * (rest / volume - 1), -1e5 * rest / volume**2

    closed_shell = open_shell.with_pressure(boyle)
    tips = opposing_points(mesh, np.array([4 * 24 + 6]))
    plain = pinch_curve(open_shell, tips, 0, [0.001, 0.002])
    gas = pinch_curve(closed_shell, tips, 0, [0.001, 0.002])
    assert plain.complete
    assert gas.complete
    assert np.all(gas.load > 1.02 * plain.load)
    # Work and energy: the mean force over a step is the rise of the wall's energy and the gas's.
    state = gas.points[0].state
    volume = closed_shell.volume(state)
    work = 1e5 * (rest * np.log(rest / volume) + volume - rest) + closed_shell.energy(state)
    tiny = np.linspace(0, 0.001, 9)[1:]
    curve = pinch_curve(closed_shell, tips, 0, tiny)
    force = np.r_[0, curve.load]
    assert 2 * np.trapezoid(force, np.r_[0, tiny]) == pytest.approx(work, rel=0.01)


def shallow_roof(cells, thickness_mm):
    """The hinged cylindrical roof of Sze et al. (2004), a quarter of it, and its central load [N]."""
    mesh = problems.grid_mesh(
        lambda u, v: (2540 * np.sin(0.1 * u), 254 * v, 2540 * np.cos(0.1 * u)),
        cells,
        cells,
        thickness_mm,
        crossed=True,
    )
    x, y, _ = mesh.vertices_m.T
    fixed = problems.held(
        mesh,
        (problems.near(x, x.max()), (0, 1, 2)),
        (problems.near(x, 0), (0, 4, 5)),
        (problems.near(y, 0), (1, 3, 5)),
    )
    model = ShellModel(mesh, IsotropicMaterial(3102.75, 0.3), fixed)
    load = np.zeros((model.nodes, 6))
    load[0, 2] = -0.25
    shell = CorotationalShell(model)
    return shell, load


def test_a_limit_load_stops_load_control_with_a_reason():
    shell, load = shallow_roof(6, 12.7)
    path = follow_displacement(shell, load, list(np.arange(1.0, 16.0)))
    assert path.complete
    # Past the limit point the tangent's determinant is negative.
    assert path.points[0].stable
    assert not path.points[-1].stable
    # Past the limit the path is walked round to the next state that carries the load.
    path = reach_loads(shell, load, [1000.0, 3000.0])
    assert path.complete
    assert path.control_m[-1] > 15
    np.testing.assert_allclose(path.load, [1000.0, 3000.0], rtol=1e-6)
    # 12 mm of displacement, where the load is falling, cannot be reached by raising the load.
    path = reach_loads(shell, load, [1000.0, 2000.0], past_limits=False)
    assert path.complete
    assert path.control_m[-1] < 11


def test_displacement_control_goes_round_a_snap_back():
    """The thin roof's middle turns back under load: its path by arc length is the truth here."""
    shell, load = shallow_roof(8, 6.35)
    targets = [5.0, 10.0, 15.0, 18.0, 22.0, 26.0]
    path = follow_displacement(shell, load, targets)
    assert path.complete
    np.testing.assert_allclose(path.control_m, targets, rtol=1e-5)
    arc = problems.follow_arc(shell, load, first=50.0, until=900.0)
    assert np.any(np.diff(arc.control_m) < 0)
    # Each point lies on the path: within the straight lines between its points.
    shown = np.stack([arc.control_m / 26, arc.load / 600], axis=1)
    dense = np.concatenate([a + (b - a) * np.linspace(0, 1, 50)[:, None] for a, b in pairwise(shown)])
    for control, factor in zip(path.control_m, path.load, strict=True):
        away = np.linalg.norm(dense - [control / 26, factor / 600], axis=1).min()
        assert away < 0.02


def test_loads_on_what_is_held_are_refused():
    model = ShellModel(tube_mesh(0.03, 0.1, 0.001, around=8, along=4), IsotropicMaterial(1e9, 0.3), range(8))
    load = np.zeros((model.nodes, 6))
    load[0, 0] = 1
    with pytest.raises(InputError, match="zero on everything that can move"):
        reach_loads(CorotationalShell(model), load, [1.0], past_limits=False)
    flat = ShellMesh(np.array([[0.1, 0, 0], [0.2, 0, 0], [0.1, 0, 0.1]]), np.array([[0, 1, 2]]), 0.001)
    tips = opposing_points(flat, axis_point_m=(0.0, 0.0))
    with pytest.raises(InputError, match="no wall across"):
        pinch_curve(CorotationalShell(ShellModel(flat, IsotropicMaterial(1e9, 0.3), [0])), tips, 0, [1e-3])

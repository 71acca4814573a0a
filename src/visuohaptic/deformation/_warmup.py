"""Loads or compiles the kernels of shells."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """A map, a nonlinear pinch with and without contents, a solid of revolution, a solid wall."""
    from . import CorotationalShell, RevolutionShell, ShellModel, dual_tip_map, opposing_points
    from .fourier_shell import pinch_stiffness
    from .material import IsotropicMaterial
    from .mitc4 import mitc4_tube_stiffness
    from .nonlinear import follow_displacement, pinch_curve
    from .patches import tube_mesh
    from .tetrahedra import linear_tetrahedra, wall_tetrahedra

    plastic = IsotropicMaterial(2.5e9, 0.38)
    mesh = tube_mesh(0.03, 0.08, 0.0005, around=12, along=8)
    model = ShellModel(mesh, plastic, range(12))
    dual_tip_map(model)
    tips = opposing_points(mesh, np.array([60]))
    model.factor().coupling(np.eye(6 * model.nodes, 2))
    model.solve(np.zeros((model.nodes, 6)))
    shell = CorotationalShell(model)
    shell.energy(shell.rest)
    pinch_curve(shell, tips, 0, [1e-4])
    gas = CorotationalShell(model, pressure=lambda volume: (0.0, -1e5 / volume))
    load = np.zeros((model.nodes, 6))
    load[60, 0] = -1.0
    follow_displacement(gas, load, [1e-4])
    height = np.linspace(0, 0.08, 5)
    pinch_stiffness(RevolutionShell(np.full(5, 0.03), height, 0.0005), plastic, harmonics=8)
    solid = wall_tetrahedra(tube_mesh(0.03, 0.08, 0.0005, around=8, along=4, crossed=False))
    fixed = np.arange(len(solid.points_m)) < 16
    linear_tetrahedra(solid, plastic, fixed).solve(np.zeros(3 * len(fixed)))
    mitc4_tube_stiffness(0.03, 0.08, 0.0005, plastic, around=8, along=4)

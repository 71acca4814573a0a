"""How a container gives way: shapes, shells, contents, stiffness maps (Alt 2016, Sec. 6.1)."""

from .corotational import CorotationalShell, PressureLaw, ShellState
from .fourier_shell import RevolutionShell, pinch_stiffness
from .material import MATERIALS, IsotropicMaterial, material
from .nonlinear import EquilibriumPath, PathPoint, follow_arc, follow_displacement, follow_load, pinch_curve
from .patches import grid_faces, grid_mesh, tube_mesh
from .shell import ShellMesh, ShellModel, enclosed_volume, plane_stress, volume_gradient
from .solids import quadratic_compliance
from .stiffness_map import DualTips, dual_tip_compliance, dual_tip_map, opposing_points, tip_loads
from .tetrahedra import SolidMesh, linear_tetrahedra, wall_tetrahedra

__all__ = [
    "MATERIALS",
    "CorotationalShell",
    "DualTips",
    "EquilibriumPath",
    "IsotropicMaterial",
    "PathPoint",
    "PressureLaw",
    "RevolutionShell",
    "ShellMesh",
    "ShellModel",
    "ShellState",
    "SolidMesh",
    "dual_tip_compliance",
    "dual_tip_map",
    "enclosed_volume",
    "follow_arc",
    "follow_displacement",
    "follow_load",
    "grid_faces",
    "grid_mesh",
    "linear_tetrahedra",
    "material",
    "opposing_points",
    "pinch_curve",
    "pinch_stiffness",
    "plane_stress",
    "quadratic_compliance",
    "tip_loads",
    "tube_mesh",
    "volume_gradient",
    "wall_tetrahedra",
]

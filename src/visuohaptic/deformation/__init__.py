"""How a container gives way: shapes, shells, contents, stiffness maps (Alt 2016, Sec. 6.1)."""

from .banded_map import nearest_value, object_map, object_stiffness
from .build import BuildJob, BuildPlan, BuildReport, build, load_plan, plan_jobs
from .container import ContainerDescription, class_names, load_container
from .contents import (
    Contents,
    closed_compliance,
    contained_curve,
    damped_iteration,
    hydrostatic_load,
    liquid_level_m,
)
from .corotational import CorotationalShell, PressureLaw, ShellState
from .curve_features import nonlinear_features
from .features import (
    StiffnessFeatures,
    curve_coefficients,
    explore_line,
    linear_features,
    normalised,
)
from .fourier_shell import RevolutionShell, pinch_stiffness
from .grasp_curve import GraspCurve, PinchPlane, grasp_curve, side_vertex
from .grasp_patterns import GraspCoupling, couple
from .imported import import_object
from .map_file import load_map, plot_map, save_map
from .material import MATERIALS, IsotropicMaterial, material
from .mesher import ShellObject, mesh_container, with_elastic_base
from .nonlinear import (
    EquilibriumPath,
    PathPoint,
    follow_arc,
    follow_displacement,
    follow_load,
    pinch_curve,
    reach_loads,
)
from .object_file import load_object
from .patches import grid_faces, grid_mesh, tube_mesh
from .shell import ShellMesh, ShellModel, enclosed_volume, plane_stress, volume_gradient
from .solids import quadratic_compliance, solid_stiffness
from .stiffness_map import DualTips, dual_tip_compliance, dual_tip_map, opposing_points, tip_loads
from .symmetric_part import SymmetricPart, Symmetry, detect_symmetry, symmetric_part
from .tetrahedra import SolidMesh, linear_tetrahedra, wall_tetrahedra
from .touching import TouchGuard, wall_gap_m

__all__ = [
    "MATERIALS",
    "BuildJob",
    "BuildPlan",
    "BuildReport",
    "ContainerDescription",
    "Contents",
    "CorotationalShell",
    "DualTips",
    "EquilibriumPath",
    "GraspCoupling",
    "GraspCurve",
    "IsotropicMaterial",
    "PathPoint",
    "PinchPlane",
    "PressureLaw",
    "RevolutionShell",
    "ShellMesh",
    "ShellModel",
    "ShellObject",
    "ShellState",
    "SolidMesh",
    "StiffnessFeatures",
    "SymmetricPart",
    "Symmetry",
    "TouchGuard",
    "build",
    "class_names",
    "closed_compliance",
    "contained_curve",
    "couple",
    "curve_coefficients",
    "damped_iteration",
    "detect_symmetry",
    "dual_tip_compliance",
    "dual_tip_map",
    "enclosed_volume",
    "explore_line",
    "follow_arc",
    "follow_displacement",
    "follow_load",
    "grasp_curve",
    "grid_faces",
    "grid_mesh",
    "hydrostatic_load",
    "import_object",
    "linear_features",
    "linear_tetrahedra",
    "liquid_level_m",
    "load_container",
    "load_map",
    "load_object",
    "load_plan",
    "material",
    "mesh_container",
    "nearest_value",
    "nonlinear_features",
    "normalised",
    "object_map",
    "object_stiffness",
    "opposing_points",
    "pinch_curve",
    "pinch_stiffness",
    "plan_jobs",
    "plane_stress",
    "plot_map",
    "quadratic_compliance",
    "reach_loads",
    "save_map",
    "side_vertex",
    "solid_stiffness",
    "symmetric_part",
    "tip_loads",
    "tube_mesh",
    "volume_gradient",
    "wall_gap_m",
    "wall_tetrahedra",
    "with_elastic_base",
]

"""How a container gives way: shapes, shells, contents, stiffness maps (Alt 2016, Sec. 6.1)."""

from .material import MATERIALS, IsotropicMaterial, material
from .patches import grid_faces, grid_mesh, tube_mesh
from .shell import ShellMesh, ShellModel, enclosed_volume, plane_stress, volume_gradient

__all__ = [
    "MATERIALS",
    "IsotropicMaterial",
    "ShellMesh",
    "ShellModel",
    "enclosed_volume",
    "grid_faces",
    "grid_mesh",
    "material",
    "plane_stress",
    "tube_mesh",
    "volume_gradient",
]

from .biharmonic import BiharmonicMesh as BiharmonicMesh
from .rbf import RbfSurface as RbfSurface
from .rbf import isosurface as isosurface

from .mesh import SurfaceMesh as SurfaceMesh
from .pipeline import METHODS as METHODS
from .pipeline import Reconstruction as Reconstruction
from .pipeline import reconstruct as reconstruct

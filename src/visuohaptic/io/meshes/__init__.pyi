from .mesh import FORMATS as FORMATS
from .mesh import TriangleMesh as TriangleMesh
from .mesh import load_mesh as load_mesh
from .ply import PlyMesh as PlyMesh
from .ply import read_ply as read_ply
from .ply import write_ply as write_ply

from .mesh import SurfaceMesh as SurfaceMesh
from .pipeline import Reconstruction as Reconstruction
from .pipeline import measured_noise as measured_noise
from .pipeline import reconstruct as reconstruct
from .pipeline import sequence_noise as sequence_noise
from .plots import plot_completion as plot_completion
from .plots import plot_reconstruction as plot_reconstruction

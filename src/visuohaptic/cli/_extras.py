"""The optional libraries: which extra brings them, and what they are for."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import MissingExtraError, VisuohapticError

__all__ = ["CORE", "OPTIONAL", "Library", "library_of", "missing_library_error"]


@dataclass(frozen=True, slots=True)
class Library:
    """One library that somebody else maintains."""

    module: str  #: name to import
    package: str  #: name on the package index
    extra: str  #: extra of visuohaptic that brings it; empty for the core
    purpose: str  #: what is missing without it
    trial: str = ""  #: Python statements that show that it works, not only that it imports


CORE = (
    Library("numpy", "numpy", "", "arrays"),
    Library("scipy", "scipy", "", "optimisation and splines"),
    Library("numba", "numba", "", "compiled kernels"),
    Library(
        "cv2",
        "opencv-python-headless",
        "",
        "images",
        "import numpy; assert cv2.imencode('.jpg', numpy.zeros((8, 8), numpy.uint8))[0]",
    ),
    Library("pydantic", "pydantic", "", "configuration files"),
    Library("yaml", "PyYAML", "", "configuration files"),
    Library("jaxtyping", "jaxtyping", "", "array types"),
    Library("rich", "rich", "", "progress bars"),
    Library("shapely", "shapely", "", "footprints and regions", "shapely.box(0, 0, 1, 1).buffer(1.0)"),
    Library("threadpoolctl", "threadpoolctl", "", "one thread where threads only wait for each other"),
)

OPTIONAL = (
    Library("av", "av", "recording", "video files"),
    Library("mcap", "mcap", "recording", "MCAP recordings"),
    Library("mcap_ros2", "mcap-ros2-support", "recording", "ROS 2 messages in MCAP recordings"),
    Library("pyarrow", "pyarrow", "recording", "Parquet tables", "import pyarrow.parquet"),
    Library("sqlalchemy", "SQLAlchemy", "database", "databases of objects"),
    Library("psycopg", "psycopg", "shared", "databases that robots share"),
    Library("uvc", "pupil-labs-uvc", "live", "live UVC cameras with fixed focus and exposure"),
    Library("sklearn", "scikit-learn", "learn", "training of the colour model", "import sklearn.mixture"),
    Library(
        "matplotlib",
        "matplotlib",
        "plot",
        "plots and reports",
        "matplotlib.use('Agg'); import matplotlib.pyplot as plt; plt.figure().canvas.draw()",
    ),
    Library(
        "mujoco",
        "mujoco",
        "sim",
        "the simulation and the demo",
        "m = mujoco.MjModel.from_xml_string('<mujoco/>'); mujoco.mj_step(m, mujoco.MjData(m))",
    ),
    Library("viser", "viser", "view", "the browser page"),
    Library("trimesh", "trimesh", "geometry", "meshes in and out"),
    Library("skimage", "scikit-image", "geometry", "surfaces of volumes", "import skimage.measure"),
    Library("robust_laplacian", "robust-laplacian", "geometry", "distances on rough meshes"),
    Library("small_gicp", "small-gicp", "geometry", "registration of point clouds"),
    Library("embreex", "embreex", "geometry", "fast ray casting", "import embreex.rtcore_scene"),
    Library("cholespy", "cholespy", "elastic", "fast solves with many loads"),
    Library("distributed", "distributed", "cluster", "builds over several machines"),
    Library("skfem", "scikit-fem", "elastic", "solid elements"),
    Library("zenoh", "eclipse-zenoh", "ros", "live ROS 2", "zenoh.KeyExpr('0/chatter')"),
    Library("pyrealsense2", "pyrealsense2", "realsense", "live RealSense depth cameras"),
    Library("pyorbbecsdk", "pyorbbecsdk2", "orbbec", "live Orbbec depth cameras"),
    Library("collada", "pycollada", "geometry", "COLLADA meshes"),
)


def library_of(module: str) -> Library | None:
    """The library that a module belongs to, by its first name."""
    first = module.partition(".")[0]
    return next((library for library in (*CORE, *OPTIONAL) if library.module == first), None)


def missing_library_error(error: ImportError, verb: str) -> VisuohapticError:
    """Say what to install when importing a verb failed."""
    module = error.name or "unknown"
    library = library_of(module)
    if library is not None and library.extra:
        return MissingExtraError(library.package, library.extra, f"visuohaptic {verb}")
    if library is not None:
        return VisuohapticError(
            f"{verb}: the package '{library.package}' cannot be imported ({error}); "
            f"run: pip install --force-reinstall {library.package}"
        )
    return VisuohapticError(f"{verb}: cannot be loaded ({error}); run: visuohaptic doctor")

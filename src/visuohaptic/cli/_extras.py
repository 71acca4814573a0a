"""Optional libraries: their extras and purposes, and which of them a command line needs."""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from types import ModuleType

from ..core.errors import MissingExtraError, VisuohapticError


@dataclass(frozen=True, slots=True)
class Library:
    """One third-party library."""

    module: str  #: name to import
    package: str  #: name on the package index
    extra: str  #: extra of visuohaptic that installs it; empty for the core
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
    Library("lazy_loader", "lazy-loader", "", "names that load at first use"),
    Library("rich", "rich", "", "progress bars"),
    Library("shapely", "shapely", "", "footprints and regions", "shapely.box(0, 0, 1, 1).buffer(1.0)"),
    Library("threadpoolctl", "threadpoolctl", "", "one thread where threads only wait for each other"),
)

OPTIONAL = (
    Library("av", "av", "recording", "video files"),
    Library("mcap", "mcap", "recording", "MCAP recordings"),
    Library("mcap_ros2", "mcap-ros2-support", "recording", "ROS 2 messages in MCAP recordings"),
    Library("pyarrow", "pyarrow", "tables", "Parquet tables", "import pyarrow.parquet"),
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
        "mujoco-core",
        "sim",
        "simulation or demo",
        "m = mujoco.MjModel.from_xml_string('<mujoco/>'); mujoco.mj_step(m, mujoco.MjData(m))",
    ),
    Library("viser", "viser", "view", "the browser page"),
    Library("trimesh", "trimesh", "geometry", "meshes in and out"),
    Library("skimage", "scikit-image", "geometry", "surfaces of volumes", "import skimage.measure"),
    Library("robust_laplacian", "robust-laplacian", "geometry", "distances on rough meshes"),
    Library("small_gicp", "small-gicp", "geometry", "registration of point clouds"),
    Library("distributed", "distributed", "cluster", "long work on several machines"),
    Library("skfem", "scikit-fem", "elastic", "solid elements"),
    Library("zenoh", "eclipse-zenoh", "ros", "live ROS 2", "zenoh.KeyExpr('0/chatter')"),
    Library("rclpy", "ros-jazzy-rclpy", "ros-jazzy", "nodes of ROS 2 over DDS"),
    Library("rmw_fastrtps_cpp", "ros-jazzy-rmw-fastrtps-cpp", "ros-jazzy", "DDS of ROS 2"),
    Library("std_srvs", "ros-jazzy-common-interfaces", "ros-jazzy", "messages of ROS 2"),
    Library("cyclonedds", "cyclonedds", "dds", "DDS without ROS", "import cyclonedds.domain"),
    Library("pyrealsense2", "pyrealsense2", "realsense", "live RealSense depth cameras"),
    Library("pyorbbecsdk", "pyorbbecsdk2", "orbbec", "live Orbbec depth cameras"),
    Library("collada", "pycollada", "geometry", "COLLADA meshes"),
)

#: Modules that an argument needs when it is given, with every verb that has it.
BY_ARGUMENT: Mapping[str, tuple[str, ...]] = {
    "cluster": ("distributed",),
    "page": ("matplotlib",),
    "parquet": ("pyarrow",),
    "plot": ("matplotlib",),
    "view": ("viser",),
}

#: Modules that a file name needs by its ending, to be read or written.
BY_ENDING: Mapping[str, tuple[str, ...]] = {
    ".mcap": ("mcap_ros2",),
    ".avi": ("av",),
    ".mkv": ("av",),
    ".mov": ("av",),
    ".mp4": ("av",),
    ".webm": ("av",),
}

#: Modules that a source needs by the maker of its camera.
BY_MAKER: Mapping[str, str] = {"realsense": "pyrealsense2", "orbbec": "pyorbbecsdk"}


def needs(module: ModuleType, args: argparse.Namespace) -> frozenset[str]:
    """Optional modules that a verb imports with these arguments.

    These are the verb's own ``NEEDS``, what its function ``needs(args)`` adds, and what arguments of all verbs need
    by their name, by the maker of a camera or, for files, by their suffix. Meshes are not among them: they are read
    first, and their reader reports what is missing.

    Parameters
    ----------
    module
        Of the verb.
    args
        As parsed.
    """
    found = set(getattr(module, "NEEDS", ()))
    if more := getattr(module, "needs", None):
        found.update(more(args))
    for name, value in vars(args).items():
        if value:
            found.update(BY_ARGUMENT.get(name, ()))
        for text in map(str, value if isinstance(value, list) else [value]):
            if name == "source" and (module_of_maker := BY_MAKER.get(text.partition(":")[0])):
                found.add(module_of_maker)
            # A topic may follow the file, as in run.mcap:/camera.
            found.update(*(modules for ending, modules in BY_ENDING.items() if _ends(text, ending)))
    return frozenset(found)


def _ends(text: str, ending: str) -> bool:
    return text.lower().partition(":/")[0].endswith(ending)


def compiling(module: ModuleType, args: argparse.Namespace) -> AbstractContextManager[object]:
    """Compilation, in another process, of the kernels that a verb needs last; nothing if they are in the cache.

    Parameters
    ----------
    module
        Of the verb, with ``KERNELS`` or ``kernels(args)``, or none of them.
    args
        As parsed.
    """
    named = module.kernels(args) if hasattr(module, "kernels") else getattr(module, "KERNELS", ())
    if not named:
        return nullcontext()
    from ._compilation import compiling_in_background

    return compiling_in_background(named)


def check_needs(verb: str, module: ModuleType, args: argparse.Namespace) -> None:
    """Check that all required extras are installed, before anything is computed.

    Parameters
    ----------
    verb
        Its words, for the message.
    module
        Of the verb.
    args
        As parsed.

    Raises
    ------
    VisuohapticError
        With all packages that are not installed, and the line that installs them.
    """
    missing = [
        library
        for library in OPTIONAL
        if library.module in needs(module, args) and not _is_there(library.module)
    ]
    if missing:
        raise _missing(verb, missing)


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:
        return False


def _missing(verb: str, libraries: Iterable[Library]) -> VisuohapticError:
    libraries = list(libraries)
    if len(libraries) == 1:
        return MissingExtraError(libraries[0].package, libraries[0].extra, f"visuohaptic {verb}")
    packages = ", ".join(f"'{library.package}'" for library in libraries)
    extras = ",".join(dict.fromkeys(library.extra for library in libraries))
    return VisuohapticError(
        f"visuohaptic {verb} needs the packages {packages}, which are not installed; "
        f"run: pip install 'visuohaptic[{extras}]'"
    )


def library_of(module: str) -> Library | None:
    """The library that a module belongs to, by its first name.

    Parameters
    ----------
    module
        Dotted name of a module.
    """
    first = module.partition(".")[0]
    return next((library for library in (*CORE, *OPTIONAL) if library.module == first), None)


def missing_library_error(error: ImportError, verb: str) -> VisuohapticError:
    """The error for a failed import, with the command that installs what is missing.

    Parameters
    ----------
    error
        Of the import.
    verb
        Its words, for the message.
    """
    module = error.name or "unknown"
    library = library_of(module)
    if library is not None and library.extra:
        return _missing(verb, [library])
    if library is not None:
        return VisuohapticError(
            f"{verb}: the package '{library.package}' cannot be imported ({error}); "
            f"run: pip install --force-reinstall {library.package}"
        )
    return VisuohapticError(f"{verb}: cannot be loaded ({error}); run: visuohaptic doctor")

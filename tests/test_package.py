"""The public names exist, and importing the package is cheap."""

from __future__ import annotations

import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import visuohaptic

MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(visuohaptic.__path__, "visuohaptic.")
    if "._" not in module.name
)

#: Libraries that belong into the function that uses them.
HEAVY = {
    "av",
    "cv2",
    "matplotlib",
    "mcap",
    "mcap_ros2",
    "mujoco",
    "pyarrow",
    "sklearn",
    "uvc",
    "viser",
    "zenoh",
}


@pytest.mark.parametrize("name", ["visuohaptic", *MODULES])
def test_every_public_name_exists(name):
    module = importlib.import_module(name)
    names = getattr(module, "__all__", [])
    assert len(names) == len(set(names)), f"{name}.__all__ repeats a name"
    missing = [public for public in names if not hasattr(module, public)]
    assert not missing, f"{name}.__all__ lists {missing}"


def test_importing_the_package_is_free():
    script = "import sys, visuohaptic; print(*sys.modules)"
    loaded = set(
        subprocess.run(
            [sys.executable, "-c", script], check=True, capture_output=True, text=True
        ).stdout.split()
    )
    assert not loaded & (HEAVY | {"numpy", "scipy", "numba", "pydantic", "yaml"})


@pytest.mark.parametrize(
    "name",
    sorted(
        path.parent.name
        for path in Path(visuohaptic.__file__).parent.glob("*/__init__.py")
        if path.parent.name not in ("cli", "demo", "rigs", "reproduce")
    ),
)
def test_packages_leave_heavy_libraries_to_their_functions(name):
    script = f"import sys, visuohaptic.{name}; print(*sys.modules)"
    loaded = set(
        subprocess.run(
            [sys.executable, "-c", script], check=True, capture_output=True, text=True
        ).stdout.split()
    )
    assert not loaded & HEAVY


def test_the_version_is_semantic():
    assert re.fullmatch(r"\d+\.\d+\.\d+(-[0-9A-Za-z.-]+)?", visuohaptic.__version__)

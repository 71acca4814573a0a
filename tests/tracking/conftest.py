"""Rendered views of a plane, shared by the tests of the planar tracker."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def views() -> ModuleType:
    """``benchmarks/_plane_view.py``: the same truth for tests and benchmarks."""
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "_plane_view.py"
    spec = importlib.util.spec_from_file_location("plane_view", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["plane_view"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module

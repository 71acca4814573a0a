"""Rendered views of a plane, shared by the tests of the planar tracker."""

from __future__ import annotations

from types import ModuleType

import pytest

from benchmarks import _plane_view


@pytest.fixture(scope="session")
def views() -> ModuleType:
    """``benchmarks/_plane_view.py``: the same truth for tests and benchmarks."""
    return _plane_view

"""Shared by all tests: location of real recordings, run-time checks of array shapes."""

from __future__ import annotations

import gc
import os
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# One run is as another, on a busy machine too; ``python -m benchmarks.laws`` looks for other examples.
settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")

ROOT = Path(__file__).resolve().parents[1]


def data_folder() -> Path | None:
    """Folder of the real recordings, if there is one."""
    named = os.environ.get("VISUOHAPTIC_DATA")
    candidates = [Path(named)] if named else [ROOT.parent / "shared" / "data"]
    return next((folder for folder in candidates if folder.is_dir()), None)


@pytest.fixture(scope="session")
def data() -> Path:
    """The real recordings; the test says so when they are absent."""
    folder = data_folder()
    if folder is None:
        pytest.skip("real recordings not found: set VISUOHAPTIC_DATA or put them into ../shared/data")
    return folder


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Folders in which the examples of the command line were run, each once in a session."""
    from tests.cli.test_help_examples import World

    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("VISUOHAPTIC_OBJECTS", raising=False)
        yield World(tmp_path_factory.mktemp("examples"))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, Any, Any]:
    """No garbage collection while modules are imported, and none of what they define afterwards.

    A full collection visits every live object. A quarter of the CPU time of collecting these tests was that.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_report_header() -> str:
    """One line at the top of every run."""
    folder = data_folder()
    return f"real recordings: {folder if folder else 'absent, their tests are skipped'}"

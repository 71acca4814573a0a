"""Shared by all tests: location of real recordings, and examples that are run once."""

from __future__ import annotations

import gc
import logging
import os
from collections.abc import Generator, Iterator
from pathlib import Path
from random import Random
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
    """Folders in which the examples of the command line were run, each once in a session, whichever worker runs it."""
    from tests.cli.test_help_examples import World, fcntl

    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ and fcntl is not None:
        base = base.parent  # that of the session, which has a folder for each worker
    folder = base / "examples"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("VISUOHAPTIC_OBJECTS", raising=False)
        yield World(folder)


@pytest.fixture
def example_foam(world: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """``write_example`` copies what the example of the command line has rendered from the same seed."""
    from visuohaptic import rigs
    from visuohaptic.rigs.foam_example import write_example

    assert write_example.__kwdefaults__["seed"] == 1, "as the verb's --seed"
    world.run("example foam")  # it calls what is replaced
    monkeypatch.setattr(rigs, "write_example", world.copy_recording)


@pytest.fixture
def fewer_explorations() -> Iterator[None]:
    """For tests that show something else than how well probabilities are calibrated."""
    from tests.explorations import explored_less

    with explored_less():
        yield


@pytest.fixture(autouse=True)
def library_log() -> None:
    """Undo what the command line does to the library's log in this process: otherwise ``caplog`` depends on the order of tests."""
    logger = logging.getLogger("visuohaptic")
    logger.handlers.clear()
    logger.setLevel(logging.NOTSET)
    logger.propagate = True
    logging.getLogger("visuohaptic.core.kernels.compiler").setLevel(logging.NOTSET)


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


def pytest_addoption(parser: pytest.Parser) -> None:
    """A random order of tests."""
    told = "files, and tests in each of them, in the random order of a seed: none must need another one"
    parser.addoption("--shuffle", type=int, default=None, metavar="SEED", help=told)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Shuffle the files and their tests; the tests of a file stay together, so that its fixtures are made once."""
    seed = config.getoption("--shuffle")
    if seed is not None:
        files = list(dict.fromkeys(item.path for item in items))
        random = Random(seed)
        random.shuffle(files)
        place = {path: number for number, path in enumerate(files)}
        random.shuffle(items)
        items.sort(key=lambda item: place[item.path])


def pytest_report_header() -> str:
    """One line at the top of every run."""
    folder = data_folder()
    return f"real recordings: {folder if folder else 'absent, their tests are skipped'}"

"""Plugin of pytest that stores the branches that each file of tests executes, in a data file of coverage.py of its own.

It imports nothing of this project, so that the modules that are measured are imported under measurement. Processes that
tests start measure themselves: they find a ``sitecustomize`` that starts coverage.py, and their data count for the file of tests.
:mod:`benchmarks.branch_coverage` starts pytest with ``-p benchmarks._covered``.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coverage
import pytest

__all__ = ["IMPORTED", "VARIABLE"]

#: Environment variable with the arguments of the plugin (JSON).
VARIABLE = "COVERED"
#: Environment variable with the data file of processes that tests start.
_DATA = "COVERED_DATA"
#: Data of what is executed while the tests are imported.
IMPORTED = "imported"


class _Measured:
    """Measures one file of tests after the other.

    Parameters
    ----------
    config
        Configuration file of coverage.py.
    files
        Data file by file of tests; of others no test is run.
    seconds
        CPU time after which no file is begun [s].
    """

    def __init__(self, config: str, files: dict[str, str], seconds: float) -> None:
        self._config, self._files, self._end_s = config, files, time.process_time() + seconds
        self._folder = tempfile.TemporaryDirectory()  # removed with this process
        child, start = Path(self._folder.name, "config"), Path(self._folder.name, "sitecustomize.py")
        run = f"[run]\ndata_file = ${{{_DATA}}}\nparallel = true\nsigterm = true\n"
        child.write_text(Path(config).read_text(encoding="utf-8").replace("[run]\n", run), encoding="utf-8")
        start.write_text("import coverage\n\ncoverage.process_startup()\n", encoding="utf-8")
        path = os.pathsep.join([self._folder.name, os.environ.get("PYTHONPATH", "")])
        os.environ.update(COVERAGE_PROCESS_START=str(child), PYTHONPATH=path)
        self._begin(IMPORTED)

    def _begin(self, name: str) -> None:
        self._path = Path(self._files[name])
        os.environ[_DATA] = f"{self._path}.child"
        self._coverage = coverage.Coverage(
            data_file=f"{self._path}.part", config_file=self._config, messages=False
        )
        self._coverage.start()

    def _end(self) -> None:
        self._coverage.stop()
        self._coverage.save()
        whole = f"{self._path}.whole"
        together = coverage.Coverage(data_file=whole, config_file=self._config, messages=False)
        children = self._path.parent.glob(f"{self._path.name}.child.*")
        together.combine([f"{self._path}.part", *map(str, children)])
        together.save()
        Path(whole).replace(self._path)

    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        """Keep the tests of the files."""
        kept = [item for item in items if _file(item) in self._files]
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = kept
        self._end()
        if kept:
            self._begin(_file(kept[0]))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
        """After the last test of a file its data are stored."""
        result: Any = yield
        if nextitem is None or _file(nextitem) != _file(item):
            self._end()
            if time.process_time() > self._end_s:
                item.session.shouldstop = "the time of this slice is over"
            elif nextitem is not None:
                self._begin(_file(nextitem))
        return result


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]


def pytest_configure(config: pytest.Config) -> None:
    """Begin before the first module is imported."""
    config.pluginmanager.register(_Measured(**json.loads(os.environ.pop(VARIABLE))))

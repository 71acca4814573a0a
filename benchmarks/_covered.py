"""Plugin of pytest that stores the branches that each file of tests executes, in a data file of coverage.py of its own.

It imports nothing of this project, so that the modules that are measured are imported under measurement.
:mod:`benchmarks.branch_coverage` starts pytest with ``-p benchmarks._covered``.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coverage
import pytest

__all__ = ["IMPORTED", "VARIABLE"]

#: Environment variable with the arguments of the plugin (JSON).
VARIABLE = "COVERED"
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
        self._begin(IMPORTED)

    def _begin(self, name: str) -> None:
        self._path = Path(self._files[name])
        self._coverage = coverage.Coverage(
            data_file=f"{self._path}.part", config_file=self._config, messages=False
        )
        self._coverage.start()

    def _end(self) -> None:
        self._coverage.stop()
        self._coverage.save()
        Path(f"{self._path}.part").replace(self._path)

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

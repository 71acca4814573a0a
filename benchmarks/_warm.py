"""Runs tests in forks of a process that has imported the libraries already, and the modules that a change does not affect.

Importing takes longer than most tests do. Started by :mod:`benchmarks.constants` beside a copy of
:mod:`benchmarks._mutant` named ``sitecustomize.py``, with a JSON list of the libraries as its argument. Each line of
its input is an order (JSON): ``hidden``, the module that is to be changed (or None); ``modules``, those that the tests
import; and ``runs``, each with ``tests`` of pytest, its ``options``, ``seconds`` of CPU time, and ``order``, the instruction
for :mod:`benchmarks._mutant`. A module is imported once for all runs if that succeeds without the hidden one. Each
run is answered by a line with ``code`` of pytest (None when its time was over), the end of its ``output``, ``seconds``
of CPU time and ``marks``, the texts that its processes left; an order ends with a line ``null``. After a run without
instruction that fails no other is made.

Uses only the standard library and no other file of this folder. Requires Linux.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import select
import signal
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

#: A run that waits for others ends after so many times its CPU time.
_PATIENCE = 6.0


def _import(names: Iterable[str]) -> None:
    for name in names:
        with suppress(Exception):  # a library that is not installed, or a module that needs the hidden one
            importlib.import_module(name)
    gc.collect()
    gc.freeze()  # a collection in a fork would copy every page


@contextmanager
def _hidden(name: str | None) -> Iterator[None]:
    """Within the context a module cannot be imported."""
    if name is not None:
        sys.modules[name] = None
    try:
        yield
    finally:
        if name is not None:
            del sys.modules[name]


def _fork(work: Callable[[], int]) -> int:
    """Process that does some work, as the leader of a group of its own."""
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        os.setsid()
        code = work()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _tested(run: dict[str, Any], place: Path) -> int:
    """Exit code of pytest, in a fork."""
    import pytest
    import sitecustomize  # type: ignore[import-not-found]

    seconds = int(run["seconds"]) + 1
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    output = os.open(place / "output", os.O_WRONLY | os.O_CREAT)
    os.dup2(output, 1)
    os.dup2(output, 2)
    order = run["order"] | {"marks": str(place / "marks")}
    os.environ |= {sitecustomize.VARIABLE: json.dumps(order), "NUMBA_CACHE_DIR": str(place)}
    if (numba := sys.modules.get("numba")) is not None:
        numba.config.CACHE_DIR = str(place)  # read when it was imported
    finish = sitecustomize.start(order)
    try:
        return int(pytest.main([*run["options"], *run["tests"]]))
    finally:
        finish()


def _answered(run: dict[str, Any]) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "marks").mkdir()
        child = _fork(lambda: _tested(run, place))
        watch = os.pidfd_open(child)
        ended, _, _ = select.select([watch], [], [], _PATIENCE * run["seconds"] + 10.0)
        os.close(watch)
        with suppress(ProcessLookupError):  # and what its tests have left running
            os.killpg(child, signal.SIGKILL)
        _, status, used = os.wait4(child, 0)
        code: int | None = os.waitstatus_to_exitcode(status)
        if not ended or code in (-signal.SIGXCPU, -signal.SIGKILL):
            code = None
        output = place / "output"
        return {
            "code": code,
            "output": output.read_text(errors="replace")[-4000:] if output.exists() else "",
            "seconds": round(used.ru_utime + used.ru_stime, 2),
            "marks": [mark.read_text(encoding="utf-8") for mark in (place / "marks").glob("*.mark")],
        }


def _all_answered(order: dict[str, Any], answers: TextIO) -> int:
    with _hidden(order["hidden"]):
        _import(order["modules"])
    for run in order["runs"]:
        answer = _answered(run)
        print(json.dumps(answer), file=answers, flush=True)
        if not run["order"] and answer["code"] not in (0, 5):
            break
    return 0


def main() -> None:
    """Serve until the input ends."""
    orders, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    _import(json.loads(sys.argv[1]))
    for line in orders:
        os.waitpid(_fork(lambda line=line: _all_answered(json.loads(line), answers)), 0)
        print("null", file=answers, flush=True)


if __name__ == "__main__":
    main()

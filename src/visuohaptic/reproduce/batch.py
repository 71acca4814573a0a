"""Many experiments, several at a time, each in a process of its own, and the table of what they cost."""

from __future__ import annotations

import csv
import io
import logging
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.files import write_text
from .runner import EXPERIMENTS, ExperimentOutcome, known_name, reproduce

__all__ = ["cores", "reproduce_all", "write_costs"]

#: Experiments that share a long computation: one after the other, the first makes it for all.
TOGETHER: tuple[tuple[str, ...], ...] = (("figure-6.6", "figure-6.7", "table-6.1", "table-6.2"),)
#: What takes longest starts first, so that none is left alone at the end.
EXPENSIVE: tuple[str, ...] = (
    "figure-5.8",
    "table-4.1",
    "figure-6.6",
    "figure-3.8",
    "figure-5.6",
    "figure-5.7",
    "figure-3.13",
)
#: One thread for each process: libraries that all take every core wait for each other.
THREADS: Mapping[str, str] = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "OPENCV_FOR_THREADS_NUM",
    ),
    "1",
)

log = logging.getLogger(__name__)


def cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def reproduce_all(
    names: Sequence[str],
    folder: Path | str,
    *,
    seed: int = 0,
    quick: bool = False,
    force: bool = False,
    jobs: int = 1,
    on_done: Callable[[ExperimentOutcome], None] | None = None,
) -> list[ExperimentOutcome]:
    """Run experiments into ``folder`` and write ``experiments.csv`` there.

    Parameters
    ----------
    names
        See :func:`.reproduce`.
    folder, seed, quick, force
        As there.
    jobs
        How many run at a time. With more than one each has its own process with one thread; one that
        dies does not stop the others.
    on_done
        Called here, with each as it is done.

    Returns
    -------
    list of ExperimentOutcome
        In the order of ``names``.

    Raises
    ------
    InputError
        A name is not known, or ``jobs`` is less than one.
    """
    if jobs < 1:
        raise InputError("reproduce", f"found {jobs}, expected at least 1", field="jobs")
    wanted = list(dict.fromkeys(known_name(name) for name in names))
    Path(folder).mkdir(parents=True, exist_ok=True)
    options: dict[str, Any] = {"seed": seed, "quick": quick, "force": force}
    found: dict[str, ExperimentOutcome] = {}
    runs = _here(wanted, folder, options) if jobs == 1 else _spread(_units(wanted), folder, options, jobs)
    for outcome in runs:
        found[outcome.name] = outcome
        # After each one: what is known when the run is interrupted is kept.
        write_costs(folder, found)
        if on_done is not None:
            on_done(outcome)
    return [found[name] for name in wanted]


def write_costs(folder: Path | str, found: Mapping[str, ExperimentOutcome]) -> Path:
    """Write ``experiments.csv``: name, wall and CPU time, whether there is a result, and why not.

    Parameters
    ----------
    folder
        Of the results.
    found
        How each experiment went, by name.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("name", "wall_s", "cpu_s", "ok", "kept", "problem"))
    for name in EXPERIMENTS:
        if name in found:
            one = found[name]
            times = (f"{one.seconds:.2f}", f"{one.cpu_seconds:.2f}")
            writer.writerow((name, *times, not one.problem, one.kept, one.problem))
    path = Path(folder) / "experiments.csv"
    write_text(path, text.getvalue())
    return path


def _here(
    names: Sequence[str], folder: Path | str, options: Mapping[str, Any]
) -> Iterator[ExperimentOutcome]:
    for name in names:
        yield reproduce(name, folder, **options)


def _units(names: Sequence[str]) -> list[list[str]]:
    """What one process does: single experiments, or those that share something; the most expensive first."""
    units: list[list[str]] = [[name for name in group if name in names] for group in TOGETHER]
    grouped = {name for unit in units for name in unit}
    units = [unit for unit in units if unit] + [[name] for name in names if name not in grouped]
    rank = {name: place for place, name in enumerate(EXPENSIVE)}
    return sorted(units, key=lambda unit: min(rank.get(name, len(rank)) for name in unit))


def _spread(
    units: Sequence[list[str]], folder: Path | str, options: Mapping[str, Any], jobs: int
) -> Iterator[ExperimentOutcome]:
    """Outcomes as they come; a thread waits for each process."""
    alive: set[BaseProcess] = set()
    with _one_thread(), ThreadPoolExecutor(jobs) as pool:
        left = {pool.submit(_in_process, unit, str(folder), options, alive) for unit in units}
        try:
            while left:
                done, left = wait(left, return_when=FIRST_COMPLETED)
                for future in done:
                    yield from future.result()
        finally:  # done, or interrupted
            pool.shutdown(wait=False, cancel_futures=True)
            for process in tuple(alive):
                process.terminate()


def _in_process(
    names: list[str], folder: str, options: Mapping[str, Any], alive: set[BaseProcess]
) -> list[ExperimentOutcome]:
    """Run them in a fresh process, and say so if it dies."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(sender, names, folder, dict(options)))
    process.start()
    alive.add(process)
    sender.close()
    outcomes: list[ExperimentOutcome] = []
    try:
        while len(outcomes) < len(names):
            outcomes.append(receiver.recv())
    except EOFError:
        log.debug("process of %s ended early", names)
    process.join()
    alive.discard(process)
    for name in names[len(outcomes) :]:
        problem = f"its process ended with code {process.exitcode}"
        outcomes.append(ExperimentOutcome(name, Path(folder) / name, 0.0, problem=problem))
    return outcomes


def _work(sender: Connection, names: list[str], folder: str, options: dict[str, Any]) -> None:
    import signal

    # Ctrl-C is for the process that was started by hand; this one is ended by it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in names:
        sender.send(reproduce(name, folder, **options))


@contextmanager
def _one_thread() -> Iterator[None]:
    """Environment of processes that are started meanwhile."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(THREADS)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

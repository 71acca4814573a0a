"""Independent tasks of one function, executed in this process, in worker processes, or on a cluster.

A task is one picklable argument, and its result depends on that argument alone: results are identical to the byte
wherever and however often they are computed. Three measures ensure this: BLAS uses one thread in every worker, a worker with
other versions of the numerical libraries is rejected, and the death of a worker only causes its task to be repeated.
Results are yielded as they complete, so that the caller can store each of them and resume after an interruption.

The cluster is a ``dask.distributed`` scheduler. Anyone who can connect to it can run code on its workers: it belongs in a
separate network, or behind TLS (``docs/howto/cluster.md``).
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import platform
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar
from urllib.parse import urlsplit

from .._version import __version__
from .errors import InputError, VisuohapticError, needs
from .resources import one_blas_thread

Task = TypeVar("Task")
Result = TypeVar("Result")

_log = logging.getLogger(__name__)

#: Maximum deaths of workers per task, and consecutive losses of the scheduler: a machine that restarts or is temporarily
#: short of memory needs one or two, a task that kills every worker must end.
MAX_DEATHS = 3
#: Time-outs of the connection to the scheduler: initially, and while it restarts [s].
CONNECT_S, RECONNECT_S = 20.0, 120.0
#: One thread per process: libraries that all use every core slow each other down.
_THREADS: Mapping[str, str] = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "OPENCV_FOR_THREADS_NUM",
    ),
    "1",
)
#: Tasks change global state of the process (BLAS threads, plots, times): one at a time per process.
_turn = threading.Lock()


def available_cores() -> int:
    """Number of cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not available on every system
        return os.cpu_count() or 1


def map_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    *,
    name: str,
    workers: int | str = 1,
    hosts: Sequence[str] | None = None,
    on_death: Callable[[Task, str], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Yield the results of independent tasks as they complete.

    Parameters
    ----------
    function
        Module-level function, so that other processes can import it.
    tasks
        Arguments of the function; started in this order.
    name
        Description of the work, for messages, like "objects build".
    workers
        Number of processes on this machine; 1 computes in this process. With more, a script needs ``if __name__ == "__main__":``.
        Or the address of a ``dask.distributed`` scheduler, like ``tcp://10.0.0.1:8786``; its workers may join and leave.
    hosts
        On a cluster, the host on which each task has to run; any if omitted.
    on_death
        Returns the result of a task that killed :data:`MAX_DEATHS` workers, from the task and the reason.

    Yields
    ------
    tuple
        Index of the task, and its result.

    Raises
    ------
    InputError
        ``workers`` is less than 1, no scheduler responds, or a worker has other versions than this process.
    VisuohapticError
        A task failed, or killed its workers and there is no ``on_death``. Results yielded before are valid.

    Examples
    --------
    >>> sorted(map_tasks(abs, [-1.0, 2.0], name="example"))
    [(0, 1.0), (1, 2.0)]
    """
    if not isinstance(workers, str) and workers < 1:
        raise InputError(name, f"found {workers}, expected at least 1", field="workers")

    def given_up(number: int, reason: str) -> tuple[int, Result]:
        if on_death is None:
            raise VisuohapticError(
                f"{name}: {reason} with task {number + 1} of {len(tasks)}; "
                "use fewer workers or give them more memory, and run it again to resume"
            )
        return number, on_death(tasks[number], reason)

    if isinstance(workers, str):
        yield from _on_cluster(function, tasks, name, workers, hosts, given_up)
    elif workers == 1 or len(tasks) <= 1:
        for number, task in enumerate(tasks):
            with one_blas_thread():
                result = function(task)
            yield number, result
    else:
        yield from _in_processes(function, tasks, name, min(workers, len(tasks)), given_up)


def cluster_hosts(address: str) -> list[str]:
    """Hosts on which a cluster has workers; waits for the first worker.

    Parameters
    ----------
    address
        Address of the scheduler.

    Raises
    ------
    InputError
        No scheduler responds, or none of its workers appears within :data:`CONNECT_S`.
    """
    with _connected(address, CONNECT_S) as client:
        try:  # recently started workers need seconds
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError as error:
            raise InputError(
                "cluster",
                f"found no worker at {address} within {CONNECT_S:.0f} s",
                remedy="start at least one: dask worker",
            ) from error
        return sorted({urlsplit(worker).hostname or worker for worker in client.nthreads()})


def _in_processes(
    function: Callable[[Any], Any],
    tasks: Sequence[Any],
    name: str,
    workers: int,
    given_up: Callable[[int, str], tuple[int, Any]],
) -> Iterator[tuple[int, Any]]:
    waiting, deaths = deque(range(len(tasks))), Counter[int]()
    running: dict[Connection, tuple[BaseProcess, int]] = {}
    idle: list[tuple[Connection, BaseProcess]] = []
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                connection, process = idle.pop() if idle else _started(function)
                running[connection] = process, waiting.popleft()
                try:
                    connection.send(tasks[running[connection][1]])
                except OSError:
                    _log.debug("a worker has died: the end of its pipe reports this below")
            for ready in wait(list(running)):
                assert isinstance(ready, Connection)
                process, number = running.pop(ready)
                try:
                    result, error = ready.recv()
                except (EOFError, OSError):
                    ready.close()
                    process.join()
                    deaths[number] += 1
                    reason = f"its process ended with code {process.exitcode}"
                    _log.warning("%s: task %d: %s", name, number + 1, reason)
                    if deaths[number] < MAX_DEATHS:
                        waiting.append(number)
                    else:
                        yield given_up(number, reason)
                    continue
                idle.append((ready, process))
                if error is not None:
                    raise error
                yield number, result
    finally:  # finished or interrupted
        for process in [process for _, process in idle] + [process for process, _ in running.values()]:
            process.terminate()
            process.join()


def _started(function: Callable[[Any], Any]) -> tuple[Connection, BaseProcess]:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, function), daemon=True)
    with _one_thread():
        process.start()
    theirs.close()
    return ours, process


def _work(connection: Connection, function: Callable[[Any], Any]) -> None:
    """Main loop of a worker process: computes a result for each received task, until the connection closes."""
    import signal

    # Ctrl-C is handled by the main process, which terminates this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        connection.send(_attempt(function, task))


def _attempt(function: Callable[[Any], Any], task: Any) -> tuple[Any, VisuohapticError | None]:
    """The result, or the error in a form that every process can unpickle."""
    with _turn, one_blas_thread():
        try:
            return function(task), None
        except VisuohapticError as error:
            return None, error
        except Exception as error:  # noqa: BLE001 - it is raised again where it is waited for
            _log.debug("in a worker", exc_info=True)
            return None, VisuohapticError(
                f"unexpected {type(error).__name__} in a worker: {error}; "
                "run it again with --workers 1 --verbose to see where"
            )


@contextmanager
def _one_thread() -> Iterator[None]:
    """Environment of processes started inside the block: one thread each."""
    before = {variable: os.environ.get(variable) for variable in _THREADS}
    os.environ.update(_THREADS)
    try:
        yield
    finally:
        for variable, value in before.items():
            if value is None:
                os.environ.pop(variable, None)
            else:
                os.environ[variable] = value


def _on_cluster(
    function: Callable[[Any], Any],
    tasks: Sequence[Any],
    name: str,
    address: str,
    hosts: Sequence[str] | None,
    given_up: Callable[[int, str], tuple[int, Any]],
) -> Iterator[tuple[int, Any]]:
    left, losses, timeout_s = set(range(len(tasks))), 0, CONNECT_S
    while left:
        try:
            with _connected(address, timeout_s) as client:
                if not client.nthreads():
                    _log.warning("%s: %s has no workers yet", name, address)
                for number, future in _futures(client, function, tasks, sorted(left), hosts):
                    found = (
                        given_up(number, "workers died")
                        if future is None
                        else (number, _result(name, future))
                    )
                    left.remove(number)
                    losses = 0
                    yield found
        except _scheduler_lost() as error:
            losses += 1
            timeout_s = RECONNECT_S
            _log.warning(
                "%s: lost the connection to the scheduler at %s; %d tasks are left", name, address, len(left)
            )
            if losses >= MAX_DEATHS:
                raise VisuohapticError(
                    f"{name}: lost the connection to the scheduler at {address} ({type(error).__name__}); "
                    "start it and run it again to resume"
                ) from error


def _futures(
    client: Any,
    function: Callable[[Any], Any],
    tasks: Sequence[Any],
    numbers: Sequence[int],
    hosts: Sequence[str] | None,
) -> Iterator[tuple[int, Any]]:
    """Completed futures by the index of their task; None if its workers died repeatedly."""
    distributed = _distributed()
    by_key: dict[str, int] = {}

    def submitted(number: int) -> Any:
        place: dict[str, Any] = {} if hosts is None else {"workers": [hosts[number]]}
        future = client.submit(_checked, function, tasks[number], _versions(), pure=False, **place)
        by_key[future.key] = number
        return future

    coming = distributed.as_completed([submitted(number) for number in numbers], loop=client.loop)
    suspected: set[int] = set()
    for future in coming:
        number = by_key[future.key]
        if future.status != "error" or not isinstance(future.exception(), distributed.KilledWorker):
            yield number, future
        elif number in suspected:
            yield number, None
        else:  # it may only have been queued with the task that killed the workers
            suspected.add(number)
            coming.add(submitted(number))


def _result(name: str, future: Any) -> Any:
    try:
        result, error = future.result()
    except _scheduler_lost():
        raise
    except Exception as error:
        raise VisuohapticError(
            f"{name}: a worker of the cluster cannot run it ({type(error).__name__}: {error}); "
            "install the same packages there as on this machine"
        ) from error
    if error is not None:
        raise error
    return result


@contextmanager
def _connected(address: str, timeout_s: float) -> Iterator[Any]:
    try:
        client = _distributed().Client(address, timeout=f"{timeout_s:g}s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError("cluster", f"no scheduler answers at {address} ({error})") from error
    with client:
        yield client


def _scheduler_lost() -> tuple[type[BaseException], ...]:
    return OSError, TimeoutError, _distributed().CancelledError


def _distributed() -> Any:
    with needs("distributed", "cluster", "work on a cluster"):
        import distributed
    return distributed


def _checked(
    function: Callable[[Any], Any], task: Any, expected: Mapping[str, str]
) -> tuple[Any, VisuohapticError | None]:
    """Task wrapper on a cluster's worker; checks the versions, since others might compute different bytes."""
    found = _versions()
    if other := [one for one in expected if found.get(one) != expected[one]]:
        return None, InputError(
            "cluster",
            f"a worker on {platform.node()} has {other[0]} {found.get(other[0], 'not at all')}, "
            f"expected {expected[other[0]]} as here",
            remedy="install the same versions on all machines",
        )
    return _attempt(function, task)


@cache
def _versions() -> dict[str, str]:
    """Versions that the bytes of a result may depend on."""
    from importlib.metadata import version

    return {
        "visuohaptic": __version__,
        "Python": ".".join(platform.python_version_tuple()[:2]),
        "machine": platform.machine(),
        **{name: version(name) for name in ("numpy", "scipy", "numba")},
    }

"""A scheduler and one-core workers as processes of this machine, which can be killed and restarted."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

__all__ = ["DaskCluster", "noted_square"]


def noted_square(task: tuple[str, int, float]) -> tuple[int, int]:
    """A task that records its start in a folder, sleeps [s], and returns its square and its process id."""
    folder, number, sleep_s = task
    (Path(folder) / f"{number}-{os.getpid()}").touch()
    time.sleep(sleep_s)
    return number * number, os.getpid()


class DaskCluster:
    """Processes that end with the block; each worker has one thread and no nanny: its process is the one that computes.

    Parameters
    ----------
    workers
        How many are started at once.
    scratch
        Folder of their files.
    environment
        Variables beyond those of this process.
    """

    def __init__(self, workers: int, scratch: Path, environment: dict[str, str] | None = None) -> None:
        with socket.socket() as server:
            server.bind(("127.0.0.1", 0))
            self._port = int(server.getsockname()[1])
        self.address = f"tcp://127.0.0.1:{self._port}"
        self._scratch, self._environment = scratch, environment or {}
        self.workers: list[subprocess.Popen[bytes]] = []
        self._processes: list[subprocess.Popen[bytes]] = []
        self._first = workers

    def __enter__(self) -> Self:
        self.scheduler = self._started("scheduler", "--host", "127.0.0.1", "--port", str(self._port))
        for _ in range(self._first):
            self.add_worker()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes:
            process.kill()
            process.wait()

    def add_worker(self) -> None:
        """Start one more."""
        self.workers.append(self._started("worker", self.address, "--nthreads", "1", "--no-nanny"))

    def kill_worker(self, which: int) -> None:
        """Kill a worker without warning, and start another in its place."""
        process = self.workers.pop(which)
        process.kill()
        process.wait()
        self.add_worker()

    def restart_scheduler(self) -> None:
        """Kill scheduler and workers without warning, and restart both, as a service manager does."""
        count = len(self.workers)
        for process in (self.scheduler, *self.workers):
            process.kill()
            process.wait()
        self.workers.clear()
        self._first = count
        self.__enter__()

    def wait(self) -> None:
        """Wait until the scheduler answers and all workers are connected."""
        import distributed

        with distributed.Client(self.address, timeout="60s", set_as_default=False) as client:
            if self.workers:
                client.wait_for_workers(len(self.workers), timeout=120)

    @staticmethod
    def ports(worker: subprocess.Popen[bytes]) -> list[str]:
        """Ports on which a worker listens."""
        import psutil

        found = psutil.Process(worker.pid).net_connections("tcp")
        return [str(one.laddr.port) for one in found if one.status == psutil.CONN_LISTEN]

    def _started(self, kind: str, *words: str) -> subprocess.Popen[bytes]:
        process: Any = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=self._scratch,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
                 **self._environment},
        )  # fmt: skip
        self._processes.append(process)
        return process

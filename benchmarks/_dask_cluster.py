"""A scheduler and one-core workers as processes of this machine, which can be killed and restarted."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Self

__all__ = ["DaskCluster", "noted_square"]

#: Ends what hangs [s]: processes start late on a busy machine.
_PATIENCE_S = 300.0


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
        self.address = "tcp://127.0.0.1:0"
        self._scratch, self._environment = scratch, environment or {}
        self._own = TemporaryDirectory()
        self.workers: list[subprocess.Popen[bytes]] = []
        self._processes: list[subprocess.Popen[bytes]] = []
        self._first = workers

    def __enter__(self) -> Self:
        # The scheduler chooses its port. A port that was free before could be taken by the first worker,
        # which then listens where it looks for its scheduler: both wait for each other.
        port = self.address.rpartition(":")[2]
        file = Path(self._own.name) / "scheduler.json"
        file.unlink(missing_ok=True)
        words = ("--host", "127.0.0.1", "--port", port, "--scheduler-file", str(file))
        try:
            self.scheduler = self._started("scheduler", *words)
            self.address = self._address(file)
            for _ in range(self._first):
                self.add_worker()
        except BaseException as error:
            self.__exit__(type(error), error, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes:
            process.kill()
            process.wait()
        self._own.cleanup()

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

        try:
            with distributed.Client(self.address, timeout=_PATIENCE_S, set_as_default=False) as client:
                if self.workers:
                    client.wait_for_workers(len(self.workers), timeout=_PATIENCE_S)
        except TimeoutError as error:
            state = f"scheduler {self.scheduler.poll()}, workers {[one.poll() for one in self.workers]}"
            raise TimeoutError(
                f"cluster: no answer ({state}); end of its output: {self.output_end()}"
            ) from error

    @staticmethod
    def ports(worker: subprocess.Popen[bytes]) -> list[str]:
        """Ports on which a worker listens."""
        import psutil

        found = psutil.Process(worker.pid).net_connections("tcp")
        return [str(one.laddr.port) for one in found if one.status == psutil.CONN_LISTEN]

    def _address(self, file: Path, timeout_s: float = _PATIENCE_S) -> str:
        """Address of the scheduler, which writes it when it listens."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s and self.scheduler.poll() is None:
            try:
                return str(json.loads(file.read_text())["address"])
            except (FileNotFoundError, json.JSONDecodeError):
                time.sleep(0.05)
        raise RuntimeError(
            f"scheduler: no address in {timeout_s:g} s; end of its output: {self.output_end()}"
        )

    def output_end(self) -> str:
        """End of the output of all processes."""
        return self._log.read_text(errors="replace")[-2000:]

    @property
    def _log(self) -> Path:
        return Path(self._own.name) / "log.txt"

    def _started(self, kind: str, *words: str) -> subprocess.Popen[bytes]:
        with self._log.open("a") as log:
            process: Any = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"],
                stdout=log,
                stderr=log,
                cwd=self._scratch,
                env={**os.environ, "OMP_NUM_THREADS": "1",
                     "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **self._environment},
            )  # fmt: skip
        self._processes.append(process)
        return process

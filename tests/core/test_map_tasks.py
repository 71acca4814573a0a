"""Tasks run locally, in processes and on a cluster: equal results, even if workers die."""

from __future__ import annotations

import copy
import importlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from benchmarks._dask_cluster import DaskCluster, noted_square

from tests.patience import PATIENCE_S
from visuohaptic.core import InputError, MissingExtraError, VisuohapticError, cluster_hosts, map_tasks

SQUARES = [number * number for number in range(6)]


def _tasks(folder: Path, sleep_s: float = 0.0) -> list[tuple[str, int, float]]:
    folder.mkdir(exist_ok=True)
    return [(str(folder), number, sleep_s) for number in range(len(SQUARES))]


def _when_begun(folder: Path, count: int) -> list[int]:
    """Processes of the tasks that have begun, as soon as there are enough of them."""
    deadline = time.monotonic() + PATIENCE_S
    while len(found := list(folder.iterdir())) < count:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return [int(path.name.partition("-")[2]) for path in found]


def _squares(found: Iterator[tuple[int, tuple[int, int]]]) -> list[int]:
    return [square for _, (square, _process) in sorted(found)]


def _refuse(task: int) -> int:
    raise InputError("task", f"found {task}, expected none", remedy="ask for less")


def _divide(task: int) -> float:
    return 1 / task


def _end(task: int) -> int:
    if task == 2:
        os._exit(7)
    return task


def test_processes_give_the_results_of_one(tmp_path: Path) -> None:
    here = list(map_tasks(noted_square, _tasks(tmp_path / "here"), name="test"))
    assert [number for number, _ in here] == list(range(6))
    there = list(map_tasks(noted_square, _tasks(tmp_path / "there"), name="test", workers=2))
    assert _squares(iter(here)) == _squares(iter(there)) == SQUARES
    assert {process for _, (_, process) in here} == {os.getpid()}
    assert os.getpid() not in {process for _, (_, process) in there}


def _held(task: tuple[str, int, float]) -> tuple[int, int]:
    """As ``noted_square``; but it does not end before the test has killed a process, however long that takes."""
    found = noted_square(task)
    deadline = time.monotonic() + PATIENCE_S
    while not Path(task[0]).with_suffix(".killed").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return found


def test_a_killed_process_costs_a_repetition_only(tmp_path: Path) -> None:
    folder = tmp_path / "tasks"
    tasks = _tasks(folder)

    def kill() -> None:
        try:
            os.kill(_when_begun(folder, 2)[0], signal.SIGKILL)
        finally:
            folder.with_suffix(".killed").touch()

    killer = threading.Thread(target=kill)
    killer.start()
    assert _squares(map_tasks(_held, tasks, name="test", workers=2)) == SQUARES
    killer.join()
    assert len(list(folder.iterdir())) == len(SQUARES) + 1  # one of them twice


def test_a_task_that_no_process_survives_is_given_up_and_the_others_are_done() -> None:
    found = dict(
        map_tasks(_end, range(4), name="test", workers=2, on_death=lambda task, reason: f"{task}: {reason}")
    )
    assert found == {0: 0, 1: 1, 2: "2: its process ended with code 7", 3: 3}
    with pytest.raises(
        VisuohapticError, match=r"test: its process ended with code 7 with task 3 of 4; use fewer"
    ):
        list(map_tasks(_end, range(4), name="test", workers=2))


def test_errors_of_tasks_are_raised_here_and_whole() -> None:
    for workers in (1, 2):
        with pytest.raises(InputError, match=r"found \d, expected none; ask for less") as caught:
            list(map_tasks(_refuse, range(2), name="test", workers=workers))
        assert caught.value.remedy == "ask for less"
    with pytest.raises(
        VisuohapticError, match="unexpected ZeroDivisionError in a worker: division by zero; run it"
    ):
        list(map_tasks(_divide, [0, 1], name="test", workers=2))
    with pytest.raises(InputError, match="test: workers: found 0"):
        list(map_tasks(_divide, [1], name="test", workers=0))
    missing = MissingExtraError("distributed", "cluster", "work on a cluster")
    assert str(copy.copy(missing)) == str(missing)


def test_a_worker_killed_and_the_scheduler_restarted_change_nothing(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="pip install 'visuohaptic[cluster]'")
    folder = tmp_path / "tasks"
    tasks = _tasks(folder, 0.3)
    with DaskCluster(2, tmp_path) as cluster:
        cluster.wait()  # on a busy machine its processes take long
        assert cluster_hosts(cluster.address) == ["127.0.0.1"]

        def disturb() -> None:
            _when_begun(folder, 2)
            cluster.kill_worker(0)
            _when_begun(folder, 4)
            cluster.restart_scheduler()

        disturber = threading.Thread(target=disturb)
        disturber.start()
        found = list(map_tasks(noted_square, tasks, name="test", workers=cluster.address))
        disturber.join()
        assert sorted(number for number, _ in found) == list(range(6))  # each once
        assert _squares(iter(found)) == SQUARES
        # A host of that name is there: the task goes to it.
        placed = map_tasks(noted_square, tasks[:1], name="test", workers=cluster.address, hosts=["127.0.0.1"])
        assert _squares(placed) == SQUARES[:1]


def test_a_worker_with_other_versions_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from visuohaptic.core.map_tasks import _checked, _versions

    other = {**_versions(), "numpy": "1.0"}
    value, error = _checked(abs, -1, other)
    assert value is None
    assert "has numpy" in str(error)
    assert "expected 1.0 as here; install the same versions on all machines" in str(error)
    assert _checked(abs, -1, _versions()) == (1, None)


def test_workers_that_are_late_are_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="pip install 'visuohaptic[cluster]'")
    with DaskCluster(0, tmp_path) as cluster:
        cluster.wait()
        module = importlib.import_module("visuohaptic.core.map_tasks")
        with monkeypatch.context() as patched:
            patched.setattr(module, "CONNECT_S", 5.0)
            with pytest.raises(
                InputError, match=r"cluster: found no worker at tcp://.*; start at least one: dask"
            ):
                cluster_hosts(cluster.address)
        cluster.add_worker()
        monkeypatch.setattr(module, "CONNECT_S", 120.0)
        assert cluster_hosts(cluster.address) == ["127.0.0.1"]


def test_an_address_without_a_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="pip install 'visuohaptic[cluster]'")
    with pytest.raises(InputError, match=r"cluster: no scheduler answers at nonsense://1 \("):
        list(map_tasks(abs, [1], name="test", workers="nonsense://1"))

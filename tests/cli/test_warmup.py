"""The warm-up calls what is there and skips what is not."""

from __future__ import annotations

import importlib
import importlib.util
import json
import sys
import types
from pathlib import Path

import pytest
from numba.core.event import install_recorder

from visuohaptic.cli import main as command
from visuohaptic.cli import warmup


def test_it_times_each_package(monkeypatch, capsys):
    called = []
    module = types.ModuleType("some_package._warmup")
    module.warmup = lambda: called.append(1)
    monkeypatch.setitem(sys.modules, "some_package._warmup", module)
    monkeypatch.setattr(
        warmup, "WARMUPS", ("some_package._warmup:warmup", "visuohaptic.absent._warmup:warmup")
    )
    assert command.main(["warmup", "--json"]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert called == [1]
    assert list(result["seconds"]) == ["some_package"]
    assert result["total_s"] == pytest.approx(sum(result["seconds"].values()))
    assert "compiled or read from the cache" in captured.err


@pytest.mark.parametrize("entry", warmup.WARMUPS)
def test_each_warm_up_runs_and_compiles_nothing_twice(entry):
    """The second run finds every kernel ready: the first has left nothing to its chance."""
    name, _, function = entry.partition(":")
    if importlib.util.find_spec(name) is None:
        pytest.skip(f"{name} is not part of this version")
    run = getattr(importlib.import_module(name), function)
    run()
    with install_recorder("numba:compile") as recorder:
        run()
    assert recorder.buffer == []


def test_a_fault_inside_a_warm_up_is_not_skipped(tmp_path, monkeypatch, capsys):
    (tmp_path / "broken_warmup.py").write_text("import no_such_library")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(warmup, "WARMUPS", ("broken_warmup:warmup",))
    assert command.main(["warmup"]) == 1
    assert "no_such_library" in capsys.readouterr().err


def test_every_package_with_kernels_has_a_warm_up():
    """Grasping, recognition and tasks have no kernels of their own: they call those of the packages below."""
    root = Path(warmup.__file__).parents[1]
    with_kernels = {path.parent for path in root.rglob("*.py") if "@numba.njit" in path.read_text()}
    warmed = {root.parent / Path(*entry.partition(":")[0].split(".")[:-1]) for entry in warmup.WARMUPS}
    assert with_kernels <= warmed

"""Installations on a minimal machine: what cannot be tried is told with its reason."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from benchmarks.bare import trial


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() != 0, reason="only root can become another user")
def test_an_interpreter_that_another_user_may_not_start_is_not_tried(tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    (locked / "bin").mkdir(parents=True)
    (locked / "bin" / "python").symlink_to(sys.executable)
    locked.chmod(0o700)
    (tmp_path / "runs" / "one").mkdir(parents=True)
    found = trial(
        locked / "bin" / "visuohaptic", "read-only", [("--help", "none")], tmp_path / "runs" / "one"
    )
    assert found["tried"] == 0
    assert found["why"] == f"another user may not start {Path(sys.executable).resolve()}"


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize(
    ("script", "said", "limit_s"),
    [("exit 127", "exit status 127", 60.0), ("sleep 60", "timed out after", 0.5)],
)
def test_an_interpreter_that_does_not_start_for_another_user_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, said: str, limit_s: float
) -> None:
    """It lacks a library there, or hangs."""
    monkeypatch.setattr("benchmarks.bare.PROBE_S", limit_s)
    above = [folder for folder in tmp_path.parents if folder.name.startswith(("pytest-", "popen-"))]
    for folder in (tmp_path, *above):
        folder.chmod(0o755)
    python = tmp_path / "bin" / "python"
    python.parent.mkdir()
    python.write_text(f"#!/bin/sh\nexec {script}\n".replace("exec exit", "exit"))
    python.chmod(0o755)
    (tmp_path / "runs" / "one").mkdir(parents=True)
    found = trial(
        python.with_name("visuohaptic"), "read-only", [("--help", "none")], tmp_path / "runs" / "one"
    )
    assert found["tried"] == 0
    assert f"{python} does not start for another user" in found["why"]
    assert said in found["why"]

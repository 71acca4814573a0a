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

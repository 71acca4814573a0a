"""Hostile input in a separate process: 2 GB of memory, 20 s of CPU time, and only a one-line InputError is accepted."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

from tests.patience import PATIENCE_S

_ROOM_BYTES = 2 << 30
#: CPU time [s]: that of a busy machine is the same.
_CPU_S = 20


def _in_small_room() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_ROOM_BYTES, _ROOM_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, _CPU_S))


def refusal(call: str, path: Path) -> str:
    """What ``call`` says when it refuses; fails when it accepts, crashes, or takes its time.

    ``call`` is "module:expression", where ``path`` stands for the file.
    """
    module, _, expression = call.partition(":")
    name = expression.partition("(")[0].partition(".")[0]
    script = (
        "import os, sys; os.environ['OPENBLAS_NUM_THREADS'] = '1'\n"
        "from pathlib import Path\n"
        "from visuohaptic.core.errors import InputError\n"
        f"from {module} import {name}\n"
        "path = Path(sys.argv[1])\n"
        f"try:\n    {expression}\n"
        "except InputError as error:\n    print(error)\nelse:\n    sys.exit('accepted')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        preexec_fn=_in_small_room,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("\n") == 1, done.stdout[:2000]
    assert len(done.stdout) < 1000, "a message, not a dump"
    assert path.name in done.stdout, "which file?"
    return done.stdout

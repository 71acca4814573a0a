"""How long ``visuohaptic --help`` takes, from nothing to the prompt.

Wall time of a fresh process, because that is what a person waits for. The
peer is a fresh process that only imports NumPy: what the command would cost
at least if it were not lazy.
"""

from __future__ import annotations

import subprocess
import sys
import time
from typing import Any

from .harness import median

REPEATS = 15


def run() -> list[dict[str, Any]]:
    """Time both in turn, so that the machine's load is the same for both."""
    ours, peer = [], []
    script = "import sys; from visuohaptic.cli.main import main; sys.exit(main(['--help']))"
    for _ in range(REPEATS):
        ours.append(_wall_s(script))
        peer.append(_wall_s("import numpy"))
    row = {
        "name": "visuohaptic --help",
        "ours": median(ours),
        "peer": median(peer),
        "peer_name": "python -c 'import numpy'",
        "unit": "s",
        "floor": 0.5,
        "aim": 0.25,
        "note": f"wall, median of {REPEATS}, slowest {max(ours):.3f}",
    }
    return [row]


def _wall_s(script: str) -> float:
    started_s = time.perf_counter()
    subprocess.run([sys.executable, "-c", script], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started_s

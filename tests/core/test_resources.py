"""Memory that images take as they pass through threads: reused, and no more than is held at once; memory that a process may use."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from pathlib import Path

import pytest

from visuohaptic.core.resources import memory_bytes

#: Four receivers and a reader, as in a node: 40 images of 1.4 MB, of which at most four wait; then the memory that is taken from the
#: system during 400 more.
_NODE = """
import queue, resource, threading
from visuohaptic.core.resources import reuse_memory
reuse_memory()
waiting = queue.Queue(4)
def receive(count):
    for number in range(count):
        waiting.put(bytes(1_433_600))
def run(count):
    receivers = [threading.Thread(target=receive, args=(count // 4,)) for _ in range(4)]
    for one in receivers:
        one.start()
    for _ in range(count):
        bytearray(waiting.get())
    for one in receivers:
        one.join()
def taken_MB():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt * resource.getpagesize() / 1e6
run(40)
before = taken_MB()
run(400)
print(taken_MB() - before)
"""


@pytest.mark.skipif(
    not hasattr(ctypes.CDLL(None) if sys.platform == "linux" else None, "gnu_get_libc_version"),
    reason="needs glibc",
)
def test_images_reuse_the_memory_of_earlier_ones() -> None:
    done = subprocess.run([sys.executable, "-c", _NODE], capture_output=True, text=True, check=True)
    # At most ten images are held at once: four wait, one of each receiver, two of the reader. Without the call, 400 images take 46 MB
    # and more; with it 0.02 MB.
    assert float(done.stdout) < 10 * 1.4336


def _system(root: Path, groups: str, **limits: str) -> Path:
    """A system with control groups: its list of this process, and files by their place below ``/sys/fs/cgroup``."""
    (root / "proc/self").mkdir(parents=True)
    (root / "proc/self/cgroup").write_text(groups)
    for place, text in limits.items():
        path = root / "sys/fs/cgroup" / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.mark.parametrize(
    ("groups", "limits", "expected"),
    [
        ("", {}, 8e9),
        ("0::/\n", {"memory.max": "2000000000\n"}, 2e9),
        ("0::/\n", {"memory.max": "max\n"}, 8e9),
        ("0::/\n", {"memory.max": "64000000000\n"}, 8e9),
        # A service within a limited slice; the narrowest holds.
        ("0::/a/b\n", {"a/memory.max": "1000000000\n", "a/b/memory.max": "3000000000\n"}, 1e9),
        # Not of this process.
        ("0::/a\n", {"b/memory.max": "1000000000\n"}, 8e9),
        # Version 1; the path is that of the host, the mount that of the container.
        ("5:cpu:/x\n4:memory:/docker/1f\n", {"memory/memory.limit_in_bytes": "5000000000\n"}, 5e9),
        ("4:cpu,memory:/x\n0::/\n", {"memory/x/memory.limit_in_bytes": "9223372036854771712\n"}, 8e9),
        ("no such format\n4:memory\n", {"memory.max": "1"}, 8e9),
        ("0::/\n", {"memory.max": "\0damaged"}, 8e9),
    ],
)
def test_a_container_has_the_memory_of_its_control_group(tmp_path, monkeypatch, groups, limits, expected):
    monkeypatch.setattr("os.sysconf", {"SC_PHYS_PAGES": 2_000_000, "SC_PAGE_SIZE": 4000}.get)
    assert round(memory_bytes(_system(tmp_path, groups, **limits)) - expected) == 0

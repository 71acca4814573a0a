"""Context managers: resources held during a ``with`` block (device, file, thread), and BLAS limited to one thread; memory.

Starting threads for a matrix of fifty rows costs more than the computation, up to a hundred times
on a busy machine. It is better to distribute objects and grasps over cores.
"""

from __future__ import annotations

import logging
import math
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, Self

_log = logging.getLogger(__name__)

#: Time-out for a thread that was asked to end [s]; the search of a travel ends within 6 s.
WAIT_S = 8.0


class Closing(ABC):
    """A resource closed at the end of its ``with`` block, also after an error, so that partial results are kept."""

    __slots__ = ()

    @abstractmethod
    def close(self) -> None:
        """Release the resource."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def end_thread(thread: threading.Thread) -> bool:
    """Wait until a thread has ended that was asked to; one that a device or a network holds is left behind, and logged.

    Parameters
    ----------
    thread
        May be the calling one, which ends later by itself.

    Returns
    -------
    bool
        It is not running any more.
    """
    if thread is threading.current_thread():
        return False
    thread.join(WAIT_S)
    if thread.is_alive():
        _log.error("%s: still computing after %g s; its result is dropped", thread.name, WAIT_S)
    return not thread.is_alive()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread inside the block; no effect without ``threadpoolctl``."""
    controller = _controller()
    if controller is None:
        yield
        return
    with controller.limit(limits=1, user_api="blas"):
        yield


@cache
def _controller() -> Any:
    import scipy.linalg.blas  # noqa: F401 - its library has to be loaded to be found

    try:
        from threadpoolctl import ThreadpoolController
    except ImportError:
        return None
    return ThreadpoolController()


#: Numbers of parameters in glibc's ``malloc.h``.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8


def reuse_memory() -> None:
    """Let this process reuse freed memory instead of returning it to the system; no effect without glibc.

    Called by long-running processes before they start threads. By default, glibc has one arena for every few threads. An image passes
    through several threads, and each arena keeps the memory of as many images as were ever allocated from it at once, so that a process
    can still grow after hours. With one arena, and with the limits of mallopt(3) for the thresholds that glibc adapts, the memory is
    that of the most images held at once by the whole process, and its pages are not cleared again for each image.
    """
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # macOS, musl; Windows
        return
    max_block = 4 * 1024 * 1024 * ctypes.sizeof(ctypes.c_long)  # DEFAULT_MMAP_THRESHOLD_MAX
    mallopt(_M_ARENA_MAX, 1)
    mallopt(_M_MMAP_THRESHOLD, max_block)
    mallopt(_M_TRIM_THRESHOLD, 2 * max_block)  # the ratio that glibc itself keeps


def memory_bytes(root: Path = Path("/")) -> float:
    """Memory that this process may use: that of the machine, or less where a container or a service is limited.

    Parameters
    ----------
    root
        Where ``proc`` and ``sys`` are mounted.

    Returns
    -------
    float
        The smallest limit [bytes]; infinite where the system reports none, as Windows.
    """
    try:
        least: float = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        least = math.inf
    groups = ""
    with suppress(OSError, ValueError):
        groups = (root / "proc/self/cgroup").read_text(encoding="utf-8")
    mounted = root / "sys/fs/cgroup"
    for line in groups.splitlines():
        # cgroups(7): ID:CONTROLLERS:PATH, without controllers in version 2. Every group above counts; inside a container the
        # path may be that of the host, and the container's own group is mounted at the top.
        _, controllers, path = line.split(":", 2) if line.count(":") >= 2 else ("", "none", "")
        if "memory" in controllers.split(","):
            top, name = mounted / "memory", "memory.limit_in_bytes"
        elif not controllers:
            top, name = mounted, "memory.max"
        else:
            continue
        group = PurePosixPath(path.lstrip("/"))
        for above in (group, *group.parents):
            # No such file, or ``max``: no limit.
            with suppress(OSError, ValueError):
                least = min(least, int((top / above / name).read_text(encoding="ascii")))
    return least

"""Child processes that are killed without warning at a chosen point of their work.

A fork has the libraries loaded already, so that a trial takes a tenth of a second. The point is chosen in two ways:

- after a CPU time: the same amount of work, independent of the load of the machine;
- at a size of a file: the kernel kills the process inside the ``write`` that exceeds it, whichever code calls it.
"""

from __future__ import annotations

import os
import resource
import signal
import traceback
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Say", "Victim"]

#: A child that runs longer than this hangs, and is killed by SIGALRM [s].
MAX_S = 600

#: Sends a line to the parent: its contents have been acknowledged.
Say = Callable[[str], object]


@dataclass(frozen=True, slots=True)
class Victim:
    """A child that works until it is killed."""

    pid: int
    reader: int  #: end of the pipe to which it says lines

    @classmethod
    def start(cls, work: Callable[[Say], object], *, cpu_s: float = 0.0, file_bytes: int = 0) -> Victim:
        """Fork.

        Parameters
        ----------
        work
            What the child does, given how to say a line.
        cpu_s
            Time of the processor after which it is killed [s]; 0: never.
        file_bytes
            It is killed when a file becomes larger [bytes]; 0: never.
        """
        reader, writer = os.pipe()
        pid = os.fork()
        if pid:
            os.close(writer)
            return cls(pid, reader)
        code = 1
        try:
            os.close(reader)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(MAX_S)
            if file_bytes:
                signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
                resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
            if cpu_s:
                signal.signal(signal.SIGPROF, signal.SIG_DFL)
                signal.setitimer(signal.ITIMER_PROF, cpu_s)
            work(lambda line: os.write(writer, f"{line}\n".encode()))
            code = 0
        finally:
            # A fork must never return into its parent's stack frames.
            if code:
                traceback.print_exc()
            os._exit(code)

    def end(self) -> tuple[list[str], int]:
        """Complete lines sent before the end, and the exit status: 0, an exit code, or minus the signal."""
        with os.fdopen(self.reader) as pipe:
            lines = [line[:-1] for line in pipe if line.endswith("\n")]
        return lines, os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])

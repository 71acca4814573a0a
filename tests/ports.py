"""Ports of this machine for servers that tests start."""

from __future__ import annotations

import itertools
import os
import socket
from pathlib import Path

#: The ports that the system hands out to sockets without one begin here.
_RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")
_FIRST = 20_000
#: Processes start this far apart, more than one of them uses: workers of one session do not meet.
_APART = 251
_next = itertools.count(os.getpid() * _APART)


def free_port() -> int:
    """A port on which nobody listens, below those of the system: no other process gets it before its server starts."""
    last = int(_RANGE.read_text().split()[0]) if _RANGE.is_file() else 32_768
    if last - _FIRST < _APART:
        last = 32_768
    for number in itertools.islice(_next, last - _FIRST):
        port = _FIRST + number % (last - _FIRST)
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port
    raise OSError(f"no free port from {_FIRST} to {last}")

"""What every message carries beside its bytes: its number, its time and who sent it.

rmw_zenoh gives up a whole process when it cannot read an attachment. So one layout is written, that of
version 0.2.4 and later, which all releases of Humble, Kilted and Rolling have; both known ones are read.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Self

from ...core.errors import InputError

__all__ = ["Attachment"]

_LAYOUT = struct.Struct("<qqB16s")
#: The first releases for Jazzy put the name of each part in front of it.
_NAMED = struct.Struct("<16sq17sq11sB16s")
_NAMES = (b"\x0fsequence_number", b"\x10source_timestamp", b"\x0asource_gid")


@dataclass(frozen=True, slots=True)
class Attachment:
    """Beside a message."""

    sequence: int  #: counts the messages of a publisher from 1
    source_ns: int  #: when it was sent [ns since 1970]
    gid: bytes  #: 16 bytes that no other publisher has

    def pack(self) -> bytes:
        """33 bytes."""
        return _LAYOUT.pack(self.sequence, self.source_ns, len(self.gid), self.gid)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """From either layout.

        Parameters
        ----------
        data
            Of a message.

        Raises
        ------
        InputError
            It is neither.
        """
        if len(data) == _LAYOUT.size:
            sequence, source_ns, length, gid = _LAYOUT.unpack(data)
            if length == 16:
                return cls(sequence, source_ns, gid)
        elif len(data) == _NAMED.size:
            first, sequence, second, source_ns, third, length, gid = _NAMED.unpack(data)
            if (first, second, third) == _NAMES and length == 16:
                return cls(sequence, source_ns, gid)
        raise InputError("attachment", f"found {len(data)} bytes, {data[:20]!r}, expected that of rmw_zenoh")

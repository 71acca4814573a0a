"""Attachment of every message: its number, its time and its sender.

rmw_zenoh terminates the whole process if it cannot read an attachment. Therefore only one layout is written, that of
version 0.2.4 and later, used by all releases of Humble, Kilted and Rolling; both known ones are read.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Self

from ...core.errors import InputError

_LAYOUT = struct.Struct("<qqB16s")
#: The first releases for Jazzy precede each part with its name.
_NAMED = struct.Struct("<16sq17sq11sB16s")
_NAMES = (b"\x0fsequence_number", b"\x10source_timestamp", b"\x0asource_gid")


@dataclass(frozen=True, slots=True)
class Attachment:
    """Attachment of a message."""

    sequence: int  #: message number of the publisher, from 1
    source_ns: int  #: sending time [ns since 1970]
    gid: bytes  #: 16-byte unique id of the publisher

    def pack(self) -> bytes:
        """Serialise to 33 bytes."""
        return _LAYOUT.pack(self.sequence, self.source_ns, len(self.gid), self.gid)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Deserialise either layout.

        Parameters
        ----------
        data
            Attachment of a message.

        Raises
        ------
        InputError
            It has neither layout.
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

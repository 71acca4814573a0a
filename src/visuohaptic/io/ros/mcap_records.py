"""MCAP files read record by record, so that all intact data of a truncated or damaged file can be read.

The readers of the ``mcap`` package stop at the first problem; a robot that was
switched off leaves a file without footer and often with a partial chunk at its
end. Layout of the format: https://mcap.dev/spec.
"""

from __future__ import annotations

import logging
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

from ...core.errors import InputError, MissingExtraError, needs
from ...core.files import MAX_DATA_BYTES, read_head

_log = logging.getLogger(__name__)

#: First bytes of a file.
MCAP_MAGIC = b"\x89MCAP0\r\n"
#: First bytes of data packed by zstandard; CDR begins with zero.
_ZSTD = b"\x28\xb5\x2f\xfd"
#: Bytes to which each byte of a file may unpack, all parts together, beyond one part of full size: what deflate reaches with
#: zeros. zstandard packs zeros ten times as densely, so that a megabyte would keep a reader busy for ten gigabytes.
_UNPACKED_PER_BYTE = 1032
#: Frames that are out of order in a file are sorted within this number of messages.
REORDER = 64
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER = 0x03, 0x04, 0x05, 0x06, 0x02


class McapMessage(NamedTuple):
    """One recorded message."""

    topic: str
    datatype: str  #: ROS 2 name such as ``sensor_msgs/msg/Image``; empty without schema
    log_time_ns: int
    sequence: int
    data: bytes  #: CDR
    channel: int
    schema: int


@dataclass(frozen=True, slots=True)
class Topic:
    """Summary of a topic in a file."""

    name: str
    datatype: str
    messages: int
    bytes: int
    start_s: float  #: time of the first message on the recorder's clock
    stop_s: float  #: time of the last message


@dataclass(slots=True)
class McapDamage:
    """Data that could not be read; updated while a file is read."""

    cut: bool = False  #: the file ends before its footer
    lost_bytes: int = 0  #: at the end of a truncated file
    chunks: list[str] = field(default_factory=list)  #: damaged chunks: position and problem

    def __bool__(self) -> bool:
        return self.cut or bool(self.chunks)

    def __str__(self) -> str:
        parts = []
        if self.cut:
            parts.append(
                f"the file ends before its footer, {self.lost_bytes} bytes at its end are not a record"
            )
        parts += self.chunks
        return "; ".join(parts) if parts else "none"


@dataclass(frozen=True, slots=True)
class RecordedSchema:
    """Definition of a message type."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class RecordedChannel:
    """A topic as written by one recorder."""

    topic: str
    schema: int
    encoding: str


class McapFile:
    """Messages of an MCAP file in file order.

    Parameters
    ----------
    path
        MCAP file.

    Raises
    ------
    InputError
        The file is missing or does not start as MCAP.
    """

    kind = "MCAP"

    def __init__(self, path: Path | str) -> None:
        self._clear(path)
        head = read_head(self.path, len(MCAP_MAGIC))
        if head != MCAP_MAGIC:
            raise InputError(path, f"begins with {head!r}, expected an MCAP file")

    def _clear(self, path: Path | str) -> None:
        self.path = Path(path)
        self.parts = [self.path]  #: files that make up the recording
        self.damage = McapDamage()
        self.schemas: dict[int, RecordedSchema] = {}
        self.channels: dict[int, RecordedChannel] = {}
        self._decoders: dict[int, Any] = {}
        self._budget = 0  # bytes that may still be unpacked

    def messages(self, topics: set[str] | None = None) -> Iterator[McapMessage]:
        """All intact messages of the selected topics; afterwards, ``damage`` describes what was lost.

        Parameters
        ----------
        topics
            Topics to read; all by default.
        """
        self.begin()
        with self.path.open("rb") as stream:
            size = stream.seek(0, 2)
            stream.seek(len(MCAP_MAGIC))
            for opcode, body in self._records(stream, size):
                if opcode == _CHUNK:
                    yield from self._chunk(body, topics, stream.tell() - len(body))
                elif opcode in (_SCHEMA, _CHANNEL, _MESSAGE):
                    yield from self._record(opcode, body, topics)
        if self.damage:
            _log.warning("%s is damaged: %s", self.path, self.damage)

    def begin(self) -> None:
        """Forget the damage that was found, before the recording is read once more."""
        self.damage = McapDamage()
        self._budget = MAX_DATA_BYTES + _UNPACKED_PER_BYTE * sum(part.stat().st_size for part in self.parts)

    def _spend(self, size: int) -> None:
        """Reject a part that unpacks to more than any, or with those before it to more than the file may."""
        if size > MAX_DATA_BYTES:
            raise ValueError(f"declares {size} bytes, expected at most {MAX_DATA_BYTES}")
        if size > self._budget:
            raise ValueError(
                f"declares {size} bytes, and the file unpacks to more than {_UNPACKED_PER_BYTE} times its size"
            )
        self._budget -= size

    def _records(self, stream: IO[bytes], size: int) -> Iterator[tuple[int, bytes]]:
        """Records of the file's top level; large records that are not needed are skipped unread."""
        while True:
            place = stream.tell()
            head = stream.read(9)
            if len(head) < 9:
                self.damage.cut, self.damage.lost_bytes = True, size - place
                return
            opcode, length = struct.unpack("<BQ", head)
            if opcode == _FOOTER:
                return
            if length > size - place - 9:
                self.damage.cut, self.damage.lost_bytes = True, size - place
                if opcode == _CHUNK and size - place <= MAX_DATA_BYTES:
                    yield opcode, stream.read()
                return
            if opcode not in (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK):
                stream.seek(length, 1)
            elif length > MAX_DATA_BYTES:
                self.spoilt(f"record at byte {place} has {length} bytes, expected at most {MAX_DATA_BYTES}")
                stream.seek(length, 1)
            else:
                yield opcode, stream.read(length)

    def _record(self, opcode: int, body: bytes, topics: set[str] | None) -> Iterator[McapMessage]:
        try:
            if opcode == _SCHEMA:
                (number,) = struct.unpack_from("<H", body)
                name, place = _text(body, 2)
                encoding, place = _text(body, place)
                (length,) = struct.unpack_from("<I", body, place)
                self.schemas[number] = RecordedSchema(name, encoding, body[place + 4 : place + 4 + length])
            elif opcode == _CHANNEL:
                number, schema = struct.unpack_from("<HH", body)
                topic, place = _text(body, 4)
                encoding, place = _text(body, place)
                self.channels[number] = RecordedChannel(topic, schema, encoding)
            else:
                number, sequence, log_time, _ = struct.unpack_from("<HIQQ", body)
                known = self.channels.get(number)
                if known is None:
                    self.spoilt(f"a message names channel {number}, which is not defined")
                elif topics is None or known.topic in topics:
                    schema_of = self.schemas.get(known.schema)
                    name = schema_of.name if schema_of else ""
                    if (data := self.unpacked(body[22:], known, sequence)) is not None:
                        yield McapMessage(known.topic, name, log_time, sequence, data, number, known.schema)
        except (struct.error, UnicodeDecodeError) as error:
            self.spoilt(f"a record of kind {opcode} is too short or no text ({error})")

    def _chunk(self, body: bytes, topics: set[str] | None, place: int) -> Iterator[McapMessage]:
        try:
            data = self._unpacked(body)
        except (ValueError, struct.error, UnicodeDecodeError) as error:
            self.spoilt(f"chunk at byte {place}: {error}")
            return
        start = 0
        while start + 9 <= len(data):
            opcode, length = struct.unpack_from("<BQ", data, start)
            if start + 9 + length > len(data):
                break
            yield from self._record(opcode, data[start + 9 : start + 9 + length], topics)
            start += 9 + length
        if start < len(data) and not self.damage.cut:
            self.spoilt(f"chunk at byte {place}: its last {len(data) - start} bytes are not a record")

    def _unpacked(self, body: bytes) -> bytes:
        """Records of a chunk; from a truncated chunk, as much as can be decompressed."""
        unpacked, checksum = struct.unpack_from("<QI", body, 16)
        compression, start = _text(body, 28)
        (length,) = struct.unpack_from("<Q", body, start)
        self._spend(unpacked)
        packed = body[start + 8 : start + 8 + length]
        whole = len(packed) == length
        if not whole and not self.damage.cut:
            raise ValueError(f"has {len(packed)} of {length} bytes")
        data = _decompress(compression, packed, unpacked, self.path, whole=whole)
        if whole and len(data) != unpacked:
            raise ValueError(f"unpacks to {len(data)} bytes, expected {unpacked}")
        if whole and checksum and zlib.crc32(data) != checksum:
            raise ValueError("its checksum is wrong")
        return data

    def unpacked(self, data: bytes, channel: RecordedChannel, sequence: int) -> bytes | None:
        """Bytes of a message, which rosbag2 packs one by one in its compression mode "message".

        Parameters
        ----------
        data
            As recorded.
        channel
            Channel of the message; only CDR is distinguished from packed data, by its first byte.
        sequence
            Number of the message, for the report.

        Returns
        -------
        :
            ``None`` if they cannot be unpacked; ``damage`` has the reason.
        """
        if channel.encoding != "cdr" or data[:4] != _ZSTD:
            return data
        try:
            return self._whole_frame(data)
        except ValueError as error:
            self.spoilt(f"message {sequence} of {channel.topic}: {error}")
            return None

    def _whole_frame(self, packed: bytes) -> bytes:
        """Decompress a frame that states its size; one that is cut, or unpacks to another size, raises :class:`ValueError`."""
        with needs("zstandard", "recording", f"reading {self.path}"):
            import zstandard
        try:
            size = zstandard.frame_content_size(packed)
            if size < 0:
                raise ValueError("states no size")
            self._spend(size)
            # A stream would return what there is of a frame that is cut, without an error.
            return zstandard.ZstdDecompressor().decompress(packed)
        except zstandard.ZstdError as error:
            raise ValueError(f"cannot be unpacked ({error})") from error

    def spoilt(self, problem: str) -> None:
        """Record a damaged section.

        Parameters
        ----------
        problem
            Position and problem.
        """
        # A bound on the memory that random data can fill with messages.
        if len(self.damage.chunks) < 100:
            self.damage.chunks.append(problem)

    def topics(self) -> list[Topic]:
        """Topics with message counts, sorted by name; reads the whole file."""
        found: dict[tuple[str, str], list[int]] = {}
        for message in self.messages():
            entry = found.setdefault(
                (message.topic, message.datatype), [0, 0, message.log_time_ns, message.log_time_ns]
            )
            entry[0] += 1
            entry[1] += len(message.data)
            entry[2] = min(entry[2], message.log_time_ns)
            entry[3] = max(entry[3], message.log_time_ns)
        return [
            Topic(name, datatype, count, size, first * 1e-9, last * 1e-9)
            for (name, datatype), (count, size, first, last) in sorted(found.items())
        ]

    def decode(self, message: McapMessage) -> Any:
        """Decode the fields of a ROS 2 message.

        Parameters
        ----------
        message
            A message of this file.

        Raises
        ------
        InputError
            It has no ``ros2msg`` schema, or its bytes do not match the schema.
        """
        where = f"{self.path}:{message.topic}"
        decoder = self._decoders.get(message.channel)
        try:
            if decoder is None:
                decoder = self._decoder(message, where)
                self._decoders[message.channel] = decoder
            return decoder(message.data)
        except InputError:
            raise
        except Exception as error:
            raise InputError(
                where, f"message at {message.log_time_ns} ns is damaged ({type(error).__name__})"
            ) from error

    def _decoder(self, message: McapMessage, where: str) -> Any:
        with needs("mcap-ros2-support", "recording", "reading MCAP"):
            from mcap.records import Schema
            from mcap_ros2.decoder import DecoderFactory
        schema = self.schemas.get(message.schema)
        channel = self.channels[message.channel]
        if schema is None or schema.encoding != "ros2msg" or channel.encoding != "cdr":
            found = f"schema {schema.encoding!r}" if schema else "no schema"
            raise InputError(
                where, f"found {found} and {channel.encoding!r} messages, expected ros2msg and cdr"
            )
        return DecoderFactory().decoder_for(
            "cdr", Schema(message.schema, schema.data, schema.encoding, schema.name)
        )


def _text(body: bytes, place: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", body, place)
    if place + 4 + length > len(body):
        raise struct.error("the string is truncated")
    return body[place + 4 : place + 4 + length].decode("utf-8"), place + 4 + length


def _decompress(compression: str, packed: bytes, unpacked: int, path: Path, *, whole: bool) -> bytes:
    """Decompress at most ``unpacked`` bytes; a decompression bomb raises :class:`ValueError`."""
    if compression == "":
        return packed
    try:
        if compression == "zstd":
            import zstandard

            reader = zstandard.ZstdDecompressor().stream_reader(BytesIO(packed), read_across_frames=True)
            return _read_some(reader, unpacked, zstandard.ZstdError, whole)
        if compression == "lz4":
            import lz4.frame

            return _read_some(lz4.frame.open(BytesIO(packed), "rb"), unpacked, RuntimeError, whole)
    except ImportError as error:
        raise MissingExtraError(str(error.name), "recording", f"reading {path}") from error
    raise ValueError(f"compression {compression!r} is not known")


def _read_some(stream: IO[bytes], limit: int, problem: type[Exception], whole: bool) -> bytes:
    parts: list[bytes] = []
    left = limit + 1  # one more byte reveals that the declared size is exceeded
    try:
        while left > 0 and (part := stream.read(min(left, 1 << 16))):
            parts.append(part)
            left -= len(part)
    except (problem, EOFError, OSError) as error:
        if whole:
            raise ValueError(f"cannot be unpacked ({error})") from error
    return b"".join(parts)

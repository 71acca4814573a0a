"""OpenEXR depth images: one channel of a scan-line file as float32.

OpenCV's wheels are built without OpenEXR. Depth maps need only a subset of the
format: single-part scan-line files, uncompressed or compressed with ZIPS, ZIP or
RLE, with half, float or integer channels. Layout:
https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from ...core import InputError, check_image_size
from ...core.errors import brief_list

_MAGIC = b"v/1\x01"
#: Flags of the version field that mark tiled, deep and multi-part files.
_OTHER_LAYOUTS = 0x200 | 0x800 | 0x1000
#: Compression -> name and rows per block.
_COMPRESSIONS = {0: ("none", 1), 1: ("RLE", 1), 2: ("ZIPS", 1), 3: ("ZIP", 16)}
_TYPES: dict[int, np.dtype] = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}
#: Channels that may contain depth, in order of preference.
_DEPTH_CHANNELS = ("Z", "depth.Z", "Y", "R", "G", "B")


@dataclass(frozen=True, slots=True)
class _Header:
    width: int
    height: int
    top: int  #: index of the first row
    compression: int
    channels: tuple[tuple[str, np.dtype], ...]  #: in file order
    end: int  #: first byte after the header


def decode_exr(data: bytes, where: str) -> Float[np.ndarray, "rows columns"]:
    """The depth channel of an OpenEXR file in memory (``Z``, otherwise ``Y`` or the first colour).

    Parameters
    ----------
    data
        Contents of the file.
    where
        Name of the file, for messages.

    Returns
    -------
    array
        Depth in the file's unit, float32, shape (rows, columns).

    Raises
    ------
    InputError
        The data is not such a file, uses another compression, or is too large or damaged.
    """
    try:
        header = _read_header(data, where)
        return _read_rows(data, header, where)
    except (struct.error, IndexError, ValueError, zlib.error, UnicodeDecodeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, f"is a damaged OpenEXR file ({error})") from error


def _read_header(data: bytes, where: str) -> _Header:
    if data[:4] != _MAGIC:
        raise InputError(where, f"begins with {data[:4]!r}, expected an OpenEXR file")
    (version,) = struct.unpack_from("<I", data, 4)
    if version & _OTHER_LAYOUTS:
        raise InputError(where, "is a tiled, deep or multi-part OpenEXR file, expected scan lines")
    fields: dict[str, bytes] = {}
    place = 8
    while data[place]:
        name, place = _text(data, place)
        _, place = _text(data, place)
        (size,) = struct.unpack_from("<I", data, place)
        fields[name] = data[place + 4 : place + 4 + size]
        place += 4 + size
    missing = {"channels", "compression", "dataWindow"} - set(fields)
    if missing:
        raise InputError(where, f"is a damaged OpenEXR file: no {', '.join(sorted(missing))}")
    compression = fields["compression"][0]
    if compression not in _COMPRESSIONS:
        raise InputError(
            where, f"is packed by OpenEXR's method {compression}, expected none, RLE, ZIPS or ZIP"
        )
    left, top, right, bottom = struct.unpack("<4i", fields["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    check_image_size(where, width, height, "its header declares")
    return _Header(width, height, top, compression, _channels(fields["channels"], where), place + 1)


def _text(data: bytes, place: int) -> tuple[str, int]:
    end = data.index(b"\0", place, place + 256)
    return data[place:end].decode(), end + 1


def _channels(packed: bytes, where: str) -> tuple[tuple[str, np.dtype], ...]:
    found: list[tuple[str, np.dtype]] = []
    place = 0
    while packed[place]:
        name, place = _text(packed, place)
        kind, _, step_x, step_y = struct.unpack_from("<iIii", packed, place)
        place += 16
        if kind not in _TYPES or (step_x, step_y) != (1, 1):
            raise InputError(where, f"its channel {name!r} is subsampled or of unknown type {kind}")
        found.append((name, _TYPES[kind]))
    return tuple(found)


def _read_rows(data: bytes, header: _Header, where: str) -> Float[np.ndarray, "rows columns"]:
    names = [name for name, _ in header.channels]
    chosen = next((name for name in _DEPTH_CHANNELS if name in names), None)
    if chosen is None:
        raise InputError(where, f"has channels {brief_list(names) or 'none'}, expected one of Z, Y, R")
    at = names.index(chosen)
    kind = header.channels[at][1]
    offset = header.width * sum(dtype.itemsize for _, dtype in header.channels[:at])
    row_bytes = header.width * sum(dtype.itemsize for _, dtype in header.channels)
    rows_per_block = _COMPRESSIONS[header.compression][1]
    blocks = -(-header.height // rows_per_block)
    places = struct.unpack_from(f"<{blocks}Q", data, header.end)
    result = np.full((header.height, header.width), np.nan, dtype=np.float32)
    for place in places:
        if place > len(data):
            raise InputError(where, f"has a block at byte {place}, expected one within its {len(data)} bytes")
        row, size = struct.unpack_from("<iI", data, place)
        row -= header.top
        rows = min(rows_per_block, header.height - row)
        packed = data[place + 8 : place + 8 + size]
        if not 0 <= row < header.height or len(packed) != size:
            raise InputError(
                where, f"is a truncated OpenEXR file: {len(packed)} of {size} bytes at row {row}"
            )
        pixels = _unpacked(packed, header.compression, rows * row_bytes)
        block = np.frombuffer(pixels, np.uint8).reshape(rows, row_bytes)
        column = np.ascontiguousarray(block[:, offset : offset + header.width * kind.itemsize])
        result[row : row + rows] = column.view(kind)
    return result


def _unpacked(packed: bytes, compression: int, size: int) -> bytes:
    if compression == 0 or len(packed) == size:  # stored: compression would have enlarged the block
        raw = packed
    elif compression == 1:
        raw = _run_lengths(packed, size)
    else:  # one more byte reveals that the declared size is exceeded
        raw = zlib.decompressobj().decompress(packed, size + 1)
    if len(raw) != size:
        raise ValueError(f"{len(raw)} bytes in a block of {size}")
    return raw if raw is packed else _restored(np.frombuffer(raw, np.uint8)).tobytes()


def _restored(values: UInt8[np.ndarray, "n"]) -> UInt8[np.ndarray, "n"]:
    """Undo the delta coding and the split into even and odd bytes."""
    steps = values.astype(np.int64)
    steps[1:] -= 128
    summed = np.cumsum(steps).astype(np.uint8)
    result = np.zeros_like(summed)
    half = (len(summed) + 1) // 2
    result[0::2], result[1::2] = summed[:half], summed[half:]
    return result


def _run_lengths(packed: bytes, size: int) -> bytes:
    out = bytearray()
    place = 0
    while place < len(packed) and len(out) <= size:
        (count,) = struct.unpack_from("<b", packed, place)
        if count < 0:
            out += packed[place + 1 : place + 1 - count]
            place += 1 - count
        else:
            out += packed[place + 1 : place + 2] * (count + 1)
            place += 2
    return bytes(out)

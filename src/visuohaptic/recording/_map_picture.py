"""Pictures of maps: grey levels as whole numbers, and every damaged file refused.

A decoder for photographs fills what is missing with grey; a map must not be
filled. PGM is read here; of PNG every chunk's checksum and the length of the
unpacked pixels are checked before OpenCV decodes it, of BMP and JPEG that the
file is whole.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt

from ..camera.model import MAX_PIXELS
from ..errors import InputError
from .ros_image import image_size

__all__ = ["Picture", "read_picture"]

#: Bytes of text that are turned into numbers at a time.
_TEXT_BLOCK = 1 << 20
#: Bytes that a file may have beside its pixels (comments, tables, profiles).
_EXTRA_BYTES = 1 << 24
#: Channels of each netpbm kind that is read.
_NETPBM = {b"P2": 1, b"P5": 1, b"P3": 3, b"P6": 3}
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """Brightness of a picture; row 0 is at the bottom."""

    level: UInt[np.ndarray, "rows columns"]  #: sum over the colour channels
    top: int  #: level of white
    opaque: Bool[np.ndarray, "rows columns"] | None  #: None: everywhere


def read_picture(path: Path) -> Picture:
    """Read a PGM, PPM, PNG, BMP or JPEG file.

    Raises
    ------
    InputError
        The file is missing, of another kind, too large or damaged.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            head = stream.read(1 << 16)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(path, f"cannot be read ({reason})") from error
    width, height = image_size(head, str(path))
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        raise InputError(
            path, f"its header says {width} x {height}, expected a positive size of at most {MAX_PIXELS} px"
        )
    if size > 24 * width * height + _EXTRA_BYTES:
        raise InputError(path, f"has {size} bytes, far more than {width} x {height} pixels need")
    if head[:2] in _NETPBM:
        picture = _read_netpbm(path)
    else:
        picture = _read_other(path)
    if picture.level.shape != (height, width):
        found = picture.level.shape
        raise InputError(path, f"is damaged: {found[1]} x {found[0]}, header {width} x {height}")
    opaque = None if picture.opaque is None else picture.opaque[::-1]
    return Picture(picture.level[::-1], picture.top, opaque)


def _read_netpbm(path: Path) -> Picture:
    """PGM or PPM, text (P2, P3) or binary (P5, P6), 8 or 16 bit, with comments."""
    data = path.read_bytes()
    kind = data[:2]
    (width, height, top), place = _netpbm_header(path, data)
    count = width * height * _NETPBM[kind]
    if kind in (b"P5", b"P6"):
        dtype = np.dtype(np.uint8) if top < 256 else np.dtype(">u2")
        found, expected = len(data) - place - 1, count * dtype.itemsize
        # A line end behind the pixels does no harm; more means that the header is of another picture.
        if found < expected or data[place + 1 + expected :].strip():
            raise InputError(path, f"has {found} bytes of pixels, expected {expected}")
        values = np.frombuffer(data, dtype=dtype, count=count, offset=place + 1)
    else:
        values = _text_pixels(path, data, place, count)
    if int(values.max()) > top:
        raise InputError(path, f"has pixels up to {values.max()}, its maxval is {top}")
    values = values.astype(np.uint8 if top < 256 else np.uint16)
    if _NETPBM[kind] == 1:
        return Picture(values.reshape(height, width), top, None)
    return Picture(values.reshape(height, width, 3).sum(axis=2, dtype=np.uint32), 3 * top, None)


def _netpbm_header(path: Path, data: bytes) -> tuple[tuple[int, int, int], int]:
    """Width, height and maxval, and the place behind them."""
    numbers: list[int] = []
    place = 2
    while len(numbers) < 3:
        while place < len(data) and (data[place : place + 1].isspace() or data[place] == ord("#")):
            if data[place] == ord("#"):
                end = data.find(b"\n", place)
                place = len(data) if end < 0 else end
            else:
                place += 1
        start = place
        while place < len(data) and data[place : place + 1].isdigit():
            place += 1
        if place == start or place - start > 10:
            raise InputError(path, f"found {data[start : start + 10]!r}, expected a number in the PGM header")
        numbers.append(int(data[start:place]))
    width, height, top = numbers
    if not 1 <= top <= 65535:
        raise InputError(path, f"found {top}, expected 1 to 65535", field="maxval")
    if place < len(data) and not data[place : place + 1].isspace():
        raise InputError(path, f"found {data[place : place + 1]!r} behind the PGM header, expected a space")
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        raise InputError(path, f"found {width} x {height}, expected at most {MAX_PIXELS} px")
    return (width, height, top), place


def _text_pixels(path: Path, data: bytes, place: int, count: int) -> UInt[np.ndarray, "count"]:
    """Whole numbers in text, block by block: the words of a large map would take gigabytes."""
    if len(data) - place < 2 * count - 1:
        raise InputError(path, f"has {len(data) - place} bytes of pixels, expected at least {2 * count - 1}")
    values = np.zeros(count, dtype=np.uint16)
    done = 0
    while place < len(data):
        end = data.find(b"\n", place + _TEXT_BLOCK)
        end = len(data) if end < 0 else end + 1
        block = data[place:end]
        place = end
        if b"#" in block:
            block = b"\n".join(line.split(b"#", 1)[0] for line in block.split(b"\n"))
        words = block.split()
        try:
            numbers = np.array(words, dtype=np.int64) if words else np.zeros(0, dtype=np.int64)
        except (ValueError, OverflowError) as error:
            raise InputError(path, "has a pixel that is no number") from error
        if done + len(numbers) > count:
            raise InputError(path, f"has more than {count} pixels, the size in its header")
        if len(numbers) and (numbers.min() < 0 or numbers.max() > 65535):
            raise InputError(
                path, f"has pixels from {numbers.min()} to {numbers.max()}, expected 0 to its maxval"
            )
        values[done : done + len(numbers)] = numbers
        done += len(numbers)
    if done < count:
        raise InputError(path, f"has {done} pixels, expected {count}")
    return values


def _read_other(path: Path) -> Picture:
    import cv2

    data = path.read_bytes()
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        _check_png(path, data)
    elif data[:2] == b"BM":
        _check_bmp(path, data)
    elif data[:2] == b"\xff\xd8":
        if not data.rstrip(b"\0 \r\n").endswith(b"\xff\xd9"):
            raise InputError(path, "is cut: a JPEG file without its end")
    else:
        raise InputError(path, f"begins with {data[:4]!r}, expected a PGM, PNG, BMP or JPEG image")
    try:
        image = cv2.imdecode(
            np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
        )
    except cv2.error as error:
        raise InputError(path, f"is a damaged image ({error.err})") from error
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise InputError(path, "is a damaged image, or not of 8 or 16 bit")
    white = int(np.iinfo(image.dtype).max)
    if image.ndim == 2:
        return Picture(image, white, None)
    opaque = image[..., -1] == white if image.shape[2] in (2, 4) else None
    colours = image[..., :3] if image.shape[2] >= 3 else image[..., :1]
    return Picture(colours.sum(axis=2, dtype=np.uint32), white * colours.shape[2], opaque)


def _check_png(path: Path, data: bytes) -> None:
    """Chunks with right checksums up to the end, and as many pixels as the header says."""
    place, ended, header = 8, False, b""
    unpack, unpacked = zlib.decompressobj(), 0
    limit = 0
    while place + 12 <= len(data) and not ended:
        length, kind = struct.unpack_from(">I4s", data, place)
        if place + 12 + length > len(data):
            break
        body = data[place + 8 : place + 8 + length]
        (checksum,) = struct.unpack_from(">I", data, place + 8 + length)
        if zlib.crc32(kind + body) != checksum:
            raise InputError(path, f"is damaged: the checksum of its chunk {kind!r} is wrong")
        if kind == b"IHDR":
            header = body
            limit = _png_bytes(path, header)
        elif kind == b"IDAT":
            try:
                rest = body
                while rest and not unpack.eof and unpacked <= limit:
                    unpacked += len(unpack.decompress(rest, 1 << 20))
                    rest = unpack.unconsumed_tail
            except zlib.error as error:
                raise InputError(path, f"is damaged: its pixels cannot be unpacked ({error})") from error
        elif kind == b"acTL":
            raise InputError(path, "is an animated PNG, expected a single picture")
        ended = kind == b"IEND"
        place += 12 + length
    while (
        not unpack.eof and unpacked <= limit and (more := unpack.decompress(unpack.unconsumed_tail, 1 << 20))
    ):
        unpacked += len(more)
    if not ended:
        raise InputError(path, "is cut: a PNG file without its end")
    if data[place:].strip(b"\0 \r\n"):
        raise InputError(path, f"has {len(data) - place} bytes behind the end of its picture")
    if not unpack.eof or (unpacked != limit and header[12] == 0) or unpacked > limit:
        raise InputError(path, f"has {unpacked} bytes of pixels, expected {limit}")


def _png_bytes(path: Path, header: bytes) -> int:
    """Bytes of the unpacked pixels; of an interlaced picture an upper bound."""
    if len(header) != 13:
        raise InputError(path, "is damaged: its header has a wrong length")
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    if colour not in _PNG_CHANNELS:
        raise InputError(path, f"found {colour}, expected a PNG colour type", field="IHDR")
    row = (width * depth * _PNG_CHANNELS[colour] + 7) // 8
    if interlaced:
        return int(2 * (row + 8) * (height + 8))
    return int((row + 1) * height)


def _check_bmp(path: Path, data: bytes) -> None:
    """The file has the length that its header says, and room for its pixels."""
    try:
        (length,) = struct.unpack_from("<I", data, 2)
        (start,) = struct.unpack_from("<I", data, 10)
        width, height = struct.unpack_from("<ii", data, 18)
        bits, packing = struct.unpack_from("<HI", data, 28)
    except struct.error as error:
        raise InputError(path, "is cut: its header is not whole") from error
    needed = start + (0 if packing in (1, 2) else (width * bits + 31) // 32 * 4 * abs(height))
    if len(data) < max(length, needed):
        raise InputError(path, f"is cut: has {len(data)} bytes, expected {max(length, needed)}")

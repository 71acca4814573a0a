"""Untrusted images: their declared sizes are checked before OpenCV decodes them.

OpenCV's decoders fill missing data with grey and trust every length in a header: a PNG of
261 bytes makes OpenCV allocate 4 GB. Here every chunk is first compared with the size of the file.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import UInt8, UInt16

from ..errors import InputError, brief
from .atomic import atomic_path
from .image_header import image_size, netpbm_words
from .regular import read_bytes

#: Allowance for data other than pixels (comments, tables, profiles) [bytes].
_EXTRA_BYTES = 1 << 24
#: Values of twelve bits are below it.
_TWELVE_BITS = 1 << 12
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}

#: ``any``: grey or BGR as in the file, 8 bit; ``unchanged``: all channels and bits of the file.
ImageMode = Literal["any", "grey", "colour", "unchanged"]


def read_image(
    path: Path | str, mode: ImageMode = "any", *, upright: bool = False, check_pixels: bool = True
) -> np.ndarray:
    """Read an image file; see :func:`decode_image`.

    Parameters
    ----------
    path
        The file.
    mode, upright, check_pixels
        As in :func:`decode_image`.

    Raises
    ------
    InputError
        The file is missing, not a regular file, of an unknown format, too large or damaged.
    """
    data = read_bytes(path)
    return decode_image(data, path, mode, upright=upright, check_pixels=check_pixels)


def decode_image(
    data: bytes | memoryview,
    where: object,
    mode: ImageMode = "any",
    *,
    upright: bool = False,
    check_pixels: bool = True,
) -> np.ndarray:
    """Decode a PNG, JPEG, BMP, PGM, PPM, TIFF or WebP file in memory.

    Parameters
    ----------
    data
        Contents of the file.
    where
        Source file, topic or field, for messages.
    mode
        Channels and bits of the result.
    upright
        Rotate a photograph as stated in its metadata; images of calibrated cameras must not be rotated.
    check_pixels
        Decompress a PNG to count its pixels, which takes about half as long as decoding it. Not needed for frames
        of a recording, whose checksums suffice.

    Returns
    -------
    ndarray
        (rows, columns) or (rows, columns, channels in BGR order); uint8, or the file's type for
        ``unchanged``.

    Raises
    ------
    InputError
        The data has an unknown format, several pages, or is too large, truncated or damaged; or has 16 bits as rejected
        by :func:`upper_bytes`.
    """
    import cv2

    data = bytes(data)
    width, height = image_size(data, where)
    if len(data) > 24 * width * height + _EXTRA_BYTES:
        raise InputError(where, f"has {len(data)} bytes, far more than {width} x {height} pixels need")
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        _check_png(where, data, check_pixels)
    elif data[:2] == b"BM":
        _check_bmp(where, data, width, height)
    elif data[:2] == b"\xff\xd8":
        _check_jpeg(where, data)
    elif mode != "unchanged" and data[:2] in (b"P2", b"P3", b"P5", b"P6"):
        white = b"".join(netpbm_words(data)[2:3]).decode("latin-1")
        if white not in ("255", "65535"):
            raise InputError(where, f"found {brief(white)}, expected one of 255, 65535", field="maxval")
    flags = {
        "any": cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR,
        "grey": cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE,
        "colour": cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR,
        "unchanged": cv2.IMREAD_UNCHANGED,
    }[mode]
    try:
        image = cv2.imdecode(
            np.frombuffer(data, dtype=np.uint8), flags if upright else flags | cv2.IMREAD_IGNORE_ORIENTATION
        )
    except cv2.error as error:
        raise InputError(where, f"is a damaged image ({error.err})") from error
    if image is None:
        raise InputError(
            where, f"is a damaged image: {width} x {height} according to its header, but cannot be decoded"
        )
    rows, columns = image.shape[:2]
    if (columns, rows) != (width, height) and not (upright and (rows, columns) == (width, height)):
        raise InputError(where, f"is a damaged image: {columns} x {rows}, header {width} x {height}")
    if mode == "unchanged" or image.dtype == np.uint8:
        return np.asarray(image)
    if image.dtype != np.uint16:
        raise InputError(where, f"has pixels of type {image.dtype}, expected 8 or 16 bits")
    return upper_bytes(image, where)


def upper_bytes(
    pixels: UInt16[np.ndarray, "rows columns *colour"], where: object
) -> UInt8[np.ndarray, "rows columns *colour"]:
    """The upper eight of sixteen bits.

    Cameras of 10 or 12 bits often store their values in 16 bits without scaling; the upper bytes are then almost empty.

    Parameters
    ----------
    pixels
        Values of 16 bits, (rows, columns) or (rows, columns, channels).
    where
        Source of the image, for messages.

    Raises
    ------
    InputError
        No value reaches 4096, and not all are 0: at most 16 grey levels would remain.
    """
    highest = int(pixels.max())
    if 0 < highest < _TWELVE_BITS:
        raise InputError(
            where,
            f"has 16-bit pixels up to {highest}, of which {(highest >> 8) + 1} grey levels would remain; "
            "expected white at 65535",
            remedy="scale pixels of 10 or 12 bits to 16, or save 8 bits",
        )
    return (pixels >> 8).astype(np.uint8)


def _check_png(where: object, data: bytes, check_pixels: bool) -> None:
    """Check the checksums of all chunks up to the end, and the number of pixels against the header."""
    place, ended, header, packed = 8, False, b"", []
    while place + 12 <= len(data) and not ended:
        length, kind = struct.unpack_from(">I4s", data, place)
        if place + 12 + length > len(data):
            break
        body = memoryview(data)[place + 8 : place + 8 + length]
        (checksum,) = struct.unpack_from(">I", data, place + 8 + length)
        if zlib.crc32(body, zlib.crc32(kind)) != checksum:
            raise InputError(where, f"is damaged: the checksum of its chunk {kind!r} is wrong")
        if (kind == b"IHDR") != (place == 8):
            raise InputError(where, "is damaged: expected one header chunk, at the beginning of the PNG")
        if kind == b"IHDR":
            header = bytes(body)
        elif kind == b"IDAT":
            packed.append(body)
        elif kind == b"acTL":
            raise InputError(where, "is an animated PNG, expected a single image")
        ended = kind == b"IEND"
        place += 12 + length
    if not ended:
        raise InputError(where, "is truncated: the PNG has no end chunk")
    limit = _png_bytes(where, header)
    if not check_pixels:
        return
    if data[place:].strip(b"\0 \r\n"):
        raise InputError(where, f"has {len(data) - place} bytes after the end of its image")
    _check_png_pixels(where, packed, limit, interlaced=header[12] != 0)


def _check_png_pixels(where: object, packed: list[memoryview], limit: int, *, interlaced: bool) -> None:
    """Decompress block by block, up to the size stated in the header."""
    unpack, unpacked = zlib.decompressobj(), 0
    blocks = [body[start : start + (1 << 16)] for body in packed for start in range(0, len(body), 1 << 16)]
    try:
        for block in blocks:
            rest: bytes | memoryview = block
            while not unpack.eof and unpacked <= limit:
                found = unpack.decompress(rest, 1 << 20)
                unpacked += len(found)
                rest = unpack.unconsumed_tail
                if not rest and not found:
                    break
    except zlib.error as error:
        raise InputError(where, f"is damaged: its pixels cannot be unpacked ({error})") from error
    if not unpack.eof or unpacked > limit or (unpacked != limit and not interlaced):
        raise InputError(where, f"has {unpacked} bytes of pixels, expected {limit}")


def _png_bytes(where: object, header: bytes) -> int:
    """Size of the decompressed pixels [bytes]; an upper bound for interlaced images."""
    if len(header) != 13:
        raise InputError(where, "is damaged: its header has a wrong length")
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    if colour not in _PNG_CHANNELS:
        raise InputError(where, f"found {colour}, expected a PNG colour type", field="IHDR")
    row = (width * depth * _PNG_CHANNELS[colour] + 7) // 8
    if interlaced:
        return int(2 * (row + 8) * (height + 8))
    return int((row + 1) * height)


def _check_bmp(where: object, data: bytes, width: int, height: int) -> None:
    """Check that the file has the length stated in its header, which includes its pixels."""
    try:
        (length,) = struct.unpack_from("<I", data, 2)
        start, header = struct.unpack_from("<II", data, 10)
        if header == 12:  # OS/2
            (bits,), packing = struct.unpack_from("<H", data, 24), 0
        else:
            bits, packing = struct.unpack_from("<HI", data, 28)
    except struct.error as error:
        raise InputError(where, "is truncated: its header is incomplete") from error
    needed = start + (0 if packing in (1, 2) else (width * bits + 31) // 32 * 4 * height)
    if len(data) < max(length, needed):
        raise InputError(where, f"is truncated: it has {len(data)} bytes, expected {max(length, needed)}")


def _check_jpeg(where: object, data: bytes) -> None:
    """Check for an end-of-image marker after the start of the pixels; cameras append arbitrary data to it."""
    place = 2
    while place + 4 <= len(data) and data[place] == 0xFF and data[place + 1] != 0xDA:
        fill = data[place + 1] == 0xFF
        place += 1 if fill else 2 + int(struct.unpack_from(">H", data, place + 2)[0])
    if data.find(b"\xff\xd9", place) < 0:
        raise InputError(where, "is truncated: the JPEG has no end marker")


def encode_image(
    image: np.ndarray, kind: str = "png", *, quality: int | None = None, where: object = "image"
) -> bytes:
    """Encode an image in a file format.

    Parameters
    ----------
    image
        Grey or blue, green, red pixels, (rows, columns) or (rows, columns, 3).
    kind
        ``png``, ``jpg`` or ``webp``.
    quality
        For ``jpg`` and ``webp``, 0 to 100; OpenCV's default if omitted.
    where
        Name used in error messages.

    Raises
    ------
    InputError
        The pixels cannot be encoded, or not in this format.
    """
    import cv2

    flags = {"jpg": cv2.IMWRITE_JPEG_QUALITY, "webp": cv2.IMWRITE_WEBP_QUALITY}
    options = [] if quality is None else [flags[kind], quality]
    try:
        done, data = cv2.imencode(f".{kind}", np.ascontiguousarray(image), options)
    except cv2.error as error:
        raise InputError(where, f"found suffix '.{kind}', expected .png, .jpg or .webp") from error
    if not done:
        raise InputError(where, f"found {image.dtype} of shape {image.shape}, which {kind} cannot hold")
    return bytes(data.tobytes())


def write_image(path: Path | str, image: np.ndarray, *, quality: int | None = None) -> None:
    """Write an image file atomically; the suffix determines the format.

    Parameters
    ----------
    path
        ``.png``, ``.jpg`` or ``.webp``.
    image, quality
        As in :func:`encode_image`.

    Raises
    ------
    InputError
        The pixels cannot be encoded.
    """
    data = encode_image(image, Path(path).suffix[1:].lower(), quality=quality, where=path)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)

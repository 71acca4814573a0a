"""ROS image messages from and to arrays."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ..camera.model import MAX_PIXELS
from ..errors import InputError

__all__ = ["decode_compressed", "decode_raw", "image_size"]

#: ROS encoding -> channels, bytes per channel, and name of OpenCV's conversion to grey or BGR.
_ENCODINGS: dict[str, tuple[int, int, str]] = {
    "mono8": (1, 1, ""),
    "8UC1": (1, 1, ""),
    "mono16": (1, 2, ""),
    "16UC1": (1, 2, ""),
    "bgr8": (3, 1, ""),
    "8UC3": (3, 1, ""),
    "rgb8": (3, 1, "COLOR_RGB2BGR"),
    "bgra8": (4, 1, "COLOR_BGRA2BGR"),
    "8UC4": (4, 1, "COLOR_BGRA2BGR"),
    "rgba8": (4, 1, "COLOR_RGBA2BGR"),
    # ROS names the order of the first row; OpenCV the second row's second and third pixel.
    "bayer_rggb8": (1, 1, "COLOR_BayerBG2BGR"),
    "bayer_bggr8": (1, 1, "COLOR_BayerRG2BGR"),
    "bayer_gbrg8": (1, 1, "COLOR_BayerGR2BGR"),
    "bayer_grbg8": (1, 1, "COLOR_BayerGB2BGR"),
}


def decode_raw(message: Any, where: str) -> UInt8[np.ndarray, "rows columns *colour"]:
    """Grey or BGR image, 8 bit, of a ``sensor_msgs/Image``.

    The padding at the end of rows (``step``) is removed; of 16-bit images the
    upper 8 bits are kept; Bayer patterns are interpolated.

    Raises
    ------
    InputError
        The encoding is not known, or size and data do not fit together.
    """
    width, height, step = int(message.width), int(message.height), int(message.step)
    encoding = str(message.encoding)
    if encoding not in _ENCODINGS:
        raise InputError(
            where, f"found {encoding!r}, expected one of {', '.join(_ENCODINGS)}", field="encoding"
        )
    channels, depth, conversion = _ENCODINGS[encoding]
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        raise InputError(
            where, f"found {width} x {height}, expected a positive size of at most {MAX_PIXELS} px"
        )
    used = width * channels * depth
    if step < used:
        raise InputError(
            where, f"found {step} bytes a row, expected at least {used} for {encoding}", field="step"
        )
    data = np.frombuffer(memoryview(message.data), dtype=np.uint8)
    # The padding of the last row may be missing.
    if data.size < step * (height - 1) + used:
        raise InputError(
            where, f"found {data.size} bytes, expected {step * height} = {step} x {height}", field="data"
        )
    rows = np.lib.stride_tricks.as_strided(data, (height, used), (step, 1), writeable=False)
    if depth == 2:
        # The upper byte of each value is its 8-bit reading.
        rows = rows[:, 0 if message.is_bigendian else 1 :: 2]
    image = np.ascontiguousarray(rows if channels == 1 else rows.reshape(height, width, channels))
    if conversion:
        import cv2

        image = cv2.cvtColor(image, getattr(cv2, conversion))
    # ``frombuffer`` gives a read-only view of the message: a frame owns its pixels.
    return image if image.flags.writeable else image.copy()


def decode_compressed(
    data: bytes | memoryview, where: str, *, grey: bool = False
) -> UInt8[np.ndarray, "rows columns *colour"]:
    """Grey or BGR image, 8 bit, of a JPEG, PNG, BMP, PGM or TIFF file in memory.

    A colour file stays in colour unless ``grey`` is asked for. The size in the
    header is checked before memory is taken.

    Raises
    ------
    InputError
        The data is of no known kind, too large, or damaged.
    """
    import cv2

    width, height = image_size(bytes(data[: 1 << 20]), where)
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        raise InputError(
            where,
            f"its header says {width} x {height}, expected a positive size of at most {MAX_PIXELS} px",
        )
    flags = cv2.IMREAD_IGNORE_ORIENTATION | (cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_ANYCOLOR)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error as error:
        raise InputError(where, f"is a damaged image ({error.err})") from error
    if image is None:
        raise InputError(where, f"is a damaged image: {width} x {height} by its header, cannot be decoded")
    if image.shape[:2] != (height, width):
        raise InputError(
            where, f"is a damaged image: {image.shape[1]} x {image.shape[0]}, header {width} x {height}"
        )
    return image


def image_size(head: bytes, where: str) -> tuple[int, int]:
    """Width and height [px] by the header of a PNG, JPEG, BMP, PGM/PPM or TIFF file.

    Raises
    ------
    InputError
        The bytes are not the begin of such a file.
    """
    try:
        if head[:8] == b"\x89PNG\r\n\x1a\n":
            width, height = struct.unpack(">II", head[16:24])
            return width, height
        if head[:2] == b"\xff\xd8":
            return _jpeg_size(head)
        if head[:2] == b"BM":
            width, height = struct.unpack("<ii", head[18:26])
            return width, abs(height)
        if head[:1] == b"P" and head[1:2] in b"123456" and len(head) > 2:
            return _netpbm_size(head)
        if head[:4] in (b"II*\0", b"MM\0*"):
            return _tiff_size(head)
    except (struct.error, IndexError, ValueError, KeyError) as error:
        raise InputError(where, "is a damaged image: its header has no size") from error
    raise InputError(where, f"begins with {head[:4]!r}, expected a PNG, JPEG, BMP, PGM, PPM or TIFF image")


def _jpeg_size(head: bytes) -> tuple[int, int]:
    place = 2
    while True:
        if head[place] != 0xFF:
            raise ValueError
        marker = head[place + 1]
        if marker == 0xFF:  # fill byte
            place += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", head[place + 5 : place + 9])
            return width, height
        place += 2 + int(struct.unpack(">H", head[place + 2 : place + 4])[0])


def _netpbm_size(head: bytes) -> tuple[int, int]:
    words: list[bytes] = []
    for line in head[2:4096].split(b"\n"):
        words += line.split(b"#", 1)[0].split()
        if len(words) >= 2:
            break
    return int(words[0]), int(words[1])


def _tiff_size(head: bytes) -> tuple[int, int]:
    order = "<" if head[:1] == b"I" else ">"
    (place,) = struct.unpack(order + "I", head[4:8])
    (count,) = struct.unpack(order + "H", head[place : place + 2])
    values = {}
    for entry in range(count):
        start = place + 2 + 12 * entry
        tag, kind = struct.unpack(order + "HH", head[start : start + 4])
        code = {3: "H", 4: "I"}.get(kind)
        if tag in (256, 257) and code:
            (values[tag],) = struct.unpack_from(order + code, head, start + 8)
    return values[256], values[257]

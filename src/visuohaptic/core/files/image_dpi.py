"""The print resolution stated in an image file."""

from __future__ import annotations

import struct


def pixels_per_metre(data: bytes) -> tuple[float, float] | None:
    """Horizontal and vertical resolution from a PNG ``pHYs`` chunk or a JPEG JFIF header.

    ``None`` if the file states none or its header is damaged.

    Parameters
    ----------
    data
        Content of the image file.
    """
    try:
        if data[:8] == b"\x89PNG\r\n\x1a\n":
            return _png(data)
        if data[:2] == b"\xff\xd8":
            return _jpeg(data)
    except (struct.error, IndexError):
        return None
    return None


def _png(data: bytes) -> tuple[float, float] | None:
    position = 8
    while position + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        if kind == b"pHYs":
            x, y, unit = struct.unpack_from(">IIB", data, position + 8)
            return (float(x), float(y)) if unit == 1 and x > 0 and y > 0 else None
        if kind == b"IDAT":
            return None
        position += 12 + length
    return None


def _jpeg(data: bytes) -> tuple[float, float] | None:
    position = 2
    while position + 4 <= len(data) and data[position] == 0xFF:
        marker, length = data[position + 1], struct.unpack_from(">H", data, position + 2)[0]
        if marker == 0xE0 and data[position + 4 : position + 9] == b"JFIF\0":
            unit, x, y = struct.unpack_from(">BHH", data, position + 11)
            # 1: dots per inch, 2: dots per centimetre, 0: only the ratio of the sides.
            scale = {1: 1 / 0.0254, 2: 100.0}.get(unit)
            return (x * scale, y * scale) if scale and x > 0 and y > 0 else None
        if marker == 0xDA:
            return None
        position += 2 + length
    return None

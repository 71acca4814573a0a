"""Map images: grey levels as integers; damaged files are rejected.

Image decoders fill missing data with grey, which is not acceptable for a map.
PGM is read here; PNG, BMP and JPEG by the shared image reader.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int8, UInt, UInt8

from ...core import InputError, check_image_size, check_numbers, decode_image, image_size, read_bytes, within

UNKNOWN, FREE, OCCUPIED = -1, 0, 100

#: Block size for the conversion of text to numbers [bytes].
_TEXT_BLOCK = 1 << 20
#: Number of channels of each supported netpbm format.
_NETPBM = {b"P1": 1, b"P4": 1, b"P2": 1, b"P5": 1, b"P3": 3, b"P6": 3}


@dataclass(frozen=True, slots=True, eq=False)
class MapImage:
    """Brightness of an image; row 0 is at the bottom."""

    level: UInt[np.ndarray, "rows columns"]  #: sum over the colour channels
    top: int  #: level of white
    opaque: Bool[np.ndarray, "rows columns"] | None  #: None: everywhere


def read_map_image(path: Path) -> MapImage:
    """Read a PBM, PGM, PPM, PNG, BMP or JPEG file.

    Parameters
    ----------
    path
        Map image.

    Raises
    ------
    InputError
        The file is missing, of another format, too large or damaged.
    """
    data = read_bytes(path)
    width, height = image_size(data, path)
    image = _read_netpbm(path, data) if data[:2] in _NETPBM else _read_other(path, data)
    if image.level.shape != (height, width):
        found = image.level.shape
        raise InputError(path, f"is damaged: {found[1]} x {found[0]}, header {width} x {height}")
    opaque = None if image.opaque is None else image.opaque[::-1]
    return MapImage(image.level[::-1], image.top, opaque)


def cells_from_image(
    image: MapImage, mode: str, negate: bool, occupied_thresh: float, free_thresh: float
) -> Int8[np.ndarray, "rows columns"]:
    """Convert grey levels to occupancy by the rules of Nav2's map_server; non-opaque pixels are unknown.

    Nav2 averages the transparency of a trinary map into its grey level, so that
    the unknown cells of an image with an opaque alpha channel become free;
    here the alpha channel has the same meaning in every mode. ``negate`` is
    ignored in mode raw.

    Parameters
    ----------
    image
        Brightness, row 0 at the bottom.
    mode
        ``trinary``, ``scale`` or ``raw``.
    negate
        Whether bright cells are occupied; ignored in mode raw.
    occupied_thresh, free_thresh
        Occupancies 0..1 above which a cell is occupied and below which it is free.

    Returns
    -------
    array
        -1 unknown, 0 free .. 100 occupied, shape (rows, columns).
    """
    # An image has few levels and many pixels: the rules are evaluated once per level.
    shade = np.arange(image.top + 1) / image.top
    if mode == "raw":
        value = np.rint(shade * 255)
        table = np.where(value <= OCCUPIED, value, UNKNOWN)
    else:
        occupancy = shade if negate else 1.0 - shade
        if mode == "scale":
            part = (occupancy - free_thresh) / (occupied_thresh - free_thresh)
            table = np.rint(100 * np.clip(part, 0.0, 1.0))
        else:
            table = np.full(shade.shape, float(UNKNOWN))
        table = np.where(occupancy < free_thresh, FREE, table)
        table = np.where(occupancy > occupied_thresh, OCCUPIED, table)
    cells = table.astype(np.int8)[image.level]
    if image.opaque is not None:
        cells[~image.opaque] = UNKNOWN
    return cells


def _read_netpbm(path: Path, data: bytes) -> MapImage:
    """PBM, PGM or PPM, text (P1, P2, P3) or binary (P4, P5, P6), 1, 8 or 16 bit, with comments."""
    kind = data[:2]
    (width, height, top), place = _netpbm_header(path, data)
    if kind in (b"P1", b"P4"):
        return MapImage(1 - _bits(path, data, place, width, height), 1, None)
    count = width * height * _NETPBM[kind]
    if kind in (b"P5", b"P6"):
        dtype = np.dtype(np.uint8) if top < 256 else np.dtype(">u2")
        found, expected = len(data) - place - 1, count * dtype.itemsize
        # A line ending after the pixels is harmless; more means that the header does not match the image.
        if found < expected or data[place + 1 + expected :].strip():
            raise InputError(path, f"has {found} bytes of pixels, expected {expected}")
        values = np.frombuffer(data, dtype=dtype, count=count, offset=place + 1)
    else:
        values = _text_pixels(path, data, place, count)
    if int(values.max()) > top:
        raise InputError(path, f"has pixels up to {values.max()}, its maxval is {top}")
    values = values.astype(np.uint8 if top < 256 else np.uint16)
    if _NETPBM[kind] == 1:
        return MapImage(values.reshape(height, width), top, None)
    return MapImage(values.reshape(height, width, 3).sum(axis=2, dtype=np.uint32), 3 * top, None)


def _netpbm_header(path: Path, data: bytes) -> tuple[tuple[int, int, int], int]:
    """Width, height and maxval (1 of a bitmap, which has none), and the offset after them."""
    numbers: list[int] = []
    place, bitmap = 2, data[:2] in (b"P1", b"P4")
    while len(numbers) < (2 if bitmap else 3):
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
    width, height, top = (*numbers, 1) if bitmap else numbers
    check_numbers(path, within(1, 65535), maxval=top)
    if place < len(data) and not data[place : place + 1].isspace():
        raise InputError(path, f"found {data[place : place + 1]!r} after the PGM header, expected a space")
    check_image_size(path, width, height)
    return (width, height, top), place


def _bits(path: Path, data: bytes, place: int, width: int, height: int) -> UInt8[np.ndarray, "rows columns"]:
    """Bits of a bitmap, 1 for black: rows of whole bytes, or digits with or without spaces between them."""
    if data[:2] == b"P4":
        row = -(-width // 8)
        if len(data) - place - 1 < row * height or data[place + 1 + row * height :].strip():
            raise InputError(path, f"has {len(data) - place - 1} bytes of pixels, expected {row * height}")
        packed = np.frombuffer(data, np.uint8, row * height, place + 1).reshape(height, row)
        return np.unpackbits(packed, axis=1)[:, :width]
    digits = b"".join(line.partition(b"#")[0] for line in data[place:].splitlines())
    found = np.frombuffer(digits.translate(None, b" \t\r\v\f"), np.uint8) - ord("0")
    if len(found) != width * height or found.max() > 1:
        raise InputError(path, f"has {len(found)} pixels, expected {width * height}, each 0 or 1")
    return found.reshape(height, width)


def _text_pixels(path: Path, data: bytes, place: int, count: int) -> UInt[np.ndarray, "count"]:
    """Integers in text, block by block: splitting a large map at once would need gigabytes."""
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
            raise InputError(path, "has a pixel that is not a number") from error
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


def _read_other(path: Path, data: bytes) -> MapImage:
    if data[:8] != b"\x89PNG\r\n\x1a\n" and data[:2] not in (b"BM", b"\xff\xd8"):
        raise InputError(path, f"begins with {data[:4]!r}, expected a PBM, PGM, PPM, PNG, BMP or JPEG image")
    if b"tRNS" in data[: max(data.find(b"IDAT"), 0)]:
        # OpenCV shows what is below: unknown cells would become free or occupied.
        raise InputError(
            path, "has a transparent colour without an alpha channel", remedy="save it as RGBA, not indexed"
        )
    image = decode_image(data, path, "unchanged")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(path, "is not an image of 8 or 16 bit")
    white = int(np.iinfo(image.dtype).max)
    if image.ndim == 2:
        return MapImage(image, white, None)
    opaque = image[..., -1] == white if image.shape[2] in (2, 4) else None
    colours = image[..., :3] if image.shape[2] >= 3 else image[..., :1]
    return MapImage(colours.sum(axis=2, dtype=np.uint32), white * colours.shape[2], opaque)

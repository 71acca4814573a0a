"""Width and height of an image from its header alone."""

from __future__ import annotations

import struct

from ..errors import InputError

#: Images with more pixels are rejected before memory is allocated.
MAX_PIXELS = 100_000_000
#: TIFF tags: width, length, samples per pixel, width and length of a tile.
_WIDTH, _LENGTH, _SAMPLES, _TILE_WIDTH, _TILE_LENGTH = 256, 257, 277, 322, 323
#: TIFF tag of a page; its lowest bit marks a smaller copy of another page.
_SUBFILE = 254


def image_size(head: bytes, where: object) -> tuple[int, int]:
    """Width and height [px] from the header of a PNG, JPEG, BMP, PGM/PPM, TIFF or WebP file.

    Parameters
    ----------
    head
        Start of the file; for JPEG and TIFF up to the size, which may follow metadata.
    where
        Source file or message, for error messages.

    Raises
    ------
    InputError
        The data does not start such a file, or the size is not positive or exceeds ``MAX_PIXELS``.
    """
    try:
        width, height = _size(head, where)
    except (struct.error, IndexError, ValueError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, "is a damaged image: its header contains no size") from error
    check_image_size(where, width, height, "its header declares")
    return width, height


def check_image_size(where: object, width: int, height: int, found: str = "found", field: str = "") -> None:
    """Reject an empty image, and one that is too large to take memory for.

    Parameters
    ----------
    where
        Source file or message, for error messages.
    width, height
        Size of the image [px].
    found
        Start of the message.
    field
        Field of the size in the source.

    Raises
    ------
    InputError
        The size is not positive or exceeds ``MAX_PIXELS``.
    """
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        expected = f"expected a positive size of at most {MAX_PIXELS} px"
        raise InputError(where, f"{found} {width} x {height}, {expected}", field=field)


def _size(head: bytes, where: object) -> tuple[int, int]:
    if head[:8] == b"\x89PNG\r\n\x1a\n":
        width, height = struct.unpack(">II", head[16:24])
        return width, height
    if head[:2] == b"\xff\xd8":
        return _jpeg_size(head)
    if head[:2] == b"BM":
        old = struct.unpack("<I", head[14:18])[0] == 12  # OS/2: 16 bit
        width, height = struct.unpack("<HH", head[18:22]) if old else struct.unpack("<ii", head[18:26])
        return width, abs(height)
    if head[:1] == b"P" and head[1:2] in b"123456" and len(head) > 2:
        return int(netpbm_words(head)[0]), int(netpbm_words(head)[1])
    if head[:4] in (b"II*\0", b"MM\0*"):
        return _tiff_size(head, where)
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return _webp_size(head, where)
    expected = "expected a PNG, JPEG, BMP, PGM, PPM, TIFF or WebP image"
    raise InputError(where, f"is not an image: begins with {head[:4]!r}, {expected}")


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


def netpbm_words(head: bytes) -> list[bytes]:
    """Words of the header of a PGM or PPM file: width, height and, except in bitmaps, the value of white.

    Parameters
    ----------
    head
        Start of the file.
    """
    words: list[bytes] = []
    # A comment ends at either line ending, as in OpenCV: both must find the same size.
    for line in head[2:4096].replace(b"\r", b"\n").split(b"\n"):
        words += line.split(b"#", 1)[0].split()
        if len(words) >= 3:
            break
    return words


def _tiff_size(head: bytes, where: object) -> tuple[int, int]:
    order = "<" if head[:1] == b"I" else ">"
    (place,) = struct.unpack(order + "I", head[4:8])
    values, following = _tiff_page(head, order, place)
    if 0 < following < len(head) - 6 and not _tiff_page(head, order, following)[0].get(_SUBFILE, 0) & 1:
        raise InputError(where, "has several pages, expected a single image")
    if values.get(_SAMPLES, 1) > 4:
        raise InputError(where, f"has {values[_SAMPLES]} channels, expected at most 4")
    # A tile is always decoded completely, even if the image uses little of it.
    tile = values.get(_TILE_WIDTH, 1) * values.get(_TILE_LENGTH, 1)
    if tile > MAX_PIXELS:
        raise InputError(where, f"has tiles of {tile} px, expected at most {MAX_PIXELS}")
    return values[_WIDTH], values[_LENGTH]


def _tiff_page(head: bytes, order: str, place: int) -> tuple[dict[int, int], int]:
    """Integers of the directory of a page by their tag, and the place of the next page; 0: none."""
    (count,) = struct.unpack_from(order + "H", head, place)
    values = {}
    for start in range(place + 2, place + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(order + "HH", head, start)
        code = {3: "H", 4: "I"}.get(kind)
        if tag in (_SUBFILE, _WIDTH, _LENGTH, _SAMPLES, _TILE_WIDTH, _TILE_LENGTH) and code:
            (values[tag],) = struct.unpack_from(order + code, head, start + 8)
    end = place + 2 + 12 * count
    return values, struct.unpack_from(order + "I", head, end)[0] if end + 4 <= len(head) else 0


def _webp_size(head: bytes, where: object) -> tuple[int, int]:
    kind = head[12:16]
    if kind == b"VP8 ":
        if head[23:26] != b"\x9d\x01\x2a":
            raise ValueError
        width, height = struct.unpack("<HH", head[26:30])
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L":
        if head[20] != 0x2F:
            raise ValueError
        (bits,) = struct.unpack("<I", head[21:25])
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":
        if head[20] & 2:
            raise InputError(where, "is an animated WebP, expected a single image")
        if len(head) < 30:
            raise ValueError
        return int.from_bytes(head[24:27], "little") + 1, int.from_bytes(head[27:30], "little") + 1
    raise ValueError

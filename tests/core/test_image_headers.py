"""Size and printed resolution from the header, compared with files written by other libraries."""

from __future__ import annotations

import io
import struct
from typing import Any

import cv2
import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.files import image_size
from visuohaptic.core.files.image_dpi import pixels_per_metre

pillow = pytest.importorskip("PIL.Image")
WIDTH, HEIGHT = 301, 43
PICTURE = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)


def _by_pillow(kind: str, **options: Any) -> bytes:
    stream = io.BytesIO()
    pillow.fromarray(PICTURE).save(stream, kind, **options)
    return stream.getvalue()


def _by_opencv(suffix: str) -> bytes:
    image = PICTURE[..., 0] if suffix == ".pgm" else PICTURE
    return cv2.imencode(suffix, image)[1].tobytes()


FILES = {
    **{suffix: _by_opencv(suffix) for suffix in (".png", ".jpg", ".bmp", ".pgm", ".ppm", ".tiff", ".webp")},
    "lossless webp": _by_pillow("WEBP", lossless=True),
    "webp with a profile": _by_pillow("WEBP", icc_profile=b"x" * 40),
    "tiff whose tags come last": _by_pillow("TIFF"),
    "progressive jpeg behind fill bytes": _by_pillow("JPEG", progressive=True).replace(
        b"\xff\xdb", b"\xff\xff\xff\xdb", 1
    ),
    "bmp of OS/2": b"BM" + bytes(12) + struct.pack("<IHHHH", 12, WIDTH, HEIGHT, 1, 24),
    "bmp from the top": b"BM" + bytes(12) + struct.pack("<Iii", 40, WIDTH, -HEIGHT),
    "pgm with comments": b"P5 # 9 9\r# 7\n301#x\n 43 255\n",
    "big-endian tiff": b"MM\0*" + struct.pack(">IHHHIIHHIII", 8, 2, 256, 4, 1, WIDTH, 257, 4, 1, HEIGHT, 0),
}


@pytest.mark.parametrize("kind", FILES)
def test_the_size_is_that_of_the_picture(kind: str) -> None:
    assert image_size(FILES[kind], "picture") == (WIDTH, HEIGHT)


def _tiff(*entries: tuple[int, int]) -> bytes:
    rows = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in entries)
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + rows


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (b"GIF89a", "is not an image: begins with b'GIF8', expected a PNG, "),
        (FILES[".png"][:20], "is a damaged image: its header contains no size"),
        (FILES[".jpg"][:20], "is a damaged image"),
        (b"\xff\xd8\x00\x10", "is a damaged image"),
        (FILES[".webp"][:12] + b"VP8 " + bytes(14), "is a damaged image"),
        (FILES[".webp"][:12] + b"VP8L" + bytes(14), "is a damaged image"),
        (FILES[".webp"][:12] + b"VP8X" + bytes(10), "is a damaged image"),
        (FILES[".webp"][:12] + b"NONE" + bytes(14), "is a damaged image"),
        (FILES[".webp"][:12] + b"VP8X" + bytes(4) + b"\2" + bytes(9), "is an animated WebP"),
        (b"P5 0 43 255 ", "its header declares 0 x 43, expected a positive size"),
        (b"P6 20000 20000 255 ", "its header declares 20000 x 20000"),
        (_tiff((256, 301)), "is a damaged image"),
        (_tiff((256, 301), (257, 43), (277, 5)), "has 5 channels, expected at most 4"),
        (_tiff((256, 301), (257, 43), (322, 10**5), (323, 10**5)), "has tiles of 10000000000 px"),
    ],
)
def test_a_header_without_a_usable_size_is_refused(head: bytes, said: str) -> None:
    with pytest.raises(InputError, match=f"picture: {said}"):
        image_size(head, "picture")


def test_a_hundred_million_pixels_are_the_most() -> None:
    assert image_size(b"P5 10000 10000 255\n", "largest.pgm") == (10_000, 10_000)
    with pytest.raises(InputError):
        image_size(b"P5 10001 10000 255\n", "larger.pgm")


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_dots_per_inch_become_pixels_per_metre(kind: str) -> None:
    found = pixels_per_metre(_by_pillow(kind, dpi=(300, 150)))
    # PNG has whole pixels per metre.
    assert found == pytest.approx((300 / 0.0254, 150 / 0.0254), abs=0.5)


def test_a_jpeg_may_count_by_the_centimetre() -> None:
    data = bytearray(_by_pillow("JPEG", dpi=(120, 60)))
    assert data[13] == 1  # dots per inch
    data[13] = 2
    assert pixels_per_metre(bytes(data)) == pytest.approx((12000.0, 6000.0))
    data[13] = 0
    assert pixels_per_metre(bytes(data)) is None


@pytest.mark.parametrize(
    "data",
    [
        FILES[".bmp"],
        FILES[".png"],
        _by_pillow("PNG", dpi=(300, 150))[:40],
        FILES[".jpg"][:2] + FILES[".jpg"][20:],  # no JFIF header
        b"\xff\xd8\xff\xda\x00\x04",
        FILES["progressive jpeg behind fill bytes"][:3],
        _by_pillow("PNG", dpi=(300, 150)).replace(struct.pack(">I", 11811), bytes(4), 1),
    ],
)
def test_without_a_resolution_there_is_none(data: bytes) -> None:
    assert pixels_per_metre(data) is None


def test_a_tiff_of_several_pages_is_refused_but_not_one_with_a_preview() -> None:
    """OpenCV reads the first page of a stack without a word."""

    stack = _by_pillow("TIFF", save_all=True, append_images=[pillow.fromarray(PICTURE[::2, ::2])])
    with pytest.raises(InputError, match="picture: has several pages, expected a single image"):
        image_size(stack, "picture")
    order = "<" if stack[:2] == b"II" else ">"
    # The second page as a smaller copy of the first one: its first tag becomes NewSubfileType = 1.
    first = struct.unpack_from(order + "I", stack, 4)[0]
    count = struct.unpack_from(order + "H", stack, first)[0]
    second = struct.unpack_from(order + "I", stack, first + 2 + 12 * count)[0]
    preview = bytearray(stack)
    struct.pack_into(order + "HHII", preview, second + 2, 254, 4, 1, 1)
    assert image_size(bytes(preview), "picture") == (WIDTH, HEIGHT)

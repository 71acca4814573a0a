"""Images of unknown origin: sizes and lengths are checked before OpenCV sees them."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.files import decode_image, image_size, read_image, write_image

from .hostile import refusal

READERS = (
    "visuohaptic.core.files:read_image(path)",
    "visuohaptic.tracking:Template.from_file(path, width_m=0.1)",
    "visuohaptic.io.maps._map_image:read_map_image(path)",
    "visuohaptic.io.depth.depth_images:read_depth(path, __import__('visuohaptic.io').io.DepthEncoding())",
)


def _chunk(kind: bytes, body: bytes, length: int | None = None) -> bytes:
    return (
        struct.pack(">I", len(body) if length is None else length)
        + kind
        + body
        + struct.pack(">I", zlib.crc32(kind + body))
    )


def _png(width: int, height: int, *, depth: int = 8, rows: int = 60, idat: int | None = None) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    pixels = zlib.compress((b"\0" + bytes(width * depth // 8)) * rows if width < 1000 else bytes(100))
    return (
        b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", pixels, idat) + _chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("length", [0xFFFFFFFF, 0x7FFFFFFF, 10_000])
def test_a_chunk_longer_than_its_file_is_refused(tmp_path, reader, length):
    path = tmp_path / "x.png"
    depth = 16 if "read_depth" in reader else 8
    path.write_bytes(_png(60, 60, depth=depth, idat=length))
    assert path.stat().st_size < 300
    refusal(reader, path)


@pytest.mark.parametrize("reader", READERS)
def test_a_size_of_10_gigapixels_is_refused(tmp_path, reader):
    path = tmp_path / "x.png"
    path.write_bytes(_png(100_000, 100_000))
    assert "100000 x 100000" in refusal(reader, path)


def _pixels() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (50, 70, 3), dtype=np.uint8)


@pytest.mark.parametrize("kind", ["png", "jpg", "bmp", "ppm", "tiff", "webp"])
def test_whole_files_are_read_as_opencv_does(tmp_path, kind):
    path = tmp_path / f"x.{kind}"
    assert cv2.imwrite(str(path), _pixels())
    assert image_size(path.read_bytes(), path) == (70, 50)
    np.testing.assert_array_equal(read_image(path), cv2.imread(str(path)))
    np.testing.assert_array_equal(read_image(path, "grey"), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))


@pytest.mark.parametrize("kind", ["png", "jpg", "bmp", "webp"])
def test_cut_files_are_refused(tmp_path, kind):
    """A decoder would fill the missing half with grey."""
    path = tmp_path / f"x.{kind}"
    cv2.imwrite(str(path), _pixels())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    for check in (True, False):
        with pytest.raises(InputError, match=rf"x.{kind}: (is truncated|is a damaged image)"):
            read_image(path, check_pixels=check)


def test_what_a_camera_appends_to_a_photograph_does_no_harm():
    done, data = cv2.imencode(".jpg", _pixels())
    assert done
    assert decode_image(data.tobytes() + b"maker's notes", "x").shape == (50, 70, 3)


def test_a_wrong_checksum_and_a_wrong_number_of_pixels_are_refused():
    data = _png(60, 60)
    assert decode_image(data, "x").shape == (60, 60)
    damaged = bytearray(data)
    damaged[50] ^= 1
    with pytest.raises(InputError, match="checksum"):
        decode_image(bytes(damaged), "x", check_pixels=False)
    with pytest.raises(InputError, match="has 3599 bytes of pixels, expected 3660"):
        decode_image(_png(60, 60, rows=59), "x")
    with pytest.raises(InputError, match=r"has \d{5,7} bytes of pixels, expected 3660"):
        decode_image(_png(60, 60, rows=100_000), "x")


def test_photographs_are_turned_only_when_asked():
    """EXIF orientation 6: the camera was held upright."""
    done, data = cv2.imencode(".jpg", _pixels())
    assert done
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    photo = data[:2].tobytes() + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:].tobytes()
    assert decode_image(photo, "x", "grey").shape == (50, 70)
    assert decode_image(photo, "x", "grey", upright=True).shape == (70, 50)


def test_a_compressed_ros_image_goes_through_the_same_gate():
    with pytest.raises(InputError, match="camera: is truncated"):
        decode_image(memoryview(_png(60, 60, idat=0xFFFFFFFF)), "camera", check_pixels=False)


@pytest.mark.parametrize("name", ["depth", "depth.xyz"])
def test_an_image_of_no_known_kind_is_refused_with_those_that_are(name, tmp_path):
    with pytest.raises(InputError, match=r"found suffix '\.\w*', expected \.png, \.jpg or \.webp"):
        write_image(tmp_path / name, np.zeros((4, 4), np.uint8))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["png", "pgm", "tiff"])
@pytest.mark.parametrize("bits", [10, 12])
def test_pixels_of_12_bits_are_not_reduced_to_16_grey_levels(tmp_path, kind, bits):
    """Cameras store them in 16 bits without scaling: the upper byte has almost nothing of the picture."""
    grey = np.random.default_rng(1).integers(0, 256, (20, 30), dtype=np.uint16)
    path = tmp_path / f"x.{kind}"
    assert cv2.imwrite(str(path), grey << (bits - 8))
    with pytest.raises(
        InputError, match=r"has 16-bit pixels up to \d+, of which \d+ grey levels would remain"
    ):
        read_image(path)
    np.testing.assert_array_equal(read_image(path, "unchanged"), grey << (bits - 8))
    assert cv2.imwrite(str(path), grey << 8)
    np.testing.assert_array_equal(read_image(path), grey)
    assert cv2.imwrite(str(path), 0 * grey)
    assert not read_image(path, "grey").any()


@pytest.mark.parametrize("white", [63, 4095])
def test_a_pgm_whose_white_is_not_that_of_its_bits_is_refused(tmp_path, white):
    """OpenCV ignores its maximum: the picture would be dark."""
    path = tmp_path / "x.pgm"
    pixels = np.full((4, 6), white, ">u2" if white > 255 else "u1")
    path.write_bytes(f"P5\n6 4\n{white}\n".encode() + pixels.tobytes())
    with pytest.raises(InputError, match=f"maxval: found '{white}', expected"):
        read_image(path)

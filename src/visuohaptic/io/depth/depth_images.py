"""Depth images: 16-bit PNG and OpenEXR, with scale, invalid values and the F200's rotated bits."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt16

from ...core.errors import InputError
from ...core.files import decode_image, image_size, read_bytes, write_image
from ...core.ranges import NON_NEGATIVE, POSITIVE, check_order, check_ranges, within
from ._exr import decode_exr

#: Supported file formats.
DEPTH_SUFFIXES = (".png", ".exr")
#: Largest value of a 16-bit image that is a depth; the next one means "not measured".
MAX_UNITS = 65534


@dataclass(frozen=True, slots=True)
class DepthEncoding:
    """Conversion of pixel values to metres: ``depth_m = value * scale_m``."""

    scale_m: float = field(default=0.001, metadata=POSITIVE)  #: size of one unit of the file [m]
    #: the file's 16-bit words are rotated left by this many bits (RealSense F200: 3)
    bit_rotation: int = field(default=0, metadata=within(0, 15))
    invalid: tuple[int, ...] = (0, 65535)  #: values for "not measured", after the rotation
    min_m: float = field(default=0.05, metadata=NON_NEGATIVE)  #: minimum depth of a valid measurement
    max_m: float = 20.0  #: maximum depth of a valid measurement

    def __post_init__(self) -> None:
        check_ranges(self)
        check_order(self, "min_m", "max_m")


def read_depth(
    path: Path | str, encoding: DepthEncoding, *, size: tuple[int, int] | None = None
) -> Float[np.ndarray, "rows columns"]:
    """Depth along the optical axis [m], float32; NaN where not measured.

    The integrity of the file is checked first (for PNG, every checksum), because image
    decoders fill missing data with zeros.

    Parameters
    ----------
    path
        16-bit PNG, or OpenEXR.
    encoding
        Meaning of the pixel values.
    size
        Required image width and height [px].

    Raises
    ------
    InputError
        The file is missing, has another format or size, is damaged, or hardly any
        of its depths are within the range of the encoding.
    """
    path = Path(path)
    data = read_bytes(path)
    if data[:4] == b"v/1\x01":
        values = decode_exr(data, str(path))
        invalid = ~np.isfinite(values) | (values <= 0)
    else:
        words = _png_words(path, data, size)
        if turn := encoding.bit_rotation:
            words = (words >> turn) | (words << (16 - turn))
        invalid = np.isin(words, np.array(encoding.invalid, dtype=np.int64)) | (words == 0)
        values = words.astype(np.float32)
    _check_size(path, values.shape[1], values.shape[0], size)
    depth = values * np.float32(encoding.scale_m)
    depth[invalid] = np.nan
    with np.errstate(invalid="ignore"):
        outside = (depth < encoding.min_m) | (depth > encoding.max_m)
    measured = depth.size - int(invalid.sum())
    if measured and outside.sum() > 0.9 * measured:
        middle = float(np.median(depth[~invalid]))
        raise InputError(
            path,
            f"its median depth is {middle:.3g} m, expected {encoding.min_m} to {encoding.max_m} m",
            remedy=f"check depth_scale_m ({encoding.scale_m:g}) and bit_rotation ({encoding.bit_rotation})",
        )
    depth[outside] = np.nan
    return depth


def _png_words(path: Path, data: bytes, size: tuple[int, int] | None) -> UInt16[np.ndarray, "rows columns"]:
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise InputError(path, f"begins with {data[:8]!r}, expected a PNG or OpenEXR image")
    width, height = image_size(data, path)
    _check_size(path, width, height, size)
    if len(data) < 26 or (data[24], data[25]) != (16, 0):
        raise InputError(path, "is not a PNG of one 16-bit channel", remedy="depth images are 16-bit grey")
    words = decode_image(data, path, "unchanged")
    if words.dtype != np.uint16 or words.ndim != 2:
        raise InputError(path, "is a damaged PNG: it cannot be decoded")
    return words


def _check_size(path: Path, width: int, height: int, size: tuple[int, int] | None) -> None:
    if size is not None and (width, height) != size:
        raise InputError(
            path, f"has {width} x {height}, expected {size[0]} x {size[1]} of the camera", field="size"
        )


def write_depth(path: Path | str, depth_m: Float[np.ndarray, "rows columns"], scale_m: float = 0.001) -> None:
    """Write depth as a 16-bit PNG; NaN and out-of-range values become 0.

    Parameters
    ----------
    path
        File that is created or replaced.
    depth_m
        Depth along the optical axis, shape (rows, columns) [m].
    scale_m
        Size of one unit of the file [m].
    """
    with np.errstate(invalid="ignore"):
        units = np.rint(np.asarray(depth_m, dtype=np.float64) / scale_m)
        units = np.where((units > 0) & (units <= MAX_UNITS), units, 0).astype(np.uint16)
    write_image(path, units)

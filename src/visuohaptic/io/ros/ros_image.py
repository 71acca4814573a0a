"""Conversion of ROS images and camera models."""

from __future__ import annotations

import re
import struct
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32, UInt8

from ...core import Camera, InputError, check_choice
from ...core.files import check_image_size, decode_image, upper_bytes
from .mcap_records import McapMessage

#: Topics of rectified images, as image_proc names them.
_RECTIFIED = re.compile(r"(/|_)rect(_[^/]*)?$")
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
    # Two pixels share their colour, after or before their brightness; newer and older names of ROS.
    "yuyv": (2, 1, "COLOR_YUV2BGR_YUY2"),
    "yuv422_yuy2": (2, 1, "COLOR_YUV2BGR_YUY2"),
    "uyvy": (2, 1, "COLOR_YUV2BGR_UYVY"),
    "yuv422": (2, 1, "COLOR_YUV2BGR_UYVY"),
    # ROS names a Bayer pattern by its first row; OpenCV by the second row's second and third pixel.
    "bayer_rggb8": (1, 1, "COLOR_BayerBG2BGR"),
    "bayer_bggr8": (1, 1, "COLOR_BayerRG2BGR"),
    "bayer_gbrg8": (1, 1, "COLOR_BayerGR2BGR"),
    "bayer_grbg8": (1, 1, "COLOR_BayerGB2BGR"),
}


def decode_raw(message: Any, where: str) -> UInt8[np.ndarray, "rows columns *colour"]:
    """Grey or BGR image, 8 bit, from a ``sensor_msgs/Image``.

    Row padding (``step``) is removed; for 16-bit images, the
    upper 8 bits are kept; Bayer patterns and the colours of ``yuyv`` and ``uyvy`` are interpolated.

    Parameters
    ----------
    message
        Decoded message.
    where
        File and topic, for messages.

    Raises
    ------
    InputError
        The encoding is unknown, size and data are inconsistent, or 16-bit values are not scaled
        (:func:`.upper_bytes`).
    """
    width, height = int(message.width), int(message.height)
    encoding = str(message.encoding)
    check_choice(where, _ENCODINGS, encoding, field="encoding")
    channels, depth, conversion = _ENCODINGS[encoding]
    if channels == 2 and width % 2:
        raise InputError(where, f"found {width}, expected an even number for {encoding}", field="width")
    rows = _rows(message, where, width * channels * depth)
    if depth == 2:
        kind = ">u2" if message.is_bigendian else "<u2"
        rows = upper_bytes(np.ascontiguousarray(rows).view(kind), where)
    image = np.ascontiguousarray(rows if channels == 1 else rows.reshape(height, width, channels))
    if conversion:
        import cv2

        image = cv2.cvtColor(image, getattr(cv2, conversion))
    # ``frombuffer`` returns a read-only view of the message, but a frame owns its pixels.
    return image if image.flags.writeable else image.copy()


def _rows(message: Any, where: str, used: int) -> UInt8[np.ndarray, "rows bytes"]:
    """The used bytes of every row of a ``sensor_msgs/Image``, without padding; a view of the message."""
    width, height, step = int(message.width), int(message.height), int(message.step)
    check_image_size(where, width, height)
    if step < used:
        raise InputError(
            where,
            f"found {step} bytes per row, expected at least {used} for {message.encoding}",
            field="step",
        )
    data = np.frombuffer(memoryview(message.data), dtype=np.uint8)
    # The padding of the last row may be missing.
    if data.size < step * (height - 1) + used:
        raise InputError(
            where, f"found {data.size} bytes, expected {step * height} = {step} x {height}", field="data"
        )
    return np.lib.stride_tricks.as_strided(data, (height, used), (step, 1), writeable=False)


def decode_depth(message: Any, where: str) -> Float32[np.ndarray, "rows columns"]:
    """Depth [m] of a ``sensor_msgs/Image``: ``16UC1`` in mm or ``32FC1`` in m (REP 118); NaN where not measured.

    ``mono16`` is taken as ``16UC1``: Intel's recorder writes it.

    Parameters
    ----------
    message
        Decoded message.
    where
        Topic, for messages.

    Raises
    ------
    InputError
        It is not a depth image, or size and data are inconsistent.
    """
    kinds = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
    encoding = str(message.encoding)
    check_choice(where, kinds, encoding, field="encoding")
    kind = np.dtype((">" if message.is_bigendian else "<") + kinds[encoding])
    rows = np.ascontiguousarray(_rows(message, where, int(message.width) * kind.itemsize))
    depth_m = rows.view(kind).astype(np.float32)
    if encoding != "32FC1":
        depth_m *= np.float32(1e-3)
    # Not measured is 0 in 16UC1 and NaN or infinite in 32FC1, by convention.
    depth_m[~(np.isfinite(depth_m) & (depth_m > 0))] = np.nan
    return depth_m


def decode_compressed_depth(message: Any, where: str) -> Float32[np.ndarray, "rows columns"]:
    """Depth [m] of a ``sensor_msgs/CompressedImage`` of ROS's ``compressed_depth_image_transport``; NaN where not measured.

    A PNG of millimetres, or of quantised inverse depths, follows a header of 12 bytes: format and two parameters.

    Parameters
    ----------
    message
        Decoded message.
    where
        Topic, for messages.

    Raises
    ------
    InputError
        It is not such a depth image, or its PNG is damaged.
    """
    encoding, data = str(message.format).partition(";")[0].strip(), bytes(message.data)
    check_choice(where, ("16UC1", "32FC1"), encoding, field="encoding")
    if len(data) <= 12:
        raise InputError(where, f"found {len(data)} bytes, expected a header and a PNG", field="data")
    values = decode_image(data[12:], where, "unchanged")
    if values.dtype != np.uint16 or values.ndim != 2:
        raise InputError(where, "is not a PNG of one 16-bit channel", field="data")
    depth_m = values.astype(np.float32)
    if encoding == "16UC1":
        depth_m *= np.float32(1e-3)
    else:
        scale, offset = struct.unpack_from("<2f", data, 4)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            depth_m = np.where(values > 0, np.float32(scale) / (depth_m - np.float32(offset)), np.nan)
    depth_m[~(np.isfinite(depth_m) & (depth_m > 0))] = np.nan
    return depth_m.astype(np.float32)


def image_stamp_ns(message: McapMessage) -> int:
    """Timestamp of the header [ns], the first field of both image messages, without decoding the pixels.

    Parameters
    ----------
    message
        As recorded; its recording time if the stamp is zero.
    """
    order: Literal["little", "big"] = "little" if len(message.data) >= 12 and message.data[1] & 1 else "big"
    seconds = int.from_bytes(message.data[4:8], order, signed=True)
    nanoseconds = int.from_bytes(message.data[8:12], order)
    if seconds <= 0 and nanoseconds == 0:
        return message.log_time_ns
    return seconds * 1_000_000_000 + nanoseconds


def camera_from_message(message: Any, where: str, topic: str = "") -> Camera:
    """Camera model of a ``sensor_msgs/CameraInfo``.

    Parameters
    ----------
    message, where
        As in :func:`.decode_raw`.
    topic
        Topic of the images. Rectified ones (``image_rect``, ``image_rect_color``) have the matrix of the projection
        and no distortion: the message describes the raw ones, too, by ROS convention.

    Raises
    ------
    InputError
        The distortion model is not supported, or the numbers are not valid for a camera.
    """
    if message.distortion_model not in ("", "plumb_bob", "rational_polynomial"):
        raise InputError(
            where,
            f"found {message.distortion_model!r}, expected plumb_bob or rational_polynomial",
            field="distortion_model",
        )
    distortion = np.array(message.d, dtype=np.float64)
    matrix = np.array(message.k, dtype=np.float64).reshape(3, 3)
    projection = np.array(message.p, dtype=np.float64).reshape(3, 4)[:, :3]
    if _RECTIFIED.search(topic.removesuffix("/compressed")) and projection[0, 0] > 0:
        matrix, distortion = projection, np.zeros(0)
    return Camera(
        int(message.width),
        int(message.height),
        matrix,
        distortion if distortion.size else np.zeros(5),
        name=str(message.header.frame_id) or "camera",
    )

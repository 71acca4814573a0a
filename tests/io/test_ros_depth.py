"""Depth images of ROS against arrays packed by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.io.ros.ros_image import decode_compressed_depth, decode_depth


def message(data: bytes, encoding: str, step: int, **more: object) -> SimpleNamespace:
    fields = {"width": 2, "height": 2, "is_bigendian": 0} | more
    return SimpleNamespace(data=data, encoding=encoding, step=step, **fields)


@pytest.mark.parametrize("order", ["<", ">"])
def test_millimetres_with_padded_rows(order: str) -> None:
    data = np.array([[1000, 0, 7], [250, 65535, 7]], order + "u2").tobytes()
    depth_m = decode_depth(message(data, "16UC1", 6, is_bigendian=int(order == ">")), "/depth")
    np.testing.assert_allclose(depth_m, [[1.0, np.nan], [0.25, 65.535]], rtol=1e-6)
    assert depth_m.dtype == np.float32


def test_intels_recorder_calls_it_mono16() -> None:
    data = np.array([[1000, 0], [250, 500]], "<u2").tobytes()
    np.testing.assert_allclose(
        decode_depth(message(data, "mono16", 4), "/depth"), [[1.0, np.nan], [0.25, 0.5]]
    )


@pytest.mark.parametrize(
    ("form", "data", "words"),
    [
        ("rgb8; jpeg", bytes(20), "encoding"),
        ("16UC1; compressedDepth", bytes(12), "found 12 bytes, expected a header and a PNG"),
        ("16UC1; compressedDepth", bytes(40), "/depth"),
    ],
)
def test_compressed_depth_that_is_none_is_refused(form: str, data: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        decode_compressed_depth(SimpleNamespace(format=form, data=data), "/depth")


def test_metres_and_what_is_not_measured() -> None:
    data = np.array([[1.5, np.inf], [np.nan, -1.0]], "<f4").tobytes()
    np.testing.assert_array_equal(
        decode_depth(message(data, "32FC1", 8), "/depth"), [[1.5, np.nan], [np.nan] * 2]
    )


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (message(bytes(8), "mono8", 4), "encoding"),
        (message(bytes(7), "16UC1", 4), "found 7 bytes, expected 8"),
        (message(bytes(8), "16UC1", 3), "found 3 bytes per row, expected at least 4 for 16UC1"),
        (message(b"", "16UC1", 4, width=0), "found 0 x 2"),
        (message(b"", "32FC1", 4, height=2**31), "expected a positive size of at most"),
    ],
)
def test_what_is_none_is_refused(broken: SimpleNamespace, words: str) -> None:
    with pytest.raises(InputError, match=words):
        decode_depth(broken, "/depth")

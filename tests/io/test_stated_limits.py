"""Numbers of file formats, by other means."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import constants

from visuohaptic.core import InputError
from visuohaptic.core.files import decode_image
from visuohaptic.io.depth import pixel_model
from visuohaptic.io.depth.depth_images import write_depth
from visuohaptic.io.sinks import table_reader


def test_all_values_of_a_depth_image_but_the_largest_are_depths(tmp_path: Path) -> None:
    """0 and 65535 mean that nothing was measured."""
    write_depth(tmp_path / "a.png", np.array([[1.0, 65534.0, 65535.0, 70000.0]]) * 1e-3, scale_m=1e-3)
    written = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert written.tolist() == [[1, 65534, 0, 0]]


def test_a_scale_shows_mass_in_standard_gravity() -> None:
    factors = {name: factor for name, _, factor in table_reader._REFERENCE_COLUMNS}
    assert factors == {
        "force_N": pytest.approx(1.0),
        "mass_g": pytest.approx(1e-3 * constants.g),
        "mass_kg": pytest.approx(constants.g),
    }


@pytest.mark.parametrize(("highest", "read"), [(4095, False), (4096, True), (4700, True)])
def test_pixels_of_twelve_bits_in_sixteen_are_refused(highest: int, read: bool) -> None:
    pixels = np.full((8, 8), 100, np.uint16)
    pixels[3, 4] = highest
    data = cv2.imencode(".png", pixels)[1].tobytes()
    if read:
        assert decode_image(data, "a.png", "grey")[3, 4] == highest >> 8
        return
    with pytest.raises(InputError, match="16-bit pixels"):
        decode_image(data, "a.png", "grey")


def test_a_profile_of_16_megabytes_may_accompany_a_picture() -> None:
    """Private chunks beside 8 x 8 pixels; with 18 MB the file has far more than they need."""
    whole = cv2.imencode(".png", np.full((8, 8), 100, np.uint8))[1].tobytes()
    for megabytes, read in ((16.0, True), (18.0, False)):
        body = bytes(int(megabytes / 4.0 * 1e6))  # OpenCV reads chunks of up to 8 MB
        chunk = struct.pack(">I", len(body)) + b"teSt" + body + struct.pack(">I", zlib.crc32(b"teSt" + body))
        data = whole[:33] + 4 * chunk + whole[33:]  # after the header
        if read:
            assert decode_image(data, "a.png", "grey").shape == (8, 8)
        else:
            with pytest.raises(InputError, match="far more"):
                decode_image(data, "a.png", "grey")


def test_networks_are_trained_with_the_mean_and_the_deviation_of_imagenet() -> None:
    """In levels of 8 bits, as other collections of models state them."""
    assert 255.0 * np.array(pixel_model._MEAN) == pytest.approx([123.675, 116.28, 103.53])
    assert 255.0 * np.array(pixel_model._SIGMA) == pytest.approx([58.395, 57.12, 57.375])

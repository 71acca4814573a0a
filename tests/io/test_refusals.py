"""Errors of readers that no test of the format covers."""

from __future__ import annotations

import struct
import wave
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera
from visuohaptic.core.files import decode_image, encode_image
from visuohaptic.io import read_scans
from visuohaptic.io.depth import read_poses
from visuohaptic.io.frames import VideoSource
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.meshes import load_mesh
from visuohaptic.io.recovery import recover
from visuohaptic.io.sinks import read_force_table, read_reference_table

#: No text in any encoding that is read here.
BYTES = b"t_s,force_N\n\xff\xfe,1\n"


def _glb(document: bytes) -> bytes:
    return (
        b"glTF"
        + struct.pack("<II", 2, 20 + len(document))
        + struct.pack("<I", len(document))
        + b"JSON"
        + document
    )


def _sound(path: Path) -> Path:
    """A file with a sound track and no pictures."""
    with wave.open(str(path), "wb") as stream:
        stream.setparams((1, 2, 8000, 0, "NONE", ""))
        stream.writeframes(bytes(1600))
    return path


def _folder(path: Path) -> Path:
    """A depth sequence whose writer was stopped before its first frame."""
    path.mkdir()
    (path / "sequence.yaml.part").write_text("sensor: unknown\n")
    (path / "poses.txt.part").write_text("# t_s tx_m ty_m tz_m qx qy qz qw, camera to world\n")
    return path


def _map(path: Path, image: str) -> Path:
    head = f"image: {image!r}\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
    path.write_text(head + "occupied_thresh: 0.65\nfree_thresh: 0.2\n")
    path.with_name("bright.pgm").write_bytes(b"P5\n2 1\n100\n\x05\xff")
    return path


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("read", "make", "said"),
    [
        (read_scans, lambda at: _written(at / "s.csv", BYTES), "is not UTF-8 text"),
        (read_force_table, lambda at: _written(at / "f.csv", BYTES), "is not UTF-8 text"),
        (read_reference_table, lambda at: _written(at / "r.csv", b"\xff" + BYTES), "is not UTF-8 text"),
        (read_poses, lambda at: _written(at / "p.txt", b"1 0 0 0 0 0 0 0.5\n"), ""),
        (VideoSource, lambda at: at / "absent.mp4", "is not a file"),
        (VideoSource, lambda at: _sound(at / "sound.wav"), "has no video stream"),
        (recover, lambda at: _folder(at / "scan"), "contains no complete frame"),
        (OccupancyMap.load, lambda at: _map(at / "m.yaml", "bright.pgm"), "has pixels up to 255, its maxval is 100"),
        (OccupancyMap.load, lambda at: _map(at / "m.yaml", "a" * 300), "which cannot be a file"),
        (load_mesh, lambda at: _written(at / "m.glb", bytes(40)), "does not start with a GLB header"),
        (load_mesh, lambda at: _written(at / "m.glb", _glb(b"[1, 2")), "has no valid glTF document"),
        (load_mesh, lambda at: _written(at / "m.glb", _glb(b'{"nodes": [{"children": [[]]}]}')), "are not numbers"),
        (
            load_mesh,
            lambda at: _written(
                at / "m.ply",
                b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
                b"property float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n" + bytes(20),
            ),
            "is truncated: 20 of 24 bytes of its vertex",
        ),
    ],
)  # fmt: skip
def test_a_file_is_refused_with_its_reason(
    read: Callable[[Path], Any], make: Callable[[Path], Path], said: str, tmp_path: Path
) -> None:
    path = make(tmp_path)
    if not said:  # a quaternion of another length is no pose, and says so where it is used
        (found,) = read(path)
        assert found.pose is None
        assert "a quaternion of length 0.5" in found.problem
        return
    with pytest.raises(InputError) as caught:
        read(path)
    assert said in str(caught.value)
    assert str(path.parent) in str(caught.value)


def test_an_image_of_many_bytes_and_one_of_a_wrong_checksum_are_refused() -> None:
    png = encode_image(np.zeros((4, 4), np.uint8), "png", where="test")
    with pytest.raises(InputError, match="far more than 4 x 4 pixels need"):
        decode_image(png + bytes(17 << 20), "big.png", "grey")
    place = png.index(b"IDAT") + 6
    with pytest.raises(InputError, match="the checksum of its chunk b'IDAT' is wrong"):
        decode_image(png[:place] + bytes([png[place] ^ 1]) + png[place + 1 :], "flipped.png", "grey")


def test_a_camera_needs_nine_finite_numbers() -> None:
    for matrix in (np.eye(2), np.full((3, 3), np.nan)):
        with pytest.raises(InputError, match="expected 3 x 3 numbers"):
            Camera(640, 480, matrix)

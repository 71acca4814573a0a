"""Errors of readers that no test of the format covers."""

from __future__ import annotations

import struct
import tracemalloc
import wave
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera
from visuohaptic.core.files import decode_image, encode_image, write_image
from visuohaptic.io import ImageFolderSource, open_source, read_scans
from visuohaptic.io.depth import DepthEncoding, read_depth, read_poses
from visuohaptic.io.depth._exr import decode_exr
from visuohaptic.io.frames import VideoSource
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.meshes import load_mesh, read_ply
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


def _images(folder: Path, times: str | None = None) -> Path:
    """Two grey images, and a table of their times."""
    folder.mkdir()
    for name in ("a.png", "b.png"):
        write_image(folder / name, np.zeros((4, 6), np.uint8))
    if times is not None:
        (folder / "times.csv").write_text(times)
    return folder


def _scan(path: Path, row: str) -> Path:
    head = "t_s,x_m,y_m,yaw_rad,angle_min_rad,angle_step_rad,range_min_m,range_max_m,r0,r1\n"
    path.write_text(head + row)
    return path


def _pgm(path: Path, pixels: bytes) -> Path:
    _map(path, "m.pgm")
    path.with_name("m.pgm").write_bytes(pixels)
    return path


PLY = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n{}end_header\n{}\n"
MANY_PARTS = b'{"meshes": [{"primitives": [' + b'{"attributes": {}},' * 10_000 + b'{"attributes": {}}]}]}'
PACKED = b'{"extensionsRequired": ["KHR_draco_mesh_compression"]}'
TWO_PARENTS = b'{"nodes": [{"children": [2]}, {"children": [2]}, {}]}'


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (lambda at: ImageFolderSource(at), "found no images, expected files with"),
        (lambda at: ImageFolderSource(at / "absent"), "cannot be read"),
        (lambda at: ImageFolderSource(_images(at / "i")), "its images have no times; add times.csv"),
        (lambda at: ImageFolderSource(_images(at / "i", "file,s\na.png,1\n")), "header: found columns file, s; missing: t_s"),
        (lambda at: ImageFolderSource(_images(at / "i", "t_s\n")), "has a header but no rows"),
        (lambda at: ImageFolderSource(_images(at / "i", "t_s\n1\nx\n")), "line 3, t_s: found 'x', expected a number"),
        (lambda at: ImageFolderSource(_images(at / "i", "t_s\n1\n")), "found 1 times, expected 2, one for each image"),
        (lambda at: ImageFolderSource(_images(at / "i", "file,t_s\nc.png,1\n")), "'c.png' is not an image of the folder"),
        (lambda at: ImageFolderSource(_images(at / "i", "t_s\n1\nnan\n")), "line 3, t_s: found 'nan', expected a finite number"),
        (lambda at: ImageFolderSource(_images(at / "i"), rate_Hz=10, start_s=2, stop_s=1), "found start 2 s and stop 1 s"),
        (lambda at: ImageFolderSource(_images(at / "i"), rate_Hz=10, start_s=2), "it lasts 0.100 s"),
        (lambda at: open_source("0", start_s=1.0), "0: is live: start and stop are for recordings only"),
        (lambda at: open_source(_written(at / "e.mp4", b"")), "is empty"),
        (lambda at: open_source(_written(at / "e.mp4", b"text, no video")), "is not a readable video"),
        (lambda at: read_scans(_written(at / "s.csv", b"a,b\n")), "header: found columns a, b; missing: t_s"),
        (lambda at: read_scans(_written(at / "s.txt", b"")), "found '.txt', expected .mcap, .db3 or .csv"),
        (lambda at: read_scans(_scan(at / "s.csv", "")), "has a header but no rows"),
        (lambda at: read_scans(_scan(at / "s.csv", "0,0,0,0,0,0.1,0.05,30,1\n")), "line 2: found 9 fields, expected 10"),
        (lambda at: read_scans(_scan(at / "s.csv", "0,0,0,a,0,0.1,0.05,30,1,1\n")), "line 2, yaw_rad: found 'a', expected a number"),
        (lambda at: read_scans(_scan(at / "s.csv", "0,0,0,nan,0,0.1,0.05,30,1,1\n")), "line 2, yaw_rad: found 'nan', expected a finite number"),
        (lambda at: read_scans(_scan(at / "s.csv", "0,0,0,0,0,0.1,0.05,30,1,-1\n")), "line 2: found a distance below 0"),
        (lambda at: read_scans(_scan(at / "s.csv", "0,0,0,0,0,0,0.05,30,1,1\n")), "line 2: found 0, expected a non-zero step"),
        (lambda at: list(read_poses(_written(at / "p.txt", b"1 2 3 4 5\n"))), "found 5 numbers, expected 8 (TUM), 4, 12 or 16"),
        (lambda at: list(read_poses(_written(at / "p.txt", b"1 0 0 0\n0 1 0 0\n"))), "has an incomplete 4 x 4 matrix"),
        (lambda at: read_depth(_images(at / "i") / "a.png", DepthEncoding()), "is not a PNG of one 16-bit channel"),
        (lambda at: read_depth(_written(at / "a.png", b"JFIF" * 9), DepthEncoding()), "expected a PNG or OpenEXR image"),
        (lambda at: OccupancyMap.load(_images(at / "i") / "a.png"), "is an image, expected the YAML file of a map"),
        (lambda at: OccupancyMap.load(_map(at / "m.yaml", "none.pgm")), "found 'none.pgm', which does not exist"),
        (lambda at: OccupancyMap.load(_map(at / "m.yaml", "../m.pgm")), "expected a file inside the folder of the map"),
        (lambda at: OccupancyMap(np.zeros((2, 2), np.int8), 0.1).save(at / "m.txt"), "expected a name that ends in .yaml"),
        (lambda at: OccupancyMap.load(_pgm(at / "m.yaml", b"P5\n2 1\n0\n\0\0")), "maxval: found 0, expected 1 to 65535"),
        (lambda at: OccupancyMap.load(_pgm(at / "m.yaml", b"P5\n2 1\nx")), "expected a number in the PGM header"),
        (lambda at: OccupancyMap.load(_pgm(at / "m.yaml", b"P5\n2 1\n255x\0\0")), "after the PGM header, expected a space"),
        (lambda at: OccupancyMap.load(_pgm(at / "m.yaml", b"P2\n2 1\n255\n1 b\n")), "has a pixel that is not a number"),
        (lambda at: OccupancyMap.load(_pgm(at / "m.yaml", b"P2\n2 1\n255\n1 2 3\n")), "has more than 2 pixels"),
        (lambda at: OccupancyMap.load(_pgm(at / "m.yaml", b"P2\n2 1\n255\n1 # 2\n")), "has 1 pixels, expected 2"),
        (lambda at: OccupancyMap.load(_pgm(at / "m.yaml", b"P2\n2 1\n255\n1 70000\n")), "has pixels from 1 to 70000"),
        (lambda at: OccupancyMap.load(_pgm(at / "m.yaml", encode_image(np.zeros((4, 4), np.uint8), "webp"))), "expected a PBM, PGM, PPM, PNG, BMP or JPEG image"),
        (lambda at: load_mesh(_written(at / "m.ply", PLY.format("", "0 0 0").encode())), "has no triangles"),
        (lambda at: read_ply(_written(at / "m.ply", PLY.format("", "0 nan 0").encode())), "has a vertex that is not finite"),
        (lambda at: read_ply(_written(at / "m.ply", b"solid")), "is not a PLY file: no header of ply ... end_header"),
        (lambda at: read_ply(_written(at / "m.ply", PLY.format("property wide w\n", "0 0 0 0").encode())), "is a damaged PLY file"),
        (lambda at: load_mesh(_written(at / "m.xyz", b"1")), "found suffix '.xyz', expected one of"),
        (lambda at: load_mesh(_written(at / "m.stl", b"")), "is empty"),
        (lambda at: load_mesh(_written(at / "m.dae", b"<!DOCTYPE a>")), "defines XML entities, which COLLADA does not need"),
        (lambda at: load_mesh(_written(at / "m.dae", b"<instance_node" * 10_001)), "nested instances, expected at most"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(TWO_PARENTS))), "nodes: a node has two parents, expected a tree"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(b'{"nodes": [{"children": [0]}]}'))), "nodes: a node is below itself"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(b'{"nodes": [{}, {"children": [2]}, {"children": [1]}]}'))), "below itself"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(b'{"accessors": [{"count": 1e9}]}'))), "more elements than fit"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(MANY_PARTS))), "has 10001 parts of meshes, expected at most 10000"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(b'{"buffers": [{"uri": "../key.bin"}]}'))), "buffers: refers to '../key.bin', expected the data in"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(b'{"bufferViews": [{"buffer": 0, "byteOffset": -4}]}'))), "outside of the file"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(b'{"bufferViews": [{"buffer": 0, "byteLength": 9}]}'))), "outside of the file"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(PACKED))), "compressed by KHR_draco_mesh_compression; export it without"),
        (lambda at: load_mesh(_written(at / "m.glb", _glb(b'{"nodes": [' + b"{}," * 10_000 + b"{}]}"))), "has 10001 nodes"),
        (lambda at: recover(_written(at / "t.csv", b"a,b\n1,2\n")), "does not end with .part; name the new file with --out"),
        (lambda at: recover(_written(at / "t.csv.part", b"a,b\n"), _written(at / "t.csv", b"")), "exists; name a new file"),
        (lambda at: recover(_written(at / "t.csv.part", b"a\nb\n")), "is neither a table, nor MCAP; it cannot be recovered"),
    ],
)  # fmt: skip
def test_a_source_is_refused_with_its_reason(read: Callable[[Path], Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def _exr(
    channels: Sequence[tuple[str, int, int]] = (("Y", 1, 1), ("Z", 2, 1)),
    *,
    packing: int = 0,
    version: int = 2,
    window: tuple[int, int, int, int] = (0, 5, 1, 6),
    place: int = 0,
    short: int = 0,
    zeros: int = 0,
) -> bytes:
    """Two rows of two pixels: half floats 0 and floats 1.5, 2.5, 3.5, 4.5 in one block, ``zeros`` too long."""
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iIii", kind, 0, step, step) for name, kind, step in channels
    )
    fields = {
        "channels": listed + b"\0",
        "compression": bytes([packing]),
        "dataWindow": struct.pack("<4i", *window),
    }
    data = struct.pack("<II", 20000630, version)
    for name, value in fields.items():
        data += name.encode() + b"\0type\0" + struct.pack("<I", len(value)) + value
    data += b"\0"
    rows = [struct.pack("<2H2f", 0, 0, *values) for values in ((1.5, 2.5), (3.5, 4.5))]
    blocks = rows if packing in (0, 1, 2) else [b"".join(rows) + bytes(zeros)]
    for k, raw in enumerate(blocks):
        if packing:
            values = np.frombuffer(raw[0::2] + raw[1::2], np.uint8).astype(np.int16)
            coded = np.r_[values[0], np.diff(values) + 128].astype(np.uint8)
            runs = np.zeros((len(coded), 2), np.uint8)  # each a run of one
            runs[:, 1] = coded
            blocks[k] = runs.tobytes() if packing == 1 else zlib.compress(coded.tobytes())
    at = len(data) + 8 * len(blocks)
    places, body = b"", b""
    for k, block in enumerate(blocks):
        places += struct.pack("<Q", place or at + len(body))
        body += struct.pack("<iI", window[1] + k, len(block)) + block
    return (data + places + body)[: -short or None]


@pytest.mark.parametrize("packing", [0, 1, 2, 3])
def test_the_depth_of_an_exr_is_its_channel_z(packing: int) -> None:
    np.testing.assert_array_equal(decode_exr(_exr(packing=packing), "a.exr"), [[1.5, 2.5], [3.5, 4.5]])
    first = (("A", 1, 1), ("R", 2, 1))  # without Z and Y it is the first colour
    np.testing.assert_array_equal(decode_exr(_exr(first, packing=packing), "a.exr")[1], [3.5, 4.5])


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"PNG", "begins with b'PNG', expected an OpenEXR file"),
        (_exr(version=2 | 0x200), "is a tiled, deep or multi-part OpenEXR file, expected scan lines"),
        (_exr(packing=4), "is packed by OpenEXR's method 4, expected none, RLE, ZIPS or ZIP"),
        (_exr(window=(0, 5, -1, 6)), "its header declares 0 x 2, expected a positive size"),
        (_exr([("Z", 9, 1)]), "its channel 'Z' is subsampled or of unknown type 9"),
        (_exr([("Z", 2, 2)]), "its channel 'Z' is subsampled"),
        (_exr([("A", 2, 1)]), "has channels A, expected one of Z, Y, R"),
        (_exr(place=10**6), "has a block at byte 1000000, expected one within its"),
        (_exr(short=3), "is a truncated OpenEXR file: 9 of 12 bytes at row 1"),
        (_exr([("Z", 2, 1)]), "is a damaged OpenEXR file (12 bytes in a block of 8)"),
        (_exr()[:30], "is a damaged OpenEXR file"),
        (_exr()[:8] + b"\0", "is a damaged OpenEXR file: no channels, compression, dataWindow"),
    ],
)
def test_a_damaged_exr_is_refused(data: bytes, said: str) -> None:
    with pytest.raises(InputError) as caught:
        decode_exr(data, "a.exr")
    assert said in str(caught.value)


def test_a_block_that_unpacks_to_far_more_than_its_rows_is_refused_before_memory_is_taken() -> None:
    bomb = _exr(packing=3, zeros=1 << 24)  # 16 MiB in 16 KiB
    assert len(bomb) < 1 << 16
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="is a damaged OpenEXR file"):
            decode_exr(bomb, "a.exr")
        assert tracemalloc.get_traced_memory()[1] < 1 << 18
    finally:
        tracemalloc.stop()


def test_an_image_of_many_bytes_and_one_of_a_wrong_checksum_are_refused() -> None:
    png = encode_image(np.zeros((4, 4), np.uint8), "png", where="test")
    with pytest.raises(InputError, match="far more than 4 x 4 pixels need"):
        decode_image(png + bytes(17 << 20), "big.png", "grey")
    place = png.index(b"IDAT") + 6
    with pytest.raises(InputError, match="the checksum of its chunk b'IDAT' is wrong"):
        decode_image(png[:place] + bytes([png[place] ^ 1]) + png[place + 1 :], "flipped.png", "grey")


def test_a_camera_needs_nine_finite_numbers() -> None:
    for matrix in (np.eye(2), np.full((3, 3), np.nan)):
        with pytest.raises(InputError, match=r"expected finite numbers \(3, 3\)"):
            Camera(640, 480, matrix)

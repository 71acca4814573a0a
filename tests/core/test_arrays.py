"""NPZ and NPY of unknown origin: sizes in the headers are checked before memory is allocated."""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.files import read_npy, read_npz

from .hostile import refusal

READERS = (
    "visuohaptic.deformation.maps.map_file:load_map(path)",
    "visuohaptic.recognition.visual.prior_file:load_prior(path)",
    "visuohaptic.recognition:load_feature_set(path)",
    "visuohaptic.tracking.contours.stripe:StripeModel.load(path)",
    "visuohaptic.core.files:read_npz(path, 'a set of arrays')",
)


def _header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape!r}, }}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def _npz(path: Path, **members: bytes) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)


@pytest.mark.parametrize("reader", READERS)
def test_a_header_of_terabytes_is_one_line(tmp_path, reader):
    path = tmp_path / "x.npz"
    promised = _header((10**12,)) + b"\0" * 80  # 8 TB
    names = ("vertices_m", "card", "features", "format", "table")
    _npz(path, **dict.fromkeys(names, promised))
    refusal(reader, path)


def test_small_files_do_not_unpack_to_large_arrays(tmp_path):
    """Two arrays of 0.7 GB of zeros each: in the budget alone, not together; 1.4 MB on the disk."""
    path = tmp_path / "x.npz"
    count, block = 700_000_000, bytes(10_000_000)
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    head = _header((count,), "|u1")
    # After a full flush a block is compressed as the one before it.
    packed = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    packed += (packer.compress(block) + packer.flush(zlib.Z_FULL_FLUSH)) * (
        count // len(block)
    ) + packer.flush()
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("a.npy", "b.npy"):
            archive.writestr(name, packed)
            info = archive.getinfo(name)
            info.compress_type, info.file_size = zipfile.ZIP_DEFLATED, len(head) + count
    assert path.stat().st_size < 3_000_000
    assert "more than 1073741824 bytes" in refusal(
        "visuohaptic.core.files:read_npz(path, 'a set of arrays')", path
    )


def test_flipped_bytes_are_one_class_of_error(tmp_path):
    """Every byte of a small file in turn: what is read is what was written, or refused."""
    path = tmp_path / "x.npz"
    arrays = {"a": np.arange(300.0), "b": np.array(["x", "yz"])}
    np.savez_compressed(path, **arrays)
    whole = path.read_bytes()
    refused = []
    for place in range(0, len(whole), 3):
        damaged = bytearray(whole)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        try:
            found = read_npz(path, "a set of arrays")
        except InputError as error:
            refused.append(str(error))
            continue
        for name in arrays.keys() & found.keys():
            np.testing.assert_array_equal(found[name], arrays[name])
    assert len(refused) > 100
    assert all("is not a set of arrays" in text and "\n" not in text for text in refused)


def test_python_objects_names_and_contents_are_checked(tmp_path):
    path = tmp_path / "x.npz"
    np.savez(path, a=np.array([{}, None]))
    with pytest.raises(InputError, match="Python objects"):
        read_npz(path, "a set of arrays")
    np.savez(path, a=np.zeros(3))
    with pytest.raises(InputError, match="b: is missing in a map; write it anew"):
        read_npz(path, "a map", names=("a", "b"), remedy="write it anew")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.txt", "hello")
    with pytest.raises(InputError, match="not an array"):
        read_npz(path, "a set of arrays")


def test_whole_files_are_read_as_numpy_does(tmp_path):
    path = tmp_path / "x.npz"
    arrays = {
        "a": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
        "b": np.array(True),
        "c": np.zeros((0, 2)),
    }
    np.savez(path, **arrays)
    found = read_npz(path, "a set of arrays")
    assert found.keys() == arrays.keys()
    for name, values in arrays.items():
        np.testing.assert_array_equal(found[name], values)
        assert found[name].dtype == values.dtype
    np.save(tmp_path / "x.npy", arrays["a"])
    np.testing.assert_array_equal(read_npy(tmp_path / "x.npy", "points"), arrays["a"])


def test_a_cut_npy_is_refused(tmp_path):
    data = io.BytesIO()
    np.save(data, np.arange(10.0))
    path = tmp_path / "x.npy"
    path.write_bytes(data.getvalue()[:-8])
    with pytest.raises(InputError, match="the header declares 80 bytes, found 72"):
        read_npy(path, "points")
    path.write_bytes(_header((10**12,)))
    refusal("visuohaptic.core.files:read_npy(path, 'points')", path)

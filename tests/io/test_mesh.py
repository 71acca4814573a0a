from __future__ import annotations

import contextlib
import json
import struct
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.io.meshes import FORMATS, load_mesh

trimesh = pytest.importorskip("trimesh")


@pytest.fixture(scope="module")
def box() -> trimesh.Trimesh:
    return trimesh.creation.box((0.1, 0.05, 0.2))


@pytest.mark.parametrize("kind", FORMATS)
def test_all_formats_hold_the_same_triangles(kind: str, tmp_path: Path, box: trimesh.Trimesh) -> None:
    path = tmp_path / f"box{kind}"
    box.export(path)
    found = load_mesh(path)
    assert len(found.faces) == 12
    np.testing.assert_allclose(np.ptp(found.vertices, axis=0), (0.1, 0.05, 0.2), rtol=1e-5)


def glb(document: dict[str, object]) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.stl", b"", "empty"),
        ("a.xyz", b"0 0 0", "suffix"),
        ("a.stl", b"solid nothing\nendsolid", "STL|triangles"),
        ("a.stl", b"\0" * 80 + struct.pack("<I", 4_000_000_000), "STL|no triangles"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", "OBJ|triangle"),
        ("a.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "three coordinates|OBJ"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "finite|OBJ"),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n",
            "more than fit into the file",
        ),
        ("a.ply", b"plywood", "PLY"),
        ("a.glb", b"glTF", "GLB header"),
        ("a.glb", glb({"accessors": [{"count": 10**12, "componentType": 5126, "type": "VEC3"}]}), "fit into"),
        ("a.glb", glb({"nodes": [{"children": [1]}, {"children": [1]}]}), "two parents"),
        ("a.glb", glb({"nodes": [{"children": [{}]}]}), "numbers"),
        ("a.dae", b'<!DOCTYPE a [<!ENTITY b "c">]><COLLADA/>', "entities"),
        ("a.dae", b"<COLLADA>" + b"<instance_node/>" * 30 + b"</COLLADA>", "instances"),
        ("a.dae", b"<COLLADA><", "DAE"),
    ],
)
def test_bad_files_are_one_line(name: str, data: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputError, match=said) as caught:
        load_mesh(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_mesh(tmp_path / "none.stl")


@pytest.mark.parametrize("kind", FORMATS)
def test_damaged_files_never_raise_anything_else(kind: str, tmp_path: Path, box: trimesh.Trimesh) -> None:
    whole = tmp_path / f"whole{kind}"
    box.export(whole)
    data = np.frombuffer(whole.read_bytes(), np.uint8)
    rng = np.random.default_rng(0)
    path = tmp_path / f"hurt{kind}"
    for turn in range(12):
        hurt = data.copy()
        if turn % 3 == 0:
            hurt = hurt[: rng.integers(1, len(hurt))]
        else:
            hurt[rng.integers(0, len(hurt), 1 + turn)] = rng.integers(0, 256, 1 + turn)
        path.write_bytes(hurt.tobytes())
        with contextlib.suppress(InputError):
            found = load_mesh(path)
            assert np.isfinite(found.vertices[found.faces]).all()


def test_copies_of_the_largest_of_many_meshes_are_counted(tmp_path: Path) -> None:
    """Thousand boxes once, and a sphere 400 times: on the average, each mesh is there once."""
    scene = trimesh.Scene()
    for number in range(1000):
        scene.add_geometry(trimesh.creation.box(), geom_name=f"box{number}", node_name=f"box{number}")
    scene.add_geometry(trimesh.creation.icosphere(5), geom_name="sphere", node_name="sphere")
    for number in range(399):
        scene.graph.update(frame_to=f"copy{number}", geometry="sphere", matrix=np.eye(4))
    (tmp_path / "many.glb").write_bytes(scene.export(file_type="glb"))
    assert (tmp_path / "many.glb").stat().st_size < 1_000_000
    with pytest.raises(InputError, match=f"has {400 * 20480 + 12000} triangles, expected at most 2000000"):
        load_mesh(tmp_path / "many.glb")

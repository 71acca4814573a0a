"""Defects of mesh files are named in the file's own numbering."""

from __future__ import annotations

from pathlib import Path

import pytest

from visuohaptic.core import InputError
from visuohaptic.io.meshes import load_mesh

POINTS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
FACES = "f 1 2 3\nf 1 2 4\nf 2 3 4\n"
PLY = """\
ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 1 2
3 0 1 3
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (POINTS + FACES.replace("f 2 3 4", "f 2 3 9"), "line 7: face 3 refers to vertex 9, the file has 4"),
        (POINTS + FACES.replace("f 2 3 4", "f 2/1 3/1 0/1"), "face 3 refers to vertex 0, OBJ counts from 1"),
        (POINTS + FACES.replace("f 2 3 4", "f -1 -2 -9"), "face 3 refers to vertex -9, the file has 4"),
        (POINTS + FACES.replace("f 2 3 4", "f 2 x 4"), "face 3 refers to vertex 'x'"),
        (POINTS.replace("v 0 1 0", "v 0 one 0") + FACES, "line 3: vertex 3 is '0 one 0'"),
        (POINTS, "no triangles"),
    ],
)
def test_obj(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        load_mesh(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (PLY.replace("3 0 1 3", "3 0 1 7"), "face 2 refers to vertex 7, expected 0 to 3"),
        (PLY.replace("3 0 1 3\n", ""), "1 of 2 lines of face"),
        (PLY.replace("1 0 0", "1 zero 0"), "vertex 2 is '1 zero 0'"),
        (PLY.replace("3 0 1 3", "3 0 one 3"), "face 2 is '3 0 one 3', expected a count and vertex numbers"),
    ],
)
def test_ply(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.ply"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        load_mesh(path)


def test_stl(tmp_path: Path) -> None:
    import trimesh

    data = trimesh.creation.box().export(file_type="stl")
    path = tmp_path / "bad.stl"
    path.write_bytes(data[:-75])
    with pytest.raises(InputError, match="declares 12 triangles, but the file has room for 10"):
        load_mesh(path)


def test_whole_files_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(POINTS + "f 1// 2// 3//\nf -4 -3 -1\n# f 0 0 0\n")
    (tmp_path / "b.ply").write_text(PLY)
    for name in ("a.obj", "b.ply"):
        found = load_mesh(tmp_path / name)
        assert len(found.faces) == 2

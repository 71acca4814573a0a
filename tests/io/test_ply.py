"""PLY files of every form, written by trimesh or by hand."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from visuohaptic.core import InputError
from visuohaptic.io.meshes import PlyMesh, read_ply, write_ply

SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
#: A square is a fan of two triangles.
FAN = [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_meshes_of_trimesh(tmp_path: Path, encoding: str) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1)
    mesh.visual.vertex_colors = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 4), np.uint8)
    (tmp_path / "a.ply").write_bytes(trimesh.exchange.ply.export_ply(mesh, encoding=encoding))
    found = read_ply(tmp_path / "a.ply")
    np.testing.assert_allclose(found.vertices_m, mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(found.faces, mesh.faces)
    np.testing.assert_array_equal(found.colors, mesh.visual.vertex_colors[:, :3])


def test_trimesh_reads_what_is_written(tmp_path: Path) -> None:
    colors = np.arange(12, dtype=np.uint8).reshape(4, 3)
    mesh = PlyMesh(SQUARE, np.array(FAN), colors, {"score": np.array([0.5, 1.5, np.nan, -2.0])})
    write_ply(tmp_path / "a.ply", mesh)
    theirs = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_array_equal(theirs.vertices, SQUARE)
    np.testing.assert_array_equal(theirs.faces, FAN)
    np.testing.assert_array_equal(theirs.visual.vertex_colors[:, :3], colors)
    ours = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(ours.fields["score"], mesh.fields["score"])
    np.testing.assert_array_equal(ours.colors, colors)
    write_ply(tmp_path / "points.ply", PlyMesh(SQUARE, np.zeros((0, 3), np.int64)))
    points = read_ply(tmp_path / "points.ply")
    assert (points.faces.shape, points.colors) == ((0, 3), None)


@pytest.mark.parametrize(
    ("kind", "code", "given"),
    [("uchar", "B", 51), ("ushort", "H", 51 * 257), ("float", "f", 0.2), ("float", "f", 51.0)],
)
@pytest.mark.parametrize("form", ["ascii", "binary_big_endian"])
def test_colours_of_any_type_are_the_same(
    tmp_path: Path, kind: str, code: str, given: float, form: str
) -> None:
    """A fifth of white; fractions of white in floating point, unless there are greater numbers."""
    white = {51: 255, 0.2: 1.0}.get(given, 65535)
    rows = [(0.0, 0.0, 0.0, given, 0, white), (1.0, 0.0, 0.0, given, 0, white)]
    head = ["ply", f"format {form} 1.0", "element vertex 2", *(f"property float {axis}" for axis in "xyz")]
    head += [*(f"property {kind} {name}" for name in ("red", "green", "blue")), "end_header"]
    body = (
        "\n".join(" ".join(map(str, row)) for row in rows).encode() + b"\n"
        if form == "ascii"
        else b"".join(struct.pack(f">3f3{code}", *row) for row in rows)
    )
    (tmp_path / "a.ply").write_bytes("\n".join(head).encode() + b"\n" + body)
    assert read_ply(tmp_path / "a.ply").colors.tolist() == [[51, 0, 255]] * 2


def _file(form: str, properties: list[str], faces: list[tuple[Any, ...]], codes: str) -> bytes:
    """The square with faces whose properties are given; of binary ones the codes of :mod:`struct`."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    head = ["ply", f"format {form} 1.0", "comment made by hand", "element vertex 4"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += [f"element face {len(faces)}", *(f"property {one}" for one in properties), "end_header"]
    text = "\n".join(head) + "\n"
    if not order:
        rows = [*SQUARE.tolist(), *faces]
        return (text + "\n".join(" ".join(map(str, row)) for row in rows) + "\n").encode()
    body = b"".join(struct.pack(f"{order}3f", *row) for row in SQUARE)
    return text.encode() + body + b"".join(struct.pack(order + codes, *row) for row in faces)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    ("properties", "faces", "codes", "expected"),
    [
        (["list uchar int vertex_indices"], [(3, 0, 1, 2), (3, 0, 2, 3)], "B3i", FAN),
        (["list uchar int vertex_index"], [(4, 0, 1, 2, 3)], "B4i", FAN),
        # A number before the list, numbers and another list behind it.
        (["uchar flags", "list uchar int vertex_indices"], [(3, 4, 0, 1, 2, 3)], "BB4i", FAN),
        (
            ["list uchar uint vertex_indices", "float area", "list uchar short parts"],
            [(4, 0, 1, 2, 3, 1.0, 2, 1, 1)],
            "B4IfB2h",
            FAN,
        ),
        (["list uchar int vertex_indices"], [(2, 0, 1)], "B2i", []),
    ],
)
def test_faces_of_every_form(
    tmp_path: Path, form: str, properties: list[str], faces: list[Any], codes: str, expected: list[Any]
) -> None:
    (tmp_path / "a.ply").write_bytes(_file(form, properties, faces, codes))
    found = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.vertices_m, SQUARE)
    np.testing.assert_array_equal(found.faces, np.array(expected, np.int64).reshape(-1, 3))


LIST = ["list uchar int vertex_indices"]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"solid x", "is not a PLY file"),
        (b"ply\nformat ascii 1.0\n", "is not a PLY file"),
        (_file("ascii", LIST, [(3, 0, 1, 2)], "").replace(b"ascii 1.0", b"utf8 1.0"), "found format 'utf8'"),
        (
            _file("ascii", LIST, [(3, 0, 1, 2)], "").replace(b"vertex 4", b"vertex 999999"),
            "more than fit into",
        ),
        (_file("ascii", LIST, [(3, 0, 1, 4)], ""), "face 1 refers to vertex 4, expected 0 to 3"),
        (_file("ascii", LIST, [(3, 0, -1, 2)], ""), "face 1 refers to vertex -1"),
        (_file("ascii", LIST, [(4, 0, 1, 2)], ""), "is a damaged PLY file"),
        (_file("ascii", LIST, [(-1, 0, 1, 2)], ""), "face 1 is '-1 0 1 2'"),
        (_file("ascii", LIST, [(3, 0, 1, "two")], ""), "is a damaged PLY file"),
        (_file("ascii", LIST, [(3, 0, 1, 2)], "").replace(b"face 1", b"face 2"), "1 of 2 lines of face"),
        (_file("ascii", LIST, [(3, 0, 1, 2)], "").replace(b"1.0 1.0 0.0", b"1.0 nan 0.0"), "is not finite"),
        (
            _file("ascii", LIST, [(3, 0, 1, 2)], "").replace(b"float z", b"float w"),
            "no vertices with x, y and z",
        ),
        (_file("ascii", LIST, [(3, 0, 1, 2)], "").replace(b"float z", b"quad z"), "is a damaged PLY file"),
        (_file("binary_little_endian", LIST, [(3, 0, 1, 2)], "B3i")[:-40], "is truncated: "),
        (_file("binary_little_endian", LIST, [(3, 0, 1, 2)], "B3i")[:-2], "is a damaged PLY file"),
        (_file("binary_little_endian", ["list int int vertex_index"], [(1001, 0)], "2i"), "a list of 1001"),
    ],
)
def test_what_is_no_ply_file_is_refused(tmp_path: Path, data: bytes, said: str) -> None:
    (tmp_path / "a.ply").write_bytes(data)
    with pytest.raises(InputError, match=said):
        read_ply(tmp_path / "a.ply")

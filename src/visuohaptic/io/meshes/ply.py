"""PLY files: surfaces and points with colour and other values per vertex."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from ...core.errors import InputError
from ...core.files import MAX_FILE_BYTES, atomic_path, read_bytes

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_POLYGONS = ("vertex_indices", "vertex_index")
#: A polygon with more corners indicates damage.
_MAX_CORNERS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class PlyMesh:
    """Contents of a PLY file."""

    vertices_m: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]  #: polygons are split into triangle fans
    colors: UInt8[np.ndarray, "v 3"] | None = None  #: red, green, blue
    #: Other values of each vertex by name, e.g. ``score``.
    fields: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(slots=True)
class _Element:
    name: str
    count: int
    #: Name, type, and for lists the type of the preceding length.
    properties: list[tuple[str, str, str]] = field(default_factory=list)


def read_ply(path: Path | str) -> PlyMesh:
    """Read a text or binary PLY file.

    Parameters
    ----------
    path
        PLY file.

    Raises
    ------
    InputError
        The file is missing, damaged, or has vertices without finite x, y, z.
    """
    path = Path(path)
    mesh = parse_ply(path, read_bytes(path, MAX_FILE_BYTES))
    if not np.isfinite(mesh.vertices_m).all():
        raise InputError(path, "has a vertex that is not finite")
    return mesh


def parse_ply(path: Path, data: bytes) -> PlyMesh:
    """Parse a complete file, including non-finite vertices; ``path`` is for messages.

    Parameters
    ----------
    path
        File name, for errors.
    data
        Content of the file.
    """
    try:
        kind, elements, place = _header(path, data)
        order = "<" if kind == "binary_little_endian" else ">"
        found = (
            _text_body(data[place:], elements)
            if kind == "ascii"
            else _binary_body(path, data, place, elements, order)
        )
        types = {name: code for one in elements if one.name == "vertex" for name, code, _ in one.properties}
        return _assembled(path, found, types)
    except InputError:
        raise
    except (ValueError, IndexError, KeyError, OverflowError, MemoryError, TypeError) as error:
        raise InputError(path, f"is a damaged PLY file ({error})") from error


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], int]:
    end = data.find(b"end_header", 0, 1 << 16)
    if data[:3] != b"ply" or end < 0:
        raise InputError(path, "is not a PLY file: no header of ply ... end_header")
    place = data.index(b"\n", end) + 1
    kind, elements = "", list[_Element]()
    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format":
            kind = words[1]
        elif words[0] == "element":
            elements.append(_Element(words[1], int(words[2])))
            if not 0 <= elements[-1].count <= len(data):
                raise InputError(path, f"found {words[2]} of {words[1]}, more than fit into the file")
        elif words[0] == "property" and elements:
            if words[1] == "list":
                elements[-1].properties.append((words[4], _TYPES[words[3]], _TYPES[words[2]]))
            else:
                elements[-1].properties.append((words[2], _TYPES[words[1]], ""))
    if kind not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise InputError(path, f"found format {kind!r}, expected ascii or binary")
    return kind, elements, place


_Columns = dict[str, dict[str, np.ndarray]]


def _text_body(data: bytes, elements: list[_Element]) -> _Columns:
    lines = iter(data.decode("ascii", errors="replace").split("\n"))
    found: _Columns = {}
    for element in elements:
        rows: list[list[str]] = []
        while len(rows) < element.count:
            line = next(lines, None)
            if line is None:
                raise ValueError(f"{len(rows)} of {element.count} lines of {element.name}")
            if words := line.split():
                rows.append(words)
        if any(length for _, _, length in element.properties):
            found[element.name] = _fans(_by_row(_text_polygon, rows, element))
        else:
            table = np.array(_by_row(_text_numbers, rows, element)).reshape(len(rows), -1)
            found[element.name] = {
                name: table[:, column] for column, (name, _, _) in enumerate(element.properties)
            }
    return found


def _by_row(
    read: Callable[[list[str], _Element], np.ndarray], rows: list[list[str]], element: _Element
) -> list[np.ndarray]:
    """Values of each line of an element; an invalid line is reported with its line number in the file."""
    found = []
    for number, words in enumerate(rows, 1):
        try:
            found.append(read(words, element))
        except (ValueError, IndexError) as error:
            said = f"{element.name} {number} is {' '.join(words)[:40]!r}, expected "
            lists = any(length for _, _, length in element.properties)
            raise ValueError(said + ("a count and vertex numbers" if lists else "numbers")) from error
    return found


def _text_numbers(words: list[str], element: _Element) -> np.ndarray:
    if len(words) < len(element.properties):
        raise ValueError
    return np.array(words[: len(element.properties)], dtype=np.float64)


def _text_polygon(words: list[str], element: _Element) -> np.ndarray:
    """Vertices in one line of an element with lists."""
    place, polygon = 0, list[str]()
    for name, _, length in element.properties:
        count = _list_length(int(words[place])) if length else 1
        place += 1 if length else 0
        if place + count > len(words):
            raise ValueError
        polygon = words[place : place + count] if name in _POLYGONS else polygon
        place += count
    return np.array(polygon, dtype=np.int64)


def _list_length(count: int) -> int:
    if not 0 <= count <= _MAX_CORNERS:
        raise ValueError(f"a list of {count}")
    return count


def _binary_body(path: Path, data: bytes, place: int, elements: list[_Element], order: str) -> _Columns:
    found: _Columns = {}
    for element in elements:
        if not any(length for _, _, length in element.properties):
            kind = np.dtype([(name, order + code) for name, code, _ in element.properties])
            size = kind.itemsize * element.count
            if place + size > len(data):
                raise InputError(
                    path, f"is truncated: {len(data) - place} of {size} bytes of its {element.name}"
                )
            table = np.frombuffer(data, kind, element.count, place)
            found[element.name] = {name: table[name] for name, _, _ in element.properties}
            place += size
        else:
            values, place = _binary_lists(data, place, element, order)
            found[element.name] = values
    return found


def _binary_lists(
    data: bytes, place: int, element: _Element, order: str
) -> tuple[dict[str, np.ndarray], int]:
    """Lists: at once if all are triangles, otherwise one by one."""
    name, code, length = element.properties[0]
    if len(element.properties) == 1 and name in _POLYGONS:
        kind = np.dtype([("n", order + length), ("at", order + code, (3,))])
        if place + kind.itemsize * element.count <= len(data):
            table = np.frombuffer(data, kind, element.count, place)
            if (table["n"] == 3).all():
                values = {"corners": table["at"].astype(np.int64), "number": np.arange(1, element.count + 1)}
                return values, place + kind.itemsize * element.count
    polygons = []
    for _ in range(element.count):
        for name, code, length in element.properties:
            count = _list_length(int(np.frombuffer(data, order + length, 1, place)[0])) if length else 1
            place += np.dtype(length).itemsize if length else 0
            found = np.frombuffer(data, order + code, count, place)
            place += found.nbytes
            if name in _POLYGONS:
                polygons.append(found.astype(np.int64))
    return _fans(polygons), place


def _fans(polygons: list[np.ndarray]) -> dict[str, np.ndarray]:
    """Polygons as triangles, and the polygon index of each."""
    triangles = [
        (number, polygon[0], polygon[k], polygon[k + 1])
        for number, polygon in enumerate(polygons, 1)
        for k in range(1, len(polygon) - 1)
    ]
    table = np.array(triangles, dtype=np.int64).reshape(-1, 4)
    return {"corners": table[:, 1:], "number": table[:, 0]}


def _assembled(path: Path, found: _Columns, types: dict[str, str]) -> PlyMesh:
    vertex = found.get("vertex", {})
    if not {"x", "y", "z"} <= set(vertex):
        raise InputError(path, "has no vertices with x, y and z")
    vertices = np.column_stack([vertex[axis] for axis in "xyz"]).astype(np.float64)
    face = found.get("face", {}) or _fans([])
    faces = face["corners"]
    for row, k in np.argwhere((faces < 0) | (faces >= len(vertices)))[:1]:
        said = (
            f"face {face['number'][row]} refers to vertex {faces[row, k]}, expected 0 to {len(vertices) - 1}"
        )
        raise InputError(path, said)
    colors = None
    if {"red", "green", "blue"} <= set(vertex):
        colors = np.column_stack([vertex[name] for name in ("red", "green", "blue")])
        kind = types["red"]
        if kind == "u2" or (kind[0] == "f" and colors.size and 0 < colors.max() <= 1):
            # 16 bit, or fractions of white.
            colors = np.rint(colors * (255.0 / (65535.0 if kind == "u2" else 1.0)))
        colors = np.clip(colors, 0, 255).astype(np.uint8)
    known = {"x", "y", "z", "red", "green", "blue"}
    fields = {name: np.asarray(values, np.float64) for name, values in vertex.items() if name not in known}
    return PlyMesh(vertices, faces, colors, fields)


def write_ply(path: Path | str, mesh: PlyMesh) -> None:
    """Write a binary PLY file, atomically; coordinates and other values are float32.

    Parameters
    ----------
    path
        File that is created or replaced.
    mesh
        Vertices [m], faces and other values by vertex.
    """
    columns: list[tuple[str, str, np.ndarray]] = [
        (axis, "float", mesh.vertices_m[:, k]) for k, axis in enumerate("xyz")
    ]
    if mesh.colors is not None:
        names = ("red", "green", "blue")
        columns += [(name, "uchar", mesh.colors[:, k]) for k, name in enumerate(names)]
    columns += [(name, "float", np.asarray(values)) for name, values in mesh.fields.items()]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(mesh.vertices_m)}"]
    head += [f"property {kind} {name}" for name, kind, _ in columns]
    if len(mesh.faces):
        head += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices"]
    table = np.zeros(len(mesh.vertices_m), dtype=[(name, "<" + _TYPES[kind]) for name, kind, _ in columns])
    for name, _, values in columns:
        table[name] = values
    faces = np.zeros(len(mesh.faces), dtype=[("n", "u1"), ("at", "<i4", (3,))])
    faces["n"] = 3
    faces["at"] = mesh.faces
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(("\n".join([*head, "end_header"]) + "\n").encode())
        stream.write(table.tobytes())
        stream.write(faces.tobytes())

"""Check of binary glTF files before a library reads them: what they declare must fit into the file and into memory."""

from __future__ import annotations

import json
import struct
from collections import Counter
from pathlib import Path
from typing import Any

from ..errors import InputError, brief

#: Nodes of a file, and vertices of all of them: each node is a copy of its mesh.
MAX_NODES, MAX_VERTICES = 10_000, 6_000_000
#: Corners of their triangles: a closed surface has two triangles for each vertex.
MAX_CORNERS = 6 * MAX_VERTICES
#: Extensions that compress what the file then has no place for.
_PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


def check_glb(path: Path, data: bytes) -> None:
    """Reject a binary glTF file that would expand far beyond its size, or whose parts lie outside of it.

    Parameters
    ----------
    path
        Name of the file, for messages.
    data
        Its content.

    Raises
    ------
    InputError
        It is not such a file; or declares more than fits into it, nodes that do not form a tree, or too many of them; or refers to
        data in other files, or is compressed.
    """
    if len(data) < 20 or data[:4] != b"glTF":
        raise InputError(path, "does not start with a GLB header")
    length = struct.unpack("<I", data[12:16])[0]
    try:
        document = json.loads(data[20 : 20 + length])
        _check_data(path, document, len(data) - 28 - length)
        _check_copies(path, document, len(data))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, f"has no valid glTF document ({type(error).__name__})") from error


def _check_data(path: Path, document: dict[str, Any], size: int) -> None:
    """What the accessors refer to lies in the file, of which ``size`` bytes are data."""
    for name in document.get("extensionsRequired", []):
        if name in _PACKED:
            remedy = "export it without compression"
            raise InputError(path, f"is compressed by {name}", field="extensionsRequired", remedy=remedy)
    for buffer in document.get("buffers", []):
        if "uri" in buffer:
            said = f"refers to {brief(buffer['uri'])}, expected the data in the file itself"
            raise InputError(path, said, field="buffers", remedy="export it as one binary file")
    for view in document.get("bufferViews", []):
        first, count, step = (view.get(name, 0) for name in ("byteOffset", "byteLength", "byteStride"))
        inside = type(first) is type(count) is type(step) is int and first >= 0 <= count
        if not inside or view.get("buffer") != 0 or first + count > size or step not in range(253):
            raise InputError(path, "has a part outside of the file, or with gaps", field="bufferViews")


def _check_copies(path: Path, document: dict[str, Any], size: int) -> None:
    """Nodes are a tree, and the meshes of all of them fit into memory."""
    counts = [entry["count"] for entry in document.get("accessors", [])]
    if any(type(count) is not int or not 0 <= count <= size for count in counts):
        raise InputError(path, "declares more elements than fit into the file", field="accessors")
    nodes = document.get("nodes", [])
    children = [node.get("children", []) for node in nodes]
    if any(type(child) is not int for each in children for child in each):
        raise InputError(path, "children are not numbers", field="nodes")
    parents = Counter(child for each in children for child in each)
    if max(parents.values(), default=1) > 1:
        raise InputError(path, "a node has two parents, expected a tree", field="nodes")
    reached = [number for number in range(len(nodes)) if number not in parents]
    for number in reached:  # grows while it is walked
        reached.extend(children[number])
    if len(reached) != len(nodes):
        raise InputError(path, "a node is below itself, expected a tree", field="nodes")
    copies = Counter(node["mesh"] for node in nodes if "mesh" in node)
    parts = vertices = corners = 0
    for index, mesh in enumerate(document.get("meshes", [])):
        times = max(1, copies[index])  # a mesh without a node is read once
        parts += times * len(mesh["primitives"])
        for part in mesh["primitives"]:
            if "POSITION" in part["attributes"]:
                vertices += times * counts[part["attributes"]["POSITION"]]
            if "indices" in part:
                corners += times * counts[part["indices"]]
    for found, most, what in (
        (len(nodes), MAX_NODES, "nodes"),
        (parts, MAX_NODES, "parts of meshes"),
        (vertices, MAX_VERTICES, "vertices"),
        (corners, MAX_CORNERS, "corners of triangles"),
    ):
        if found > most:
            raise InputError(path, f"has {found} {what}, expected at most {most}", field="nodes")

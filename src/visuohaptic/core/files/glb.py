"""Check of binary glTF files before a library reads them: what they declare must fit into the file and into memory."""

from __future__ import annotations

import json
import struct
from collections import Counter
from pathlib import Path

from ..errors import InputError

#: Nodes of a file, and vertices of all of them: each node is a copy of its mesh.
MAX_NODES, MAX_VERTICES = 10_000, 6_000_000
#: Corners of their triangles: a closed surface has two triangles for each vertex.
MAX_CORNERS = 6 * MAX_VERTICES


def check_glb(path: Path, data: bytes) -> None:
    """Reject a binary glTF file that would expand far beyond its size.

    Parameters
    ----------
    path
        Name of the file, for messages.
    data
        Its content.

    Raises
    ------
    InputError
        It is not such a file, or declares more than fits into it, nodes with two parents, or too many of them.
    """
    if len(data) < 20 or data[:4] != b"glTF":
        raise InputError(path, "does not start with a GLB header")
    length = struct.unpack("<I", data[12:16])[0]
    try:
        document = json.loads(data[20 : 20 + length])
        counts = [entry["count"] for entry in document.get("accessors", [])]
        nodes = document.get("nodes", [])
        children = [child for node in nodes for child in node.get("children", [])]
        copies = Counter(node["mesh"] for node in nodes if "mesh" in node)
        if any(type(count) is not int or not 0 <= count <= len(data) for count in counts):
            raise InputError(path, "declares more elements than fit into the file", field="accessors")
        vertices = corners = 0
        for index, mesh in enumerate(document.get("meshes", [])):
            times = max(1, copies[index])  # a mesh without a node is read once
            for part in mesh["primitives"]:
                if "POSITION" in part["attributes"]:
                    vertices += times * counts[part["attributes"]["POSITION"]]
                if "indices" in part:
                    corners += times * counts[part["indices"]]
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, f"has no valid glTF document ({type(error).__name__})") from error
    try:
        repeated = len(children) != len(set(children))
    except TypeError as error:
        raise InputError(path, "children are not numbers", field="nodes") from error
    if repeated:
        raise InputError(path, "a node has two parents, expected a tree", field="nodes")
    for found, most, what in (
        (len(nodes), MAX_NODES, "nodes"),
        (vertices, MAX_VERTICES, "vertices"),
        (corners, MAX_CORNERS, "corners of triangles"),
    ):
        if found > most:
            raise InputError(path, f"has {found} {what}, expected at most {most}", field="nodes")
